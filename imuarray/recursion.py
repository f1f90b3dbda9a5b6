"""First-order recursions over long columns without scipy.signal, which takes a second to import."""

from __future__ import annotations

import numpy as np

from imuarray.arrays import Floats
from imuarray.kernels import tridiagonal


def first_order(drive: Floats, remaining: float) -> Floats:
    """Return y (n, k) of ``y[i] = drive[i] + remaining * y[i - 1]``, y[-1] being zero, for `drive` (n, k).

    The recursion is the solution of a triangular system with one band below the diagonal, which BLAS solves column by
    column as `scipy.signal.lfilter` does. Compiled code computes the same without the import of SciPy's linear algebra.
    """
    count = len(drive)
    compiled = tridiagonal(np.full(count, remaining), np.zeros(count), drive.T) if drive.size else None
    if compiled is not None and np.isfinite(compiled[:, -1]).all():  # others affect earlier values
        return np.ascontiguousarray(compiled.T)
    from scipy.linalg.blas import dtbsv  # slow to import

    result = np.empty(drive.shape)
    bands = np.empty((2, len(drive)), order="F")
    bands[0], bands[1] = 1.0, -remaining
    for column in range(drive.shape[1]) if len(drive) else ():
        result[:, column] = dtbsv(1, bands, drive[:, column], lower=1, diag=1)
    return result
