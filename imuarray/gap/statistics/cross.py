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

import numpy as np
import numpy.typing as npt

from imuarray.log.format import Phase, SensorHeader
from imuarray.log.writer import Block
from imuarray.units import SI_PER_UNIT

Floats = npt.NDArray[np.float64]
Bools = npt.NDArray[np.bool_]

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
    its mean in the segment, and `changes` (p, p) that of two changes.
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
    `replicates` at once, whose rows have the same times.
    """

    def __init__(self, sensors: Sequence[SensorHeader], phase: Phase, window_ns: int, replicates: int = 1) -> None:
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
        self._sums = np.zeros((self._length, replicates, len(sensors), 3))
        self._rows = np.zeros((self._length, len(sensors)))
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
        starts = np.searchsorted(since_ns, np.arange(first, last + 1) * self._window_ns)
        rows = np.concatenate([starts[1:], [len(since_ns)]]) - starts
        filled = rows > 0
        self._make_room(last)
        at = first - self._base + np.flatnonzero(filled)
        counts = np.array([block.counts.T for block in blocks], float)
        self._sums[at, :, place] += np.add.reduceat(counts, starts[filled], axis=2).transpose(2, 0, 1)
        self._rows[at, place] += rows[filled]
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
        slow = np.concatenate([np.zeros((len(fast), 0, fast.shape[2])), *self._slow], axis=1)
        window_s = self._window_ns * 1e-9
        return [
            Cross(self._sensors, self._phase, window_s, self._windows, *own)
            for own in zip(slow, fast, turning, changes, strict=True)
        ]

    def _make_room(self, window: int) -> None:
        missing = window - self._base + 1 - len(self._rows)
        if missing > 0:
            more = max(missing, len(self._rows))
            self._sums = np.concatenate([self._sums, np.zeros((more, *self._sums.shape[1:]))])
            self._rows = np.concatenate([self._rows, np.zeros((more, self._rows.shape[1]))])

    def _work(self, reached: int) -> None:
        """Adds up the segments that end up to window `reached`, which isn't complete itself."""
        count = (reached - self._base) // self._length
        if count < 1:
            return
        done = count * self._length
        self._make_room(self._base + done - 1)
        sums, rows = (held[:done].reshape(count, self._length, *held.shape[1:]) for held in (self._sums, self._rows))
        self._add(sums, rows)
        for held in (self._sums, self._rows):
            held[:-done] = held[done:].copy()
            held[-done:] = 0
        self._base += done

    def _add(self, sums: Floats, rows: Floats) -> None:
        """Segments: sums (s, w, r, m, 3), rows (s, w, m). Windows in which not all sensors read count for nothing."""
        full = np.asarray((rows > 0).all(axis=2))
        told = np.count_nonzero(full, axis=1) >= _SEGMENT_WINDOWS // 2
        slow = np.full((len(self._fast), len(full), self._fast.shape[2]), np.nan)
        self._slow.append(slow)
        if not told.any():
            return
        full = full[told]
        with np.errstate(invalid="ignore"):
            readings = sums[told] / rows[told, :, None, :, None] * self._scale[:, None]
        readings = _filled(np.ascontiguousarray(np.moveaxis(readings, 2, 0)), full)
        line = np.concatenate([readings.reshape(*readings.shape[:3], -1), self._kinematic(readings)], axis=3)
        line, slow[:, told] = _centred(line, full)
        inner = full[:, :-2] & full[:, 1:-1] & full[:, 2:]
        changes, _ = _centred((line[:, :, 2:] - line[:, :, :-2]) / 2, inner)
        parts = (line, line[:, :, 1:-1], changes)
        flat, between, changes = (part.reshape(len(part), -1, part.shape[3]) for part in parts)
        self._fast += flat.swapaxes(1, 2) @ flat
        self._turning += between.swapaxes(1, 2) @ changes
        self._changes += changes.swapaxes(1, 2) @ changes
        self._windows += int(np.count_nonzero(full))
        self._inner_windows += int(np.count_nonzero(inner))

    def _kinematic(self, readings: Floats) -> Floats:
        """(r, s, w, 9) products xx, xy, xz, yy, yz, zz of the mean rate in the box, and its change per second."""
        if not self._gyroscopes:
            return np.zeros((*readings.shape[:3], KINEMATIC))
        rate = np.mean([unit * readings[:, :, :, place] @ turn for place, unit, turn in self._gyroscopes], axis=0)
        first, second = _PRODUCTS
        acceleration = np.gradient(rate, self._window_ns * 1e-9, axis=2)
        return np.concatenate([rate[..., first] * rate[..., second], acceleration], axis=3)


def _filled(readings: Floats, full: Bools) -> Floats:
    """Readings (r, s, w, m, 3) with the segment's mean in windows that aren't full (s, w)."""
    if full.all():
        return readings
    held = full[:, :, None, None]
    mean = np.mean(readings, axis=2, where=held, keepdims=True)
    return np.where(held, readings, mean)


def _centred(line: Floats, held: Bools) -> tuple[Floats, Floats]:
    """Columns (r, s, w, p) less their means (r, s, p) over the windows that are held (s, w), and these; 0 in the
    others.
    """
    if held.all():
        mean = line.mean(axis=2)
        return line - mean[:, :, None], mean
    count = np.maximum(np.count_nonzero(held, axis=1), 1)
    mean = (line * held[:, :, None]).sum(axis=2) / count[:, None]
    return (line - mean[:, :, None]) * held[:, :, None], mean
