"""Fusion of arrays beside a loop over their frames, beside reading the counts from a log, and beside the time there is.

The kernel (`imuarray.fuse.least_squares.ConstantGain`, which `fuse` uses where every reading is at its frame's time and
none is in doubt) has the counts in memory, six triads and the paper's 27 axes; so have the loop, ``W @ (raw - b)``
frame by frame with NumPy. Beside it stand ``counts.sum()`` over the same array, and what it takes to read the same
counts from a finished file: what a user waits for anyhow, on any processor.
The whole way is `fuse(log)` from the file to the estimates with their covariance, of a log whose sensors are read at
once and of one whose sensors are read one after the other, beside a loop that reads the same log 4096 rows at a time
and does nothing but ``W @ (raw - b)``: no times, no flags. Live is the same array at 400 Hz in steps of a second, as
`log --fuse` gets it, by the mean and by the estimator of the whole array. Turns are taken alternately and the least of
each side counts.
Memory is what Python and NumPy allocate.
"""

from __future__ import annotations

import time
import tracemalloc
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import h5py
import numpy as np
from compare import Row, row

from imuarray.calibrate import Calibration
from imuarray.calibrate.model import nominal
from imuarray.fuse import axes_of, fuse, live
from imuarray.fuse.alignment import cut
from imuarray.fuse.frames import Estimate, directions
from imuarray.fuse.fusion import aligned
from imuarray.fuse.least_squares import ConstantGain, whole_gain
from imuarray.fuse.optimal import error_model
from imuarray.fuse.optimal.geometry import Geometry, geometry_of
from imuarray.fuse.optimal.optimal import Optimal
from imuarray.fuse.optimal.states import ErrorStates, states_of
from imuarray.log import Block, Log, LogWriter, SensorLog, open_log
from imuarray.log.format import SensorHeader
from imuarray.log.sensor_log import recorded_header

FRAMES, LOOPED, RATE_HZ, TURNS = 200_000, 10_000, 400.0, 15
LOGGED = 40_000
TEXTBOOK = 300
"""Frames of the textbook's filter, which takes milliseconds for each."""
AXES = ("+X+Y+Z", "-Y-X-Z", "+Y+X-Z", "+Y-X+Z")


def rows() -> list[Row]:
    """Kernel, whole way, memory, live."""
    with TemporaryDirectory() as folder:
        at_once = written(Path(folder) / "at_once.h5", LOGGED, 0.0)
        in_turn = written(Path(folder) / "in_turn.h5", LOGGED, 0.0002)
        longer = written(Path(folder) / "longer.h5", 4 * LOGGED, 0.0002)
        return [
            *kernel(18),
            *kernel(27),
            whole_way("read at once", at_once),
            whole_way("read in turn", in_turn),
            row("fuse: peak memory of a log four times as long", peak_mb(longer), peak_mb(in_turn), "MB", 1.1, "lower"),
            row("fusion live, 27 axes at 400 Hz, of a core", live_share(in_turn), 1.0, "cores", 0.02, "lower"),
            row("the same by optimal, watched", live_share(in_turn, "optimal"), 1.0, "cores", 0.02, "lower"),
            textbook(in_turn),
        ]


