"""Input and output of techniques: aligned readings, estimates with their covariance, and the axes of an array
(direction and position of each in the box frame, its range and its noise).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import TypeVar

import numpy as np
import numpy.typing as npt

from imuarray.arrays import Booleans, Floats, Times
from imuarray.calibrate import Calibration, SensorCalibration
from imuarray.calibrate.model import Described
from imuarray.units import SI_PER_UNIT


@dataclass(frozen=True)
class CalibrationErrors:
    """Errors that a calibration leaves in the three axes of one sensor, constant in a log.

    `bias_si2` (3, 3): covariance of their biases, with what biases do from run to run and within a run, in the square
    of m/s2 or rad/s; `response` (3, 3, 3, 3): covariance of axis i's error along box axis a with axis j's along box
    axis b at [i, a, j, b], as shares of the axes' scale factors. What was not measured is zero: nobody knows it.
    """

    bias_si2: Floats
    response: Floats


@dataclass(frozen=True)
class Axis:
    """One sensor axis: where it points in the box frame (unit vector) and what it is.

    `range_si` is the end of the measuring range and `noise_si` the standard deviation of a reading (None: unknown), in
    m/s2 or rad/s; `position_m` where the sensor sits in the box frame; `bandwidth_hz` the -3 dB bandwidth to which it
    is set (None: unknown); `stability_si` the rms of its slow error, from run to run and within a run (None: unknown);
    `errors` what the calibration of its sensor leaves unknown (None: nothing was measured).
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
        """True for x and y, which lie in the plane of the silicon; z stands on it."""
        return self.index < 2

    @property
    def label(self) -> str:
        """Sensor and axis as people say it: "Gyro1 y"."""
        return f"{self.sensor} {'xyz'[self.index]}"


def axes_of(sensors: Sequence[Described], calibration: Calibration) -> list[Axis]:
    """Every axis of `sensors`, in order."""
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


def response_shares(known: SensorCalibration) -> Floats | None:
    """(9, 9) covariance of a sensor's response row by row, as shares of the axes' scale factors; None if it was not
    measured.
    """
    covariance = known.response_covariance()
    if covariance is None:
        return None
    scale = np.repeat(known.scale_lsb_per_unit, 3)
    return np.asarray(covariance / np.outer(scale, scale))


def _errors_of(known: SensorCalibration) -> CalibrationErrors | None:
    """Return a calibration's own errors as they were measured; None without a measurement."""
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
    """Rms of what the bias of an axis does from run to run and within a run, as far as either was measured."""
    parts = [group.rms_lsb[index] for group in (known.turn_on, known.drift) if group is not None]
    finite = [float(part / known.lsb_per_si[index]) for part in parts if np.isfinite(part)]
    return math.hypot(*finite) if finite else None


def directions(axes: Sequence[Axis]) -> Floats:
    """(m, 3) unit vectors of the axes in the box frame: values = directions @ truth_box + errors."""
    return np.array([axis.direction_box for axis in axes])


_Kind = TypeVar("_Kind", bound=np.generic)

ENTRIES = ("xx", "yy", "zz", "xy", "xz", "yz")
"""Columns of a covariance as it is kept: the six entries that differ."""


@dataclass(frozen=True)
class Frames:
    """n frames of m axes: time (n,) ns, values (n, m) in SI along each axis, valid (n, m): there is a reading, no
    flag throws doubt on it, and its triad is off the ends of its range (a clipped reading is a bound, not a
    value).

    `clipped` (n, m) is +1 where an axis stands at the upper end of its range, -1 at the lower one, else 0; `stale`
    (n, m) where the chip had nothing newer than the reading before. None: nowhere.

    `offsets` (n, m): in frames that lack a reading, how far each axis has recently been from the array's mean, NaN for
    axes without a recent reading; 0 in all other frames (`imuarray.fuse.stream`). None: not known.
    """

    time: Times
    values: Floats
    valid: Booleans
    clipped: npt.NDArray[np.int8] | None = None
    stale: Booleans | None = None
    offsets: Floats | None = None

    def part(self, rows: slice) -> Frames:
        """Some of the frames."""
        clipped = None if self.clipped is None else self.clipped[rows]
        stale = None if self.stale is None else self.stale[rows]
        offsets = None if self.offsets is None else self.offsets[rows]
        return Frames(self.time[rows], self.values[rows], self.valid[rows], clipped, stale, offsets)

    def without(self, excluded: Booleans) -> Frames:
        """The frames without the axes `excluded` (n, m), whose offsets are forgotten, too."""
        offsets = None if self.offsets is None else np.where(excluded, np.nan, self.offsets)
        return replace(self, valid=self.valid & ~excluded, offsets=offsets)

    @staticmethod
    def joined(parts: Sequence[Frames]) -> Frames:
        """Frames of the same axes one after the other, of one part at least."""
        return Frames(
            np.concatenate([part.time for part in parts]),
            np.concatenate([part.values for part in parts]),
            np.concatenate([part.valid for part in parts]),
            _flags([part.clipped for part in parts], parts, np.int8),
            _flags([part.stale for part in parts], parts, np.bool_),
            _flags([part.offsets for part in parts], parts, np.float64),
        )


