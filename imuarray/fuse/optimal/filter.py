"""Kalman filter of the slow errors of an array, segment by segment, from the parities of the frames.

The stimulus of every frame is unknown, so only the parities of a frame, the combinations of its readings that do not
depend on the stimulus, contain information about errors. Slow errors are constant during a segment, so sums over its
frames (`SegmentEvidence`) are sufficient statistics.

Segments are counted from the first frame and have 1, 1, 2, 4, 8, ... frames, up to the full length. The frames of a
segment are solved with the estimate from the segments before it. The limits of blocks have no effect.

One part of the slow errors acts on the change of the stimulus instead of the stimulus, because the time of a reading is
not known exactly: the error of a reading that is late by t is t times the stimulus's change per second. While a box is
moved to and fro, that error varies like noise. Where the change is fast, frames therefore have less weight for slow
errors, the covariances of the frames are larger, and gains are those of a noise that is increased by the mean square of
the change over the segment before.

The smoother of a log is a backward pass over the steps of the filter, with its data on disk. The filter stores its
steps on a spool (`Spool`, a stack of arrays in a temporary file), with the estimate at every `_STRIDE`th step. The
backward pass recomputes the estimates in between from these, so that those of one stride are in memory. The results are
stored on a second spool, with the first segment on top.
"""

from __future__ import annotations

import math
from array import array
from bisect import bisect_left
from collections.abc import Callable, Iterator, Sequence
from itertools import pairwise
from tempfile import TemporaryFile
from typing import NamedTuple

import numpy as np

from imuarray.arrays import Booleans, Floats, Indices, Times
from imuarray.fuse.optimal import compiled
from imuarray.fuse.optimal.frame_solution import FrameSolution, SegmentView, SmoothedEffect, segment_view, solve
from imuarray.fuse.optimal.geometry import FrameReadings, Geometry, hold_last, patterns
from imuarray.fuse.optimal.states import (
    Adjoint,
    Drift,
    ErrorStates,
    Gaussian,
    Innovation,
    StateResponse,
    StateStep,
    correct_states,
    predict_states,
    smoothed_drifts,
)

OVER_S = 0.05
"""Time over which a change is evaluated: the noise of a frame is small in comparison, and shaking by hand is slower."""


