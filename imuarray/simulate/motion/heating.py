"""The heating experiment: a box at rest is heated twice by a hairdryer and cools in between and after it (paper,
sections 4 and 5.2.5).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from imuarray.arrays import Integers, Reals
from imuarray.log.format import Phase
from imuarray.simulate.motion.faces import resting, standing_on
from imuarray.simulate.motion.stimulus import BoxStimulus
from imuarray.simulate.motion.timeline import consecutive, finite, nanoseconds, positive

HEATING_MIN = 2.0
COOLING_MIN = 20.0


class _Stretch(NamedTuple):
    """A part of the profile: phase, duration in minutes, temperature at its beginning and asymptotic temperature in
    degC, time constant in minutes.
    """

    name: str
    minutes: float
    begins_degc: float
    towards_degc: float
    constant_min: float

    @property
    def ends_degc(self) -> float:
        """Return the temperature at the end."""
        remaining = math.exp(-self.minutes / self.constant_min)
        return self.towards_degc + (self.begins_degc - self.towards_degc) * remaining


def _heat(minutes: float, begins_degc: float, ends_degc: float) -> _Stretch:
    """Return a stretch of heating that ends at exactly `ends_degc`."""
    remaining = math.exp(-minutes / HEATING_MIN)
    return _Stretch("heat", minutes, begins_degc, (ends_degc - begins_degc * remaining) / (1 - remaining), HEATING_MIN)


@dataclass(frozen=True)
class Heating:
    """A heating on the -Z face: 5 minutes at room temperature, 5 of heating, 5 of cooling, 5 of heating, 90 of cooling.

    Taken from the paper: these times, about 24 degC at the beginning, maxima of 42 to 43 and 52 degC, and a final
    temperature slightly above the initial one. Our assumptions, without a source: exponential approaches with time
    constants of 2 minutes (heating) and 20 minutes (cooling), and ambient air that is 1 degC warmer in the last
    stretch. `scale` below 1 shortens times and time constants alike. ValueError for invalid values.
    """

    scale: float = 1.0
    peaks_degc: tuple[float, float] = (42.5, 52.0)
    room_degc: float = 24.0
    last_room_degc: float = 25.0
    up: str = "+Z"

    def __post_init__(self) -> None:
        positive(scale=self.scale)
        standing_on(self.up, (0.0, 0.0))
        if len(self.peaks_degc) != 2:
            raise ValueError(f"peaks_degc: {self.peaks_degc}; two temperatures are required")
        first, second = self.peaks_degc
        finite(first_peak=first, second_peak=second, room_degc=self.room_degc, last_room_degc=self.last_room_degc)

    @property
    def seconds(self) -> float:
        """Return the duration: 110 minutes, scaled."""
        return int(self._edges_ns[-1]) * 1e-9

    @cached_property
    def phases(self) -> tuple[Phase, ...]:
        """Return the phases room, heat, cool, heat, cool."""
        lengths = np.diff(self._edges_ns).tolist()
        return consecutive(*((part.name, length, self.up) for part, length in zip(self._profile, lengths, strict=True)))

    @cached_property
    def _attitude(self) -> Reals:
        return standing_on(self.up, (0.0, 0.0))

    @cached_property
    def _profile(self) -> tuple[_Stretch, ...]:
        room = _Stretch("room", 5.0, self.room_degc, self.room_degc, COOLING_MIN)
        heat = _heat(5.0, room.ends_degc, self.peaks_degc[0])
        cool = _Stretch("cool", 5.0, self.peaks_degc[0], self.room_degc, COOLING_MIN)
        second_heat = _heat(5.0, cool.ends_degc, self.peaks_degc[1])
        return (
            room,
            heat,
            cool,
            second_heat,
            _Stretch("cool", 90.0, self.peaks_degc[1], self.last_room_degc, COOLING_MIN),
        )

    @cached_property
    def _edges_ns(self) -> Integers:
        """Return (6,) the beginning of each stretch, and the end of the last one."""
        minutes = np.cumsum([0.0, *(stretch.minutes for stretch in self._profile)])
        return np.array([nanoseconds(self.scale * 60 * passed) for passed in minutes.tolist()])

    @cached_property
    def _columns(self) -> Reals:
        """Return (3, 5) for each stretch: asymptotic temperature in degC, initial difference from it, decay per ns."""
        towards = np.array([stretch.towards_degc for stretch in self._profile])
        begins = np.array([stretch.begins_degc for stretch in self._profile])
        constants_ns = np.array([self.scale * 60e9 * stretch.constant_min for stretch in self._profile])
        return np.array([towards, begins - towards, -1 / constants_ns])

    def stimulus(self, time_ns: Integers) -> BoxStimulus:
        """Return the stimulus of a box at rest, at the temperature of that time."""
        since_ns = np.clip(time_ns, 0, self._edges_ns[-1])
        index = np.searchsorted(self._edges_ns[1:-1], since_ns, side="right")
        towards, distance, decay = self._columns
        remaining = np.exp(decay[index] * (since_ns - self._edges_ns[index]))
        return resting(time_ns, self._attitude, towards[index] + distance[index] * remaining)
