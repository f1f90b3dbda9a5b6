"""The slow errors of a log with all that its frames say: back over the filter's steps.

The filter puts its steps on a spool, with what it believed at every `_STRIDE`th; from there the beliefs between are
worked out again on the way back, so that memory holds those of one stride. The results lie on a second spool, the
first segment on top.
"""

from __future__ import annotations

import numpy as np

from imuarray.fuse.frames import Floats
from imuarray.fuse.optimal.filter import Step
from imuarray.fuse.optimal.geometry import Geometry
from imuarray.fuse.optimal.kalman import Adjoint, Innovation, Normal, backwards, corrected, predicted, smoothed
from imuarray.fuse.optimal.spool import Spool
from imuarray.fuse.optimal.states import States
from imuarray.fuse.optimal.view import View, view_of

_STRIDE = 32


class Recorder:
    """Takes the steps of an `ArrayFilter`, then gives the smoothed views of the segments in their order."""

    def __init__(self, geometry: Geometry, states: States) -> None:
        self._geometry, self._states = geometry, states
        self._steps, self._views = Spool(), Spool()
        self._count = 0

    def __call__(self, step: Step) -> None:
        """Keep a step."""
        belief = step.before if self._count % _STRIDE == 0 else ()
        self._steps.push([*step[1:], *belief])
        self._count += 1

    def smooth(self) -> None:
        """Go back over the steps."""
        size = len(self._states.names)
        adjoint = Adjoint(np.zeros(size), np.zeros((size, size)))
        stride: list[list[Floats]] = []
        while self._steps:
            stride.append(self._steps.pop())
            if len(stride[-1]) > len(Step._fields) - 1:
                adjoint = self._back(stride[::-1], adjoint)
                stride = []

    def view(self) -> View:
        """The next segment's."""
        offset, response, errors = self._views.pop()
        return View(self._geometry, offset, response, errors, final=True)

    def close(self) -> None:
        """Give the room back."""
        self._steps.close()
        self._views.close()

    def _back(self, stride: list[list[Floats]], adjoint: Adjoint) -> Adjoint:
        """One stride, in order of time, of which the first begins with a known belief."""
        belief = Normal(*stride[0][-2:])
        taken: list[tuple[Normal, Innovation]] = []
        for left, added, _, rows, values, *_ in stride:
            at = predicted(belief, left, added)
            belief, innovation = corrected(at, rows, values)
            taken.append((at, innovation))
        for (at, innovation), (left, _, warmer_degc, *_) in zip(taken[::-1], stride[::-1], strict=True):
            adjoint = backwards(adjoint, at, innovation)
            view = view_of(self._states, self._geometry, smoothed(at, adjoint), warmer_degc, final=True)
            self._views.push([view.offset, view.response, view.errors])
            adjoint = Adjoint(left * adjoint.vector, adjoint.matrix * np.outer(left, left))
        return adjoint
