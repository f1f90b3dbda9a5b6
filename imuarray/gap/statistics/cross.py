"""Joint moments of the sensors in one phase: means over common windows of time, and their covariances.

The mean of a window is that of its rows; nothing is interpolated. Windows are grouped into segments: variation between
segments is slow, variation between windows within a segment is fast. Moments are kept along the sensors' own axes,
along which errors of one design have the same sign; the mounting rotates them into the axes of the box, along which
motion is common.

Further columns are products of the mean angular rate and its derivative, in which the lever-arm acceleration of a
sensor is linear, and cubes of the mean angular rate, in which a nonlinear response is linear. A single sensor of its
quantity can only be compared with the track of an instrument, and of two sensors only a track determines which one is
wrong. For each sensor of which the array has fewer than three, the values of the track at the times of the sensor's
rows are therefore further columns. With three sensors or more the first of them has such columns too: they show whether
the common clock of the sensors drifts relative to that of the track.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from imuarray.arrays import Booleans, Floats, Integers
from imuarray.gap.recording.host_lag import track_values
from imuarray.log.format import Phase, SensorHeader
from imuarray.log.writer import Block
from imuarray.simulate.motion.stimulus import Motion
from imuarray.units import SI_PER_UNIT

KINEMATIC, CUBES = 9, 3
"""Numbers of the last columns: six products of angular rates and three angular accelerations; three cubes of angular
rates. They are computed from the gyroscopes, or from the track if there is no gyroscope; zeros without either.
"""

SQUARES = (0, 3, 5)
"""Places of the squares xx, yy and zz among the six products."""

ENOUGH = 3
"""Number of sensors of a quantity from which on they are compared only with each other: three sensors determine which
of them is wrong without a track.
"""

SEGMENTS = 64
"""Largest number of segments of a phase."""

_SEGMENT_WINDOWS = 8
"""Least number of windows in a segment."""

_WINDOWS_S = (0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0)
"""Usual lengths of windows, in s."""

_WINDOW_ROWS = 2.0
"""Least mean number of rows of the slowest sensor in a window."""

_UNRESOLVED_ROWS, _UNRESOLVED_S = 5.0, 0.1
"""Least mean number of rows, and least length, of a window in a motion with changes that the rows do not resolve. The
filters of the sensors, the moments of their rows, and knocks of a few ms change single rows, and hardly these means.
"""

_PRODUCTS = np.triu_indices(3)


@dataclass(frozen=True)
class Cross:
    """Second moments of window means. The p columns are: three for each of m sensors, in its unit along its own axes;
    three of the track for each of the sensors `with_track`, in that sensor's unit along the box's axes; the `KINEMATIC`
    (rad^2/s^2) and the `CUBES` columns (rad^3/s^3).

    `slow` (s, p) are the means of the segments (nan for a segment with too few windows in which all sensors have rows);
    `fast` (p, p) is the mean product of two columns less their segments' means, over `windows` windows. `turning` (p,
    p) is the mean product of the first column and the change of the second; the change is half of the difference
    between the next and the previous window, less its mean in the segment. `changes` (p, p) is the mean product of two
    changes. Without changes (`CrossTally`) both are nan and the `KINEMATIC` and `CUBES` columns 0.
    """

    sensors: tuple[SensorHeader, ...]
    phase: Phase
    window_s: float
    windows: int
    slow: Floats
    fast: Floats
    turning: Floats
    changes: Floats
    with_track: tuple[str, ...] = ()

    def columns(self, sensor: str) -> slice:
        """Return the columns of a sensor's three axes; KeyError for an unknown sensor."""
        return slice(3 * self._places[sensor], 3 * self._places[sensor] + 3)

    def track_columns(self, sensor: str) -> slice:
        """Return the columns of the track at a sensor's times; ValueError for a sensor without them."""
        first = 3 * (len(self.sensors) + self.with_track.index(sensor))
        return slice(first, first + 3)

    @cached_property
    def tracked(self) -> tuple[str, ...]:
        """The sensors that are compared with the track: those of a quantity with fewer than `ENOUGH` sensors."""
        quantities = [sensor.quantity for sensor in self.sensors]
        return tuple(name for name in self.with_track if quantities.count(self.header(name).quantity) < ENOUGH)

    @property
    def kinematic(self) -> slice:
        """The columns of the products of rates and the angular accelerations."""
        return slice(len(self.fast) - KINEMATIC - CUBES, len(self.fast) - CUBES)

    @property
    def cubes(self) -> slice:
        """The columns of the cubes of rates."""
        return slice(len(self.fast) - CUBES, len(self.fast))

    def header(self, sensor: str) -> SensorHeader:
        """Return the header of a sensor."""
        return self.sensors[self._places[sensor]]

    def others(self, sensor: str, *, family: bool) -> tuple[str, ...]:
        """Return the other sensors of the same quantity: those of the same chip type (`family`), or all."""
        return self._others[sensor, family]

    def reference(self, sensor: str) -> Floats | None:
        """Return weights (3, p) of the expected reading of a sensor along its nominal axes: the mean of the other
        sensors of its quantity and of the track, if the sensor is compared with it; None without either.
        """
        others = self.others(sensor, family=False)
        box, references = self.mean_box(others) * len(others), len(others)
        if sensor in self.tracked:
            box[:, self.track_columns(sensor)] += np.eye(3)
            references += 1
        return np.array(self.header(sensor).orientation).T @ box / references if references else None

    def mean_box(self, sensors: Collection[str]) -> Floats:
        """Return weights (3, p) of the mean of these sensors along the box's axes."""
        weights = np.zeros((3, self.fast.shape[0]))
        for name in sensors:
            weights[:, self.columns(name)] = np.array(self.header(name).orientation) / len(sensors)
        return weights

    @cached_property
    def slow_covariance(self) -> Floats:
        """Covariance (p, p) of the segments' means; nan for fewer than three segments."""
        known = self.slow[np.isfinite(self.slow).all(axis=1)]
        columns = self.slow.shape[1]
        return np.cov(known.T) if len(known) > 2 else np.full((columns, columns), np.nan)

    @cached_property
    def _others(self) -> dict[tuple[str, bool], tuple[str, ...]]:
        names: dict[tuple[str, bool], tuple[str, ...]] = {}
        for sensor in self.sensors:
            same = [item for item in self.sensors if item.quantity == sensor.quantity and item.name != sensor.name]
            names[sensor.name, False] = tuple(item.name for item in same)
            names[sensor.name, True] = tuple(item.name for item in same if item.chip == sensor.chip)
        return names

    @cached_property
    def _places(self) -> dict[str, int]:
        return {sensor.name: place for place, sensor in enumerate(self.sensors)}