class Dynamics:
    """The change of consecutive triads, block after block."""

    def __init__(self, geometry: Geometry, period_s: float) -> None:
        self._geometry = geometry
        self._lookback = max(1, round(OVER_S / period_s))
        self._time, self._triad = np.zeros(0, np.int64), np.zeros((0, 3))
        self._sum, self._frames, self._mean = 0.0, 0, 0.0
        self._worst = float((geometry.timing / geometry.noise).max(initial=0.0))

    def recent(self) -> float:
        """Return the mean square of the change per second since the last call, and start a new mean."""
        if self._frames:
            self._mean = self._sum / self._frames
        self._sum, self._frames = 0.0, 0
        return self._mean

    def solve(
        self,
        view: SegmentView,
        readings: FrameReadings,
        solution: FrameSolution,
        frames: slice,
        evidence: SegmentEvidence | None = None,
    ) -> None:
        """Solve the triads of `readings`, which are `frames` of the solution, increase their covariances by the effect
        of the change, and add them to the `evidence`.
        """
        packed = view.packed
        if packed is None or not self._solve_alike(view, packed, readings, solution.part(frames), evidence):
            solve(view, readings, solution, frames)
            weights = self(view, readings, solution, frames)
            if evidence is not None:
                evidence.add(readings, solution, frames, weights)

    def _solve_alike(
        self,
        view: SegmentView,
        packed: Floats,
        readings: FrameReadings,
        into: FrameSolution,
        evidence: SegmentEvidence | None,
    ) -> bool:
        """Do the same by compiled code; return whether that is possible."""
        count, back = len(readings.time), self._lookback if self._worst > 0 else 0
        if not readings.same_rows or readings.bounds is not None or (back and len(self._time) < back):
            return False
        valid, (rows, unknowns, terms) = readings.valid[0], view.sizes
        if valid.tobytes() != view.packed_rows:
            return False
        sums = _RegressionSums(terms, rows) if evidence is None else evidence.sums_of(valid)
        weights = np.empty(count)
        inputs = (
            np.ascontiguousarray(readings.values, float),
            packed,
            self._triad[:back],
            np.ascontiguousarray(readings.time, np.int64),
            self._time[:back],
        )
        done, change = compiled.frames(
            (*inputs, into.unknowns, into.covariance, weights, sums.squares, sums.products, sums.blur),
            (count, rows, unknowns, terms, back),
            evidence is not None,
            view.reach,
            self._worst,
            self._geometry.fair_square,
        )
        if not done:
            return False
        into.used[:] = valid[: self._geometry.axes]
        if back:
            self._sum, self._frames = self._sum + change, self._frames + count
            self._time = np.concatenate([self._time, readings.time[-back:]])[-back:]
            self._triad = np.concatenate([self._triad, into.unknowns[-back:, :3]])[-back:]
        if evidence is not None and done == 1:
            evidence.add(readings, into, slice(None), weights)
        return True

    def __call__(
        self, view: SegmentView, readings: FrameReadings, solution: FrameSolution, frames: slice
    ) -> Floats | None:
        """Increase the covariances of frames by the effect of the change. Return the weights (n,) of the frames for
        slow errors; None if all are 1.
        """
        if not self._worst or not len(readings.time):
            return None
        changes = self._changes(readings.time, solution.unknowns[frames, :3])
        self._sum, self._frames = self._sum + float(changes.sum()), self._frames + len(changes)
        for valid, which in readings.patterns():
            usual = view.usual(valid)
            if usual is not None:
                solution.covariance[frames][which] += changes[which][:, None, None] * usual.timing
        return np.asarray(1 / (1 + self._worst**2 * changes))

    def _changes(self, time: Times, triad: Floats) -> Floats:
        """Return the squares (n,) of the change per second; 0 if not yet known."""
        times, triads = np.concatenate([self._time, time]), hold_last(np.concatenate([self._triad, triad]))
        now: slice | Indices = slice(len(self._time), len(times))
        then: slice | Indices = slice(len(times) - self._lookback)
        if len(self._time) < self._lookback:  # the first frames have no frame so far back
            now = np.arange(len(self._time), len(times))
            then = np.maximum(now - self._lookback, 0)
        self._time, self._triad = times[-self._lookback :], triads[-self._lookback :]
        seconds = np.maximum((times[now] - times[then]) * 1e-9, 1e-9)
        return np.asarray(np.nan_to_num(((triads[now] - triads[then]) ** 2).sum(axis=1) / seconds**2))


_DOUBT = 3.0
"""Least sum of squares, in standard deviations of that of noise, that counts as signal."""

_KEPT = 1024
"""Number of parities that are cached for the next segments."""


class _RegressionSums:
    """Sums over the frames with the same rows in use: of the products of (1, stimulus) with itself (`squares`) and with
    the readings (`products`), and of the stimulus's covariances, which the squares include (`blur`).
    """

    def __init__(self, terms: int, rows: int) -> None:
        self.squares = np.zeros((terms, terms))
        self.products = np.zeros((terms, rows))
        self.blur = np.zeros((3, 3))


