"""The regulator that feeds all chips of a kind drifts, and each of them feels its supply."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from firmware_emulator.chip import Triple
from firmware_emulator.element import stream
from firmware_emulator.mechanisms.mechanism import FittedBoard, Mechanism
from firmware_emulator.mechanisms.site import Site, plus
from firmware_emulator.world import Stimulus

GRID_S = 0.1


@dataclass(frozen=True)
class SupplyDrift(Mechanism):
    """Volts away from nominal: a first-order Gauss-Markov process of `drift_v` rms and correlation time `drift_s`.

    Each axis answers with its sensitivity to the supply, which the design gives and each part varies by a tenth;
    `per_v_g` or `per_v_dps` on average. ADX-71 knows such an effect of the supply on bias. Reference: 8 mg or 0.25 dps
    rms over 20 s.
    """

    drift_v: float = 0.02
    drift_s: float = 20.0
    per_v_g: float = 0.4
    per_v_dps: float = 12.5

    place: ClassVar[str] = "design"
    resembles: ClassVar[tuple[str, ...]] = ("common_mode",)

    @classmethod
    def at(cls, severity: float) -> Self:
        """Return one with more drift."""
        return cls(drift_v=cls.drift_v * severity)

    def fit(self, board: FittedBoard, sites: Sequence[Site]) -> None:
        """One supply; axes of one design answer alike, in the sensors' own frames."""
        volts = self.volts(stream(board.seed, f"supply, run {board.run}"))
        of_design = stream(board.seed, f"supply of {sites[0].chip}").standard_normal(3)
        of_design *= math.sqrt(3) / float(np.linalg.norm(of_design))
        for site in sites:
            x, y, z = (of_design * (1 + 0.1 * site.unit_random("supply").standard_normal(3))).tolist()
            site.chain.sensed.append(answer(volts, (x, y, z), site.by_unit(self.per_v_g, self.per_v_dps)))

    def volts(self, random: np.random.Generator) -> Callable[[int], float]:
        """Deviation of the supply at any time from 0 on, straight between grid points, in whatever order asked."""
        kept = math.exp(-GRID_S / self.drift_s)
        grid = [float(random.normal(0.0, self.drift_v))]

        def at(at_ns: int) -> float:
            index, share = divmod(at_ns * 1e-9 / GRID_S, 1.0)
            while len(grid) < index + 2:
                grid.append(kept * grid[-1] + self.drift_v * math.sqrt(1 - kept * kept) * random.standard_normal())
            return grid[int(index)] * (1 - share) + grid[int(index) + 1] * share

        return at


def answer(volts: Callable[[int], float], direction: Triple, per_v: float) -> Callable[[int, Triple, Stimulus], Triple]:
    """Return what a supply adds to one sensor."""
    return lambda at_ns, value, stimulus: plus(value, direction, per_v * volts(at_ns))
