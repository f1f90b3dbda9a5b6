"""Parity space of an array: what its axes say that no motion of the box can explain.

Readings of one instant are ``values = rows @ truth_box + errors``. With weights W (inverse variances, 0 for an axis
that is left out), ``A = W - W rows (rows' W rows)^-1 rows' W`` is blind to the truth, and ``d = A @ values`` is what
the readings say of errors only. The generalised likelihood ratio of "these axes F have an error, of any size" against
"none has" is ``d_F' A_FF^-1 d_F``, chi-square with as many degrees of freedom as axes (Daly, Gai and Harrison,
Journal of Guidance and Control 2, 1979; Sturza, Navigation 35, 1988).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from imuarray.fuse.solve import spans

Floats = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class Parity:
    """One choice of weights: `gain` (3, m) gives the triad, `matrix` (m, m) is A, `spread` (3, 3) the triad's
    covariance, `told` (m,) whether an error of this axis shows at all.
    """

    gain: Floats
    matrix: Floats
    spread: Floats
    told: Flags

    @cached_property
    def deleted(self) -> Floats:
        """(m, m) gives the deleted residuals: each axis against what all the others say of it; 0 for an axis whose
        error does not show.
        """
        size = np.where(self.told, self.matrix.diagonal(), 1.0)
        return np.asarray(np.where(self.told[:, None], self.matrix / size[:, None], 0.0))

    def axis_gains(self, errors: Floats) -> Floats:
        """(m,) twice the log-likelihood ratio of an error in one axis, for `errors` (m,): one degree of freedom."""
        shown = self.matrix @ errors
        return np.asarray(np.where(self.told, shown**2 / np.where(self.told, self.matrix.diagonal(), 1.0), 0.0))

    def sensor_gains(self, errors: Floats) -> Floats:
        """(m / 3,) the same of an error in all axes of one triad: three degrees of freedom."""
        sensors = len(errors) // 3
        blocks = np.einsum("sisj->sij", self.matrix.reshape(sensors, 3, sensors, 3))
        shown = (self.matrix @ errors).reshape(sensors, 3, 1)
        scale = np.maximum(np.einsum("sii->s", blocks), 1e-300)
        firm = blocks + (1e-9 * scale)[:, None, None] * np.eye(3)
        return np.asarray((shown * np.linalg.solve(firm, shown)).sum(axis=(1, 2)))


def parity(rows: Floats, weights: Floats) -> Parity | None:
    """The parity space of axes `rows` (m, 3) with `weights` (m,); None where the weighted axes don't span space."""
    weighted = rows * weights[:, None]
    normal = weighted.T @ rows
    if not spans(normal):
        return None
    spread = np.asarray(np.linalg.inv(normal), float)
    gain = spread @ weighted.T
    matrix = np.diag(weights) - weighted @ gain
    told = matrix.diagonal() > 1e-6 * weights
    return Parity(np.asarray(gain), np.asarray(matrix), np.asarray(spread), np.asarray(told & (weights > 0)))


class Spaces:
    """Parity spaces of one set of axes; the last one is kept, for weights change only when somebody is left out."""

    def __init__(self, rows: Floats) -> None:
        self._rows = rows
        self._key = b""
        self._last: Parity | None = None

    def __call__(self, weights: Floats) -> Parity | None:
        """As `parity`."""
        if (key := weights.tobytes()) != self._key:
            self._key, self._last = key, parity(self._rows, weights)
        return self._last