class SegmentEvidence:
    """The sums over the current segment, and the cached `parity` of every set of rows."""

    def __init__(self, geometry: Geometry, terms: int) -> None:
        self._geometry, self._terms = geometry, terms
        self._parities: dict[bytes, Floats] = {}
        self._sums: dict[bytes, _RegressionSums] = {}

    def add(
        self, readings: FrameReadings, solution: FrameSolution, frames: slice, weights: Floats | None = None
    ) -> None:
        """Add the readings of `frames` of the solution with `weights` (n,) up to 1 (None: all 1)."""
        triad, covariance = solution.unknowns[frames, :3], solution.covariance[frames, :3, :3]
        fair = self._fair(readings.valid, triad, solution.used[frames])
        for valid, which in readings.patterns() if fair is readings.valid else patterns(fair):
            if not valid.any():
                continue
            sums = self.sums_of(valid)
            values = readings.values[which]
            weight = np.ones(len(values)) if weights is None else weights[which]
            if self._terms == 1:
                sums.squares += weight.sum()
                sums.products += weight @ values
                continue
            terms = np.concatenate([np.ones((len(values), 1)), triad[which]], axis=1)
            weighted = (terms * weight[:, None]).T
            sums.squares += weighted @ terms
            sums.products += weighted @ values
            sums.blur += np.tensordot(weight, covariance[which], axes=1)

    def sums_of(self, valid: Booleans) -> _RegressionSums:
        """Return the sums over the frames with these rows in use."""
        key = valid.tobytes()
        if key not in self._parities:
            self._parities[key] = self._geometry.parity(valid)
        if key not in self._sums:
            self._sums[key] = _RegressionSums(self._terms, len(valid))
        return self._sums[key]

    def measurements(self, response: StateResponse) -> tuple[Floats, Floats]:
        """Return the measurements (p, n) and values (p,) of the segment, ``values = measurements @ states + errors`` of
        unit variance, from the `response` of the readings to the states; then start a new segment.
        """
        parts = [
            _measurements(sums, self._parities[key], response)
            for key, sums in self._sums.items()
            if sums.squares[0, 0]  # else no frame was added
        ]
        self._sums = {}
        if len(self._parities) > _KEPT:
            self._parities = {}
        states = response.dense.shape[2]
        if not parts:
            return np.zeros((0, states)), np.zeros(0)
        rows, values = parts[0]
        if len(parts) > 1:
            rows, values = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))
        if len(rows) > states + 1:
            both = np.asarray(np.linalg.qr(np.concatenate([rows, values[:, None]], axis=1), mode="r"))
            return np.ascontiguousarray(both[:, :-1]), np.ascontiguousarray(both[:, -1])
        return rows, values

    def _fair(self, valid: Booleans, triad: Floats, used: Booleans) -> Booleans:
        """Return the readings (n, r) to use: of frames with a triad, and of axes that are not near the ends of their
        range.
        """
        solved = np.asarray(used.any(axis=1))
        if not solved.all():
            valid = valid & solved[:, None]
        fair = self._geometry.fair
        if np.nanmax(np.einsum("ni,ni->n", triad, triad), initial=0.0) < fair.min() ** 2 and fair.min() > 0:
            return valid
        return valid & (np.abs(np.nan_to_num(triad) @ self._geometry.rows[:, :3].T) < fair)


def _measurements(sums: _RegressionSums, parity: Floats, response: StateResponse) -> tuple[Floats, Floats]:
    """Return the measurements (p, n) and values (p,) by the sums over frames with one parity."""
    size, (terms, rows, states) = len(parity), response.dense.shape
    measured = np.empty((terms * size, states)), np.empty(terms * size)
    inputs = (sums.squares, sums.products, sums.blur, parity, *response.sparse)
    count, entries = -1, len(response.sparse[1])
    if compiled.COMPILED:
        count = compiled.measure((*inputs, *measured), (states, terms, rows, entries, size), _DOUBT)
    if count >= 0:
        return measured[0][: count * size], measured[1][: count * size]
    sizes, weights = _components(sums)
    responses = weights @ (parity @ response.dense).reshape(terms, size * states)
    scaled = responses.reshape(len(sizes), size, states) * sizes[:, None, None]
    return scaled.reshape(len(sizes) * size, states), (weights @ sums.products @ parity.T / sizes[:, None]).ravel()


def _components(sums: _RegressionSums) -> tuple[Floats, Floats]:
    """Return the roots of the sizes (c,), and weights (c, terms), of the independent components of the sums of (1,
    stimulus), after subtraction of the contribution of the stimulus's own noise.
    """
    if len(sums.squares) == 1:
        return np.sqrt(sums.squares[0]), np.ones((1, 1))
    squares = sums.squares.copy()
    frames = squares[0, 0]
    squares[1:, 1:] -= sums.blur
    sizes, vectors = np.linalg.eigh(squares)
    noise = _DOUBT * np.sqrt(2 / frames) * np.linalg.eigvalsh(sums.blur)[-1]
    known = sizes > max(noise, 1e-9 * sizes[-1])
    return np.sqrt(sizes[known]), vectors[:, known].T


class Step(NamedTuple):
    """One segment of the filter: the states `before` its transition, the `remaining` shares of them and the `added`
    variance, the temperature of the rows above that of their biases, and what was measured.
    """

    before: Gaussian
    remaining: Floats
    added: Floats
    warmer_degc: Floats
    innovation: Innovation


