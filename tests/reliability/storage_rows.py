"""Rows that can be told from any others by their number, a process that logs them, and a look at what is left of them.

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

import imuarray.log.writer as writing
from imuarray.log import Block, LogWriter, Stimulus, open_log
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
    row = np.arange(first, first + count)
    counts = (row[:, None] * 7919 + np.array([1, 12_345, 30_011]) + sensor * 97) % 65_521 - 32_760
    temperature = (row % 251 - 125).astype(np.int16) if SENSORS[sensor].has_temperature else None
    return Block((row + 1) * PERIOD_NS + sensor, counts.astype(np.int16), (row % 64).astype(np.uint16), temperature)


def stimulus(first: int, count: int) -> Stimulus:
    """Rows of `/truth`."""
    row = np.arange(first, first + count, dtype=float)
    triad = row[:, None] + [1, 2, 3]
    return Stimulus((np.arange(first, first + count) + 1) * PERIOD_NS, triad, -triad, row + 0.5)


def record(
    path: Path,
    frames: int,
    batch: int,
    chunk: int,
    acknowledged: Callable[[int], Any] = lambda frames: None,
    synced: Callable[[int], Any] = lambda frames: None,
    **options: Any,
) -> None:
    """Log frames; the callbacks hear how many are acknowledged, and every ten batches how many are on the disk."""
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
    """How many whole frames the log holds, and what in it is not as it was written. LogError if it can't be read."""
    problems = []
    with open_log(path) as log:
        for sensor, header in enumerate(SENSORS):
            rows = log[header.name]
            expected = block(sensor, 0, len(rows))
            for name in ("time", "counts", "status", "temperature_counts"):
                column, good = getattr(rows, name), getattr(expected, name)
                if good is not None and not np.array_equal(np.asarray(column[:]), good):
                    problems.append(f"{header.name}.{name}")
        truth = log.truth
        length = 0 if truth is None else len(truth.time)
        if truth is not None:
            for name, good in stimulus(0, length)._asdict().items():
                if not np.array_equal(np.asarray(getattr(truth, name)[:]), good):
                    problems.append(f"truth.{name}")
        frames = min(length, *(len(sensor) for sensor in log.sensors.values()))
        noted = [event for event in log.events if event.kind != "recovered"]
        events = [
            Event(first, "Acc", "note", f"event {first}") for first in range(0, len(noted) * EVENT_EVERY, EVENT_EVERY)
        ]
        if noted != events or frames > len(events) * EVENT_EVERY:
            problems.append("events")
    return frames, problems


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
