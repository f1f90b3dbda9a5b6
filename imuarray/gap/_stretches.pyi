from typing import Any

import numpy.typing as npt

def clearest(
    arrays: tuple[npt.NDArray[Any], ...], sizes: tuple[int, int, int, int], each: float, share: float
) -> int: ...
