"""Array types by the type of their elements. Docstrings give the shapes, units and frames."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]
Reals = npt.NDArray[np.floating[Any]]
"""Values in single or double precision."""
Complexes = npt.NDArray[np.complex128]
Integers = npt.NDArray[np.int64]
Times = npt.NDArray[np.int64]
"""Nanoseconds since the epoch of a log."""
Indices = npt.NDArray[np.intp]
"""Places in another array."""
Booleans = npt.NDArray[np.bool_]


def triple(values: Floats) -> tuple[float, float, float]:
    """Return one number per axis as a tuple."""
    x, y, z = values.tolist()
    return x, y, z
