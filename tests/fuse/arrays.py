"""Axes and frames without a log, and the weights and errors of a technique."""

from __future__ import annotations

import numpy as np

from imuarray.fuse import Axis, Frames
from imuarray.fuse.techniques import Technique
from tests.fuse.conftest import Floats, Part, pointing


def triad(
    sensor: str, axes: str, noise: tuple[float, float, float] | None, chip: str = "c", span: float = 1e3
) -> list[Axis]:
    """The three axes of a sensor; noise and range in any unit."""
    return [
        Axis(sensor, chip, index, tuple(row), span, None if noise is None else noise[index])
        for index, row in enumerate(pointing(axes).tolist())
    ]


def at_once(values: Floats) -> Frames:
    """Frames (n, m) a hundredth of a second apart, all valid."""
    return Frames(np.arange(len(values), dtype=np.int64) * 10_000_000, values, np.ones(values.shape, bool))


def weights(technique: Technique, count: int) -> Floats:
    """(3, m) contribution of each axis to each box axis: the responses to a unit reading of each axis alone."""
    small = 1e-3
    return np.asarray(technique(at_once(small * np.eye(count))).triad_box.T / small)


LOW_MG, HIGH_MG = 9.53, 17.05
"""The paper's Table 10, mean of six channels at typical sensitivity: BMA180 at +-1.5 g and at +-16 g, mg."""


def low_and_high(bias_g: float = 0.0, sigma: bool = True) -> list[Part]:
    """A BMA180 at each of the two ranges, with the same orientation."""

    def error(seconds: Floats) -> Floats:
        return np.full((len(seconds), 3), bias_g)

    low = Part("LOW", range=1.5, sensitivity=5460.0, sigma=LOW_MG / 1e3 if sigma else 0.0, error=error)
    return [low, Part("HIGH", range=16.0, sensitivity=2048.0, sigma=HIGH_MG / 1e3 if sigma else 0.0, error=error)]
