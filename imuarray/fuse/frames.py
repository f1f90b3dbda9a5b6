"""Input and output of techniques: aligned readings, estimates with their covariance, and the axes of an array (their
directions and positions in the box frame, ranges and noise).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt

from imuarray.arrays import Booleans, Floats, Times
from imuarray.calibrate import Calibration, SensorCalibration
from imuarray.calibrate.model import SensorDescription
from imuarray.fuse.response_change import response_shares
from imuarray.units import SI_PER_UNIT


@dataclass(frozen=True)
class CalibrationErrors:
    """Remaining errors of the three axes of one sensor after calibration, constant in a log.

    `bias_si2` (3, 3): covariance of their biases, including changes from run to run and within a run, in (m/s2)^2 or
    (rad/s)^2; `response` (3, 3, 3, 3): covariance of axis i's error along box axis a with axis j's along box axis b at
    [i, a, j, b], relative to the axes' scale factors, including its change since. Unmeasured parts are zero.
    """

    bias_si2: Floats
    response: Floats


@dataclass(frozen=True)
class Axis:
    """One sensor axis: its sensor, chip and index (0 to 2), and its direction in the box frame (unit vector).

    `range_si` is the end of the measuring range and `noise_si` the standard deviation of a reading (None: unknown), in
    m/s2 or rad/s; `position_m` the position of the sensor in the box frame; `bandwidth_hz` its configured -3 dB
    bandwidth (None: unknown); `stability_si` the rms of its slow error, from run to run and within a run (None:
    unknown); `errors` the remaining errors of its sensor after calibration (None: nothing was measured).
    """

    sensor: str
    chip: str
    index: int
    direction_box: tuple[float, float, float]
    range_si: float
    noise_si: float | None
    position_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    bandwidth_hz: float | None = None
    stability_si: float | None = None
    errors: CalibrationErrors | None = field(default=None, compare=False, repr=False)

    @property
    def in_plane(self) -> bool:
        """True for x and y, which are in the plane of the silicon; z is perpendicular to it."""
        return self.index < 2

    @property
    def label(self) -> str:
        """Sensor and axis as text: "Gyro1 y"."""
        return f"{self.sensor} {'xyz'[self.index]}"


def axes_of(sensors: Sequence[SensorDescription], calibration: Calibration) -> list[Axis]:
    """Return every axis of `sensors`, in order."""
    axes = []
    for sensor in sensors:
        known = calibration.or_nominal(sensor)
        x_m, y_m, z_m = (1e-3 * float(part) for part in sensor.position_mm)
        errors = _errors_of(known)
        for index, direction in enumerate(known.directions_box):
            noise = None if known.noise_lsb is None else float(known.noise_lsb[index] / known.lsb_per_si[index])
            x, y, z = (float(part) for part in direction)
            range_si = sensor.range * SI_PER_UNIT[sensor.unit]
            place = (x_m, y_m, z_m)
            bandwidth_hz, stability = sensor.bandwidth_hz or None, _stability_si(known, index)
            axes.append(
                Axis(
                    sensor.name, sensor.chip, index, (x, y, z), range_si, noise, place, bandwidth_hz, stability, errors
                )
            )
    return axes


def _errors_of(known: SensorCalibration) -> CalibrationErrors | None:
    """Return the remaining errors of a calibrated sensor; None without a measurement."""
    bias = np.zeros((3, 3))
    if known.bias_covariance_lsb2 is not None:
        bias = known.bias_covariance_lsb2 / np.outer(known.lsb_per_si, known.lsb_per_si)
    elif known.bias_sem_lsb is not None:
        bias = np.diag((known.bias_sem_lsb / known.lsb_per_si) ** 2)
    slow = [_stability_si(known, index) or 0.0 for index in range(3)]
    bias = bias + np.diag(np.square(slow))
    shares = response_shares(known)
    if shares is None and not bias.any():
        return None
    return CalibrationErrors(bias, (np.zeros((9, 9)) if shares is None else shares).reshape(3, 3, 3, 3))


def _stability_si(known: SensorCalibration, index: int) -> float | None:
    """Return the rms change of an axis's bias from run to run and within a run, as far as either was measured."""
    parts = [group.rms_lsb[index] for group in (known.turn_on, known.drift) if group is not None]
    finite = [float(part / known.lsb_per_si[index]) for part in parts if np.isfinite(part)]
    return math.hypot(*finite) if finite else None


def directions(axes: Sequence[Axis]) -> Floats:
    """Return the unit vectors (m, 3) of the axes in the box frame: values = directions @ truth_box + errors."""
    return np.array([axis.direction_box for axis in axes])


_Kind = TypeVar("_Kind", bound=np.generic)

ENTRIES = ("xx", "yy", "zz", "xy", "xz", "yz")
"""Columns of a stored covariance: its six different entries."""


