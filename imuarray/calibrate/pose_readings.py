"""Static poses of the box in a log, and the readings of every sensor in them.

The phases of a log may name the faces (`z_up`, `x_down`, ...) and thus the poses. In any other log poses are detected:
windows of half a second in which the accelerometers hardly change and the gyroscopes show no turn are joined as long as
their means agree. In a log without accelerometers the gyroscopes are used, or else the magnetometers (`find_rests`).

Readings at rest are read block by block. Stale, saturated and suspect rows are ignored; readings on either side of a
gap are not neighbours. `PoseReadings` contains the means of many sensors over many poses as arrays, with their standard
errors.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from imuarray.arrays import Floats, Times
from imuarray.axes import CHECK, UP_AXES, face_up, up_vector
from imuarray.characterise.noise import LEFT_OUT
from imuarray.characterise.stretch import GAP, broken_rows
from imuarray.errors import CalibrationError
from imuarray.log import Log, SensorLog
from imuarray.log.format import SATURATED, SUSPECT, Phase
from imuarray.log.rests import OVEN_NAMES, is_at_rest
from imuarray.log.row_timing import row_timing
from imuarray.series import add_windows

WINDOW_S = 0.5
MIN_POSE_S = 1.5
SAME_POSE_G = 0.02
"""Largest difference between the means of neighbouring windows of one pose."""

TURNING_DPS = 0.5
"""Largest rate in a pose, relative to the rate at rest: accelerometers do not measure the slow beginning and end of a
turn, nor turns about the vertical."""

BRIDGED_S = 5.0
"""Longest time without readings within a pose, if the attitude is the same after it: a recorder may stall, and a box
turned by hand does not return to the same attitude, to hundredths of a g, within that time.
"""

_LEAST_ROWS = 4
"""Fewest rows in a window: for a slow sensor, windows are longer than half a second."""

_SPIKED_ROWS = 8
"""Fewest rows in a window for one of them to be ignored as an outlier: motion changes most rows."""

SAME_POSE: Mapping[str, float] = MappingProxyType(
    {"specific_force": SAME_POSE_G, "angular_rate": TURNING_DPS, "magnetic_field": 0.02}
)
"""Largest difference between the means of neighbouring windows of one pose, in the unit of the quantity from which
poses are detected. Two degrees of a turn change the earth's field along an axis by 0.02 gauss.
"""

_CLIPPED_SHARE = 1e-3
"""Largest share of saturated readings in a mean: clipping biases it by more than its standard error before it is
visible."""

_BATCHES = 16
_WIDTH_NS = round(WINDOW_S * 1e9)


@dataclass(frozen=True)
class Pose:
    """One static stretch; `up_box` is known only for a named face.

    `log` is the log that contains the stretch; None: the log of the sensor that is read.
    """

    phase: Phase
    up_box: tuple[float, float, float] | None
    log: Log | None = None

    def rows_of(self, sensor: SensorLog) -> tuple[SensorLog, slice]:
        """Return the sensor of the same name in the pose's log, and its rows; CalibrationError if it is configured
        differently there.
        """
        sensor_of_log = sensor if self.log is None else sensor_in(self.log, sensor)
        return sensor_of_log, sensor_of_log.between(self.phase.start_ns, self.phase.end_ns)

    @property
    def label(self) -> str:
        """The phase's name, with the axis that was up if the name does not state it."""
        name = self.phase.name
        return name if not self.phase.up or face_up(name) else f"{name} ({self.phase.up})"

    def where(self, sensor: SensorLog) -> str:
        """Return the sensor in the pose's log as text for messages."""
        return self.rows_of(sensor)[0].where

    @property
    def is_check(self) -> bool:
        """True for a face that was read again to measure the drift; it is not part of a fit."""
        return self.phase.name.endswith(CHECK)


@dataclass(frozen=True)
class Reading:
    """Mean counts (3,) of one sensor over one pose, with standard error (3,) and number of rows; the standard deviation
    of single rows (3,), and the `change_lsb` (3,) of the mean from the first half to the second.
    """

    mean_lsb: Floats
    sem_lsb: Floats
    rows: int
    sd_lsb: Floats
    change_lsb: Floats


