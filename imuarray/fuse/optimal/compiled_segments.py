"""The compiled part of `optimal` (`_segments.c`): frames of a segment in which the same rows are in use.

It computes the same as the NumPy code of `SegmentView`, `solve`, `Dynamics` and `SegmentEvidence`, to rounding, if no
axis is clipped and the usual gain applies. It is not available if the package was installed without a C compiler.
"""

from __future__ import annotations

from typing import Any

import numpy.typing as npt

__all__ = ["begin", "frames"]

try:
    from imuarray.fuse.optimal._segments import begin, frames
except ImportError:  # installed without a C compiler

    def begin(
        arrays: tuple[npt.NDArray[Any], ...], sizes: tuple[int, ...], final: bool, change: float, tolerance: float
    ) -> float:
        """Process no segment."""
        return -1.0

    def frames(
        arrays: tuple[npt.NDArray[Any], ...],
        sizes: tuple[int, ...],
        teaches: bool,
        reach: float,
        worst: float,
        fair: float,
    ) -> tuple[int, float]:
        """Process no frames."""
        return 0, 0.0
