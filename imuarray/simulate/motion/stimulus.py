"""Stimulus of the box as a function of time: the interface between motions and the sensors that measure them.

A motion is a pure function of time; its one required method is `stimulus`. Times are int64 nanoseconds since the log's
epoch, vectors are in the box frame.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from imuarray.arrays import Integers, Reals
from imuarray.log.format import Phase


@dataclass(frozen=True)
class BoxStimulus:
    """The stimulus of the box at n instants `time_ns` (n,): specific force (n, 3) in m/s2, angular rate (n, 3) in
    rad/s, angular acceleration (n, 3) in rad/s2 and magnetic field (n, 3) in gauss, all in the box frame and at its
    origin; temperature (n,) and pressure (n,).

    Constant columns may be broadcast (read-only); they are not written to.
    """

    time_ns: Integers
    force_box: Reals
    rate_box: Reals
    angular_acceleration_box: Reals
    field_box: Reals
    temperature_degc: Reals
    pressure_pa: Reals


class Motion(Protocol):
    """The motion and the environment of the box."""

    @property
    def phases(self) -> tuple[Phase, ...]:
        """The phases that an observer with a stopwatch would note, in order and without overlap; the last may end later
        than a log.
        """

    @property
    def seconds(self) -> float:
        """The duration in s; after it the stimulus keeps its final value."""

    def stimulus(self, time_ns: Integers) -> BoxStimulus:
        """Return the stimulus of the box at these times (n,), in any order."""


@dataclass(frozen=True)
class MotionVariant:
    """A variant of another motion: it has the same phases and duration; a subclass changes the stimulus."""

    motion: Motion

    @property
    def phases(self) -> tuple[Phase, ...]:
        """The phases of the motion."""
        return self.motion.phases

    @property
    def seconds(self) -> float:
        """The duration of the motion."""
        return self.motion.seconds


@runtime_checkable
class Warming(Protocol):
    """A motion that computes the temperature without the rest of the stimulus."""

    def temperature_at(self, time_ns: Integers) -> Reals:
        """Return the temperature (n,) of the stimulus at these times (n,)."""


def temperature_at(motion: Motion, time_ns: Integers) -> Reals:
    """Return the temperature (n,) of the box at times (n,), in degC."""
    if isinstance(motion, Warming):
        return motion.temperature_at(time_ns)
    return motion.stimulus(time_ns).temperature_degc


def thermometer_lag_s(motion: Motion) -> float:
    """Return the lag, in s, of the thermometer by which the temperature of a motion is known (`lead_s`); 0 for motions
    that state none.
    """
    return float(getattr(motion, "lead_s", 0.0))
