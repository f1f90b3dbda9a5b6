from typing import Any

import numpy.typing as npt

def begin(
    arrays: tuple[npt.NDArray[Any], ...], sizes: tuple[int, ...], final: bool, change: float, tolerance: float
) -> float: ...
def frames(
    arrays: tuple[npt.NDArray[Any], ...],
    sizes: tuple[int, ...],
    teaches: bool,
    reach: float,
    worst: float,
    fair: float,
) -> tuple[int, float]: ...