class SegmentEnds:
    """The ends of segments of up to `full` frames, counted from the first frame."""

    def __init__(self, full: int) -> None:
        self._full = full
        self._done = 0
        self._left = 1
        self.starts = True

    def parts(self, frames: int) -> Iterator[tuple[slice, bool, bool]]:
        """Yield the pieces of the next `frames` within one segment: the frames, whether a segment starts with them, and
        whether it ends with them.
        """
        at = 0
        while at < frames:
            size = min(self._left, frames - at)
            starts, self._left = self.starts, self._left - size
            self.starts = self._left == 0
            if self.starts:
                self._left = min(self._full, 1 << min(self._done, 62))
                self._done += 1
            yield slice(at, at + size), starts, self.starts
            at += size


class ArrayFilter:
    """Estimates the slow errors of the rows of one quantity and the triads of consecutive blocks of frames; `record` is
    called with the step of every segment.
    """

    def __init__(
        self,
        geometry: Geometry,
        states: ErrorStates,
        segment_frames: int,
        dynamics: Dynamics,
        record: Callable[[Step], None] | None = None,
    ) -> None:
        self.states, self.geometry = states, geometry
        self.belief = Gaussian(np.zeros(len(states.names)), states.prior)
        self.warmer_degc = np.zeros(len(geometry.noise))
        self._segments = SegmentEnds(segment_frames)
        self._evidence = SegmentEvidence(geometry, states.terms)
        self._record, self._dynamics = record, dynamics
        self._since: int | None = None
        self._stimulus = np.zeros(3)
        self._view: SegmentView | None = None
        self._step = (self.belief, np.ones(len(states.names)), np.zeros(len(states.names)))

    def __call__(self, readings: FrameReadings, warmer: Callable[[int], Floats]) -> FrameSolution:
        """Solve the next frames; `warmer` returns the temperatures (r,) of the rows above those of their biases at a
        frame of the block.
        """
        solution = FrameSolution.empty(len(readings.time), self.geometry)
        for frames, starts, ends in self._segments.parts(len(readings.time)):
            part = readings.part(frames)
            view = self._begin(part, warmer(frames.start)) if starts or self._view is None else self._view
            self._dynamics.solve(view, part, solution, frames, self._evidence)
            if ends:
                self.end()
        return solution

    def _begin(self, part: FrameReadings, warmer_degc: Floats) -> SegmentView:
        """Predict the state at the start of a segment, and return its view."""
        since = int(part.time[0]) if self._since is None else self._since
        decay, added = self.states.transition(max(0, int(part.time[0]) - since) * 1e-9)
        self._step = (self.belief, decay, added)
        self.belief = predict_states(self.belief, decay, added)
        self._since, self.warmer_degc = int(part.time[0]), warmer_degc
        self._view = segment_view(self.states.response_at(warmer_degc), self.geometry, self.belief)
        self._view.begin(part, self._stimulus, self._dynamics.recent())
        self._stimulus = self._view.stimulus
        return self._view

    def end(self) -> None:
        """End the current segment, complete or not, and update the states by its frames."""
        if self._view is None:
            return
        rows, values = self._evidence.measurements(self.states.response_at(self.warmer_degc))
        self.belief, innovation = correct_states(self.belief, rows, values)
        if self._record is not None:
            self._record(Step(*self._step, self.warmer_degc, innovation))
        self._view = None


_HELD_BYTES = 1 << 20
"""Size of the last groups that a spool holds in memory, and writes and reads together."""


