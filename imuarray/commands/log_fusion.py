"""Fusion beside a recording: in a thread of its own, which the recording neither waits for nor hears failing.

Rows go through a queue that ends somewhere. If it is full, rows are thrown away until half of it is empty again, and
counted: the log has them, and `imuarray fuse` will not miss them.

Nothing is fused before the first inertial rows come. Where a calibration says how sensors come up, these come as soon
as it is known (`imuarray.acquire.start_up`), and the biases are those of the states found then; a sensor that has to be
set up again later keeps the one that was found first.
"""

from __future__ import annotations

import queue
import sys
import threading
from collections import deque
from collections.abc import Callable, Collection, Iterable, Sequence
from contextlib import closing, suppress
from itertools import chain
from pathlib import Path

import click

from imuarray.calibrate import Calibration
from imuarray.chips import CHIPS
from imuarray.commands.log_fused_files import FusedFiles, names_of
from imuarray.errors import ImuArrayError
from imuarray.fuse import FaultEvent, FusedBlock, FusionNotes, FusionStream, Watch, live, notes_of
from imuarray.log import Block
from imuarray.log.disk_space import WATERMARK, free_bytes
from imuarray.log.format import SensorHeader
from imuarray.printable import counted
from imuarray.units import INERTIAL, READABLE_SI

_SECONDS_WAITING = 30.0
"""Of rows in the queue, at most."""
_WRITE_S = 1.0
"""Frames of so long are written at once."""
_SWITCH_S = 5e-5
"""How long the thread may keep the interpreter from the recording, which asks for it after every transaction."""
_FAULTS_KEPT = 1000
"""The last ones, for the report; the file has all of them."""


