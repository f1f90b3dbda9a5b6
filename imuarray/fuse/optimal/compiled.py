"""The compiled parts of `optimal`: frames of a segment in which the same rows are in use (`_segments.c`), and the steps
of the filter of slow errors and of its smoother (`_states.c`).

They compute the same as the NumPy code of `SegmentView`, `solve`, `Dynamics` and `SegmentEvidence` (if no axis is
clipped and the usual gain applies) and of `imuarray.fuse.optimal.states`, to rounding. They are not available if the
package was installed without a C compiler.
"""

from __future__ import annotations

from typing import Any

import numpy.typing as npt

__all__ = ["begin", "correct", "drifts", "effect", "frames", "measure", "predict", "smooth", "turn_back"]

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


try:
    from imuarray.fuse.optimal._states import correct, drifts, effect, measure, predict, smooth, turn_back
except ImportError:  # installed without a C compiler

    def predict(arrays: tuple[npt.NDArray[Any], ...], states: int) -> bool:
        """Predict nothing."""
        return False

    def correct(arrays: tuple[npt.NDArray[Any], ...], sizes: tuple[int, int]) -> bool:
        """Correct nothing."""
        return False

    def turn_back(arrays: tuple[npt.NDArray[Any], ...], sizes: tuple[int, int]) -> bool:
        """Process no step."""
        return False

    def effect(arrays: tuple[npt.NDArray[Any], ...], sizes: tuple[int, int, int, int]) -> bool:
        """Compute no effect."""
        return False

    def drifts(arrays: tuple[npt.NDArray[Any], ...], sizes: tuple[int, int, int, int]) -> bool:
        """Compute no effect."""
        return False

    def smooth(arrays: tuple[npt.NDArray[Any], ...], sizes: tuple[int, int, int, int, int, int]) -> bool:
        """Process no steps."""
        return False

    def measure(arrays: tuple[npt.NDArray[Any], ...], sizes: tuple[int, int, int, int, int], doubt: float) -> int:
        """Compute no measurements."""
        return -1