def window_ns(rates_hz: Sequence[float], *, is_resolved: bool = True) -> int:
    """Return, in ns, the shortest of the usual windows in which the slowest sensor has two rows; at most 5 s. If the
    rows do not resolve the motion, the slowest sensor has five rows in it, and it is at least 0.1 s long.
    """
    rows, shortest_s = (_WINDOW_ROWS, 0.0) if is_resolved else (_UNRESOLVED_ROWS, _UNRESOLVED_S)
    needed_s = max(rows / min(rates_hz), shortest_s)
    return round(next((window_s for window_s in _WINDOWS_S if window_s >= needed_s), _WINDOWS_S[-1]) * 1e9)


class CrossTally:
    """Accumulates the blocks of several sensors of one phase. The blocks of each sensor come in order; sums are kept
    until all sensors have reached their window.

    Processes several `replicates` at once, whose rows have the same times. `changes`: also compute the moments for
    statistics of a moving box; without them it takes half of the time. `track`: the motion that an instrument measured,
    sampled at the times of the sensors of which the array has fewer than `ENOUGH`, and of the first sensor of each
    other quantity.
    """

    def __init__(
        self,
        sensors: Sequence[SensorHeader],
        phase: Phase,
        window_ns: int,
        replicates: int = 1,
        *,
        changes: bool = True,
        track: Motion | None = None,
    ) -> None:
        self._sensors, self._phase, self._window_ns = tuple(sensors), phase, window_ns
        self._last = (phase.end_ns - phase.start_ns) // window_ns
        self._length = max(_SEGMENT_WINDOWS, -(-self._last // SEGMENTS))
        self._places = {sensor.name: place for place, sensor in enumerate(sensors)}
        quantities = [sensor.quantity for sensor in sensors]
        chosen = [
            sensor
            for place, sensor in enumerate(sensors if track is not None else ())
            if quantities.count(sensor.quantity) < ENOUGH or sensor.quantity not in quantities[:place]
        ]
        self._track, self._with_track = track, tuple(sensor.name for sensor in chosen)
        # places of the track's quantities, by the sensor whose row times they are sampled at
        self._track_places = {sensor.name: [(len(sensors) + at, sensor.quantity)] for at, sensor in enumerate(chosen)}
        units = [1 / sensor.sensitivity for sensor in sensors] + [1 / SI_PER_UNIT[sensor.unit] for sensor in chosen]
        self._gyroscopes = [
            (place, SI_PER_UNIT[sensor.unit], np.array(sensor.orientation).T)
            for place, sensor in enumerate(sensors)
            if sensor.quantity == "angular_rate"
        ]
        if track is not None and not self._gyroscopes:
            self._gyroscopes = [(len(units), 1.0, np.eye(3))]
            self._track_places.setdefault(sensors[0].name, []).append((len(units), "angular_rate"))
            units.append(1.0)
        self._scale = np.array(units)
        columns = 3 * len(units) + KINEMATIC + CUBES
        self._with_changes = changes
        self._sums = np.zeros((replicates, len(units), 3, self._length))
        self._rows = np.zeros((len(units), self._length))
        self._reached = np.zeros(len(sensors), np.int64)
        self._base, self._windows, self._inner_windows = 0, 0, 0
        self._slow: list[Floats] = []
        self._fast, self._turning, self._changes = np.zeros((3, replicates, columns, columns))

    @property
    def sensors(self) -> Collection[str]:
        """Names of the sensors that are accumulated."""
        return self._places.keys()

    def update(self, sensor: str, *blocks: Block) -> None:
        """Add rows of one sensor in each replicate, at least one row."""
        place, since_ns = self._places[sensor], blocks[0].time - self._phase.start_ns
        first, last = int(since_ns[0]) // self._window_ns, int(since_ns[-1]) // self._window_ns
        windows = since_ns // self._window_ns
        starts = np.concatenate([[0], (windows[1:] != windows[:-1]).nonzero()[0] + 1])
        self._extend(last)
        at: Any = windows[starts] - self._base
        if len(at) == last - first + 1:
            at = slice(first - self._base, last - self._base + 1)  # no window is empty
        counts = np.ascontiguousarray([block.counts.T for block in blocks], float)
        rows = np.concatenate([starts[1:], [len(since_ns)]]) - starts
        self._accumulate(place, at, np.add.reduceat(counts, starts, axis=2), rows)
        if self._track is not None and sensor in self._track_places:
            stimulus = track_values(self._track, blocks[0].time)
            for track_place, quantity in self._track_places[sensor]:
                self._accumulate(track_place, at, np.add.reduceat(stimulus[quantity].T, starts, axis=1), rows)
        self._reached[place] = last
        self._finish_segments(int(self._reached.min()))

    def accept(self, sensor: str, blocks: Sequence[Block] | None) -> None:
        """Add rows of one sensor in each replicate; None means that there are no more."""
        if blocks is None:
            self.end(sensor)
        else:
            self.update(sensor, *blocks)

    def end(self, sensor: str) -> None:
        """Mark a sensor as complete."""
        self._reached[self._places[sensor]] = self._last
        self._finish_segments(int(self._reached.min()))

    def result(self) -> Cross:
        """Return the moments of all complete segments for the only replicate."""
        (cross,) = self.results()
        return cross

    def results(self) -> list[Cross]:
        """Return the moments of all complete segments for each replicate."""
        self._finish_segments(self._last)
        with np.errstate(invalid="ignore"):
            fast = self._fast / np.float64(self._windows)
            turning, changes = np.array([self._turning, self._changes]) / np.float64(self._inner_windows)
        if not self._with_changes:
            turning, changes = np.full((2, *fast.shape), np.nan)
        slow = np.concatenate([np.zeros((len(fast), 0, fast.shape[2])), *self._slow], axis=1)
        window_s = self._window_ns * 1e-9
        return [
            Cross(self._sensors, self._phase, window_s, self._windows, *moments, self._with_track)
            for moments in zip(slow, fast, turning, changes, strict=True)
        ]

    def _accumulate(self, place: int, windows: Any, sums: Floats, rows: Integers) -> None:
        """Add sums (r, 3, w) or (3, w) over `rows` (w,) rows to windows, given by a slice or by their places (w,)."""
        place_sums = self._sums[:, place]  # an integer and an array in one index would change the order of the axes
        place_sums[:, :, windows] += sums
        self._rows[place, windows] += rows

    def _extend(self, window: int) -> None:
        missing = window - self._base + 1 - self._rows.shape[1]
        if missing > 0:
            more = max(missing, self._rows.shape[1])
            self._sums = np.concatenate([self._sums, np.zeros((*self._sums.shape[:3], more))], axis=3)
            self._rows = np.concatenate([self._rows, np.zeros((len(self._rows), more))], axis=1)

    def _finish_segments(self, reached: int) -> None:
        """Add the moments of the segments that end before window `reached`, which is not complete itself."""
        count = (reached - self._base) // self._length
        if count < 1:
            return
        finished = count * self._length
        self._extend(self._base + finished - 1)
        self._add(
            *(buffer[..., :finished].reshape(*buffer.shape[:-1], count, -1) for buffer in (self._sums, self._rows))
        )
        for buffer in (self._sums, self._rows):
            buffer[..., :-finished] = buffer[..., finished:].copy()
            buffer[..., -finished:] = 0
        self._base += finished

    def _add(self, sums: Floats, rows: Floats) -> None:
        """Add segments: sums (r, m, 3, s, w), rows (m, s, w). Windows in which a sensor has no row are left out."""
        full = np.asarray((rows > 0).all(axis=0))
        is_known = np.count_nonzero(full, axis=1) >= _SEGMENT_WINDOWS // 2
        columns = self._fast.shape[2]
        slow = np.full((len(self._fast), len(full), columns), np.nan)
        self._slow.append(slow)
        if not is_known.any():
            return
        if not is_known.all():
            sums, rows, full = sums[..., is_known, :], rows[:, is_known], full[is_known]
        with np.errstate(invalid="ignore"):
            readings = sums / rows[:, None]
        readings *= self._scale[:, None, None, None]
        readings = _fill(readings, full)
        line = readings.reshape(len(readings), -1, *full.shape)
        if self._with_changes:
            line = np.concatenate([line, self._kinematic(readings)], axis=1)
        line, means = _centre(line, full)
        slow[:, is_known, : means.shape[1]] = means.swapaxes(1, 2)
        slow[:, is_known, means.shape[1] :] = 0.0
        flat = line.reshape(*line.shape[:2], -1)
        self._fast[:, : flat.shape[1], : flat.shape[1]] += flat @ flat.swapaxes(1, 2)
        self._windows += int(np.count_nonzero(full))
        if not self._with_changes:
            return
        inner = full[:, :-2] & full[:, 1:-1] & full[:, 2:]
        changes, _ = _centre((line[..., 2:] - line[..., :-2]) / 2, inner)
        between, changes = (part.reshape(*part.shape[:2], -1) for part in (line[..., 1:-1], changes))
        self._turning += between @ changes.swapaxes(1, 2)
        self._changes += changes @ changes.swapaxes(1, 2)
        self._inner_windows += int(np.count_nonzero(inner))

    def _kinematic(self, readings: Floats) -> Floats:
        """Return (r, 12, s, w): the products xx, xy, xz, yy, yz, zz of the mean rate along the box's axes, its
        derivative, and its cubes; SI units.
        """
        if not self._gyroscopes:
            return np.zeros((len(readings), KINEMATIC + CUBES, *readings.shape[3:]))
        turned = [np.einsum("ab,rasw->rbsw", turn, unit * readings[:, at]) for at, unit, turn in self._gyroscopes]
        rate = np.mean(turned, axis=0)
        first, second = _PRODUCTS
        acceleration = np.gradient(rate, self._window_ns * 1e-9, axis=3)
        products = rate[:, first] * rate[:, second]
        return np.concatenate([products, acceleration, products[:, SQUARES] * rate], axis=1)


def _fill(readings: Floats, full: Booleans) -> Floats:
    """Return readings (r, m, 3, s, w) with windows that are not `full` (s, w) replaced by the segment's mean."""
    if full.all():
        return readings
    mean = np.mean(readings, axis=4, where=full, keepdims=True)
    return np.where(full, readings, mean)


def _centre(line: Floats, counts: Booleans) -> tuple[Floats, Floats]:
    """Return the columns (r, p, s, w) less their means over the windows in which `counts` (s, w) is true, 0 in the
    other windows; and the means (r, p, s).
    """
    if counts.all():
        mean = line.mean(axis=3)
        return line - mean[..., None], mean
    count = np.maximum(np.count_nonzero(counts, axis=1), 1)
    mean = (line * counts).sum(axis=3) / count
    return (line - mean[..., None]) * counts, mean