def sensor_in(log: Log, sensor: SensorLog) -> SensorLog:
    """Return the sensor of the same name in `log`; CalibrationError if it is configured differently there."""
    sensor_of_log = log[sensor.name]
    settings = (
        (candidate.quantity, candidate.range, candidate.sensitivity, candidate.axes)
        for candidate in (sensor_of_log, sensor)
    )
    if next(settings) != next(settings):
        raise CalibrationError(f"{sensor_of_log.where}: range or axes differ from {sensor.where}")
    return sensor_of_log


def labelled_faces(logs: Sequence[Log]) -> list[Pose]:
    """Return the faces of several logs: poses that phases name; if there are none, rests of any name that state which
    axis was up, except those in which the box is heated, because biases change. CalibrationError for an `up` that is
    not an axis.
    """
    named = [pose for log in logs for pose in named_faces(log)]
    return named or [
        pose for log in logs for pose in _faces(log, lambda phase: is_at_rest(phase) and phase.name not in OVEN_NAMES)
    ]


def named_faces(log: Log) -> list[Pose]:
    """Return the poses that the log's phases name, in file order; CalibrationError for an `up` that is not an axis."""
    return _faces(log, lambda phase: bool(face_up(phase.name)))


def _faces(log: Log, is_face: Callable[[Phase], bool]) -> list[Pose]:
    """Return the phases that are faces and state which axis was up."""
    faces = [phase for phase in log.phases if phase.up and is_face(phase)]
    for phase in faces:
        if phase.up not in UP_AXES:
            raise CalibrationError(
                f"{log.path}: phase {phase.name!r}: up {phase.up!r}; allowed are {', '.join(UP_AXES)}"
            )
    return [Pose(phase, up_vector(phase.up), log) for phase in faces]


def read_pose(sensor: SensorLog, pose: Pose) -> Reading:
    """Return the mean reading of `sensor` in `pose`; CalibrationError if it has no readings there.

    The standard error is computed from the means of batches, so that correlation of neighbouring readings does not make
    it too small. Saturated and suspect readings are ignored; CalibrationError if over 0.1 % are saturated.
    """
    sensor, rows = pose.rows_of(sensor)
    status = np.asarray(sensor.status[rows])
    counts = np.asarray(sensor.counts[rows], float)[(status & (SATURATED | SUSPECT)) == 0]
    if len(counts) < 2:
        raise CalibrationError(f"{sensor.where}: no valid readings in phase {pose.phase.name!r}")
    clipped = int(np.count_nonzero(status & SATURATED))
    if clipped > _CLIPPED_SHARE * len(status):
        raise CalibrationError(
            f"{sensor.where}: {clipped} of {len(status)} readings clip in phase {pose.phase.name!r}: no valid mean"
        )
    batches = [batch.mean(axis=0) for batch in np.array_split(counts, min(_BATCHES, len(counts)))]
    sem = np.std(batches, axis=0, ddof=1) / np.sqrt(len(batches))
    half = len(counts) // 2
    change = counts[-half:].mean(axis=0) - counts[:half].mean(axis=0)
    return Reading(counts.mean(axis=0), sem, len(counts), counts.std(axis=0), change)


def find_poses(log: Log, only: Collection[str] = ()) -> list[Pose]:
    """Detect the static poses of a log by its accelerometers and, if it has any, its gyroscopes (`only` these, unless
    that is empty), without the first and last window of each. CalibrationError without accelerometers, and for a log
    that is too short.
    """
    sensors = _rows_of(log, "specific_force", only)
    if not sensors:
        raise CalibrationError(
            f"{log.path}: no accelerometer to detect when the box stood still; mark the rest as a phase, for example"
            " with --up of log or import"
        )
    return poses_in(log, _windows(log, sensors, only))


def find_rests(log: Log) -> list[Pose]:
    """Detect static poses by `rest_windows`; CalibrationError."""
    return poses_in(log, rest_windows(log))


Indices = npt.NDArray[np.int64]


class RestWindows(NamedTuple):
    """Windows of a log: window k starts at `begin_ns` + k `width_ns`. `mean` (w, 3) and `spread` (w,), the largest
    standard deviation, are in the unit of the `quantity` from which rests are detected; `spread` is infinite without
    readings. `still` (w,) is true at rest. `rate_dps` (w, 3) are the means of the gyroscopes, if there are others.
    """

    quantity: str
    begin_ns: int
    width_ns: int
    mean: Floats
    spread: Floats
    still: npt.NDArray[np.bool_]
    rate_dps: Floats | None = None

    @property
    def read(self) -> Indices:
        """Indices of the windows with readings."""
        return np.flatnonzero(np.isfinite(self.spread))


