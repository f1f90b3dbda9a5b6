"""Rows that are identified by their number, a process that logs them, and a check of the rows in a log.

As a program: ``python -m tests.reliability.storage_rows FOLDER FRAMES BATCH CHUNK``. It writes `FOLDER/run.h5`, and
into `FOLDER/acknowledged` and `FOLDER/synced`, each time with one write, how many frames are.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

import imuarray.log.writer as writing
from imuarray.log import Block, Log, LogWriter, Stimulus
from imuarray.log.format import Event, SensorHeader

SENSORS = (
    SensorHeader("Acc", "bma180", "specific_force", "g", 16.0, 512.0, has_temperature=True),
    SensorHeader("Gyro", "l3g4200d", "angular_rate", "dps", 250.0, 114.3),
)
EPOCH = "2026-01-01T00:00:00.000000Z"
PERIOD_NS = 10_000_000
EVENT_EVERY = 50


def block(sensor: int, first: int, count: int) -> Block:
    """Rows `first` ... of a sensor; no two rows are alike, and none is zero."""
    return block_of(sensor, np.arange(first, first + count))


def block_of(sensor: int, row: npt.NDArray[np.int64]) -> Block:
    """The rows of a sensor with these numbers (n,)."""
    counts = (row[:, None] * 7919 + np.array([1, 12_345, 30_011]) + sensor * 97) % 65_521 - 32_760
    temperature = (row % 251 - 125).astype(np.int16) if SENSORS[sensor].has_temperature else None
    return Block((row + 1) * PERIOD_NS + sensor, counts.astype(np.int16), (row % 64).astype(np.uint16), temperature)


def stimulus(first: int, count: int) -> Stimulus:
    """Rows of `/truth`."""
    return stimulus_of(np.arange(first, first + count))


def stimulus_of(row: npt.NDArray[np.int64]) -> Stimulus:
    """The rows of `/truth` with these numbers (n,)."""
    triad = row[:, None] + np.array([1.0, 2.0, 3.0])
    return Stimulus((row + 1) * PERIOD_NS, triad, -triad, row + 0.5)


def record(
    path: Path,
    frames: int,
    batch: int,
    chunk: int,
    acknowledged: Callable[[int], Any] = lambda frames: None,
    synced: Callable[[int], Any] = lambda frames: None,
    **options: Any,
) -> None:
    """Log frames; the callbacks get the number of acknowledged rows, and every ten batches of those on the disk."""
    writing.CHUNK = chunk
    with LogWriter(path, SENSORS, source="simulated", epoch=EPOCH, sync_s=0.02, **options) as log:
        log.keep()
        for number, first in enumerate(range(0, frames, batch)):
            count = min(batch, frames - first)
            for at in range(first, first + count):
                if at % EVENT_EVERY == 0:
                    log.event(Event(at, "Acc", "note", f"event {at}"))
            log.stimulus("truth", stimulus(first, count))
            for sensor, header in enumerate(SENSORS):
                log.append(header.name, block(sensor, first, count))
            if number % 10 == 9:
                log.flush()
                synced(first + count)
            else:
                time.sleep(0.0003)
            acknowledged(min(log.acknowledged.values()))
        log.flush()
        synced(frames)


def wrong(path: Path) -> tuple[int, list[str]]:
    """The number of whole frames at the start of the log, and the differences from the written values: rows are known
    by their times; where some are missing before others, the log must report it. LogError if it can't be read.
    """
    problems, lengths = [], []
    with Log(path) as log:
        for sensor, header in enumerate(SENSORS):
            rows = log[header.name]
            number = (np.asarray(rows.time[:]) - sensor) // PERIOD_NS - 1
            lengths.append(_leading(number))
            expected = block_of(sensor, number)
            for name in ("time", "counts", "status", "temperature_counts"):
                column, good = getattr(rows, name), getattr(expected, name)
                if good is not None and not np.array_equal(np.asarray(column[:]), good):
                    problems.append(f"{header.name}.{name}")
            has_gap = lengths[-1] < len(number)
            if has_gap and not log.losses:
                problems.append(f"{header.name}: rows are missing, and the log does not say so")
        truth = log.truth
        if truth is not None:
            number = np.asarray(truth.time[:]) // PERIOD_NS - 1
            for name, good in stimulus_of(number)._asdict().items():
                if not np.array_equal(np.asarray(getattr(truth, name)[:]), good):
                    problems.append(f"truth.{name}")
            lengths.append(_leading(number))
        frames = min(lengths) if truth is not None else 0
        noted = [event.time_ns for event in log.events if event.kind not in ("damaged", "recovered")]
        written = [Event(first, "Acc", "note", f"event {first}") for first in noted]
        if [event for event in log.events if event.kind == "note"] != written or sorted(set(noted)) != noted:
            problems.append("events")
        if any(first % EVENT_EVERY for first in noted) or not set(range(0, frames, EVENT_EVERY)) <= set(noted):
            problems.append("events")
    return frames, problems


def _leading(number: npt.NDArray[np.int64]) -> int:
    """How many of these increasing row numbers (n,) are 0, 1, 2 ... without a gap."""
    gaps = np.flatnonzero(number != np.arange(len(number)))
    return int(gaps[0]) if len(gaps) else len(number)


def counter(path: Path) -> Callable[[int], int]:
    """A file to which numbers are added, 8 bytes each, by one write."""
    fd = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o644)
    return lambda frames: os.write(fd, frames.to_bytes(8, "little"))


def counts(path: Path) -> int:
    """How many numbers are in such a file."""
    return path.stat().st_size // 8 if path.exists() else 0


def counted(path: Path) -> int:
    """The last number in such a file; 0 if there is none."""
    content = path.read_bytes() if path.exists() else b""
    return int.from_bytes(content[len(content) // 8 * 8 - 8 :][:8], "little") if len(content) >= 8 else 0


if __name__ == "__main__":
    folder = Path(sys.argv[1])
    record(
        folder / "run.h5",
        *(int(number) for number in sys.argv[2:5]),
        acknowledged=counter(folder / "acknowledged"),
        synced=counter(folder / "synced"),
    )
