"""The motion of a recorded log, as far as the log tells."""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from itertools import pairwise
from typing import Literal

import numpy as np
import numpy.typing as npt

from imuarray.arrays import Floats, Integers, Reals
from imuarray.axes import UP_AXES
from imuarray.calibrate.segments import TemperatureSeries, chip_thermometer
from imuarray.errors import LogError
from imuarray.log.columns import Track
from imuarray.log.format import Phase
from imuarray.log.reader import Log
from imuarray.simulate.motion.faces import FIELD_LEVEL, GRAVITY_LEVEL, resting, standing_on
from imuarray.simulate.motion.felt import Felt
from imuarray.simulate.motion.fields import PhaseField, field_at, field_until_ns
from imuarray.simulate.motion.recorded import SplineColumns
from imuarray.simulate.motion.timeline import FOREVER_NS

ROOM_DEGC = 25.0

CHIP_S, SHORT_CHIP_S, CHIP_SHARE = 10.0, 2.0, 1 / 15
"""The readings of a chip's own thermometer are averaged over this time, or over this share of a shorter log, at least
over the shorter time: its steps and its noise are no change of the temperature, and a heating lasts a part of the log.
"""

FINEST_CHIP_S = 0.5
"""Shortest time over which they are averaged where the temperature changes by more than their steps and noise."""

_FEW_READINGS, _SIGNIFICANT = 5, 3.0
"""Fewest readings of a thermometer that show its noise; the scatter of readings of a temperature that changes, in this
noise: otherwise a straight line is taken, since the noise of a thermometer is no change of the temperature.
"""

_MEDIAN_OF_SECOND_DIFFERENCES = 0.6745 * math.sqrt(6)
"""Median size of the second differences of independent normal readings, in their standard deviation."""

TemperatureSource = Literal["truth", "reference", "barometer", "chip", "nothing"]

_FEW = 256
"""The largest number of instants whose stimulus is cached: the same few, scattered over a phase, are requested
repeatedly.
"""
_KEPT = 512

_LAST = 8
"""Number of stretches whose values are cached: trials of a model ask for the same ones in turn."""


