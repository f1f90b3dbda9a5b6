"""Mechanisms of the supply, and mechanisms that restart at each power-up."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from firmware_emulator.chip import Triple
from firmware_emulator.element import stream
from firmware_emulator.mechanisms.mechanism import FittedBoard, Mechanism, SensorMechanism
from firmware_emulator.mechanisms.site import ACCELEROMETERS, WHILE_SET_UP_S, Site, plus
from firmware_emulator.world import WorldStimulus

GRID_S = 0.1


@dataclass(frozen=True)
class SupplyDrift(Mechanism):
    """The regulator of all chips of a kind drifts, and each of them is sensitive to its supply.

    Deviation of the supply in volts: a first-order Gauss-Markov process of `drift_v` rms and correlation time
    `drift_s`.

    Each axis responds with its sensitivity to the supply, `per_v_g` or `per_v_dps` on average, which is given by the
    design and scatters by a tenth from part to part. ADX-71 states an effect of the supply on the bias. Reference: 8 mg
    or 0.25 dps rms over 20 s.
    """

    drift_v: float = 0.02
    drift_s: float = 20.0
    per_v_g: float = 0.4
    per_v_dps: float = 12.5

    place: ClassVar[str] = "design"
    resembles: ClassVar[tuple[str, ...]] = ("common_mode",)
    scaled: ClassVar[tuple[str, ...]] = ("drift_v",)

    def fit(self, board: FittedBoard, sites: Sequence[Site]) -> None:
        """Connect one supply to all sensors; axes of one design respond with the same sign in the sensors' frames."""
        volts = self.volts(stream(board.seed, f"supply, run {board.run}"))
        of_design = stream(board.seed, f"supply of {sites[0].chip}").standard_normal(3)
        of_design *= math.sqrt(3) / float(np.linalg.norm(of_design))
        for site in sites:
            x, y, z = (of_design * (1 + 0.1 * site.unit_random("supply").standard_normal(3))).tolist()
            site.chain.sensed.append(answer(volts, (x, y, z), site.by_unit(self.per_v_g, self.per_v_dps)))

    def volts(self, random: np.random.Generator) -> Callable[[int], float]:
        """Return a function of time in ns, from 0 on: the deviation of the supply in V, linear between grid points. It
        may be called with times in any order.
        """
        correlation = math.exp(-GRID_S / self.drift_s)
        grid = [float(random.normal(0.0, self.drift_v))]

        def at(at_ns: int) -> float:
            index, share = divmod(at_ns * 1e-9 / GRID_S, 1.0)
            while len(grid) < index + 2:
                grid.append(
                    correlation * grid[-1]
                    + self.drift_v * math.sqrt(1 - correlation * correlation) * random.standard_normal()
                )
            return grid[int(index)] * (1 - share) + grid[int(index) + 1] * share

        return at


def answer(
    volts: Callable[[int], float], direction: Triple, per_v: float
) -> Callable[[int, Triple, WorldStimulus], Triple]:
    """Return a function that adds the contribution of a supply to the signal of one sensor."""
    return lambda at_ns, value, stimulus: plus(value, direction, per_v * volts(at_ns))


@dataclass(frozen=True)
class SupplyDroop(SensorMechanism):
    """A battery whose voltage sags under load, and a sensor whose scale depends on it.

    scale = 1 - `droop` (1 - exp(-t / `sag_s`)), t since power-on: the polarisation of a cell under load.

    The bias is not affected: the bridge is ratiometric, its amplifier is not. Reference: 2 % within 40 s.
    """

    droop: float = 0.02
    sag_s: float = 40.0

    touches: ClassVar[tuple[str, ...]] = ACCELEROMETERS
    scaled: ClassVar[tuple[str, ...]] = ("droop",)

    def put_on(self, site: Site) -> None:
        """Act on the stimulus, before the unit's bias."""

        def changed_stimulus(at_ns: int, stimulus: WorldStimulus) -> WorldStimulus:
            share = 1 + self.droop * math.expm1(-at_ns * 1e-9 / self.sag_s)
            x, y, z = stimulus.force_box
            force: Triple = (x * share, y * share, z * share)
            return stimulus._replace(force_box=force)

        site.chain.stimulus.append(changed_stimulus)