def _flags(
    columns: Sequence[npt.NDArray[_Kind] | None], parts: Sequence[Frames], kind: type[_Kind]
) -> npt.NDArray[_Kind] | None:
    """Booleans of all parts, 0 in those that have none; None if no part has any."""
    if all(column is None for column in columns):
        return None
    pairs = zip(columns, parts, strict=True)
    return np.concatenate([np.zeros(part.valid.shape, kind) if column is None else column for column, part in pairs])


@dataclass(frozen=True)
class Estimate:
    """n frames of one quantity in SI in the box frame.

    `triad_box` (n, 3), NaN where the axes used don't span space; `covariance_box` (n, 6), the entries `ENTRIES` of its
    error's covariance, NaN where a noise is not known; `used` (n, m): which axes went into it.
    """

    triad_box: Floats
    covariance_box: Floats
    used: Booleans


@dataclass(frozen=True)
class FusedBlock:
    """n frames: time (n,) ns and, per quantity, the fused triad (n, 3) in SI in the box frame (NaN where too few axes
    were valid).

    `covariances` (n, 6), per quantity, are the entries `ENTRIES` of its error's covariance; `used` (n, s), per
    quantity, says which axes of each of its s sensors went into it: 1 x, 2 y, 4 z. Both are missing where nobody
    worked them out.
    """

    time: Times
    triads: Mapping[str, Floats]
    covariances: Mapping[str, Floats] = field(default_factory=lambda: MappingProxyType({}))
    used: Mapping[str, npt.NDArray[np.uint8]] = field(default_factory=lambda: MappingProxyType({}))

    def part(self, rows: slice) -> FusedBlock:
        """Some of the frames."""
        return FusedBlock(
            self.time[rows],
            {name: column[rows] for name, column in self.triads.items()},
            {name: column[rows] for name, column in self.covariances.items()},
            {name: column[rows] for name, column in self.used.items()},
        )

    @staticmethod
    def joined(blocks: Sequence[FusedBlock]) -> FusedBlock:
        """Frames of the same quantities one after the other, of one block at least."""
        return FusedBlock(
            np.concatenate([block.time for block in blocks]),
            _columns([block.triads for block in blocks]),
            _columns([block.covariances for block in blocks]),
            _columns([block.used for block in blocks]),
        )


def _columns(parts: Sequence[Mapping[str, npt.NDArray[_Kind]]]) -> dict[str, npt.NDArray[_Kind]]:
    """The rows of all parts, by name."""
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}


def entries(covariance_box: Floats) -> Floats:
    """(..., 6) the entries `ENTRIES` of covariances (..., 3, 3)."""
    rows, columns = [0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]
    return np.asarray(covariance_box[..., rows, columns])


def matrices(covariance_entries: Floats) -> Floats:
    """(..., 3, 3) covariances from their entries (..., 6)."""
    return np.asarray(covariance_entries[..., [[0, 3, 4], [3, 1, 5], [4, 5, 2]]])


def axis_bits(used: Booleans, axes: Sequence[Axis]) -> npt.NDArray[np.uint8]:
    """(n, s) from (n, m): for every sensor of `axes`, in order, the sum of 1 x, 2 y, 4 z over its axes in use."""
    sensors = list(dict.fromkeys(axis.sensor for axis in axes))
    table = np.zeros((len(axes), len(sensors)), np.uint8)
    for index, axis in enumerate(axes):
        table[index, sensors.index(axis.sensor)] = 1 << axis.index
    if len(used) and (used == used[0]).all():
        return np.broadcast_to(used[0].astype(np.uint8) @ table, (len(used), len(sensors)))
    return np.asarray(used.astype(np.uint8) @ table)
