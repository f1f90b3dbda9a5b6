"""What the frames of a segment say of the slow errors, whatever the box felt.

The stimulus of every frame is unknown, so that only the parities of a frame tell anything: the combinations of its
readings that no stimulus changes. Slow errors stay as they are during a segment, and sums over its frames hold all
that the frames say.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from imuarray.fuse.frames import Flags, Floats
from imuarray.fuse.optimal.geometry import Geometry
from imuarray.fuse.optimal.readings import Readings, patterns
from imuarray.fuse.optimal.solve import Solution

_DOUBT = 3.0
"""Standard deviations of a sum of squares of noise within which it is taken for noise."""

_KEPT = 1024
"""Parities that are kept for the next segments."""


class _Sums:
    """Over the frames in which the same rows were in use: of the products of (1, stimulus) with itself, with the
    readings, and of the stimulus's covariances, which are in the first.
    """

    def __init__(self, terms: int, rows: int) -> None:
        self.squares = np.zeros((terms, terms))
        self.products = np.zeros((terms, rows))
        self.blur = np.zeros((3, 3))


class Evidence:
    """The sums of the segment that is being gathered, and the `parity` of every set of rows there was."""

    def __init__(self, geometry: Geometry, terms: int) -> None:
        self._geometry, self._terms = geometry, terms
        self._parities: dict[bytes, Floats] = {}
        self._sums: dict[bytes, _Sums] = {}

    def add(self, readings: Readings, solution: Solution, frames: slice, weights: Floats | None = None) -> None:
        """Take in the readings of `frames` of the solution, by `weights` (n,) up to 1."""
        triad, covariance = solution.unknowns[frames, :3], solution.covariance[frames, :3, :3]
        for valid, which in patterns(self._fair(readings.valid, triad, solution.used[frames])):
            if not valid.any():
                continue
            key = valid.tobytes()
            if key not in self._parities:
                self._parities[key] = self._geometry.parity(valid)
            sums = self._sums.setdefault(key, _Sums(self._terms, len(valid)))
            values = readings.values[which]
            weight = np.ones(len(values)) if weights is None else weights[which]
            if self._terms == 1:
                sums.squares += weight.sum()
                sums.products += weight @ values
                continue
            felt = np.concatenate([np.ones((len(values), 1)), triad[which]], axis=1)
            weighted = (felt * weight[:, None]).T
            sums.squares += weighted @ felt
            sums.products += weighted @ values
            sums.blur += np.tensordot(weight, covariance[which], axes=1)

    def measurements(self, rows: Floats) -> tuple[Floats, Floats]:
        """(p, n) and (p,): ``values = measurements @ states + errors`` of unit variance, from `rows` (terms, r, n) of
        what the readings feel of the states; then begins anew.
        """
        parts = []
        for key, sums in self._sums.items():
            parity = self._parities[key]
            seen = parity @ rows
            for size, weights in _components(sums):
                values = parity @ (weights @ sums.products) / size
                parts.append(np.column_stack([np.tensordot(weights, seen, axes=1) * size, values]))
        self._sums = {}
        if len(self._parities) > _KEPT:
            self._parities = {}
        both = np.concatenate(parts) if parts else np.zeros((0, rows.shape[2] + 1))
        if len(both) > both.shape[1]:
            both = np.asarray(np.linalg.qr(both, mode="r"))
        return both[:, :-1], both[:, -1]

    def _fair(self, valid: Flags, triad: Floats, used: Flags) -> Flags:
        """The readings to learn from: of frames that have a triad, and of axes that are not near their ends."""
        solved = np.asarray(used.any(axis=1))
        if not solved.all():
            valid = valid & solved[:, None]
        fair = self._geometry.fair
        if np.nanmax(np.einsum("ni,ni->n", triad, triad), initial=0.0) < fair.min() ** 2 and fair.min() > 0:
            return valid
        return valid & (np.abs(np.nan_to_num(triad) @ self._geometry.rows[:, :3].T) < fair)


def _components(sums: _Sums) -> list[tuple[float, npt.NDArray[np.float64]]]:
    """Root of size, and weights (terms,), of the independent components of the sums of (1, stimulus), without what the
    stimulus's own noise makes of them.
    """
    if len(sums.squares) == 1:
        return [(float(np.sqrt(sums.squares[0, 0])), np.ones(1))]
    squares = sums.squares.copy()
    frames = squares[0, 0]
    squares[1:, 1:] -= sums.blur
    sizes, vectors = np.linalg.eigh(squares)
    noise = _DOUBT * np.sqrt(2 / frames) * np.linalg.eigvalsh(sums.blur)[-1]
    return [
        (float(np.sqrt(size)), vectors[:, index])
        for index, size in enumerate(sizes)
        if size > max(noise, 1e-9 * sizes[-1])
    ]
