"""What a chip samples, and what a recorder reads of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from tests.bench_world.chips import Array, Sensor
from tests.bench_world.motion import Motion
from tests.bench_world.recorder import Frames

STALE, SATURATED, AFTER_LOSS = 1, 4, 8
"""Bits of the status of a row: repeats the sample before it, at an end of the codes, and rows before it are missing."""


@dataclass(frozen=True)
class Session:
    """One log: its number from 0 on, the motion of the box, the polled frames, and by how many K a chip warms up after
    the power was switched on.
    """

    number: int
    motion: Motion
    frames: Frames
    self_heating_k: float


@dataclass(frozen=True)
class Samples:
    """What a chip feels at each of its samples: (n,) time in s and temperature above 25 degC in K, (n, 3) the true
    value in its unit and the specific force in g, in the axes of the sensor; `noise` (3,) is the standard deviation of
    a sample.
    """

    sensor: Sensor
    duration_s: float
    rate_hz: float
    time_s: Array
    warmth_k: Array
    value: Array
    force_g: Array
    noise: Array


@dataclass(frozen=True)
class Readings:
    """What was read: (n,) time in s, the sample's number and the status, (n, 3) codes."""

    time_s: Array
    sample: npt.NDArray[np.intp]
    codes: Array
    status: npt.NDArray[np.uint16]


@dataclass(frozen=True)
class Rows:
    """The rows of a sensor in a log, as they are written."""

    time_ns: npt.NDArray[np.int64]
    counts: npt.NDArray[np.int16]
    status: npt.NDArray[np.uint16]
    temperature_counts: npt.NDArray[np.int16] | None
