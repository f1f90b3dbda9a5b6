"""What an array agrees on before anybody has looked for faults: the mean, in which none weighs more than a little who
is far from the rest.

Where all readings of a frame are about what their mean says, it is the mean. Else each reading's difference from the
median of the sensors' triads is limited to `TOLERATED_SI` and some times the median of all differences (in a fast
motion sensors that are read one after the other differ, by as much as they are apart in time), and the mean is that of
the readings so limited: Huber's estimator of location, one step from the median (P. J. Huber, Robust Statistics, 1981,
section 6.7). The limit grows and shrinks with the differences, so that nothing jumps when somebody passes it.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

import numpy as np

from imuarray.fuse.frames import Flags, Floats
from imuarray.fuse.solve import solve_frames
from imuarray.units import STANDARD_GRAVITY

TOLERATED_SI: Mapping[str, float] = MappingProxyType(
    {"specific_force": 0.25 * STANDARD_GRAVITY, "angular_rate": np.radians(10.0)}
)
"""By quantity: five times the noise of a noisy sensor (an ADXL345's z axis; an L3G4200D's, ten times)."""

_TIMES_USUAL = 4.0


def consensus(values: Floats, valid: Flags, rows: Floats, quantity: str) -> Floats:
    """(n, 3) what the valid ones of the axes along `rows` (m, 3), in threes, agree on of `values` (n, m) in SI; NaN
    where they don't span space.
    """
    mean = solve_frames(values, valid.astype(float), rows)
    apart = np.abs(values - mean @ rows.T)
    doubtful = ((apart > TOLERATED_SI[quantity] / 2) & valid).any(axis=1)
    if len(rows) < 9 or not doubtful.any():  # of two sensors none is more right than the other
        return mean
    some, present = values[doubtful], valid[doubtful]
    whole = present.reshape(len(some), -1, 3).all(axis=2)
    known = whole.sum(axis=1) > 2
    doubtful[doubtful] = known
    if known.any():
        mean[doubtful] = _limited(some[known], present[known], whole[known], rows, TOLERATED_SI[quantity])
    return mean


def _limited(values: Floats, valid: Flags, whole: Flags, rows: Floats, tolerated: float) -> Floats:
    """(n, 3) the mean of the readings whose differences from the median are limited."""
    back = np.linalg.inv(rows.reshape(-1, 3, 3))
    triads = np.einsum("sij,nsj->nsi", back, values.reshape(len(values), -1, 3))
    middle = np.nanmedian(np.where(whole[:, :, None], triads, np.nan), axis=1)
    apart = values - middle @ rows.T
    usual = np.nanmedian(np.where(valid, np.abs(apart), np.nan), axis=1)
    limit = (tolerated + _TIMES_USUAL * usual)[:, None]
    return middle + solve_frames(np.clip(apart, -limit, limit), valid.astype(float), rows)