class Spool:
    """A stack of groups of arrays, the last ones in memory and the others in a temporary file, which is deleted with
    the object. A group is stored as one row of numbers.
    """

    def __init__(self) -> None:
        self._file = TemporaryFile()  # noqa: SIM115, it lives as long as the spool
        self._starts, self._end = array("q"), 0
        """The number in the file at which each of its groups begins, and the number of all."""
        self._shapes: list[tuple[tuple[int, ...], ...]] = []
        self._places: dict[tuple[tuple[int, ...], ...], int] = {}
        """The distinct shapes of the arrays of a group, of which there are few, and their places in the list."""
        self._kinds = array("I")
        """The place of the shapes of each group."""
        self._held: list[Floats] = []
        self._held_bytes = 0

    def __bool__(self) -> bool:
        """Return whether the stack has any group."""
        return len(self._kinds) > 0

    def push(self, arrays: Sequence[Floats]) -> None:
        """Push a group."""
        shapes = tuple([rows.shape for rows in arrays])
        place = self._places.setdefault(shapes, len(self._shapes))
        if place == len(self._shapes):
            self._shapes.append(shapes)
        self._kinds.append(place)
        self._held.append(np.concatenate(arrays, axis=None))
        self._held_bytes += self._held[-1].nbytes
        if self._held_bytes > _HELD_BYTES:
            self._write()

    def pop(self) -> list[Floats]:
        """Pop the last group; IndexError if there is none."""
        if not self:
            raise IndexError("the spool is empty")
        if not self._held:
            self._read()
        numbers, start, arrays = self._held.pop(), 0, []
        self._held_bytes -= numbers.nbytes
        for shape in self._shapes[self._kinds.pop()]:
            stop = start + math.prod(shape)
            arrays.append(numbers[start:stop].reshape(shape))
            start = stop
        return arrays

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def _write(self) -> None:
        """Write the groups in memory to the file."""
        self._file.seek(8 * self._end)
        self._file.write(b"".join([numbers.data for numbers in self._held]))
        for numbers in self._held:
            self._starts.append(self._end)
            self._end += len(numbers)
        self._held, self._held_bytes = [], 0

    def _read(self) -> None:
        """Take the last groups from the file into memory."""
        first = bisect_left(self._starts, self._end - _HELD_BYTES // 8, hi=len(self._starts) - 1)
        start = self._starts[first]
        self._file.seek(8 * start)
        numbers = np.frombuffer(self._file.read(8 * (self._end - start)))
        self._held_bytes = numbers.nbytes
        ends = [begin - start for begin in [*self._starts[first + 1 :], self._end]]
        self._held = [numbers[begin:end] for begin, end in pairwise([0, *ends])]
        del self._starts[first:]
        self._end = start


_STRIDE = 32

_PLAIN = 6
"""Number of arrays of a step without a recorded state."""


class SegmentSmoother:
    """Records the steps of an `ArrayFilter`, then returns the smoothed views of the segments in order."""

    def __init__(self, geometry: Geometry, states: ErrorStates) -> None:
        self._geometry, self._states = geometry, states
        self._drifting = states.drifting
        self._steps, self._views = Spool(), Spool()
        self._count = 0
        self._at_end = Gaussian(np.zeros(len(states.names)), states.prior)
        self._effect: SmoothedEffect | None = None

    def __call__(self, step: Step) -> None:
        """Record a step."""
        before, *others, innovation = step
        belief = before if self._count % _STRIDE == 0 else ()
        self._steps.push([*others, *innovation, *belief])
        self._count += 1

    def smooth(self, at_end: Gaussian) -> None:
        """Run the backward pass over the steps, from the filter's states `at_end`."""
        self._at_end = at_end
        size = len(self._states.names)
        adjoint = Adjoint(np.zeros(size), np.zeros((size, size)))
        stride: list[list[Floats]] = []
        while self._steps:
            stride.append(self._steps.pop())
            if len(stride[-1]) > _PLAIN:
                adjoint = self._smooth_stride(stride[::-1], adjoint)
                stride = []

    def view(self) -> SegmentView:
        """Return the smoothed view of the next segment."""
        warmer_degc, offset, errors = self._views.pop()
        states = self._states.response_at(warmer_degc)
        if self._effect is None or self._effect.states is not states:
            self._effect = SmoothedEffect(self._geometry, states, self._at_end, self._drifting)
        return self._effect.view(Drift(offset, errors))

    def close(self) -> None:
        """Delete the temporary files."""
        self._steps.close()
        self._views.close()

    def _smooth_stride(self, stride: list[list[Floats]], adjoint: Adjoint) -> Adjoint:
        """Smooth one stride, in order of time, whose first step has the recorded state."""
        warmer_degc = [step[2] for step in stride]
        steps = [
            StateStep(decay, added, Innovation(*innovation[:3]), self._states.response_at(warmer))
            for decay, added, warmer, *innovation in stride
        ]
        drifts, adjoint = smoothed_drifts(Gaussian(*stride[0][-2:]), steps, adjoint, self._drifting)
        for warmer, drift in zip(warmer_degc[::-1], drifts[::-1], strict=True):
            self._views.push([warmer, *drift])
        return adjoint