def kernel(columns: int) -> list[Row]:
    """Frames per second beside the loop's, and the time beside that of reading the counts."""
    rng = np.random.default_rng(1)
    counts = rng.integers(-20_000, 20_000, (FRAMES, columns)).astype(np.int16)
    gain, bias = rng.normal(size=(3, columns)) * 1e-3, rng.normal(0, 50, columns)
    combine = ConstantGain(gain, bias)
    difference = np.abs(combine([counts[:100]]) - looped(counts[:100], gain, bias)).max()
    if difference > 1e-9:
        raise ValueError(f"the kernel and the loop differ by {difference}")
    with TemporaryDirectory() as folder:
        path = Path(folder) / "counts.h5"
        options = {"chunks": (4096, columns), "compression": "gzip", "shuffle": True, "fletcher32": True}
        with h5py.File(path, "w") as file:
            file.create_dataset("counts", data=counts // 1000, **options)  # as noise at rest packs
        peers = [lambda: looped(counts[:LOOPED], gain, bias), lambda: counts.sum(), lambda: from_file(path)]
        times = [[seconds(call) for call in (lambda: combine([counts]), *peers)] for _ in range(TURNS)]
    took_s, loop_s, sum_s, read_s = (min(column) for column in zip(*times, strict=True))
    title, each_ns = f"fusion kernel, {columns} axes to 3", took_s / FRAMES * 1e9
    speed, peer = FRAMES / took_s / 1e6, LOOPED / loop_s / 1e6
    return [
        row(f"{title}, against a loop over frames", speed, peer, "1e6 frames/s", 40.0, "higher"),
        row(f"{title}, against the counts' sum", each_ns, sum_s / FRAMES * 1e9, "ns", 3.0, "lower"),
        row(f"{title}, against reading them", each_ns, read_s / FRAMES * 1e9, "ns", 0.5, "lower"),
    ]


def from_file(path: Path) -> np.ndarray:
    """The counts, of a file that nobody holds open: none of them is in a cache of HDF5's."""
    with h5py.File(path) as file:
        return np.asarray(file["counts"][:])


def looped(counts: np.ndarray, gain: np.ndarray, bias: np.ndarray) -> np.ndarray:
    """Frame by frame, as one writes it first."""
    fused = np.empty((len(counts), 3))
    for index, raw in enumerate(counts):
        fused[index] = gain @ (raw - bias)
    return fused


def whole_way(name: str, path: Path) -> Row:
    """Frames per second of `fuse(log)` and of a loop that reads the same log."""
    times = []
    for _ in range(TURNS):
        with open_log(path) as log:
            ours = seconds(lambda log=log: sum(len(block.time) for block in fuse(log, Calibration(), "mean")))
            peer = seconds(lambda log=log: looped_log(log))
        times.append((ours, peer))
    best, loop = (min(column) for column in zip(*times, strict=True))
    title = f"fuse(log) of 27 axes {name}, from the file, against a loop over frames"
    return row(title, LOGGED / best / 1e6, LOGGED / loop / 1e6, "1e6 frames/s", 10.0, "higher")


def looped_log(log: Log) -> None:
    """Both quantities, frame by frame, of the same file."""
    for quantity in ("specific_force", "angular_rate"):
        sensors: list[SensorLog] = log.of(quantity)
        axes = axes_of(sensors, Calibration())
        scale = np.concatenate([Calibration().of(sensor).lsb_per_si for sensor in sensors])
        gain = whole_gain(np.ones(len(axes)), directions(axes)) / scale
        for part in sensors[0].blocks(4096):
            looped(np.concatenate([np.asarray(sensor.counts[part]) for sensor in sensors], axis=1), gain, scale)


def textbook(path: Path) -> Row:
    """Frames per second of `optimal`, beside a Kalman filter of the textbook with the same states and error model."""
    with open_log(path) as log:
        calibration = Calibration(
            {name: replace(nominal(sensor), noise_lsb=np.full(3, 5.0)) for name, sensor in log.sensors.items()}
        )
        sensors = {quantity: log.of(quantity) for quantity in ("angular_rate", "specific_force")}
        axes = {quantity: axes_of(its, calibration) for quantity, its in sensors.items()}
        model = error_model([sensor for its in sensors.values() for sensor in its], calibration)
        blocks = [frames for frames, _ in aligned(log, calibration)]
    known = {name: (geometry_of(its, model), states_of(its, model)) for name, its in axes.items()}
    few = {name: frames.part(slice(TEXTBOOK)) for name, frames in blocks[0].items()}

    def ours() -> list[dict[str, Estimate]]:
        estimator = Optimal(axes, model, period_s=1 / RATE_HZ)
        return [estimator(frames) for frames in blocks]

    def theirs() -> dict[str, np.ndarray]:
        return {name: kalman(few[name].values, *known[name]) for name in few}

    estimates, triads = ours()[0], theirs()
    for name, (geometry, _) in known.items():
        apart = np.abs(estimates[name].triad_box[TEXTBOOK - 20 : TEXTBOOK] - triads[name][-20:]).max()
        if apart > geometry.noise.max():
            raise ValueError(f"optimal and the textbook's filter differ by {apart} in {name}")
    best, loop = min(seconds(ours) for _ in range(3)), seconds(theirs)
    title = "optimal of 27 axes, against a textbook's Kalman filter of the same states in a Python loop"
    return row(title, LOGGED / best / 1e3, TEXTBOOK / loop / 1e3, "1e3 frames/s", 50.0, "higher")


def kalman(values: np.ndarray, geometry: Geometry, states: ErrorStates) -> np.ndarray:
    """Triads (n, 3) of readings (n, m) by a filter whose states are the triad, which is another one in every frame, and
    the slow errors, frame by frame (Bar-Shalom, Li and Kirubarajan, "Estimation with applications to tracking and
    navigation", 2001, sections 5.2 and 5.2.6, covariances in Joseph's form).
    """
    count, slow = len(geometry.noise), len(states.names)
    remaining, added = states.transition(1 / RATE_HZ)
    remaining, added = np.append(np.zeros(3), remaining), np.diag(np.append(np.full(3, 1e4), added))
    mean, covariance = np.zeros(3 + slow), np.zeros((3 + slow, 3 + slow))
    covariance[3:, 3:] = states.prior
    noise, one, triads = np.diag(geometry.noise**2), np.eye(3 + slow), np.empty((len(values), 3))
    steady, *response = states.response_at(np.zeros(count)).dense
    felt = np.linalg.lstsq(geometry.rows, values[0], rcond=None)[0]
    for index, reading in enumerate(values):
        mean = remaining * mean
        covariance = remaining[:, None] * covariance * remaining + added
        errors = steady + sum(share * rows for share, rows in zip(felt, response, strict=False))
        seen = np.concatenate([geometry.rows, errors], axis=1)
        gain = np.linalg.solve(seen @ covariance @ seen.T + noise, seen @ covariance).T
        mean = mean + gain @ (reading - seen @ mean)
        kept = one - gain @ seen
        covariance = kept @ covariance @ kept.T + gain @ noise @ gain.T
        triads[index] = felt = mean[:3]
    return triads


def live_share(path: Path, technique: str = "mean") -> float:
    """Seconds of work per second of rows; `optimal` looks for sensors that fail as well."""
    with open_log(path) as log:
        blocks = {
            name: Block(np.asarray(sensor.time[:]), np.asarray(sensor.counts[:]), np.asarray(sensor.status[:]))
            for name, sensor in log.sensors.items()
        }
        headers = [recorded_header(sensor) for sensor in log.sensors.values()]
        noisy = {name: replace(nominal(sensor), noise_lsb=np.full(3, 5.0)) for name, sensor in log.sensors.items()}
    span_s = int(LOGGED / RATE_HZ)

    def stream() -> None:
        fusion = live(headers, Calibration(noisy), technique)
        for start_s in range(span_s):
            for name, block in blocks.items():
                first, last = np.searchsorted(block.time, [start_s * 10**9, (start_s + 1) * 10**9])
                list(fusion.push(name, cut(block, slice(int(first), int(last)))))
        list(fusion.finish())

    return min(seconds(stream) for _ in range(3)) / span_s


def peak_mb(path: Path) -> float:
    """The most memory that fusing a log allocates."""
    with open_log(path) as log:
        tracemalloc.start()
        for _ in fuse(log, Calibration(), "mean"):
            pass
        most = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
    return most / 1e6


def written(path: Path, frames: int, apart_s: float) -> Path:
    """A log of the paper's six accelerometers and three gyroscopes at rest, read `apart_s` one after the other."""
    kinds = [("bma180", "specific_force", "g", 16.0, 512.0)] * 6 + [
        ("l3g4200d", "angular_rate", "dps", 250.0, 114.0)
    ] * 3
    headers = [SensorHeader(f"S{i}", *kind, axes=AXES[i % 4]) for i, kind in enumerate(kinds)]
    rng, status = np.random.default_rng(1), np.zeros(frames, np.uint16)
    with LogWriter(path, headers, source="simulated", epoch="2024-01-01T00:00:00Z") as writer:
        for index, header in enumerate(headers):
            moment = np.round((np.arange(frames) / RATE_HZ + apart_s * index) * 1e9).astype(np.int64)
            writer.append(header.name, Block(moment, rng.normal(0, 5, (frames, 3)).astype(np.int16), status))
    return path


def seconds(call: Callable[[], object]) -> float:
    """Time on the wall of one call."""
    begun = time.perf_counter()
    call()
    return time.perf_counter() - begun


if __name__ == "__main__":
    for found in rows():
        print(found)
