"""Fault monitors: a stage between alignment and technique that excludes failed axes of one quantity.

Frames are processed in decision windows of a tenth of a second, counted from the first frame, so that the limits of
blocks have no effect. Frames are returned one window late, so that a faulty axis is excluded from the window in which
the fault is detected and from the one before, in which it may have begun.

`MonitoredPipeline` puts monitors before another pipeline.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from imuarray.arrays import Booleans, Floats
from imuarray.calibrate.runs import NO_RANGES, Ranges
from imuarray.errors import FusionError
from imuarray.fuse.faults.exclusions import FaultEvent
from imuarray.fuse.faults.fast_path import WindowSeries
from imuarray.fuse.faults.fault_isolation import FaultIsolation
from imuarray.fuse.faults.window import DecisionWindow, lever_arms
from imuarray.fuse.frames import Axis, Frames, directions
from imuarray.fuse.least_squares import consensus
from imuarray.fuse.pipeline import FusionNotes, Out, Pipeline, notes_of

WINDOW_S = 0.1
"""Length of a decision window; two of them are the delay of a live result."""

LEAST_FRAMES = 4
"""Fewest frames of a window: in a slow log, windows are longer."""

_AT_FIRST, _AT_ONCE = 8, 256
"""Number of windows that are prepared together: after an exclusion or readmission, and at most (some megabytes)."""


class ExclusionMasks:
    """The axes that a monitor excluded from each frame; only changes are stored."""

    def __init__(self, window: int, axes: int) -> None:
        self._window, self._windows = window, 0
        self._begins, self._masks = [0], [np.zeros(axes, bool)]

    def add(self, masks: Booleans) -> None:
        """Add the masks (k, m) of the next windows."""
        before = np.concatenate([self._masks[-1][None], masks[:-1]])
        for row in np.flatnonzero((masks != before).any(axis=1)).tolist():
            self._begins.append((self._windows + row) * self._window)
            self._masks.append(masks[row].copy())
        self._windows += len(masks)

    def of(self, frames: Frames, first: int) -> Frames:
        """Return the frames, whose first one has the number `first`, without the excluded axes."""
        numbers = np.arange(first, first + len(frames.time))
        which = np.searchsorted(self._begins, numbers, "right") - 1
        used, where = np.unique(which, return_inverse=True)
        masks = np.array([self._masks[index] for index in used.tolist()])
        if not masks.any():
            return frames
        return frames.without(masks[where])


class FaultMonitor:
    """Processes consecutive blocks of frames of one quantity, of any length, and returns the same frames, with `valid`
    False for faulty axes. `events` are the events so far.

    At most two decision windows are delayed (0.2 s, or 8 frames if those are longer); `finish` returns them. A fault is
    detected in any geometry of two or more triads, and isolated if the axes determine the faulty one; with two triads,
    only a triad that is stuck, or whose range or noise changed, can be isolated.
    """

    def __init__(self, axes: Sequence[Axis], quantity: str, *, period_s: float, ranges: Ranges = NO_RANGES) -> None:
        """`axes` are triads, as returned by `axes_of`, of `quantity` ("specific_force" or "angular_rate"); `period_s`
        from frame to frame; `ranges` the sensitivities of the chips by name, to identify a sensor that returned to
        another range. FusionError for axes that are not triads, and for a period that is not above 0.
        """
        _check(axes, period_s)
        self.window = max(LEAST_FRAMES, round(WINDOW_S / period_s))
        self._rows = directions(axes)
        self._isolation = FaultIsolation(axes, self._rows, quantity, self.window, period_s, ranges)
        self._positions_m = np.array([axis.position_m for axis in axes])
        self._spread_out = quantity == "specific_force" and bool(np.ptp(self._positions_m, axis=0).any())
        self._held: Frames | None = None
        self._rates = np.empty((0, 3))
        self._masks: list[Booleans] = []
        self.left_out = ExclusionMasks(self.window, len(axes))

    @property
    def events(self) -> tuple[FaultEvent, ...]:
        """The events so far, in order."""
        return tuple(self._isolation.report.events)

    @property
    def disagreement_s(self) -> float:
        """Total time in which all sensors disagree (`disagreement`), so that none is suspected."""
        return self._isolation.disagreement_s

    def __call__(self, frames: Frames, rate_box: Floats | None = None) -> Frames:
        """Process the next frames and return the frames that are complete, in order.

        `rate_box` (n, 3) is the box's angular rate in rad/s at these frames. For accelerometers at different positions
        (`Axis.position_m`) it is used to remove the effect of turns; without it a fast turn may look like a fault.
        """
        if rate_box is None:
            rate_box = np.zeros((len(frames.time), 3))
        self._rates = np.concatenate([self._rates, rate_box])
        held = frames if self._held is None else Frames.joined([self._held, frames])
        first = len(self._masks) * self.window
        starts = range(first, len(held.time) - self.window + 1, self.window)
        sound = _sound(held, first, len(starts), self.window) if starts else np.zeros(0, bool)
        disturbed = np.append(np.flatnonzero(~sound), len(sound))
        stretch, start, ahead, number = None, 0, _AT_FIRST, 0
        while number < len(starts):
            if sound[number]:
                if stretch is None or number - start >= len(stretch):
                    stretch, start = self._stretch(held, starts[number : number + ahead]), number
                    ahead = min(2 * ahead, _AT_ONCE)
                if stretch is not None:
                    last = min(int(disturbed[np.searchsorted(disturbed, number)]), start + len(stretch))
                    passed = self._isolation.advance(stretch, range(number - start, last - start))
                    self._masks += [stretch.out.copy() for _ in range(passed)]
                    number += passed
                    if passed:
                        continue
            self._masks.append(np.zeros(held.valid.shape[1], bool))
            excluded = self._isolation.out
            self._isolation(self._window_at(held, starts[number]), self._masks[-2:])
            if (self._isolation.out != excluded).any():
                stretch, ahead = None, _AT_FIRST
            number += 1
        return self._release(held, max(0, len(self._masks) - 1))

    def finish(self) -> Frames | None:
        """Return the remaining frames; None if there are none. Frames after the last whole window are without the axes
        that are excluded at the end.
        """
        if self._held is None or not len(self._held.time):
            return None
        self._isolation.close()
        self._masks.append(self._isolation.out)
        return self._release(self._held, len(self._masks))

    def _stretch(self, frames: Frames, starts: range) -> WindowSeries | None:
        """Return the fast path for the windows that begin at these rows; None if it does not apply."""
        rows = slice(starts[0], starts[-1] + self.window)
        shape = (len(starts), self.window)
        time, values = frames.time[rows].reshape(shape), frames.values[rows].reshape(*shape, -1)
        if self._spread_out:
            rates = self._rates[rows].reshape(*shape, 3)
            values = values - np.stack(
                [lever_arms(*window, self._positions_m, self._rows) for window in zip(time, rates, strict=True)]
            )
        return self._isolation.stretch(time, values)

    def _window_at(self, frames: Frames, start: int) -> DecisionWindow:
        """Return the decision window that begins at a row."""
        rows = slice(start, start + self.window)
        values = frames.values[rows]
        if self._spread_out:
            values = values - lever_arms(frames.time[rows], self._rates[rows], self._positions_m, self._rows)
        stale = None if frames.stale is None else frames.stale[rows]
        return DecisionWindow(frames.time[rows], values, frames.valid[rows], stale)

    def _release(self, frames: Frames, windows: int) -> Frames:
        """Return the frames of the first `windows` windows, masked, and keep the others."""
        stop = min(windows * self.window, len(frames.time))
        self._held, self._rates = frames.part(slice(stop, None)), self._rates[stop:]
        released = frames.part(slice(stop))
        masks = np.array(self._masks[:windows]).reshape(windows, frames.valid.shape[1])
        self._masks = self._masks[windows:]
        self.left_out.add(masks)
        if not masks.any():
            return released
        excluded = np.repeat(masks, self.window, axis=0)[:stop]
        return released.without(excluded)


def _sound(frames: Frames, first: int, windows: int, length: int) -> Booleans:
    """Return (k,) the windows of `length` frames, from the row `first` on, in which every reading is present and no
    triad is always stale.
    """
    rows = slice(first, first + windows * length)
    sound: Booleans = np.asarray(frames.valid[rows].reshape(windows, -1).all(axis=1))
    if frames.stale is not None and frames.stale[rows].any():
        stale: Booleans = np.asarray(frames.stale[rows].reshape(windows, length, -1, 3).all(axis=(1, 3)))
        sound = np.asarray(sound & ~stale.any(axis=1))
    return sound


def _check(axes: Sequence[Axis], period_s: float) -> None:
    """Raise FusionError unless the axes are triads and the period is positive."""
    triads = [axes[start : start + 3] for start in range(0, len(axes), 3)]
    if not axes or any([axis.index for axis in triad] != [0, 1, 2] for triad in triads):
        raise FusionError(f"{len(axes)} axes: triads in the order x, y, z, sensor by sensor, are required")
    for triad in triads:
        if len({axis.sensor for axis in triad}) > 1:
            raise FusionError(f"sensor {triad[0].sensor}: a whole triad is required, but {triad[1].label} follows")
    if not period_s > 0:
        raise FusionError(f"period_s: {period_s}; it must be above 0")


_RATE = "angular_rate"


class MonitoredPipeline(Pipeline[Out]):
    """A fault monitor of each quantity before another pipeline; both monitors use the same windows, so that they return
    the same frames. `report` is called with each event when it is detected.
    """

    def __init__(
        self,
        inner: Pipeline[Out],
        axes: Mapping[str, Sequence[Axis]],
        period_s: float,
        ranges: Ranges,
        report: Callable[[FaultEvent], None],
    ) -> None:
        self._inner = inner
        self._monitors = {
            quantity: FaultMonitor(triads, quantity, period_s=period_s, ranges=ranges)
            for quantity, triads in axes.items()
        }
        self._report, self._reported = report, dict.fromkeys(axes, 0)
        self._gyroscopes = directions(axes.get(_RATE, []))
        self._has_lever_arms = any(
            axis.position_m != triads[0].position_m for triads in axes.values() for axis in triads
        )
        self._degc: dict[str, Floats] = {}
        """Temperatures of the frames that the monitors have not returned yet."""

    @property
    def left_out(self) -> dict[str, ExclusionMasks]:
        """The axes excluded from the frames so far, by quantity."""
        return {quantity: monitor.left_out for quantity, monitor in self._monitors.items()}

    def __call__(self, frames: Mapping[str, Frames], degc: Mapping[str, Floats]) -> Iterator[Out]:
        """See `Pipeline`."""
        rate_box = self._rate_box(frames)
        released = {quantity: self._monitors[quantity](part, rate_box) for quantity, part in frames.items()}
        self._report_events()
        self._degc = {name: np.concatenate([self._degc.get(name, values[:0]), values]) for name, values in degc.items()}
        yield from self._pass_on(released)

    def _rate_box(self, frames: Mapping[str, Frames]) -> Floats | None:
        """Return the angular rate (n, 3) of the box, which affects sensors at different positions; None if not known or
        not required.
        """
        if _RATE not in frames or not self._has_lever_arms:
            return None
        part = frames[_RATE]
        return np.nan_to_num(consensus(part.values, part.valid, self._gyroscopes, _RATE))

    def finish(self) -> Iterator[Out]:
        """See `Pipeline`."""
        last = {quantity: monitor.finish() for quantity, monitor in self._monitors.items()}
        self._report_events()
        yield from self._pass_on({quantity: part for quantity, part in last.items() if part is not None})
        yield from self._inner.finish()

    def notes(self) -> FusionNotes:
        """Return the notes of the inner pipeline, with the remarks of the monitors."""
        notes = notes_of(self._inner)
        return replace(notes, remarks=(*notes.remarks, *self.remarks()))

    def remarks(self) -> list[str]:
        """Return a sentence for each quantity whose sensors all disagreed at times."""
        return [
            f"{quantity}: for {monitor.disagreement_s:.1f} s all sensors disagree (knocks, clipping, or motion that is "
            "too fast for the rate of the rows); no sensor is suspected in that time"
            for quantity, monitor in self._monitors.items()
            if monitor.disagreement_s > 0
        ]

    def _pass_on(self, frames: Mapping[str, Frames]) -> Iterator[Out]:
        """Pass complete frames and their temperatures to the inner pipeline."""
        count = max((len(part.time) for part in frames.values()), default=0)
        if count:
            now = {name: values[:count] for name, values in self._degc.items()}
            self._degc = {name: values[count:] for name, values in self._degc.items()}
            yield from self._inner(frames, now)

    def _report_events(self) -> None:
        for quantity, monitor in self._monitors.items():
            for event in monitor.events[self._reported[quantity] :]:
                self._report(event)
            self._reported[quantity] = len(monitor.events)
