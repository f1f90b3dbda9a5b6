"""What an array agrees on before anybody has looked for faults: the mean, in which none weighs more than a little who
is far from the rest.

Where all readings of a frame are about what their mean says, it is the mean. Else each sensor's difference from the
median of their triads is limited, on its worst axis, to `TOLERATED_SI` and some times the median of all differences (in
a fast motion sensors that are read one after the other differ, by as much as they are apart in time), and the mean is
that of the readings so limited: Huber's estimator of location, one step from the median (P. J. Huber, Annals of
Mathematical Statistics 35, 1964). What is far off is drawn in and not thrown away, so that nothing jumps when somebody
passes the limit.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

import numpy as np

from imuarray.fuse.frames import Flags, Floats
from imuarray.fuse.solve import solve_frames
from imuarray.units import STANDARD_GRAVITY

TOLERATED_SI: Mapping[str, float] = MappingProxyType(
    {"specific_force": 0.25 * STANDARD_GRAVITY, "angular_rate": np.radians(2.0)}
)
"""By quantity: five times the noise of an ADXL345's z axis, ten times that of an L3G4200D. Axes whose bias is more than
that tell the mean no more than where they are, which does no harm to its slope.
"""

_TIMES_USUAL = 4.0


def consensus(values: Floats, valid: Flags, rows: Floats, quantity: str) -> Floats:
    """(n, 3) what the valid ones of the axes along `rows` (m, 3), in threes, agree on of `values` (n, m) in SI; NaN
    where they don't span space.
    """
    mean = solve_frames(values, valid.astype(float), rows)
    apart = np.abs(values - mean @ rows.T)
    whole: Flags = np.asarray(valid.reshape(len(valid), -1, 3).all(axis=2))
    doubtful: Flags = (apart > TOLERATED_SI[quantity] / 2) & valid
    checked: Flags = np.asarray(whole.sum(axis=1) > 2)  # of two sensors none is more right than the other
    some = np.flatnonzero(doubtful.any(axis=1) & checked)
    if len(some):
        mean[some] = _limited(values[some], valid[some], whole[some], rows, TOLERATED_SI[quantity])
    return mean


def _limited(values: Floats, valid: Flags, whole: Flags, rows: Floats, tolerated: float) -> Floats:
    """(n, 3) the mean of the readings when the differences of sensors from their median are limited."""
    back = np.linalg.inv(rows.reshape(-1, 3, 3))
    triads = np.matmul(values.reshape(len(values), -1, 1, 3), back.transpose(0, 2, 1))[:, :, 0]
    middle = _medians(np.where(whole[:, :, None], triads, np.nan))
    apart = values - middle @ rows.T
    usual = _medians(np.where(valid, np.abs(apart), np.nan))
    limit = (tolerated + _TIMES_USUAL * usual)[:, None]
    most = np.where(valid, np.abs(apart), 0.0).reshape(len(values), -1, 3).max(axis=2)
    share = np.minimum(1.0, limit / np.maximum(most, 1e-300)).repeat(3, axis=1)
    return middle + solve_frames(share * apart, valid.astype(float), rows)


def _medians(values: Floats) -> Floats:
    """Medians along the second axis of what is not NaN."""
    ordered = np.sort(values, axis=1)
    if np.isfinite(ordered[:, -1]).all():  # NaN is sorted behind all others
        count = values.shape[1]
        return np.asarray((ordered[:, (count - 1) // 2] + ordered[:, count // 2]) / 2)
    known = np.isfinite(values).sum(axis=1, keepdims=True)
    low, high = (np.take_along_axis(ordered, middle, axis=1) for middle in ((known - 1) // 2, known // 2))
    return np.asarray((low + high)[:, 0] / 2)
