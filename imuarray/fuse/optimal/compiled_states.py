"""The compiled steps of the filter of slow errors and of its smoother (`_states.c`).

They compute the same as the NumPy code in `imuarray.fuse.optimal.states`, to rounding. They are not available if the
package was installed without a C compiler.
"""

from __future__ import annotations

from typing import Any

import numpy.typing as npt

__all__ = ["correct", "drifts", "effect", "measure", "predict", "turn_back"]

try:
    from imuarray.fuse.optimal._states import correct, drifts, effect, measure, predict, turn_back
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

    def measure(arrays: tuple[npt.NDArray[Any], ...], sizes: tuple[int, int, int, int, int], doubt: float) -> int:
        """Compute no measurements."""
        return -1
