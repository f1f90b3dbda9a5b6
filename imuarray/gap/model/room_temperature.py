"""Random variation of a room temperature that was not recorded: it drifts and has draughts, and biases follow it.

A log without a reference temperature, a barometer or a useful thermometer is simulated at a constant temperature. The
bias of a part changes by half a mg or some hundredths of a dps per degC (BMA-115, L3G-71). Within a tenth of a degree
this exceeds the standard error of the mean over a hundred seconds. Each replicate of a log without a recorded
temperature therefore has its own variation of temperature: a sum of waves with random phases, sizes and periods.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from imuarray.arrays import Floats, Integers, Reals
from imuarray.simulate.motion.stimulus import BoxStimulus, Motion, MotionVariant, temperature_at
from imuarray.simulate.streams import Streams

ROOM_DEGC = (0.02, 0.5)
"""Least and largest usual root mean square of the variation, in degC, drawn log-uniformly: a closed box in a quiet
room, and a room with an open door.
"""

HEAT_DEGC = (2.0, 20.0)
"""The same for a box that is heated on purpose."""

PERIODS_S = (20.0, 1800.0)
"""Shortest and longest period of a wave, in s, drawn log-uniformly: the shortest that the wall of a box does not damp,
and the cycle of a heating.
"""

WAVES = 4
"""Number of waves in the variation of temperature."""


@dataclass(frozen=True)
class RoomTemperature(MotionVariant):
    """A motion in a room whose temperature is that of `motion` plus sine waves of `amplitude_degc` with the periods
    `period_s` and phases `phase_rad`.
    """

    amplitude_degc: float
    period_s: tuple[float, ...]
    phase_rad: tuple[float, ...]

    def stimulus(self, time_ns: Integers) -> BoxStimulus:
        """Return the stimuli of the box at times (n,), with the temperature of this room."""
        stimulus = self.motion.stimulus(time_ns)
        return replace(stimulus, temperature_degc=stimulus.temperature_degc + self._wander_degc(np.asarray(time_ns)))

    def temperature_at(self, time_ns: Integers) -> Reals:
        """Return the temperature (n,) of this room at times (n,)."""
        return np.asarray(temperature_at(self.motion, time_ns) + self._wander_degc(np.asarray(time_ns)))

    def _wander_degc(self, time_ns: Integers) -> Floats:
        time_s = time_ns * 1e-9
        waves = (
            np.sin(2 * math.pi / period_s * time_s + phase_rad)
            for period_s, phase_rad in zip(self.period_s, self.phase_rad, strict=True)
        )
        return np.asarray(self.amplitude_degc * sum(waves))


def draw_room_temperature(
    motion: Motion, streams: Streams, log: int, usual_degc: tuple[float, float] = ROOM_DEGC
) -> RoomTemperature:
    """Draw the variation of the temperature around the box in log number `log` of a replicate, with a root mean square
    within `usual_degc`.
    """
    stream = streams.of_unit("", "room_temperature", f"log {log}")
    rms_degc = float(np.exp(stream.uniform(*np.log(usual_degc))))
    shortest, longest = np.log(PERIODS_S)
    period_s = np.exp(stream.uniform(shortest, longest, WAVES))
    phase_rad = stream.uniform(0.0, 2 * math.pi, WAVES)
    amplitude_degc = rms_degc * math.sqrt(2 / WAVES)
    return RoomTemperature(motion, amplitude_degc, tuple(period_s.tolist()), tuple(phase_rad.tolist()))
