from typing import Any

import numpy.typing as npt

def medians(arrays: tuple[npt.NDArray[Any], ...], sizes: tuple[int, int]) -> bool: ...
def windows(
    arrays: tuple[npt.NDArray[Any], ...], sizes: tuple[int, int], begin: int, width: int, flags: int
) -> None: ...
def second_differences(
    arrays: tuple[npt.NDArray[Any], ...], sizes: tuple[int, int], size: int, start: int, stop: int
) -> None: ...