def rest_windows(log: Log) -> RestWindows:
    """Return half-second windows of a log and which of them are at rest, by its accelerometers, or its gyroscopes, or
    its magnetometers, the first that exist; CalibrationError without any, and for a log that is too short.
    """
    sensors = next(filter(None, (_rows_of(log, quantity, ()) for quantity in SAME_POSE)), [])
    if not sensors:
        raise CalibrationError(f"{log.path}: no sensor with three axes to detect when the box stood still")
    return _windows(log, sensors, ())


def _windows(log: Log, sensors: Sequence[SensorLog], only: Collection[str]) -> RestWindows:
    """Return the windows by these sensors of one quantity and by the gyroscopes; CalibrationError."""
    width_ns = max(_WIDTH_NS, round(_LEAST_ROWS * 1e9 * max(_length_s(sensor) / len(sensor) for sensor in sensors)))
    begin = max(int(sensor.time[0]) for sensor in sensors)
    end = min(int(sensor.time[len(sensor) - 1]) for sensor in sensors)
    count = max(0, (end - begin) // width_ns)
    if count < 4:
        raise CalibrationError(
            f"{sensors[0].where}: {(end - begin) * 1e-9:.1f} s of data, too short to hold several poses"
        )
    mean, std = windows_of(sensors, begin, count, width_ns)
    # Most logs contain long rests: the noise at rest is estimated from the quietest quarter of the windows.
    finite = np.isfinite(std)
    still = finite & (std <= 2.5 * np.quantile(std[finite], 0.25)) if finite.any() else finite
    gyroscopes = _rows_of(log, "angular_rate", only)
    if not gyroscopes:
        return RestWindows(sensors[0].quantity, begin, width_ns, mean, std, still)
    rate_dps, rate_std_dps = windows_of(gyroscopes, begin, count, width_ns)
    if still.any():
        rows = max(1.0, width_ns * 1e-9 * min(len(sensor) / _length_s(sensor) for sensor in gyroscopes))
        still &= ~_turning(rate_dps, rate_std_dps, still, rows)
    return RestWindows(sensors[0].quantity, begin, width_ns, mean, std, still, rate_dps)


def poses_in(log: Log, windows: RestWindows) -> list[Pose]:
    """Return the static stretches in these windows of the log."""
    read, still, width_ns = windows.read, windows.still, windows.width_ns
    starts_ns = windows.begin_ns + width_ns * np.arange(len(still))
    jump = np.abs(np.diff(windows.mean[read], axis=0)).max(axis=1) > SAME_POSE[windows.quantity]
    jump |= np.diff(read) * width_ns > BRIDGED_S * 1e9 + width_ns
    edges = np.flatnonzero(jump | (still[read][1:] != still[read][:-1])) + 1
    poses: list[Pose] = []
    for run in np.split(read, edges):
        if len(run) and still[run[0]] and len(run) * width_ns >= MIN_POSE_S * 1e9:
            readings = [windows.mean[run]] if windows.rate_dps is None else [windows.mean[run], windows.rate_dps[run]]
            first, last = _slow_ends(np.hstack(readings))
            start_ns = int(starts_ns[run[0]]) if not first else int(starts_ns[run[first - 1]]) + width_ns
            end_ns = int(starts_ns[run[-1]]) + width_ns if not last else int(starts_ns[run[-last]])
            poses.append(Pose(Phase(start_ns, end_ns, f"pose {len(poses) + 1}"), None, log))
    return poses


def _slow_ends(mean: Floats) -> tuple[int, int]:
    """Return how many windows at the beginning and at the end of a stretch at rest, with these means (w, k), may belong
    to the adjacent motion: one, or in a long stretch twice the number of windows that differ significantly from the
    next ones, but at least one. A motion may begin slowly: if its rate grows with the square of the time, it is a
    quarter as large at half the time.
    """
    if len(mean) < _LEAST_MARGINED:
        return 0, 0
    if len(mean) < 2 * _MOST_SLOW + _NEXT_WINDOWS:
        return 1, 1
    # Windows next to a stall have fewer rows and a larger error: they are in the tail of the changes.
    noise = np.quantile(np.abs(np.diff(mean, axis=0)), 0.9, axis=0) / _TAIL_OF_CHANGES
    limit = SLOW_MOTION * noise * np.sqrt(1 + 1 / _NEXT_WINDOWS)

    def slow(ordered: Floats) -> int:
        next_ones = np.stack([ordered[k + 1 : k + 1 + _NEXT_WINDOWS].mean(axis=0) for k in range(_MOST_SLOW)])
        differs = (np.abs(ordered[:_MOST_SLOW] - next_ones) > limit).any(axis=1)
        return max(1, 2 * int(np.argmin([*differs, False])))

    return slow(mean), slow(mean[::-1])


_LEAST_MARGINED = 5
_MOST_SLOW = 6
_NEXT_WINDOWS = 6
"""Fewest windows of a stretch without its ends, and number of next windows that a window at an end is compared with."""

SLOW_MOTION = 5.0
"""Difference of a window's mean from the next ones in standard errors, beyond which the box moved in it."""

_TAIL_OF_CHANGES = 1.6449 * 2**0.5
"""0.9 quantile of the absolute difference of two normal deviates with unit variance."""


def _rows_of(log: Log, quantity: str, only: Collection[str]) -> list[SensorLog]:
    """Return the sensors of a quantity that have rows."""
    return [sensor for sensor in log.of(quantity, only) if len(sensor)]


def _turning(rate_dps: Floats, std_dps: Floats, still: npt.NDArray[np.bool_], rows: float) -> npt.NDArray[np.bool_]:
    """Return (w,) whether the box turns in a window of `rows` rows: the mean rate of a gyroscope differs from the
    median of the `still` windows. A window without readings of a gyroscope counts as still.
    """
    usual = np.median(rate_dps[still], axis=0)
    noise = float(np.median(std_dps[still])) / np.sqrt(rows)
    deviation = np.abs(rate_dps - usual).max(axis=1)
    return np.asarray(np.isfinite(std_dps) & (deviation > TURNING_DPS + 5 * np.nan_to_num(noise, posinf=0.0)))


def _length_s(sensor: SensorLog) -> float:
    return max((int(sensor.time[len(sensor) - 1]) - int(sensor.time[0])) * 1e-9, 1e-9)


def windows_of(
    sensors: Sequence[SensorLog], begin: int, count: int, width_ns: int, flags: int = 0
) -> tuple[Floats, Floats]:
    """Return mean (w, 3) and largest standard deviation (w,) of every window from `begin` (ns), in the sensors' unit,
    averaged over the sensors in the box frame; the deviation is infinite without readings. Rows with one of `flags` are
    ignored, and so is, in a window of at least `_SPIKED_ROWS`, the reading that is furthest from the others: a single
    wrong reading is not motion.
    """
    means, spreads = np.zeros((count, 3)), np.zeros((count, 3))
    for sensor in sensors:
        rows, figures = np.zeros(count), np.zeros((4, count, 3))
        sums, squares, lowest, highest = figures
        lowest[:], highest[:] = np.inf, -np.inf
        for block in sensor.blocks():
            part = sensor.time[block], sensor.counts[block], sensor.status[block]
            turn = sensor.orientation / sensor.sensitivity
            if not add_windows(part, turn, (rows, figures), (begin, width_ns), flags):
                _add_windows(part, turn, (rows, figures), (begin, width_ns), flags)
        spreads[rows < 2] = np.inf  # the scatter is not known without readings of every sensor
        may_spike = rows >= _SPIKED_ROWS
        low, high, middle = lowest[may_spike], highest[may_spike], (sums[may_spike].T / rows[may_spike]).T
        furthest = np.where(high - middle > middle - low, high, low)
        sums[may_spike] -= furthest
        squares[may_spike] -= furthest**2
        rows = (np.maximum(rows, 1) - may_spike)[:, None]
        means += sums / rows / len(sensors)
        spreads += np.sqrt(np.maximum(squares / rows - (sums / rows) ** 2, 0)) / len(sensors)
    return means, spreads.max(axis=1)


def _add_windows(
    block: tuple[Times, npt.NDArray[Any], npt.NDArray[np.uint16]],
    turn: Floats,
    figures: tuple[Floats, Floats],
    windows: tuple[int, int],
    flags: int,
) -> None:
    """Add as `imuarray.series.add_windows` does, with NumPy."""
    rows, (sums, squares, lowest, highest) = figures[0], figures[1]
    (begin, width_ns), (time, counts, status) = windows, block
    window = (time - begin) // width_ns
    inside = (window >= 0) & (window < len(rows)) & ((status & flags) == 0)
    if not inside.all():
        window, counts = window[inside], counts[inside]
    if not len(window):
        return
    starts = np.flatnonzero(np.diff(window, prepend=-1))
    value = turn @ np.ascontiguousarray(counts.T, float)
    places = window[starts]
    rows[places] += np.diff(starts, append=len(window))  # times increase: a window begins once in a block
    sums[places] += np.add.reduceat(value, starts, axis=1).T
    squares[places] += np.add.reduceat(value**2, starts, axis=1).T
    lowest[places] = np.minimum(lowest[places], np.minimum.reduceat(value, starts, axis=1).T)
    highest[places] = np.maximum(highest[places], np.maximum.reduceat(value, starts, axis=1).T)


@dataclass(frozen=True)
class PoseReadings:
    """Mean readings of `sensors` (s) in `poses` (k), in counts along their own axes.

    All arrays are (s, k, 3): `mean_lsb`, its `variance_lsb2` by the scatter within poses, `change_lsb`, the mean of a
    pose's second half less that of its first, and its standard error `change_sem_lsb`.
    """

    sensors: tuple[SensorLog, ...]
    poses: tuple[Pose, ...]
    mean_lsb: Floats
    variance_lsb2: Floats
    change_lsb: Floats
    change_sem_lsb: Floats

    def only(self, selected: Sequence[int] | Indices) -> PoseReadings:
        """Return the readings in some of the poses."""
        places = np.asarray(selected, int)
        columns = (self.mean_lsb, self.variance_lsb2, self.change_lsb, self.change_sem_lsb)
        mean, variance, change, sem = (column[:, places] for column in columns)
        return PoseReadings(self.sensors, tuple(self.poses[place] for place in places), mean, variance, change, sem)

    def force_box_g(self) -> Floats:
        """Return the specific force (s, k, 3) in g in the box frame by the data sheets' sensitivities; it includes the
        biases.
        """
        turns = np.array([sensor.orientation / sensor.sensitivity for sensor in self.sensors])
        return np.asarray(np.einsum("sij,skj->ski", turns, self.mean_lsb))

    @property
    def sensitivity(self) -> Floats:
        """Counts per unit (s,) according to the data sheets."""
        return np.array([sensor.sensitivity for sensor in self.sensors])

    @property
    def middle_s(self) -> Floats:
        """Middle (k,) of each pose, in s since the epoch of its log."""
        return np.array([(pose.phase.start_ns + pose.phase.end_ns) * 0.5e-9 for pose in self.poses])

    def powers_of_time(self, highest: int) -> Floats:
        """Return orthogonal polynomials (k, highest + 1) of time over the poses, with mean square 1, the first all
        ones; only the first for poses of several logs, which have no common time, and for too few poses.
        """
        if not self.one_run or len(self.poses) <= highest + 1:
            return np.ones((len(self.poses), 1))
        since = self.middle_s - self.middle_s.mean()
        powers = np.linalg.qr(np.vander(since / np.abs(since).max(), highest + 1, increasing=True))[0]
        powers *= np.sqrt(len(self.poses)) * np.sign(powers[-1])
        powers[:, 0] = 1.0
        return np.asarray(powers)

    @property
    def one_run(self) -> bool:
        """True if all poses are in one log, so that their times are comparable."""
        return len({id(pose.log) for pose in self.poses}) == 1


def read_poses(sensors: Sequence[SensorLog], poses: Sequence[Pose]) -> PoseReadings:
    """Read every sensor in every pose; CalibrationError if one has no valid readings in a pose.

    The noise of an axis is assumed equal in all poses, so its variances are pooled. Means of counts with little scatter
    have an error by rounding, ``exp(-4 pi^2 sd^2) / 12`` (the first harmonic of the rounding bias for a normal scatter
    sd).
    """
    readings = [[read_pose(sensor, pose) for pose in poses] for sensor in sensors]

    def column(name: str) -> Floats:
        return np.array([[getattr(reading, name) for reading in row] for row in readings], float)

    rows = column("rows")[:, :, None]
    scatter = np.mean(rows * column("sem_lsb") ** 2, axis=1, keepdims=True)
    rounding = np.exp(-4 * np.pi**2 * np.mean(column("sd_lsb") ** 2, axis=1, keepdims=True)) / 12
    variance = scatter / rows + rounding
    return PoseReadings(
        tuple(sensors), tuple(poses), column("mean_lsb"), variance, column("change_lsb"), 2 * np.sqrt(variance)
    )


Stretches = Sequence[tuple[SensorLog, slice]]
"""Rows of a sensor at rest, in one or several logs."""

SEGMENT_ROWS = 256
"""Number of rows beyond which a change counts as drift, not as noise."""

_BLOCK_ROWS = 256 * SEGMENT_ROWS


class ReadingInterval(NamedTuple):
    """Readings per second, and the longest interval between two readings without a gap."""

    rate_hz: float
    limit_ns: float


_NO_GAP_NS = 1e18
"""Limit of the interval between readings, in ns, that no interval exceeds: there are no gaps."""


def clock_of(stretches: Stretches) -> ReadingInterval:
    """Return the interval of readings in the first block of the longest stretch; rate 0 without two valid readings.
    Rows that arrived in bursts were read steadily, at their mean rate and without gaps.
    """
    sensor, rows = max(stretches, key=lambda stretch: stretch[1].stop - stretch[1].start)
    timing = row_timing(sensor)
    if timing.kind == "bursts":
        return ReadingInterval(timing.rate_hz, _NO_GAP_NS)
    part = slice(rows.start, min(rows.stop, rows.start + _BLOCK_ROWS))
    sound = (np.asarray(sensor.status[part]) & LEFT_OUT) == 0
    intervals = np.diff(np.asarray(sensor.time[part])[sound]).astype(float)
    if len(intervals) == 0:
        return ReadingInterval(0.0, np.inf)
    limit_ns = GAP * float(np.quantile(intervals, 0.75))
    usual = intervals[(intervals > 0) & (intervals <= limit_ns)]
    return ReadingInterval(1e9 / float(usual.mean()) if len(usual) else 0.0, limit_ns)


class SegmentReadings(NamedTuple):
    """Valid readings of one block: counts (n, 3), the number of the segment that contains each reading, and whether
    there is a gap before it.
    """

    counts: Floats
    segment: npt.NDArray[np.int64]
    is_first: npt.NDArray[np.bool_]


def readings(sensor: SensorLog, rows: slice, limit_ns: float) -> Iterator[SegmentReadings]:
    """Yield the valid readings of `rows` block by block; an interval longer than `limit_ns` is a gap."""
    last_ns, breaks, breaks_then = -np.inf, 0, 0
    for start in range(rows.start, rows.stop, _BLOCK_ROWS):
        part = slice(start, min(start + _BLOCK_ROWS, rows.stop))
        status = np.asarray(sensor.status[part])
        sound = (status & LEFT_OUT) == 0
        so_far = breaks + np.cumsum(broken_rows(status))
        breaks = int(so_far[-1])
        if not sound.any():
            continue
        kept = slice(None) if sound.all() else sound  # avoids a copy
        time = np.asarray(sensor.time[part])[kept].astype(float)
        is_separate = np.diff(time, prepend=last_ns) > limit_ns
        is_separate |= np.diff(so_far[kept], prepend=breaks_then) > 0
        segment = (np.flatnonzero(sound) + start - rows.start) // SEGMENT_ROWS
        yield SegmentReadings(np.asarray(sensor.counts[part])[kept].astype(float), segment, is_separate)
        last_ns, breaks_then = float(time[-1]), int(so_far[kept][-1])


def runs_of(part: SegmentReadings) -> Iterator[tuple[bool, Floats]]:
    """Yield the runs of readings between gaps, and whether there is a gap before each."""
    edges = np.flatnonzero(part.is_first)
    if len(edges) == 0 or edges[0] > 0:
        yield False, part.counts[: edges[0]] if len(edges) else part.counts
    for begin, end in pairwise([*edges.tolist(), len(part.counts)]):
        yield True, part.counts[begin:end]
