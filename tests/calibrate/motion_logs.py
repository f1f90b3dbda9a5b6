"""Logs of an accelerometer and a gyroscope in a given motion."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from imuarray.log import Block, LogWriter, Stimulus
from imuarray.log.format import Phase
from tests.calibrate.conftest import EPOCH, Floats, accelerometer, gyroscope

RATE_HZ = 50.0
Felt = Callable[[Floats], Floats]


def resting(seconds: Floats) -> Floats:
    return np.tile([0.0, 0.0, 1.0], (len(seconds), 1))


def record(
    path: Path,
    felt: Felt,
    seed: int,
    *,
    seconds: float = 60.0,
    noise_g: float = 0.02,
    phase: str = "",
    warm: Floats | None = None,
) -> Path:
    """An accelerometer and a gyroscope that measures the rate of the swing; usual noise."""
    rng = np.random.default_rng(seed)
    at_s = np.arange(round(seconds * RATE_HZ)) / RATE_HZ
    force = felt(at_s)
    rate = np.degrees(np.gradient(force, at_s, axis=0)) / 3
    time = np.round(at_s * 1e9).astype(np.int64)
    with LogWriter(path, [accelerometer("A"), gyroscope("G")], source="simulated", epoch=EPOCH) as writer:
        for name, values, per_unit, sigma in (("A", force, 2048.0, noise_g), ("G", rate, 1 / 0.00875, 0.2)):
            counts = np.clip(np.rint(per_unit * (values + rng.normal(0, sigma, values.shape))), -32768, 32767)
            writer.append(name, Block(time, counts.astype(np.int16), np.zeros(len(time), np.uint16)))
        if phase:
            writer.phase(Phase(0, int(time[-1]) + 1, phase))
        if warm is not None:
            nothing = np.zeros((len(time), 3))
            writer.stimulus("reference", Stimulus(time, nothing, nothing, np.interp(at_s, *warm)))
    return path
