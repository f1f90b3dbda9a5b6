"""Smoother of the slow errors of a log: a backward pass over the steps of the filter, with its data on the disk.

The filter puts its steps on a spool (`Spool`, a stack of arrays in a temporary file), with the estimate at every
`_STRIDE`th. On the way back the estimates between are recomputed from there, so that memory holds those of one stride.
The results are put on a second spool, the first segment on top.
"""

from __future__ import annotations

import math
import struct
from array import array
from collections.abc import Sequence
from tempfile import TemporaryFile

import numpy as np

from imuarray.arrays import Floats
from imuarray.fuse.optimal.filter import Step
from imuarray.fuse.optimal.frame_solution import SegmentView, segment_view
from imuarray.fuse.optimal.geometry import Geometry
from imuarray.fuse.optimal.states import (
    Adjoint,
    Gaussian,
    Innovation,
    States,
    backwards,
    corrected,
    predicted,
)

_LENGTH = struct.Struct("<q")
"""Begin of a group: the length of its head, the shapes."""


class Spool:
    """Groups of arrays, last in, first out, in a temporary file that nobody else sees and that ends with the object."""

    def __init__(self) -> None:
        self._file = TemporaryFile()  # noqa: SIM115, it lives as long as the spool
        self._starts = array("q")
        self._end = self._place = 0

    def __bool__(self) -> bool:
        """Return whether there is anything on it."""
        return self._end > 0

    def push(self, arrays: Sequence[Floats]) -> None:
        """Put a group on top."""
        shapes = [rows.shape for rows in arrays]
        head = np.array([number for shape in shapes for number in (len(shape), *shape)], np.int64).tobytes()
        if self._place != self._end:  # to seek empties the file's buffer
            self._file.seek(self._end)
        self._starts.append(self._end)
        self._file.write(_LENGTH.pack(len(head)) + head)
        self._end += _LENGTH.size + len(head)
        for rows in arrays:
            self._file.write(np.ascontiguousarray(rows, np.float64).data)
            self._end += 8 * rows.size
        self._place = self._end

    def pop(self) -> list[Floats]:
        """Take the topmost group; IndexError if there is none."""
        if not self:
            raise IndexError("nothing is on the spool")
        start = self._starts.pop()
        self._file.seek(start)
        content = self._file.read(self._end - start)
        self._end, self._place = start, -1
        at = _LENGTH.size + _LENGTH.unpack_from(content)[0]
        head = iter(np.frombuffer(content[_LENGTH.size : at], np.int64).tolist())
        arrays = []
        for dimensions in head:
            shape = tuple(next(head) for _ in range(dimensions))
            size = math.prod(shape)
            arrays.append(np.frombuffer(content, np.float64, size, at).reshape(shape))
            at += 8 * size
        return arrays

    def close(self) -> None:
        """Give the file back."""
        self._file.close()


_STRIDE = 32


class SegmentSmoother:
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

    def view(self) -> SegmentView:
        """The next segment's."""
        offset, response, errors = self._views.pop()
        return SegmentView(self._geometry, offset, response, errors, final=True)

    def close(self) -> None:
        """Give the room back."""
        self._steps.close()
        self._views.close()

    def _back(self, stride: list[list[Floats]], adjoint: Adjoint) -> Adjoint:
        """One stride, in order of time, of which the first begins with a known belief."""
        belief = Gaussian(*stride[0][-2:])
        taken: list[tuple[Gaussian, Innovation]] = []
        for decay, added, _, rows, values, *_ in stride:
            at = predicted(belief, decay, added)
            belief, innovation = corrected(at, rows, values)
            taken.append((at, innovation))
        for (at, innovation), (decay, _, warmer_degc, *_) in zip(taken[::-1], stride[::-1], strict=True):
            adjoint = backwards(adjoint, at, innovation)
            view = segment_view(self._states.felt(warmer_degc), self._geometry, at, adjoint)
            self._views.push([view.offset, view.response, view.errors])
            adjoint = Adjoint(decay * adjoint.vector, adjoint.matrix * np.outer(decay, decay))
        return adjoint