@dataclass(frozen=True)
class Frames:
    """n frames of m axes: time (n,) ns and values (n, m) in SI along each axis; `valid` (n, m) is true if there is a
    reading that no flag marks as doubtful and whose triad is within its range (a clipped reading is a bound, not a
    value).

    `clipped` (n, m) is +1 for an axis at the upper end of its range, -1 at the lower end, else 0; `stale` (n, m) is
    true if the chip had no reading newer than the one before. None: nowhere.

    `offsets` (n, m), in frames that lack a reading: the recent difference of each axis from the array's mean, NaN for
    axes without a recent reading; 0 in all other frames (`imuarray.fuse.stream`). None: not known. `averaged` (n,) is
    the number of frames over which they were averaged, 0 in all other frames.

    `delay_noise` (n, 2 s), for each of s sensors: the noise of the array's mean that the correction of the sensor's
    delay subtracts from its readings (`imuarray.fuse.alignment`), first the share of the mean's noise in the same
    frame, then the rms share of that of all frames. None: no reading has a delay.
    """

    time: Times
    values: Floats
    valid: Booleans
    clipped: npt.NDArray[np.int8] | None = None
    stale: Booleans | None = None
    offsets: Floats | None = None
    averaged: npt.NDArray[np.int16] | None = None
    delay_noise: npt.NDArray[np.float32] | None = None

    def part(self, rows: slice) -> Frames:
        """Return some of the frames."""
        optional = (getattr(self, name) for name in _OPTIONAL)
        return Frames(
            self.time[rows],
            self.values[rows],
            self.valid[rows],
            *(None if column is None else column[rows] for column in optional),
        )

    def without(self, excluded: Booleans) -> Frames:
        """Return the frames with the axes `excluded` (n, m) marked as not valid and without their offsets."""
        offsets = None if self.offsets is None else np.where(excluded, np.nan, self.offsets)
        return replace(self, valid=self.valid & ~excluded, offsets=offsets)

    @staticmethod
    def joined(parts: Sequence[Frames]) -> Frames:
        """Concatenate one or more parts with frames of the same axes."""
        return Frames(
            np.concatenate([part.time for part in parts]),
            np.concatenate([part.values for part in parts]),
            np.concatenate([part.valid for part in parts]),
            *(_optional_column([getattr(part, name) for part in parts], parts) for name in _OPTIONAL),
        )


_OPTIONAL = ("clipped", "stale", "offsets", "averaged", "delay_noise")
"""Columns of `Frames` that may be absent, in order."""


def _optional_column(columns: Sequence[npt.NDArray[Any] | None], parts: Sequence[Frames]) -> npt.NDArray[Any] | None:
    """Concatenate an optional column of all parts, with 0 for parts without it; None if no part has it."""
    first = next((column for column in columns if column is not None), None)
    if first is None:
        return None
    return np.concatenate(
        [
            np.zeros((len(part.time), *first.shape[1:]), first.dtype) if column is None else column
            for column, part in zip(columns, parts, strict=True)
        ]
    )


@dataclass(frozen=True)
class Estimate:
    """n frames of one quantity in SI in the box frame.

    `triad_box` (n, 3) is NaN where the axes used do not span space; `covariance_box` (n, 6) are the entries `ENTRIES`
    of its error's covariance, NaN if a noise is not known; `used` (n, m) are the axes that contribute.
    """

    triad_box: Floats
    covariance_box: Floats
    used: Booleans


@dataclass(frozen=True)
class FusedBlock:
    """n frames: time (n,) ns and, per quantity, the fused triad (n, 3) in SI in the box frame (NaN where too few axes
    were valid).

    `covariances` (n, 6), per quantity, are the entries `ENTRIES` of its error's covariance; `used` (n, s), per
    quantity, are the axes of each of its s sensors that contribute: 1 x, 2 y, 4 z. Both are empty if not computed.
    """

    time: Times
    triads: Mapping[str, Floats]
    covariances: Mapping[str, Floats] = field(default_factory=lambda: MappingProxyType({}))
    used: Mapping[str, npt.NDArray[np.uint8]] = field(default_factory=lambda: MappingProxyType({}))

    def part(self, rows: slice) -> FusedBlock:
        """Return some of the frames."""
        return FusedBlock(
            self.time[rows],
            {name: column[rows] for name, column in self.triads.items()},
            {name: column[rows] for name, column in self.covariances.items()},
            {name: column[rows] for name, column in self.used.items()},
        )

    @staticmethod
    def joined(blocks: Sequence[FusedBlock]) -> FusedBlock:
        """Concatenate one or more blocks with frames of the same quantities."""
        return FusedBlock(
            np.concatenate([block.time for block in blocks]),
            _columns([block.triads for block in blocks]),
            _columns([block.covariances for block in blocks]),
            _columns([block.used for block in blocks]),
        )


def _columns(parts: Sequence[Mapping[str, npt.NDArray[_Kind]]]) -> dict[str, npt.NDArray[_Kind]]:
    """Concatenate the columns of all parts, by name."""
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}


def entries(covariance_box: Floats) -> Floats:
    """Return the entries `ENTRIES` (..., 6) of covariances (..., 3, 3)."""
    rows, columns = [0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]
    return np.asarray(covariance_box[..., rows, columns])


def matrices(covariance_entries: Floats) -> Floats:
    """Return covariances (..., 3, 3) from their entries (..., 6)."""
    return np.asarray(covariance_entries[..., [[0, 3, 4], [3, 1, 5], [4, 5, 2]]])


def axis_bits(used: Booleans, axes: Sequence[Axis]) -> npt.NDArray[np.uint8]:
    """Return (n, s), for every sensor of `axes` in order, the sum of 1 x, 2 y, 4 z over its axes in `used` (n, m)."""
    sensors = list(dict.fromkeys(axis.sensor for axis in axes))
    table = np.zeros((len(axes), len(sensors)), np.uint8)
    for index, axis in enumerate(axes):
        table[index, sensors.index(axis.sensor)] = 1 << axis.index
    if len(used) and (used.strides[0] == 0 or (used == used[0]).all()):
        return np.broadcast_to(used[0].astype(np.uint8) @ table, (len(used), len(sensors)))
    return np.asarray(used.astype(np.uint8) @ table)
