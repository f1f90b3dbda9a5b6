"""Fusion during a recording, in a separate thread: the recording neither waits for it nor fails with it.

Rows pass through a bounded queue. If it is full, rows are dropped and counted until half of it is free again; the log
contains all rows, so `imuarray fuse` can fuse them later.

Fusion starts with the first inertial rows. If a calibration contains start-up states, these rows arrive as soon as the
states are known (`imuarray.acquire.sensor_health`), and the biases are those of these states; a sensor that is
configured again later keeps its first state.
"""

from __future__ import annotations

import queue
import sys
import threading
from collections import deque
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path

import numpy as np

from imuarray.calibrate import Calibration
from imuarray.errors import ImuArrayError
from imuarray.fuse.faults import FaultEvent
from imuarray.fuse.frames import FusedBlock
from imuarray.fuse.fused_file import LiveFused
from imuarray.fuse.fusion import Patience, Watch, live
from imuarray.fuse.pipeline import FusionNotes, notes_of
from imuarray.fuse.stream import FusionStream
from imuarray.log import Block
from imuarray.log.disk_space import WATERMARK, free_bytes
from imuarray.log.format import SensorHeader
from imuarray.log.rotate import part_of, runs_of
from imuarray.printable import counted
from imuarray.units import INERTIAL, READABLE_SI

_SECONDS_WAITING = 30.0
"""Longest duration in s of the rows in the queue."""
_WRITE_S = 1.0
"""Duration in s of the frames that are written at once."""
_SWITCH_S = 5e-5
"""Longest time in s for which the thread holds the interpreter, which the recording needs after every transaction.
"""
_FAULTS_KEPT = 1000
"""Number of most recent faults in the report; the file contains all of them."""


def default_path(log: Path) -> Path:
    """Return the default path of the result of a log, where `imuarray monitor` expects it: `RUN_fused.h5`."""
    return log.with_name(f"{log.stem}_fused.h5")


@dataclass(frozen=True)
class FusionOutput:
    """Destination of the result: the file `path` of the log `log`; with `rotate_s`, one file per part of this length.

    `technique` and `calibration_file` are noted in the files; `force` overwrites existing ones.
    """

    path: Path
    log: Path
    technique: str = "mean"
    calibration_file: str = ""
    rotate_s: float | None = None
    force: bool = False

    def part(self, number: int) -> tuple[Path, Path]:
        """Return the paths of the fused file and of the log of part `number`, counted from 0."""
        if self.rotate_s is None:
            return self.path, self.log
        log = part_of(self.log, number + 1)
        return default_path(log) if self.path == default_path(self.log) else part_of(self.path, number + 1), log