@dataclass(frozen=True)
class BrownOut(SensorMechanism):
    """The supply dips, and the chip loses its configuration.

    One dip after each power-up, after an exponentially distributed time of mean `mean_s` from `WHILE_SET_UP_S` on:
    every register has its reset value, and the range is that of the EEPROM, as after power-on (BMA-52, BMA-57).

    The driver's checks may detect it. Reference: a mean of 300 s, shorter as severity grows.
    """

    mean_s: float = 300.0

    touches: ClassVar[tuple[str, ...]] = ("bma180",)  # the other chips do not measure after power-on
    resembles: ClassVar[tuple[str, ...]] = ("range_reset",)
    inverse: ClassVar[tuple[str, ...]] = ("mean_s",)

    def put_on(self, site: Site) -> None:
        """Reset the chip before it is next addressed."""
        due_ns = (WHILE_SET_UP_S + site.run_random("dip").exponential(self.mean_s)) * 1e9
        has_dipped, touched = False, site.touched.setdefault(self, set())

        def reset(at_ns: int) -> int | None:
            nonlocal has_dipped
            if has_dipped or at_ns < due_ns:
                return None
            has_dipped = True
            touched.add(site.name)
            site.note(f"browned out at {due_ns * 1e-9:.3f} s")
            return round(due_ns)

        site.links.resets.append(reset)


@dataclass(frozen=True)
class PowerOnStress(SensorMechanism):
    """The stress of the die, and therefore the bias, changes at each power-up.

    The bias of each axis is drawn at each power-up from a Laplace distribution of scale b (rms b sqrt 2) and kept until
    power-off.

    Reference: b = 5 mg or 0.2 dps.
    """

    scale_g: float = 5e-3
    scale_dps: float = 0.2

    resembles: ClassVar[tuple[str, ...]] = ("turn_on_bias",)
    scaled: ClassVar[tuple[str, ...]] = ("scale_g", "scale_dps")

    def put_on(self, site: Site) -> None:
        """Draw the bias once, at power-up."""
        x, y, z = site.run_random("stress").laplace(0.0, site.by_unit(self.scale_g, self.scale_dps), 3).tolist()

        def sensed(at_ns: int, value: Triple, stimulus: WorldStimulus) -> Triple:
            return plus(value, (x, y, z), 1.0)

        site.chain.sensed.append(sensed)


@dataclass(frozen=True)
class BiasCurrentDac(SensorMechanism):
    """One bit of the converter that sets the bias current has a random state after power-up.

    A bias-current bit that is set in a `share` of power-ups: all three axes are shifted together, by `step_g` or
    `step_dps` on average.

    This is like Gyro3 of the paper's Table 7, which started in two states. Reference: 15 mg or 0.5 dps.
    """

    step_g: float = 15e-3
    step_dps: float = 0.5
    share: float = 0.4

    resembles: ClassVar[tuple[str, ...]] = ("bistable_bias",)
    scaled: ClassVar[tuple[str, ...]] = ("step_g", "step_dps")

    def put_on(self, site: Site) -> None:
        """Shift each axis by an amount that depends on the part."""
        if site.run_random("bias current").random() >= self.share:
            return
        site.note("started in the other state")
        site.add("bias current", self.step_g, self.step_dps, lambda at_ns, stimulus: 1.0)


@dataclass(frozen=True)
class LogCreep(SensorMechanism):
    """Ageing since power-on: the bias changes with the logarithm of time, in the same way after every power-up.

    error = c log10(1 + t / `onset_s`), t since power-on, c `per_decade_g` or `per_decade_dps` on average.

    Dielectric absorption in the front end (Curie 1889, von Schweidler 1907). Reference: 4 mg or 0.15 dps a decade.
    """

    per_decade_g: float = 4e-3
    per_decade_dps: float = 0.15
    onset_s: float = 1.0
    scaled: ClassVar[tuple[str, ...]] = ("per_decade_g", "per_decade_dps")

    def put_on(self, site: Site) -> None:
        """Add the creep by the world's clock, which starts at power-on."""

        def decades(at_ns: int, stimulus: WorldStimulus) -> float:
            return math.log10(1 + at_ns * 1e-9 / self.onset_s)

        site.add("creep", self.per_decade_g, self.per_decade_dps, decades)
