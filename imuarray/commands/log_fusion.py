"""Fusion beside a recording: in a thread of its own, which the recording neither waits for nor hears failing.

Rows go through a queue that ends somewhere. If it is full, rows are thrown away until half of it is empty again, and
counted: the log has them, and `imuarray fuse` will not miss them.
"""

from __future__ import annotations

import queue
import sys
import threading
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path

import click
import numpy as np

from imuarray.calibrate import Calibration
from imuarray.errors import ImuArrayError
from imuarray.fuse import FusedBlock, FusionStream, live
from imuarray.fuse.store import LiveFused
from imuarray.log import Block
from imuarray.log.format import SensorHeader
from imuarray.log.room import WATERMARK, free_bytes
from imuarray.printable import counted
from imuarray.units import INERTIAL, READABLE_SI

_SECONDS_WAITING = 30.0
"""Of rows in the queue, at most."""
_WRITE_S = 1.0
"""Frames of so long are written at once."""
_SWITCH_S = 5e-5
"""How long the thread may keep the interpreter from the recording, which asks for it after every transaction."""


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
        force: bool = False,
        timeout_s: float | None = None,
        tell: Callable[[str], None] = lambda text: click.echo(f"imuarray: {text}", err=True),
        waiting: int | None = None,
    ) -> None:
        self.path, self.skipped, self.failure = path, 0, ""
        self.frames = 0
        self._about = {"technique": technique, "log": str(log), "calibration": calibration_file}
        self._calibration, self._force, self.tell = calibration, force, tell
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
        stream = live(
            headers,
            self._calibration,
            self._about["technique"],
            timeout_s=self._timeout_s,
            tell=lambda text: self.tell(text),
        )
        ordered = sorted(headers, key=lambda header: header.name)
        names: dict[str, list[str]] = {
            quantity: [h.name for h in ordered if h.quantity == quantity] for quantity in INERTIAL
        }
        file = LiveFused(self.path, epoch=epoch, sensors=names, force=self._force, **self._about)
        self._wanted = frozenset(stream.sensors)
        blocks = round(_SECONDS_WAITING * len(self._wanted)) if self._waiting is None else self._waiting
        self._queue: queue.Queue[tuple[str, Block]] = queue.Queue(blocks)
        sys.setswitchinterval(min(self._switch_s, _SWITCH_S))
        self._thread = threading.Thread(target=self._work, args=(stream, file), name="fusion", daemon=True)
        self._thread.start()

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

    def report(self) -> dict[str, object]:
        """What came of it, JSON-ready."""
        return {"fused": str(self.path), "frames": self.frames, "skipped": self.skipped, "failure": self.failure}

    def _work(self, stream: FusionStream[FusedBlock], file: LiveFused) -> None:
        """The thread. Whatever goes wrong is told once, and the rest is not fused."""
        try:
            with file:
                held: list[FusedBlock] = []
                for sensor, block in self._rows():
                    held += stream.push(sensor, block)
                    if held and held[-1].time[-1] - held[0].time[0] >= _WRITE_S * 1e9:
                        self._write(file, held)
                        held = []
                self._write(file, [*held, *stream.finish()])
        except Exception as error:  # whatever it is, the log goes on
            known = isinstance(error, ImuArrayError | OSError)
            self.failure = str(error) if known else f"{type(error).__name__}: {error}"
            self.tell(f"fusion ends, the log goes on: {self.failure}")
        finally:
            with suppress(queue.Empty):
                while True:
                    self._queue.get_nowait()

    def _rows(self) -> Iterable[tuple[str, Block]]:
        """What comes through the queue, until the end and until it is empty."""
        while True:
            try:
                yield self._queue.get(timeout=0.1)
            except queue.Empty:
                if self._ending.is_set():
                    return

    def _write(self, file: LiveFused, blocks: Sequence[FusedBlock]) -> None:
        if free_bytes(self.path) < 2 * WATERMARK:
            raise OSError(f"{self.path}: the disk is nearly full, what is left is the log's")
        if blocks:
            block = _joined(blocks)
            file.append(block)
            self.frames, self._latest = file.frames, block


def _joined(blocks: Sequence[FusedBlock]) -> FusedBlock:
    """Blocks one after the other."""
    columns: list[Mapping[str, np.ndarray]] = []
    for name in ("triads", "covariances", "used"):
        parts = [getattr(block, name) for block in blocks]
        columns.append({quantity: np.concatenate([part[quantity] for part in parts]) for quantity in parts[0]})
    triads, covariances, used = columns
    return FusedBlock(np.concatenate([block.time for block in blocks]), triads, covariances, used)
