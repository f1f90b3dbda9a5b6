"""Products of many rows with a small matrix, in one thread.

OpenBLAS starts threads for a long product, which then wait for the next product in a loop. This uses processor time
without a gain, half of the time of a characterisation from Python. The command line sets the number of threads before
NumPy is imported, but a library can't.
"""

from __future__ import annotations

import numpy as np

from imuarray.arrays import Floats

_PRODUCTS_IN_ONE_THREAD = 1 << 18
"""Largest number of multiplications in a product of matrices for which OpenBLAS uses one thread
(`GEMM_MULTITHREAD_THRESHOLD` of its interface/gemm.c: 4 times 2^16).
"""


def multiply_rows(rows: Floats, matrix: Floats) -> Floats:
    """Return ``rows @ matrix`` for rows (n, m) and a matrix (m, k)."""
    product = np.empty((len(rows), matrix.shape[1]))
    at_once = max(1, _PRODUCTS_IN_ONE_THREAD // max(1, matrix.size))
    for start in range(0, len(rows), at_once):
        np.matmul(rows[start : start + at_once], matrix, out=product[start : start + at_once])
    return product
