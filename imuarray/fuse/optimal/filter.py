"""The recursive part: what is known of the slow errors grows from segment to segment.

Segments are counted from the first frame: of 1, 1, 2, 4, 8, ... frames, up to the full length. Frames of one are solved
with what those before it told; slow errors stay as they are during one. Where a block ends makes no difference.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np

from imuarray.fuse.frames import Floats
from imuarray.fuse.optimal.dynamics import Dynamics
from imuarray.fuse.optimal.evidence import Evidence
from imuarray.fuse.optimal.geometry import Geometry
from imuarray.fuse.optimal.kalman import Normal, corrected, predicted
from imuarray.fuse.optimal.readings import Readings
from imuarray.fuse.optimal.solve import Solution, solve
from imuarray.fuse.optimal.states import States
from imuarray.fuse.optimal.view import View, view_of


class Step(NamedTuple):
    """One segment as the filter took it: `before` its transition, what was `left` and `added` by that, how much warmer
    than their biases the rows were, and the measurements.
    """

    before: Normal
    left: Floats
    added: Floats
    warmer_degc: Floats
    rows: Floats
    values: Floats


class Segments:
    """Where segments of up to `full` frames end, counted from the first frame."""

    def __init__(self, full: int) -> None:
        self._full = full
        self._done = 0
        self._left = 1
        self.starts = True

    def parts(self, frames: int) -> Iterator[tuple[slice, bool, bool]]:
        """The pieces of the next `frames`: where, whether a segment starts with it, whether it ends."""
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
    """The slow errors of the rows of one quantity, and the triads of consecutive blocks of frames.

    `warmer` gives (r,), how much warmer than their biases the rows are, at a frame of the block; `record` is given
    every segment's step.
    """

    def __init__(
        self,
        geometry: Geometry,
        states: States,
        segment_frames: int,
        dynamics: Dynamics,
        record: Callable[[Step], None] | None = None,
    ) -> None:
        self.states, self.geometry = states, geometry
        self.belief = Normal(np.zeros(len(states.names)), states.prior)
        self.warmer_degc = np.zeros(len(geometry.noise))
        self._segments = Segments(segment_frames)
        self._evidence = Evidence(geometry, states.terms)
        self._record, self._dynamics = record, dynamics
        self._since: int | None = None
        self._stimulus = np.zeros(3)
        self._view: View | None = None
        self._step = (self.belief, np.ones(len(states.names)), np.zeros(len(states.names)))

    def __call__(self, readings: Readings, warmer: Callable[[int], Floats]) -> Solution:
        """The triads of the next frames."""
        solution = Solution(len(readings.time), self.geometry)
        for frames, starts, ends in self._segments.parts(len(readings.time)):
            part = readings.part(frames)
            view = self._begun(part, warmer(frames.start)) if starts or self._view is None else self._view
            solve(view, part, solution, frames)
            self._evidence.add(part, solution, frames, self._dynamics(view, part, solution, frames))
            if ends:
                self.end()
        return solution

    def _begun(self, part: Readings, warmer_degc: Floats) -> View:
        """What is believed as a segment begins."""
        since = int(part.time[0]) if self._since is None else self._since
        left, added = self.states.transition(max(0, int(part.time[0]) - since) * 1e-9)
        self._step = (self.belief, left, added)
        self.belief = predicted(self.belief, left, added)
        self._since, self.warmer_degc = int(part.time[0]), warmer_degc
        self._view = view_of(self.states, self.geometry, self.belief, warmer_degc)
        self._view.begin(part, self._stimulus, self._dynamics.recent())
        self._stimulus = self._view.stimulus
        return self._view

    def end(self) -> None:
        """Learn from the frames of a segment, whole or not, that has begun."""
        if self._view is None:
            return
        rows, values = self._evidence.measurements(self.states.rows(self.warmer_degc))
        if self._record is not None:
            self._record(Step(*self._step, self.warmer_degc, rows, values))
        if len(rows):
            self.belief, _ = corrected(self.belief, rows, values)
        self._view = None
