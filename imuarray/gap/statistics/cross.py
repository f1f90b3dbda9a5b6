"""What the sensors of one phase have in common: means over common windows of time, and how they vary together.

A window's mean is taken of the rows that lie in it; nothing is interpolated. Windows make up segments: what varies from
segment to segment is slow, what varies from window to window within one is fast. All is kept along the sensors' own
axes, where errors of one design are alike; the sensors' mounting turns it into the box's, where motion is.

Products of the mean angular rate and its change stand beside the readings: what a sensor feels through its distance
from the origin is linear in them.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from imuarray.arrays import Booleans, Floats
from imuarray.log.format import Phase, SensorHeader
from imuarray.log.writer import Block
from imuarray.units import SI_PER_UNIT

KINEMATIC = 9
"""Columns after those of the sensors: six products of angular rates, three angular accelerations; zeros without a
gyroscope."""

SEGMENTS = 64
_SEGMENT_WINDOWS = 8
_WINDOWS_S = (0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0)
_WINDOW_ROWS = 2.0
_PRODUCTS = np.triu_indices(3)


@dataclass(frozen=True)
class Cross:
    """Second moments of window means of m sensors, in their units, along their own axes, three columns each, and of the
    `KINEMATIC` columns (rad^2/s^2).

    `slow` (s, p) means of the segments (nan for one without enough windows in which all sensors read); `fast` (p, p)
    mean product of two columns less their segments' means, over `windows` windows. `turning` (p, p) is the mean product
    of the first column and the change of the second, half of that from the window before to the one after less
    its mean in the segment, and `changes` (p, p) that of two changes; without these (`CrossTally`) both are nan, and
    the `KINEMATIC` columns 0.
    """

    sensors: tuple[SensorHeader, ...]
    phase: Phase
    window_s: float
    windows: int
    slow: Floats
    fast: Floats
    turning: Floats
    changes: Floats

    def columns(self, sensor: str) -> slice:
        """Where its three axes stand; KeyError for a sensor that isn't there."""
        return slice(3 * self._places[sensor], 3 * self._places[sensor] + 3)

    @property
    def kinematic(self) -> slice:
        """Where the products of rates and the angular accelerations stand."""
        return slice(3 * len(self.sensors), None)

    def header(self, sensor: str) -> SensorHeader:
        """What is known of it."""
        return self.sensors[self._places[sensor]]

    def others(self, sensor: str, *, family: bool) -> tuple[str, ...]:
        """The sensors of the same chip, or else all others that measure the same."""
        return self._others[sensor, family]

    @cached_property
    def slow_covariance(self) -> Floats:
        """(p, p) of the segments' means; nan for fewer than three."""
        known = self.slow[np.isfinite(self.slow).all(axis=1)]
        columns = self.slow.shape[1]
        return np.cov(known.T) if len(known) > 2 else np.full((columns, columns), np.nan)

    @cached_property
    def _others(self) -> dict[tuple[str, bool], tuple[str, ...]]:
        found: dict[tuple[str, bool], tuple[str, ...]] = {}
        for own in self.sensors:
            same = [item for item in self.sensors if item.quantity == own.quantity and item.name != own.name]
            found[own.name, False] = tuple(item.name for item in same)
            found[own.name, True] = tuple(item.name for item in same if item.chip == own.chip)
        return found

    @cached_property
    def _places(self) -> dict[str, int]:
        return {sensor.name: place for place, sensor in enumerate(self.sensors)}


def window_ns(rates_hz: Sequence[float]) -> int:
    """The shortest of the usual windows in which the slowest sensor has two rows."""
    wanted = _WINDOW_ROWS / min(rates_hz)
    return round(next((window_s for window_s in _WINDOWS_S if window_s >= wanted), _WINDOWS_S[-1]) * 1e9)


