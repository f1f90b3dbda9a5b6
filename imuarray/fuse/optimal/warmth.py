"""How much warmer the axes are than they were when their biases were measured."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from imuarray.fuse.axes import Axis
from imuarray.fuse.frames import Floats
from imuarray.fuse.optimal.error_model import ErrorModel


class Warmth:
    """Follows the temperatures of the sensors, block after block; one that is not told stays as it was, and is that of
    the bias before any was told.
    """

    def __init__(self, axes: Sequence[Axis], model: ErrorModel, others: int = 0) -> None:
        """`others` rows follow those of the axes, and are never warmer."""
        self._sensors = [axis.sensor for axis in axes]
        degc = [error.bias_degc for error in model.of(axes)]
        self._bias_degc = np.array([np.nan if known is None else known for known in degc])
        self._warmer = np.zeros(len(axes) + others)

    def of(self, degc: Mapping[str, Floats]) -> Callable[[int], Floats]:
        """(r,) by the frame of a block whose temperatures are `degc`, (n,) by sensor; frames are asked in order."""
        return lambda frame: self._at({sensor: float(column[frame]) for sensor, column in degc.items()})

    def _at(self, degc: Mapping[str, float]) -> Floats:
        if not degc:
            return self._warmer.copy()
        now = np.array([degc.get(sensor, np.nan) for sensor in self._sensors])
        self._bias_degc = np.where(np.isnan(self._bias_degc), now, self._bias_degc)
        warmer = now - self._bias_degc
        self._warmer[: len(now)] = np.where(np.isnan(warmer), self._warmer[: len(now)], warmer)
        return self._warmer.copy()