class FusedFiles:
    """Writes fused frames, each to the file of the part that contains its time.

    For a log RUN.h5 in parts RUN_001.h5, RUN_002.h5, ... the results are RUN_001_fused.h5, ..., or, with another output
    name, FUSED_001.h5, ...
    """

    def __init__(self, output: FusionOutput, *, epoch: str, sensors: Mapping[str, Sequence[str]]) -> None:
        """`sensors`: names by quantity. OutputExistsError, OutputError."""
        self._output, self._epoch, self._sensors = output, epoch, sensors
        self._part_ns = None if output.rotate_s is None else round(output.rotate_s * 1e9)
        self.origin_ns = 0
        """Start of the first part."""
        self.paths: list[Path] = []
        self.frames = 0
        self._number = 0
        self._file = self._create(0)

    def append(self, block: FusedBlock) -> None:
        """Append more frames. OSError, OutputExistsError, OutputError."""
        for number, rows in self._split(block):
            if number > self._number:
                self._file.close()
                self._number, self._file = number, self._create(number)
            self._file.append(block.part(rows))
            self.frames += rows.stop - rows.start

    def event(self, event: FaultEvent) -> None:
        """Write a fault event to the file of the last frames. OSError."""
        self._file.event(event)

    def _create(self, number: int) -> LiveFused:
        path, log = self._output.part(number)
        file = LiveFused(
            path,
            sensors=self._sensors,
            force=self._output.force,
            epoch=self._epoch,
            technique=self._output.technique,
            log=str(log),
            calibration=self._output.calibration_file,
        )
        self.paths.append(path)
        return file

    def _split(self, block: FusedBlock) -> list[tuple[int, slice]]:
        """Return the numbers of parts and the frames in each; frames before the first part belong to it."""
        if self._part_ns is None or not len(block.time):
            return [(0, slice(0, len(block.time)))]
        return runs_of(np.maximum((block.time - self.origin_ns) // self._part_ns, 0))

    def close(self) -> None:
        """Complete the last file."""
        self._file.close()


@dataclass(frozen=True)
class LiveFusionOptions:
    """Options of a fusion during a recording at `rate_hz` frames per second.

    `watch`: whether failing sensors are excluded (None: by `optimal` only); `ranges` are the sensitivities of chips by
    range, to identify a sensor that returned to another range (`imuarray.chips.SENSITIVITIES`). `start_calibration`
    returns, once the first inertial rows have arrived, the calibration for the states in which the sensors started
    (None: the given calibration). Frames wait for a sensor for `timeout_s` (None: by the frame rate); the queue holds
    `queue_blocks` (None: 30 s).
    """

    rate_hz: float
    watch: bool | None = None
    ranges: Mapping[str, Mapping[float, float]] = field(default_factory=dict)
    start_calibration: Callable[[], Calibration] | None = None
    timeout_s: float | None = None
    queue_blocks: int | None = None


class LiveFusion:
    """Fuses observed rows into `output`. Call `begin` once, `observe` for each block of rows, then `close`."""

    def __init__(
        self,
        output: FusionOutput,
        calibration: Calibration,
        options: LiveFusionOptions,
        on_remark: Callable[[str], None] = lambda text: None,
    ) -> None:
        """`on_remark` receives sentences about the fusion: failing sensors, skipped frames, its end."""
        self.output, self.skipped, self.failure = output, 0, ""
        self.frames = 0
        self._calibration, self._options, self.on_remark = calibration, options, on_remark
        self._start_calibration = options.start_calibration or (lambda: calibration)
        self._watch = Watch(options.watch, options.ranges, self._record_fault)
        self._faults: deque[FaultEvent] = deque(maxlen=_FAULTS_KEPT)
        self._unwritten: list[FaultEvent] = []
        self._notes = FusionNotes()
        self._files: FusedFiles | None = None
        self._timeout_s = max(3.0, 3 + 100 / options.rate_hz) if options.timeout_s is None else options.timeout_s
        self._dropped: dict[str, int] = {}
        self._overrun = False
        self._latest: FusedBlock | None = None
        self._ending = threading.Event()
        self._thread: threading.Thread | None = None
        self._switch_s = sys.getswitchinterval()

    @property
    def path(self) -> Path:
        """The path of the result; for a result in parts, the path from which their names are derived."""
        return self.output.path

    @property
    def first_path(self) -> Path:
        """The path of the first file of the result."""
        return self.output.part(0)[0]

    def begin(self, epoch: str, headers: Sequence[SensorHeader]) -> None:
        """Begin with the log's epoch and sensors. FusionError if these are not sufficient for the technique,
        CalibrationError if the calibration does not fit, OutputExistsError, OutputError.
        """
        stream = self._stream(headers, self._calibration)
        ordered = sorted(headers, key=lambda header: header.name)
        names: dict[str, list[str]] = {
            quantity: [h.name for h in ordered if h.quantity == quantity] for quantity in INERTIAL
        }
        self._files = FusedFiles(self.output, epoch=epoch, sensors=names)
        self._fused_sensors = frozenset(stream.sensors)
        blocks = self._options.queue_blocks or round(_SECONDS_WAITING * len(self._fused_sensors))
        self._queue: queue.Queue[tuple[str, Block]] = queue.Queue(blocks)
        sys.setswitchinterval(min(self._switch_s, _SWITCH_S))
        self._thread = threading.Thread(target=self._work, args=(headers, self._files), name="fusion", daemon=True)
        self._thread.start()

    def set_start(self, time_ns: int) -> None:
        """Set the start of the first part of a log in parts; call it before there are rows."""
        if self._files is not None:
            self._files.origin_ns = time_ns

    def observe(self, sensor: str, block: Block) -> None:
        """Queue rows without waiting."""
        if self.failure or self._thread is None or sensor not in self._fused_sensors:
            return
        if self._overrun and self._queue.qsize() <= self._queue.maxsize // 2:
            self._overrun = False
        if not self._overrun:
            try:
                self._queue.put_nowait((sensor, block))
                return
            except queue.Full:
                self._overrun = True
                self.on_remark("fusion can't keep up: its file lacks frames; the log contains them")
        self._dropped[sensor] = self._dropped.get(sensor, 0) + len(block.time)
        self.skipped = max(self._dropped.values())

    def status(self) -> str:
        """Return the latest result as one line of text."""
        block = self._latest
        if self.failure or block is None:
            return "no fusion" if self.failure else ""
        parts = []
        for quantity, triad in block.triads.items():
            factor, unit = READABLE_SI[quantity]
            parts.append(" ".join(f"{factor * value:.1f}" for value in triad[-1]) + f" {unit}")
        return ", ".join(parts)

    def close(self) -> None:
        """Fuse the queued rows, and complete the file."""
        self._ending.set()
        if self._thread is not None:
            self._thread.join()
            self._thread = None
            sys.setswitchinterval(self._switch_s)
            if self.skipped:
                self.on_remark(f"{self.path}: {counted(self.skipped, 'frame')} skipped: fusion could not keep up")

    @property
    def paths(self) -> list[Path]:
        """The files that were written, in order of time."""
        return [path for path in (self._files.paths if self._files else []) if path.exists()]

    def report(self) -> dict[str, object]:
        """Return a summary of the fusion for JSON."""
        return {
            "fused": str(self.path),
            "files": [str(path) for path in self.paths],
            "frames": self.frames,
            "skipped": self.skipped,
            "failure": self.failure,
            "faults": [event.as_json() for event in self._faults],
            "learned": self._notes.as_json(),
        }

    def _stream(self, headers: Sequence[SensorHeader], calibration: Calibration) -> FusionStream[FusedBlock]:
        return live(
            headers,
            calibration,
            self.output.technique,
            watch=self._watch,
            patience=Patience(self._timeout_s, lambda text: self.on_remark(text)),
        )

    def _record_fault(self, event: FaultEvent) -> None:
        """Store and report a failure or recovery of a sensor."""
        self._faults.append(event)
        self._unwritten.append(event)
        self.on_remark(event.sentence)

    def _work(self, headers: Sequence[SensorHeader], files: FusedFiles) -> None:
        """Run in the thread. An error is reported once and ends the fusion."""
        try:
            with closing(files):
                blocks: list[FusedBlock] = []
                first = self._first_rows({header.name for header in headers if header.quantity in INERTIAL})
                stream = self._stream(headers, self._start_calibration())
                for sensor, block in chain(first, self._rows()):
                    blocks += stream.push(sensor, block)
                    if blocks and blocks[-1].time[-1] - blocks[0].time[0] >= _WRITE_S * 1e9:
                        self._write(files, blocks)
                        blocks = []
                self._write(files, [*blocks, *stream.finish()])
                self._notes = notes_of(stream.pipeline)
        except Exception as error:  # no error may stop the recording
            is_own_error = isinstance(error, ImuArrayError | OSError)
            self.failure = str(error) if is_own_error else f"{type(error).__name__}: {error}"
            self.on_remark(f"fusion stops, recording continues: {self.failure}")
        finally:
            with suppress(queue.Empty):
                while True:
                    self._queue.get_nowait()

    def _first_rows(self, inertial: Collection[str]) -> list[tuple[str, Block]]:
        """Return all rows up to and including the first rows of an inertial sensor."""
        first = []
        for sensor, block in self._rows():
            first.append((sensor, block))
            if sensor in inertial:
                break
        return first

    def _rows(self) -> Iterable[tuple[str, Block]]:
        """Yield the rows from the queue until the fusion is closed and the queue is empty."""
        while True:
            try:
                yield self._queue.get(timeout=0.1)
            except queue.Empty:
                if self._ending.is_set():
                    return

    def _write(self, files: FusedFiles, blocks: Sequence[FusedBlock]) -> None:
        if free_bytes(self.path) < 2 * WATERMARK:
            raise OSError(f"{self.path}: the disk is nearly full; the remaining space is kept for the log")
        if blocks:
            block = FusedBlock.joined(blocks)
            files.append(block)
            self.frames, self._latest = files.frames, block
            for event in self._unwritten:
                files.event(event)
            self._unwritten = []