@dataclass(frozen=True, eq=False)
class LikeLog:
    """The motion of the box of `log`, at the log's own times.

    Force and rate come from `/truth`, else from `/reference`, if it has both, by splines (`SplineColumns`); the angular
    acceleration is the derivative of that rate, so what happened between two rows is not in it. Without them the box is
    taken to have stood still: on the face that a phase names as up, and until the next such phase on that one (before
    the first, on the first; +Z if none is named); then turns and shaking are missing from it, and tilts too.

    The temperature is that of the same rows, else what a barometer of the log measured, noise and offset included,
    else what a chip's own thermometer measured, averaged over at most `CHIP_S`, if its zero is known, else 25 degC.
    The field is that of `fields`, if there are any, else the earth's on that face, also while the box moves; the
    pressure is that of height 0. In `rests`, stretches from and to a time in ns, force and rate are the means of
    the track: a reference has noise, and a box at rest does not move. The log stays open. LogError for a phase
    whose `up` is no box axis, or rows that can't be meant.
    """

    log: Log
    fields: tuple[PhaseField, ...] = ()
    rests: tuple[tuple[int, int], ...] = ()

    def __post_init__(self) -> None:
        for phase in self.log.phases:
            if phase.up and phase.up not in UP_AXES:
                allowed = ", ".join(UP_AXES)
                raise LogError(f"{self.log.path}: phase {phase.name!r}: up {phase.up!r}; allowed are {allowed}")

    @property
    def phases(self) -> tuple[Phase, ...]:
        """The log's."""
        return tuple(sorted(self.log.phases))

    @cached_property
    def seconds(self) -> float:
        """The end of its last phase or its last reading, whichever is later."""
        times = [int(sensor.time[-1]) for sensor in self.log.sensors.values() if len(sensor)]
        return max([0, *times, *(phase.end_ns for phase in self.log.phases)]) * 1e-9

    @cached_property
    def source(self) -> str:
        """The source of force and rate: "truth", "reference" or "phases"."""
        return self._track[0]

    @property
    def temperature_source(self) -> TemperatureSource:
        """The source of the temperature; "nothing": 25 degC is assumed."""
        return self._warming[0]

    def felt(self, time_ns: Integers) -> Felt:
        """Return what the log's rows or its phases say; read-only for few instants."""
        if len(time_ns) > _FEW:
            return self._felt_before(time_ns)
        return self._remembered(np.asarray(time_ns, np.int64).tobytes())

    def _felt_before(self, time_ns: Integers) -> Felt:
        """Return the motion at many instants from a cache."""
        kept, key = self._stretches, (len(time_ns), int(time_ns[0]), int(time_ns[-1]))
        remembered = kept.pop(key, None)
        if remembered is None or not np.array_equal(remembered.time_ns, time_ns):
            remembered = self._felt(time_ns)
        kept[key] = remembered
        if len(kept) > _LAST:
            del kept[next(iter(kept))]
        return remembered

    @cached_property
    def _stretches(self) -> dict[tuple[int, int, int], Felt]:
        """A cache of stretches by number, first and last of their instants; the most recently used stand last."""
        return {}

    def __reduce__(self) -> tuple[type[LikeLog], tuple[object, ...]]:
        """Its log, which opens itself, and the other fields; what was read of the log is not sent."""
        return LikeLog, (self.log, self.fields, self.rests)

    def unchanged_until_ns(self, at_ns: int) -> int:
        """Return the time up to which the stimulus of `at_ns` stays the same, exclusive."""
        if self._moving is not None or self._warming[1] is not None:
            return at_ns
        later = self._starts_ns[self._starts_ns > at_ns]
        return min(int(later[0]) if len(later) else FOREVER_NS, field_until_ns(self.fields, at_ns))

    @cached_property
    def _remembered(self) -> Callable[[bytes], Felt]:
        """A cache of what is felt at times that are given as bytes."""
        return lru_cache(maxsize=_KEPT)(lambda times: self._felt(np.frombuffer(times, np.int64)))

    def _felt(self, time_ns: Integers) -> Felt:
        felt = self._on_faces(time_ns)
        if self.fields:
            felt = replace(felt, field_box=field_at(self.fields, time_ns))
        if self._moving is None:
            return felt
        values, slopes = self._moving.at(time_ns)
        if self._means:
            values, slopes = values.copy(), slopes.copy()
        for start_ns, end_ns, mean in self._means:
            is_at_rest = (start_ns <= time_ns) & (time_ns < end_ns)
            values[is_at_rest], slopes[is_at_rest] = mean, 0.0
        return replace(felt, force_box=values[:, :3], rate_box=values[:, 3:], angular_acceleration_box=slopes[:, 3:])

    def _on_faces(self, time_ns: Integers) -> Felt:
        """Return the box at rest, at the temperature of the moment."""
        warming = self._warming[1]
        degc = ROOM_DEGC if warming is None else warming.values_at(time_ns)[:, 0]
        ends = np.array([time_ns.min(), time_ns.max()]) if len(time_ns) else np.zeros(1, np.int64)
        first, last = self._face_at(ends)[[0, -1]].tolist()
        if first == last:
            return resting(time_ns, self._attitudes[first], degc)
        face = self._face_at(time_ns)
        turned = replace(resting(time_ns, np.eye(3), degc), field_box=(FIELD_LEVEL @ self._attitudes)[face])
        return turned if self._moving is not None else replace(turned, force_box=self._gravity[face])

    def _face_at(self, time_ns: Integers) -> npt.NDArray[np.intp]:
        """Return (n,) the number of the face on which it stands."""
        return np.clip(np.searchsorted(self._starts_ns, time_ns, side="right") - 1, 0, None)

    @cached_property
    def _faces(self) -> tuple[Phase, ...]:
        return tuple(phase for phase in self.phases if phase.up) or (Phase(0, 0, "static", "+Z"),)

    @cached_property
    def _starts_ns(self) -> Integers:
        return np.array([phase.start_ns for phase in self._faces])

    @cached_property
    def _attitudes(self) -> Reals:
        """(k, 3, 3) of each named face."""
        return np.array([standing_on(phase.up) for phase in self._faces])

    @cached_property
    def _gravity(self) -> Reals:
        """(k, 3) of each named face."""
        return np.asarray(GRAVITY_LEVEL @ self._attitudes)

    @cached_property
    def _track(self) -> tuple[str, Track | None]:
        """The rows to follow."""
        for name, track in (("truth", self.log.truth), ("reference", self.log.reference)):
            complete = track is not None and track.specific_force is not None and track.angular_rate is not None
            if track is not None and complete and len(track.time):
                return name, track
        return "phases", None

    @cached_property
    def _moving(self) -> SplineColumns | None:
        """Force and rate."""
        name, track = self._track
        if track is None or track.specific_force is None or track.angular_rate is None:
            return None
        return SplineColumns(track.time, (track.specific_force, track.angular_rate), f"{self.log.path}, {name}")

    @cached_property
    def _means(self) -> tuple[tuple[int, int, Reals], ...]:
        """The rests, each with the mean force and rate (6,) of the track's rows in it; without those that have none."""
        _, track = self._track
        if track is None or track.specific_force is None or track.angular_rate is None:
            return ()
        time_ns = track.time[:]
        columns = np.hstack([track.specific_force[:], track.angular_rate[:]])
        means = []
        for start_ns, end_ns in self.rests:
            first, stop = np.searchsorted(time_ns, [start_ns, end_ns]).tolist()
            if stop > first:
                means.append((start_ns, end_ns, np.asarray(columns[first:stop].mean(axis=0))))
        return tuple(means)

    @cached_property
    def _warming(self) -> tuple[TemperatureSource, SplineColumns | None]:
        """The source of the temperature, and the temperature itself."""
        tracks: tuple[tuple[TemperatureSource, Track | None], ...]
        tracks = ("truth", self.log.truth), ("reference", self.log.reference)
        for name, track in tracks:
            if track is not None and track.temperature is not None and len(track.time):
                return name, SplineColumns(track.time, (track.temperature,), f"{self.log.path}, {name}")
        for sensor in self.log.of("pressure"):
            with suppress(LogError):  # a barometer that was imported without
                if len(sensor):
                    return "barometer", SplineColumns(sensor.time, (sensor.compensated("temperature"),), sensor.where)
        chip = chip_thermometer(self.log, FINEST_CHIP_S)
        if chip is None:
            return "nothing", None
        time_s, degc = _average(chip, min(CHIP_S, max(SHORT_CHIP_S, CHIP_SHARE * self.seconds)))
        if not _changes(degc):
            line = np.polynomial.Polynomial.fit(time_s, degc, 1)
            time_s = time_s[[0, -1]]
            degc = line(time_s)
        time_ns = np.rint(time_s * 1e9).astype(np.int64)
        return "chip", SplineColumns(time_ns, (degc,), f"{self.log.path}, temperature_counts")


