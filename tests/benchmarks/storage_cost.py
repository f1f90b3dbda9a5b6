"""What a frame of ten sensors costs in the log: CPU time beside h5py frame by frame, bytes beside the bare columns.

Ours is the whole path, from decoded rows in blocks of a second through queue, journal, syncs, live file, compression
and its check to the finished file. The peers write every frame as it comes, uncompressed and not crash-safe: one into
the same columns, one, the cheapest way there is with h5py, into a single table of a time and thirty counts.
"""

from __future__ import annotations

import tempfile
import time
from pathlib import Path

import h5py
import numpy as np
from compare import Row, row

from imuarray.log import Block, LogWriter, open_log
from imuarray.log.format import SensorHeader

FRAMES = 100_000
PEER_FRAMES = 1_000
RATE_HZ = 50
CHUNK = 1024

ACCELEROMETERS = [
    SensorHeader(f"A{number}", "bma180", "specific_force", "g", 16.0, 512.0, 2400.0, 150.0) for number in range(6)
]
GYROSCOPES = [
    SensorHeader(f"G{number}", "l3g4200d", "angular_rate", "dps", 250.0, 114.3, 800.0, 110.0, has_temperature=True)
    for number in range(4)
]
SENSORS = (*ACCELEROMETERS, *GYROSCOPES)


def sensor_rows(header: SensorHeader, seed: int) -> Block:
    """Rest: scatter of 1.2 counts (BMA180, 150 ug/sqrt(Hz) at 150 Hz: BMA-110) or 36 (L3G4200D, 0.03 dps/sqrt(Hz) at
    110 Hz: L3G-74), temperature in steps, bursts that start some microseconds early or late.
    """
    draw = np.random.default_rng(seed)
    scatter = 36.0 if header.has_temperature else 1.2
    at = (np.arange(FRAMES) * (1_000_000_000 // RATE_HZ)) + seed * 230_000 + draw.integers(0, 20_000, FRAMES)
    counts = np.rint(draw.normal([3.0, -7.0, 512.0], scatter, (FRAMES, 3))).astype(np.int16)
    temperature = (np.arange(FRAMES) // 5000).astype(np.int16) if header.has_temperature else None
    return Block(at, counts, np.zeros(FRAMES, np.uint16), temperature)


def ours(folder: Path, blocks: list[Block]) -> tuple[float, int, int]:
    """CPU seconds a frame, bytes of the live file at its end, bytes of the finished file."""
    path = folder / "run.h5"
    start = time.process_time()
    with LogWriter(path, SENSORS, source="simulated", epoch="2000-01-01T00:00:00Z", watermark=0) as log:
        log.keep()
        for first in range(0, FRAMES, RATE_HZ):
            part = slice(first, first + RATE_HZ)
            for header, block in zip(SENSORS, blocks, strict=True):
                temperature = None if block.temperature_counts is None else block.temperature_counts[part]
                log.append(header.name, Block(block.time[part], block.counts[part], block.status[part], temperature))
        log.flush()
        live = path.stat().st_size
    spent = time.process_time() - start
    with open_log(path) as log:
        if [len(sensor) for sensor in log.sensors.values()] != [FRAMES] * len(SENSORS):
            raise RuntimeError("the log is not whole")
    return spent / FRAMES, live, path.stat().st_size


def same_columns(folder: Path, blocks: list[Block]) -> float:
    """CPU seconds a frame of the same columns, a row at a time."""
    with h5py.File(folder / "columns.h5", "w") as file:
        datasets = []
        for header, block in zip(SENSORS, blocks, strict=True):
            for name, column in (("time", block.time), ("counts", block.counts), ("status", block.status)):
                shape = column.shape[1:]
                made = file.create_dataset(
                    f"{header.name}/{name}", (0, *shape), column.dtype, maxshape=(None, *shape), chunks=(CHUNK, *shape)
                )
                datasets.append((made, column))
        start = time.process_time()
        for frame in range(PEER_FRAMES):
            for dataset, column in datasets:
                dataset.resize(frame + 1, axis=0)
                dataset[frame] = column[frame]
        return (time.process_time() - start) / PEER_FRAMES


def one_table(folder: Path, blocks: list[Block]) -> float:
    """CPU seconds a frame of a single table, a row at a time."""
    kind = np.dtype([("time", "<i8"), ("counts", "<i2", (len(SENSORS), 3))])
    rows = np.zeros(PEER_FRAMES, kind)
    rows["time"] = blocks[0].time[:PEER_FRAMES]
    rows["counts"] = np.stack([block.counts[:PEER_FRAMES] for block in blocks], axis=1)
    with h5py.File(folder / "table.h5", "w") as file:
        table = file.create_dataset("frames", (0,), kind, maxshape=(None,), chunks=(CHUNK,))
        start = time.process_time()
        for frame in range(PEER_FRAMES):
            table.resize(frame + 1, axis=0)
            table[frame] = rows[frame]
        return (time.process_time() - start) / PEER_FRAMES


def rows() -> list[Row]:
    """Microseconds of processor a frame, and bytes."""
    blocks = [sensor_rows(header, seed) for seed, header in enumerate(SENSORS)]
    columns = [column for block in blocks for column in block[:4] if column is not None]
    raw = sum(column.nbytes for column in columns)
    with tempfile.TemporaryDirectory() as name:
        spent, live, finished = ours(Path(name), blocks)
        by_columns, by_table = same_columns(Path(name), blocks), one_table(Path(name), blocks)
    text = "CPU a frame of 10 sensors, whole log path"
    return [
        row(f"{text}, against h5py frame by frame", spent * 1e6, by_columns * 1e6, "us a frame", 1 / 20, "lower"),
        row(f"{text}, against h5py, one bare table", spent * 1e6, by_table * 1e6, "us a frame", 1 / 5, "lower"),
        row("live file, against the bare columns", live / FRAMES, raw / FRAMES, "bytes a frame", 1.1, "lower"),
        row("finished file, against the bare columns", finished / FRAMES, raw / FRAMES, "bytes a frame", 0.55, "lower"),
    ]
