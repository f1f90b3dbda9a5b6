"""Reads and checks every block of a log: checksums of chunks and commits, chunks that were never written, times."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from imuarray.errors import LogError
from imuarray.log.reader import Log
from imuarray.log.sensor_log import SensorLog
from imuarray.log.untrusted_input import DAMAGE
from imuarray.printable import counted

_ROWS = 1 << 16


class Verification(NamedTuple):
    """The result of a verification: `problems` are rows that can't be read or can't be right, `remarks` are defects
    that a reader corrects.
    """

    state: str
    rows: Mapping[str, int]
    problems: tuple[str, ...]
    remarks: tuple[str, ...]


def verify(path: Path, progress: Callable[[int], None] = lambda rows: None) -> Verification:
    """Read all of the log at `path`; `progress` gets the number of rows read. LogError if it can't be opened."""
    with Log(path, thorough=True) as log:
        problems = list(log.losses)
        done = 0
        for sensor in log.sensors.values():
            for read, complaints in _sensor(sensor):
                problems += complaints
                progress(done + read)
            done += len(sensor)
        for name in ("truth", "reference"):
            problems += _stimulus(log, name)
        for name in ("phases", "events"):
            try:
                getattr(log, name)
            except LogError as error:
                problems.append(str(error))
        rows = {name: len(sensor) for name, sensor in log.sensors.items()}
        return Verification(log.state, rows, tuple(problems), tuple(_remarks(log)))


def _sensor(sensor: SensorLog) -> Iterator[tuple[int, list[str]]]:
    """Read all rows of a sensor; yield the number of rows so far and the problems of the last block."""
    columns = {"time": sensor.time, "counts": sensor.counts, "status": sensor.status}
    if sensor.temperature_counts is not None:
        columns["temperature_counts"] = sensor.temperature_counts
    for name in ("temperature", "pressure") if sensor.quantity == "pressure" else ():
        if sensor.has_compensated(name) or sensor.counts.shape[1:] == (2,):  # one that was imported has no words
            columns[name] = sensor.compensated(name)
    place = f"sensor {sensor.name}"
    yield 0, [problem for name, column in columns.items() for problem in _holes(place, name, column)]
    last_ns = None
    for block in sensor.blocks(_ROWS):
        read, problems = _read(place, columns, block)
        if "time" in read:
            time = read["time"].astype(np.int64)
            before = time[:0] if last_ns is None else np.array([last_ns])
            late = np.flatnonzero(np.diff(np.concatenate([before, time])) <= 0)
            if len(late):
                problems.append(f"{place}: time does not increase after row {block.start + late[0] - len(before)}")
            last_ns = int(time[-1])
        yield block.stop, problems


def _stimulus(log: Log, name: str) -> list[str]:
    try:
        track = log.truth if name == "truth" else log.reference
    except LogError as error:
        return [str(error)]
    if track is None:
        return []
    columns = {column: dataset for column, dataset in track._asdict().items() if dataset is not None}
    problems = [problem for column, dataset in columns.items() for problem in _holes(name, column, dataset)]
    for start in range(0, len(track.time), _ROWS):
        problems += _read(name, columns, slice(start, min(start + _ROWS, len(track.time))))[1]
    return problems


def _read(place: str, columns: Mapping[str, Any], block: slice) -> tuple[dict[str, Any], list[str]]:
    """Read a block of all columns that can be read, and return complaints about the others."""
    read, problems = {}, []
    for name, column in columns.items():
        try:
            read[name] = np.asarray(column[block])
        except (LogError, *DAMAGE):
            problems.append(f"{place}: column {name}: rows {block.start} to {block.stop - 1} are damaged")
    return read, problems


def _holes(place: str, name: str, column: Any) -> list[str]:
    """Return a complaint if chunks are missing: HDF5 would return zeros for them without an error."""
    if not hasattr(column, "id") or column.chunks is None:  # zeros in place of none, or of a log that still grows
        return []
    try:
        wanted = int(np.prod([-(-length // chunk) for length, chunk in zip(column.shape, column.chunks, strict=True)]))
        missing = wanted - int(column.id.get_num_chunks())
    except DAMAGE:
        return [f"{place}: column {name}: its index of chunks is damaged"]
    return [f"{place}: column {name}: {missing} of {wanted} chunks were never written"] if missing > 0 else []


def _remarks(log: Log) -> Iterator[str]:
    if log.state == "interrupted":
        there = "" if log.losses else "; all that was acknowledged is there"
        yield f"it was not finished{there}: imuarray recover {log.path} finishes it"
    if log.damaged_commits:
        yield f"{counted(log.damaged_commits, 'commit')} of its HDF5 file damaged: those rows are read from its journal"
    if log.is_rebuilt:
        yield f"its HDF5 file is {'damaged' if log.path.exists() else 'gone'}: all rows are read from its journal"
