"""What the rows of an array see of the unknowns of a frame, and with how much noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from imuarray.fuse.axes import Axis, directions
from imuarray.fuse.optimal.error_model import ErrorModel
from imuarray.fuse.solve import spans

Floats = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]

AT_END = 0.98
"""Share of the measuring range from which on a reading is taken as a bound: the truth is there or beyond."""

_NEAR = 3.0
"""Standard deviations from there within which an axis teaches nothing about slow errors: the readings that are left
are not a fair choice.
"""


_KEPT = 1024
"""Sets of axes of which it is remembered whether they span space."""


@dataclass(frozen=True)
class Geometry:
    """r rows, the m axes and then what else is known of the unknowns: `rows` (r, k), the first three unknowns being the
    triad in the box frame; `noise` (r,) standard deviations, and of means over many frames; `end` (r,) where a reading
    becomes a bound, infinite for rows that are no axes; `timing` (r,) seconds, of
    the time at which a reading holds.
    """

    rows: Floats
    noise: Floats
    noise_of_means: Floats
    end: Floats
    timing: Floats
    axes: int
    _spanning: dict[bytes, bool] = field(default_factory=dict, init=False, repr=False, compare=False)

    @property
    def fair(self) -> Floats:
        """(r,) up to which stimulus along the axis its readings are a fair choice."""
        return self.end - _NEAR * self.noise

    def spans(self, valid: Flags) -> bool:
        """Whether these of the axes, (r,), span space."""
        key = valid[: self.axes].tobytes()
        if key not in self._spanning:
            if len(self._spanning) >= _KEPT:
                self._spanning.clear()
            rows = self.rows[: self.axes, :3][valid[: self.axes]]
            self._spanning[key] = bool(spans(rows.T @ rows))
        return self._spanning[key]

    def parity(self, valid: Flags) -> Floats:
        """(p, r) what the rows in use say of their own errors whatever the unknowns are, whitened for means: ``parity @
        readings`` has unit variance but for the slow errors.
        """
        rows = self.rows[valid] / self.noise_of_means[valid, None]
        left, sizes, _ = np.linalg.svd(rows)
        rank = int((sizes > 1e-9 * max(float(sizes.max(initial=0.0)), 1e-300)).sum())
        parity = np.zeros((len(rows) - rank, len(self.noise)))
        parity[:, valid] = left[:, rank:].T / self.noise_of_means[valid]
        return parity


def geometry_of(axes: Sequence[Axis], model: ErrorModel) -> Geometry:
    """The axes alone: three unknowns."""
    errors = model.of(axes)
    return Geometry(
        rows=directions(axes),
        noise=np.array([error.noise for error in errors]),
        noise_of_means=np.array([error.noise_of_means for error in errors]),
        end=AT_END * np.array([axis.range_si for axis in axes]),
        timing=np.array([error.timing_s for error in errors]),
        axes=len(axes),
    )