class LiveFusion:
    """Fuses the rows that it observes into `path`. Use: `begun` once, `observe` often, `close`."""

    def __init__(
        self,
        path: Path,
        log: Path,
        calibration: Calibration,
        technique: str,
        *,
        rate_hz: float,
        calibration_file: str = "",
        watch: bool | None = None,
        came_up: Callable[[], Calibration] | None = None,
        rotate_s: float | None = None,
        force: bool = False,
        timeout_s: float | None = None,
        tell: Callable[[str], None] = lambda text: click.echo(f"imuarray: {text}", err=True),
        waiting: int | None = None,
    ) -> None:
        """`watch`: whether sensors that fail are left out (None: by `optimal`). `came_up` says, once the first inertial
        rows are there, what the calibration is in the states in which sensors came up. `rotate_s`: a file for each part
        of the log.
        """
        self.path, self.skipped, self.failure = path, 0, ""
        self.frames = 0
        self._log, self._technique, self._calibration_file, self._rotate_s = log, technique, calibration_file, rotate_s
        self._calibration, self._force, self.tell = calibration, force, tell
        self._came_up = came_up or (lambda: calibration)
        self._watch = Watch(watch, {name: chip.sensitivity for name, chip in CHIPS.items()}, self._failed)
        self._faults: deque[FaultEvent] = deque(maxlen=_FAULTS_KEPT)
        self._unwritten: list[FaultEvent] = []
        self._told = FusionNotes()
        self._files: FusedFiles | None = None
        self.first_path = names_of(path, log, 0, rotate_s)[0]
        """What it will write first."""
        self._timeout_s = max(3.0, 3 + 100 / rate_hz) if timeout_s is None else timeout_s
        self._waiting = waiting
        self._dropped: dict[str, int] = {}
        self._overrun = False
        self._latest: FusedBlock | None = None
        self._ending = threading.Event()
        self._thread: threading.Thread | None = None
        self._switch_s = sys.getswitchinterval()

    def begun(self, epoch: str, headers: Sequence[SensorHeader]) -> None:
        """The log's epoch and sensors are known: FusionError if they can't feed the technique, CalibrationError if the
        calibration does not fit, OutputExistsError, OutputError.
        """
        stream = self._stream(headers, self._calibration)
        ordered = sorted(headers, key=lambda header: header.name)
        names: dict[str, list[str]] = {
            quantity: [h.name for h in ordered if h.quantity == quantity] for quantity in INERTIAL
        }
        self._files = FusedFiles(
            self.path,
            self._log,
            epoch=epoch,
            technique=self._technique,
            calibration=self._calibration_file,
            sensors=names,
            rotate_s=self._rotate_s,
            force=self._force,
        )
        self._wanted = frozenset(stream.sensors)
        blocks = round(_SECONDS_WAITING * len(self._wanted)) if self._waiting is None else self._waiting
        self._queue: queue.Queue[tuple[str, Block]] = queue.Queue(blocks)
        sys.setswitchinterval(min(self._switch_s, _SWITCH_S))
        self._thread = threading.Thread(target=self._work, args=(headers, self._files), name="fusion", daemon=True)
        self._thread.start()

    def started(self, time_ns: int) -> None:
        """When the first part of a log in parts begins; before there are rows."""
        if self._files is not None:
            self._files.origin_ns = time_ns

    def observe(self, sensor: str, block: Block) -> None:
        """Rows that were written; returns at once."""
        if self.failure or self._thread is None or sensor not in self._wanted:
            return
        if self._overrun and self._queue.qsize() <= self._queue.maxsize // 2:
            self._overrun = False
        if not self._overrun:
            try:
                self._queue.put_nowait((sensor, block))
                return
            except queue.Full:
                self._overrun = True
                self.tell("fusion can't keep up: frames are skipped in its file, the log has them")
        self._dropped[sensor] = self._dropped.get(sensor, 0) + len(block.time)
        self.skipped = max(self._dropped.values())

    def status(self) -> str:
        """The latest result, for a line that a person watches."""
        block = self._latest
        if self.failure or block is None:
            return "no fusion" if self.failure else ""
        parts = []
        for quantity, triad in block.triads.items():
            factor, unit = READABLE_SI[quantity]
            parts.append(" ".join(f"{factor * value:.1f}" for value in triad[-1]) + f" {unit}")
        return ", ".join(parts)

    def close(self) -> None:
        """Everything that waits is fused, and the file complete."""
        self._ending.set()
        if self._thread is not None:
            self._thread.join()
            self._thread = None
            sys.setswitchinterval(self._switch_s)
            if self.skipped:
                self.tell(f"{self.path}: {counted(self.skipped, 'frame')} skipped: fusion could not keep up")

    @property
    def paths(self) -> list[Path]:
        """The files that it wrote, in the order of their time."""
        return [path for path in (self._files.paths if self._files else []) if path.exists()]

    def report(self) -> dict[str, object]:
        """What came of it, JSON-ready."""
        return {
            "fused": str(self.path),
            "files": [str(path) for path in self.paths],
            "frames": self.frames,
            "skipped": self.skipped,
            "failure": self.failure,
            "faults": [event.as_json() for event in self._faults],
            "learned": self._told.as_json(),
        }

    def _stream(self, headers: Sequence[SensorHeader], calibration: Calibration) -> FusionStream[FusedBlock]:
        return live(
            headers,
            calibration,
            self._technique,
            watch=self._watch,
            timeout_s=self._timeout_s,
            tell=lambda text: self.tell(text),
        )

    def _failed(self, event: FaultEvent) -> None:
        """Something became of a sensor."""
        self._faults.append(event)
        self._unwritten.append(event)
        self.tell(event.sentence)

    def _work(self, headers: Sequence[SensorHeader], files: FusedFiles) -> None:
        """The thread. Whatever goes wrong is told once, and the rest is not fused."""
        try:
            with closing(files):
                held: list[FusedBlock] = []
                first = self._first_rows({header.name for header in headers if header.quantity in INERTIAL})
                stream = self._stream(headers, self._came_up())
                for sensor, block in chain(first, self._rows()):
                    held += stream.push(sensor, block)
                    if held and held[-1].time[-1] - held[0].time[0] >= _WRITE_S * 1e9:
                        self._write(files, held)
                        held = []
                self._write(files, [*held, *stream.finish()])
                self._told = notes_of(stream.pipeline)
        except Exception as error:  # whatever it is, the log goes on
            known = isinstance(error, ImuArrayError | OSError)
            self.failure = str(error) if known else f"{type(error).__name__}: {error}"
            self.tell(f"fusion ends, the log goes on: {self.failure}")
        finally:
            with suppress(queue.Empty):
                while True:
                    self._queue.get_nowait()

    def _first_rows(self, inertial: Collection[str]) -> list[tuple[str, Block]]:
        """What comes up to the first rows of an inertial sensor."""
        first = []
        for sensor, block in self._rows():
            first.append((sensor, block))
            if sensor in inertial:
                break
        return first

    def _rows(self) -> Iterable[tuple[str, Block]]:
        """What comes through the queue, until the end and until it is empty."""
        while True:
            try:
                yield self._queue.get(timeout=0.1)
            except queue.Empty:
                if self._ending.is_set():
                    return

    def _write(self, files: FusedFiles, blocks: Sequence[FusedBlock]) -> None:
        if free_bytes(self.path) < 2 * WATERMARK:
            raise OSError(f"{self.path}: the disk is nearly full, what is left is the log's")
        if blocks:
            block = FusedBlock.joined(blocks)
            files.append(block)
            self.frames, self._latest = files.frames, block
            for event in self._unwritten:
                files.event(event)
            self._unwritten = []