def _average(chip: TemperatureSeries, longest_s: float) -> tuple[Floats, Floats]:
    """Means (k,) of the times and of the readings of a thermometer over `longest_s`, and over less, by halves, as long
    as the means of the halves differ by more than a step of the thermometer and by more than its noise.
    """
    degc = chip.degc
    noise = float(np.median(np.abs(np.diff(degc, n=2)))) / _MEDIAN_OF_SECOND_DIFFERENCES if len(degc) > 2 else 0.0
    edges = np.searchsorted(chip.time_s, np.arange(chip.time_s[0], chip.time_s[-1], longest_s)).tolist() or [0]
    windows = [(first, stop) for first, stop in pairwise([*edges, len(degc)]) if stop > first]
    means = []
    while windows:
        first, stop = windows.pop()
        middle = (first + stop) // 2
        if middle > first:
            change = abs(float(degc[first:middle].mean() - degc[middle:stop].mean()))
            if change > max(
                chip.step_degc, _SIGNIFICANT * noise * math.sqrt(1 / (middle - first) + 1 / (stop - middle))
            ):
                windows += [(first, middle), (middle, stop)]
                continue
        means.append((chip.time_s[first:stop].mean(), degc[first:stop].mean()))
    time_s, averages = np.array(sorted(means)).T
    return time_s, averages


def _changes(degc: Reals) -> bool:
    """True if averaged readings (k,) of a thermometer change by more than their noise, or are too few to tell."""
    if len(degc) < _FEW_READINGS:
        return True
    noise = math.sqrt(float(np.mean(np.diff(degc, n=2) ** 2)) / 6)  # of independent readings
    return float(np.std(degc)) > _SIGNIFICANT * noise