class CrossTally:
    """Takes the blocks of several sensors of one phase, of each in order; keeps what not all have reached. Of so many
    `replicates` at once, whose rows have the same times. `changes`: with what statistics of a moving box are made of;
    those of a box at rest do without, for half of the time.
    """

    def __init__(
        self,
        sensors: Sequence[SensorHeader],
        phase: Phase,
        window_ns: int,
        replicates: int = 1,
        *,
        changes: bool = True,
    ) -> None:
        self._sensors, self._phase, self._window_ns = tuple(sensors), phase, window_ns
        self._last = (phase.end_ns - phase.start_ns) // window_ns
        self._length = max(_SEGMENT_WINDOWS, -(-self._last // SEGMENTS))
        self._places = {sensor.name: place for place, sensor in enumerate(sensors)}
        self._scale = np.array([1 / sensor.sensitivity for sensor in sensors])
        self._gyroscopes = [
            (place, SI_PER_UNIT[sensor.unit], np.array(sensor.orientation).T)
            for place, sensor in enumerate(sensors)
            if sensor.quantity == "angular_rate"
        ]
        columns = 3 * len(sensors) + KINEMATIC
        self._with_changes = changes
        self._sums = np.zeros((replicates, len(sensors), 3, self._length))
        self._rows = np.zeros((len(sensors), self._length))
        self._reached = np.zeros(len(sensors), np.int64)
        self._base, self._windows, self._inner_windows = 0, 0, 0
        self._slow: list[Floats] = []
        self._fast, self._turning, self._changes = np.zeros((3, replicates, columns, columns))

    @property
    def sensors(self) -> Collection[str]:
        """The names of those that take part."""
        return self._places.keys()

    def update(self, sensor: str, *blocks: Block) -> None:
        """The next rows of one sensor in each replicate, at least one."""
        place, since_ns = self._places[sensor], blocks[0].time - self._phase.start_ns
        first, last = int(since_ns[0]) // self._window_ns, int(since_ns[-1]) // self._window_ns
        windows = since_ns // self._window_ns
        starts = np.concatenate([[0], (windows[1:] != windows[:-1]).nonzero()[0] + 1])
        self._make_room(last)
        at: Any = windows[starts] - self._base
        if len(at) == last - first + 1:
            at = slice(first - self._base, last - self._base + 1)  # no window is empty
        counts = np.ascontiguousarray([block.counts.T for block in blocks], float)
        sums = self._sums[:, place]  # numbers and a list in one index would change the order of the axes
        sums[:, :, at] += np.add.reduceat(counts, starts, axis=2)
        self._rows[place, at] += np.concatenate([starts[1:], [len(since_ns)]]) - starts
        self._reached[place] = last
        self._work(int(self._reached.min()))

    def take(self, sensor: str, blocks: Sequence[Block] | None) -> None:
        """The next rows of one sensor in each replicate, or (None) word that there are no more."""
        if blocks is None:
            self.end(sensor)
        else:
            self.update(sensor, *blocks)

    def end(self, sensor: str) -> None:
        """No more rows of this sensor."""
        self._reached[self._places[sensor]] = self._last
        self._work(int(self._reached.min()))

    def result(self) -> Cross:
        """All segments that are whole, of the only replicate."""
        (found,) = self.results()
        return found

    def results(self) -> list[Cross]:
        """All segments that are whole, of each replicate."""
        self._work(self._last)
        with np.errstate(invalid="ignore"):
            fast = self._fast / np.float64(self._windows)
            turning, changes = np.array([self._turning, self._changes]) / np.float64(self._inner_windows)
        if not self._with_changes:
            turning, changes = np.full((2, *fast.shape), np.nan)
        slow = np.concatenate([np.zeros((len(fast), 0, fast.shape[2])), *self._slow], axis=1)
        window_s = self._window_ns * 1e-9
        return [
            Cross(self._sensors, self._phase, window_s, self._windows, *own)
            for own in zip(slow, fast, turning, changes, strict=True)
        ]

    def _make_room(self, window: int) -> None:
        missing = window - self._base + 1 - self._rows.shape[1]
        if missing > 0:
            more = max(missing, self._rows.shape[1])
            self._sums = np.concatenate([self._sums, np.zeros((*self._sums.shape[:3], more))], axis=3)
            self._rows = np.concatenate([self._rows, np.zeros((len(self._rows), more))], axis=1)

    def _work(self, reached: int) -> None:
        """Adds up the segments that end up to window `reached`, which isn't complete itself."""
        count = (reached - self._base) // self._length
        if count < 1:
            return
        done = count * self._length
        self._make_room(self._base + done - 1)
        self._add(*(held[..., :done].reshape(*held.shape[:-1], count, -1) for held in (self._sums, self._rows)))
        for held in (self._sums, self._rows):
            held[..., :-done] = held[..., done:].copy()
            held[..., -done:] = 0
        self._base += done

    def _add(self, sums: Floats, rows: Floats) -> None:
        """Segments: sums (r, m, 3, s, w), rows (m, s, w). Windows in which not all sensors read count for nothing."""
        full = np.asarray((rows > 0).all(axis=0))
        told = np.count_nonzero(full, axis=1) >= _SEGMENT_WINDOWS // 2
        columns = self._fast.shape[2]
        slow = np.full((len(self._fast), len(full), columns), np.nan)
        self._slow.append(slow)
        if not told.any():
            return
        if not told.all():
            sums, rows, full = sums[..., told, :], rows[:, told], full[told]
        with np.errstate(invalid="ignore"):
            readings = sums / rows[:, None]
        readings *= self._scale[:, None, None, None]
        readings = _filled(readings, full)
        line = readings.reshape(len(readings), -1, *full.shape)
        if self._with_changes:
            line = np.concatenate([line, self._kinematic(readings)], axis=1)
        line, means = _centred(line, full)
        slow[:, told, : means.shape[1]] = means.swapaxes(1, 2)
        slow[:, told, means.shape[1] :] = 0.0
        flat = line.reshape(*line.shape[:2], -1)
        self._fast[:, : flat.shape[1], : flat.shape[1]] += flat @ flat.swapaxes(1, 2)
        self._windows += int(np.count_nonzero(full))
        if not self._with_changes:
            return
        inner = full[:, :-2] & full[:, 1:-1] & full[:, 2:]
        changes, _ = _centred((line[..., 2:] - line[..., :-2]) / 2, inner)
        between, changes = (part.reshape(*part.shape[:2], -1) for part in (line[..., 1:-1], changes))
        self._turning += between @ changes.swapaxes(1, 2)
        self._changes += changes @ changes.swapaxes(1, 2)
        self._inner_windows += int(np.count_nonzero(inner))

    def _kinematic(self, readings: Floats) -> Floats:
        """(r, 9, s, w) products xx, xy, xz, yy, yz, zz of the mean rate in the box, and its change per second."""
        if not self._gyroscopes:
            return np.zeros((len(readings), KINEMATIC, *readings.shape[3:]))
        turned = [np.einsum("ab,rasw->rbsw", turn, unit * readings[:, at]) for at, unit, turn in self._gyroscopes]
        rate = np.mean(turned, axis=0)
        first, second = _PRODUCTS
        acceleration = np.gradient(rate, self._window_ns * 1e-9, axis=3)
        return np.concatenate([rate[:, first] * rate[:, second], acceleration], axis=1)


def _filled(readings: Floats, full: Booleans) -> Floats:
    """Readings (r, m, 3, s, w) with the segment's mean in windows that aren't full (s, w)."""
    if full.all():
        return readings
    mean = np.mean(readings, axis=4, where=full, keepdims=True)
    return np.where(full, readings, mean)


def _centred(line: Floats, held: Booleans) -> tuple[Floats, Floats]:
    """Columns (r, p, s, w) less their means (r, p, s) over the windows that are held (s, w), and these; 0 in the
    others.
    """
    if held.all():
        mean = line.mean(axis=3)
        return line - mean[..., None], mean
    count = np.maximum(np.count_nonzero(held, axis=1), 1)
    mean = (line * held).sum(axis=3) / count
    return (line - mean[..., None]) * held, mean
