"""Flicker: a bank of charge traps, each of which fills and empties in its own time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from firmware_emulator.chip import Triple
from firmware_emulator.mechanisms.mechanism import SensorMechanism
from firmware_emulator.mechanisms.site import Site, Stopwatch
from firmware_emulator.world import Stimulus


@dataclass(frozen=True)
class TrappedCharges(SensorMechanism):
    """`traps` per axis, full or empty, time constants spread evenly in log(tau) from `fastest_s` to `slowest_s`.

    A trap that contributes +-a has the autocorrelation a^2 exp(-dt/tau), the bank a spectrum of 1/f between the two
    corner frequencies (McWhorter 1957). Between two looks a trap flips with probability (1 - exp(-dt/tau)) / 2. Rms of
    the bank is a sqrt(traps). Reference: a bank of 2 mg or 0.06 dps rms.
    """

    rms_g: float = 2e-3
    rms_dps: float = 0.06
    traps: int = 12
    fastest_s: float = 0.1
    slowest_s: float = 300.0

    resembles: ClassVar[tuple[str, ...]] = ("bias_instability",)

    @classmethod
    def at(cls, severity: float) -> Self:
        """Larger traps."""
        return cls(rms_g=cls.rms_g * severity, rms_dps=cls.rms_dps * severity)

    def put_on(self, site: Site) -> None:
        """A bank for each axis."""
        random, elapsed = site.run_random("traps"), Stopwatch()
        each = site.by_unit(self.rms_g, self.rms_dps) / self.traps**0.5
        constants_s = np.geomspace(self.fastest_s, self.slowest_s, self.traps)
        bank = np.where(random.random((3, self.traps)) < 0.5, -each, each)
        flips: dict[float, np.ndarray[tuple[int], np.dtype[np.float64]]] = {}

        def sensed(at_ns: int, value: Triple, stimulus: Stimulus) -> Triple:
            passed_s = elapsed(at_ns)
            if passed_s not in flips:
                flips[passed_s] = 0.5 - 0.5 * np.exp(-passed_s / constants_s)
            bank[random.random((3, self.traps)) < flips[passed_s]] *= -1.0
            dx, dy, dz = bank.sum(axis=1).tolist()
            return value[0] + dx, value[1] + dy, value[2] + dz

        site.chain.sensed.append(sensed)
