"""The weighted means of any set of an array's axes, and what shows of each axis' error against them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from imuarray.fuse.frames import Flags, Floats
from imuarray.fuse.solve import whole_gain


class Blend(NamedTuple):
    """Of a set of axes: the gain (3, m), the noise (m,) of its triad along each axis, and of the residuals their
    variance (m,) and how much of every axis' error is in them: `apart` (m, m), `share` (m,) its sums of squares.
    `seen` (m,): there is something to see.
    """

    gain: Floats
    along: Floats
    variance: Floats
    share: Floats
    apart: Floats
    seen: Flags

    def level(self, differences: Floats, rows: Floats) -> Floats:
        """(..., m, 3) What of the differences (..., m, 3: bias, scale, delay) of the axes is the blend's own, along
        each axis: nothing, if they were told by this blend.
        """
        bias = differences[..., 0] @ self.gain.T @ rows.T
        mixed = (np.einsum("im,...m,mj->...ij", self.gain, differences[..., column], rows) for column in (1, 2))
        return np.stack([bias, *(np.einsum("mi,...ij,mj->...m", rows, turned, rows) for turned in mixed)], axis=-1)


class Blends:
    """The blends of axes along `rows` (m, 3), with `weights` and `noise` (m,), by which of them are there."""

    def __init__(self, rows: Floats, weights: Floats, noise: Floats) -> None:
        self._rows, self._weights, self._noise = rows, weights, noise
        self._known: dict[bytes, Blend | None] = {}

    def of(self, present: npt.NDArray[np.bool_]) -> Blend | None:
        """The blend of the axes `present` (m,); None if they don't span space."""
        key = present.tobytes()
        if key not in self._known:
            spans = present.any() and np.linalg.matrix_rank(self._rows[present], tol=1e-3) == 3
            self._known[key] = self._of(present) if spans else None
        return self._known[key]

    def _of(self, present: npt.NDArray[np.bool_]) -> Blend:
        gain = whole_gain(self._weights * present, self._rows)
        through = self._rows @ gain
        apart = (np.eye(len(through)) - through) * present[:, None] * present
        variance, share = apart**2 @ self._noise**2, (apart**2).sum(axis=1)
        return Blend(gain, np.sqrt(through**2 @ self._noise**2), variance, share, apart, share > 1e-6)
