"""Monitors a log from outside: `LogMonitor(path).refresh(now_s)` returns a snapshot of it, at bounded cost.

It only reads, follows a log that is split into parts from one to the next, and starts again where another log takes the
name.
"""

from __future__ import annotations

import re
import time
from collections.abc import Callable
from dataclasses import replace
from itertools import count, takewhile
from pathlib import Path

from imuarray.calibrate import Calibration
from imuarray.errors import ImuArrayError, reason_of
from imuarray.log.journal import JournalReader, is_running
from imuarray.log.rotate import part_of
from imuarray.log.untrusted_input import DAMAGE
from imuarray.monitor.composition import snapshot_of
from imuarray.monitor.log_source import Growing, ReadRows, Source, Whole, look
from imuarray.monitor.snapshot import WAITING, WRITTEN, Snapshot

SPAN_S = 10.0
"""The last seconds that are shown."""


class LogMonitor:
    """The log at `path`, which need not be there yet, or of that name cut into parts; its last `span_s`. A context
    manager. `result` is where its fused output is written (None: `RUN_fused.h5` beside it).
    """

    def __init__(
        self,
        path: Path,
        *,
        span_s: float = SPAN_S,
        calibration: Calibration | None = None,
        result: Path | None = None,
        stopwatch: Callable[[], float] = time.perf_counter,
    ) -> None:
        self.path = path
        self._span_ns = round(span_s * 1e9)
        self._calibration, self._result = calibration or Calibration(), result
        self._stopwatch = stopwatch
        self._there: tuple[object, ...] = ()
        self._source: Source | None = None
        self._fresh_s = 0.0
        self._remark = ""

    def refresh(self, now_s: float) -> Snapshot:
        """Return the snapshot at `now_s`, a monotonic time. Errors of the log are its remark, not raised."""
        start_s = self._stopwatch()
        try:
            self._look(now_s)
            if self._source is not None:
                quiet_s = now_s - self._fresh_s
                snapshot = snapshot_of(self._source, self._calibration, self._remark, quiet_s, self._result)
                return replace(snapshot, took_s=self._stopwatch() - start_s)
        except ImuArrayError as error:
            self._remark = str(error)
            self.close()
        except DAMAGE as error:  # the file changes while it is read: it is looked at anew
            self._remark = f"{self.path}: {reason_of(error)}"
            self.close()
        return Snapshot(self.path, WAITING, self._remark)

    def _look(self, now_s: float) -> None:
        """Open the log if it exists, read new rows, continue with the next part."""
        source = self._source
        if source is None or (source.state != WRITTEN and look(source.path) != self._there):
            source = self._open(self._found() if source is None else source.path, now_s)
            if source is None:
                return
        written = source.state == WRITTEN
        rows = source.read()
        if not rows or source.state != WRITTEN:
            if written and source.state != WRITTEN and not is_running(source.path):
                self._there = look(source.path)
            source = self._turned(source, written)
        self._fresh_s = now_s if rows else self._fresh_s
        source.backlog.step({name: window.usual_ns for name, window in source.read_rows.windows.items()})

    def _found(self) -> Path:
        """The log, or where there is none of that name, its newest part that has begun."""
        if self.path.exists() or not self.path.parent.is_dir():
            return self.path
        pattern = re.compile(rf"{re.escape(self.path.stem)}_(\d{{3,}}){re.escape(self.path.suffix)}")
        names = (pattern.fullmatch(entry.name) for entry in self.path.parent.iterdir())
        numbers = sorted(int(name[1]) for name in names if name)
        parts = [part_of(self.path, number) for number in numbers]
        return next((part for part in reversed(parts) if _has_begun(part)), parts[-1] if parts else self.path)

    def _open(self, path: Path, now_s: float) -> Source | None:
        """Start anew with what is there; None if it is not there yet."""
        self.close()
        self._fresh_s = now_s
        if not path.exists():
            self._remark = f"{path}: not there yet"
            return None
        self._there, self._remark = look(path), ""
        self._source = _source(path, ReadRows(self._span_ns))
        return self._source

    def _turned(self, source: Source, followed: bool) -> Source:
        """The part in which the log goes on. One that was `followed` while it was written is followed on, whatever
        became of the next; what was seen goes on too, as long as no part is passed over.
        """
        parts = _parts_behind(source.path)
        if not parts or not (followed or is_running(parts[-1])):
            return source
        parts = [part for part in parts if _has_begun(part) and _epoch(part) == source.epoch]
        if not parts:
            return source
        goes_on = followed and is_running(parts[0])
        part = parts[0] if goes_on else parts[-1]
        self._there = look(part)
        for name, window in source.read_rows.windows.items():
            window.gaps += source.backlog.gaps(name)
        source.read()  # what came just before the next part began
        turned = _source(part, source.read_rows if goes_on else ReadRows(self._span_ns))
        source.close()
        self._source, self._remark = turned, f"goes on in {part.name}"
        turned.read()
        return turned

    def close(self) -> None:
        """Let go of the files."""
        if self._source is not None:
            self._source.close()
        self._source = None

    def __enter__(self) -> LogMonitor:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()


def _source(path: Path, read_rows: ReadRows) -> Source:
    return Growing(path, read_rows) if is_running(path) else Whole(path, read_rows)


def _parts_behind(path: Path) -> list[Path]:
    """The parts that are there behind this one, in order; none for what is no part."""
    match = re.fullmatch(r"(.+)_(\d{3,})", path.stem)
    if match is None:
        return []
    named = (part_of(path.with_stem(match[1]), number) for number in count(int(match[2]) + 1))
    return list(takewhile(Path.exists, named))


def _has_begun(path: Path) -> bool:
    """Return whether a log is there and has rows: the next part of one is begun seconds before it is required."""
    if not path.exists():
        return False
    if not is_running(path):
        return True
    with JournalReader(path) as journal:
        return any(journal.groups[record.group].path.startswith("sensors/") for record in journal.records())


def _epoch(path: Path) -> str:
    """The time 0 of a log."""
    if is_running(path):
        with JournalReader(path) as journal:
            return journal.preamble.epoch
    whole = Whole(path, ReadRows(0))
    whole.close()
    return whole.epoch
