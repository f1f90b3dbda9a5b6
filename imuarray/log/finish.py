"""The end of a log: what a reader sees of it is written, compressed, into a copy; the copy is compared with it, row by
row; then it takes the log's place and the journal goes. Whatever interrupts that, the log is there.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from imuarray.errors import LogError
from imuarray.log.draft import Draft
from imuarray.log.journal import JournalLock
from imuarray.log.layout import BESIDE, NOTES, Group, Notes, groups_of
from imuarray.log.reader import Log
from imuarray.log.room import reserve_of, sync_folder, unwritable

_ROWS = 1 << 16


class Recovered(NamedTuple):
    """A log that was finished: rows by sensor; `changed` is False if there was nothing to do."""

    rows: dict[str, int]
    changed: bool


def recover(path: Path, output: Path | None = None, progress: Callable[[int], None] = lambda rows: None) -> Recovered:
    """Finish the interrupted log at `path`, in its place or as `output`; LogBusyError, DiskFullError, LogError."""
    try:
        lock = JournalLock(path, create=False)
    except FileNotFoundError:
        lock = None
    try:
        with Log(path, thorough=True) as log:
            rows = {name: len(sensor) for name, sensor in log.sensors.items()}
            changed = log.preamble is not None
            if changed:
                _rewrite(log, output or path, progress)
        if output is None:
            _sweep(path, lock)
    finally:
        if lock is not None:
            lock.close()
    return Recovered(rows, changed)


def finish(path: Path, lock: JournalLock) -> None:
    """Finish the log at `path`, whose writer has closed it and holds its `lock`; DiskFullError, LogError."""
    with Log(path) as log:
        _rewrite(log, path, lambda rows: None)
    _sweep(path, lock)


def _rewrite(log: Log, target: Path, progress: Callable[[int], None]) -> None:
    """A finished copy of an unfinished log takes the name `target`, once it is known to be equal."""
    if log.preamble is None:
        raise LogError(f"{log.path}: is finished")
    draft = Draft(target, log.preamble, durable=True)
    try:
        done = 0
        for number, group in enumerate(draft.groups):
            for rows in _stretches(log, group):
                draft.append(number, rows)
                done += len(rows["time"])
                progress(done)
        draft.notes = Notes(list(log.phases), list(log.events))
        draft.close()
        with Log(draft.part) as copy:
            _compare(log, copy, groups_of(log.preamble.sensors))
        draft.publish(target)
        sync_folder(target)
    except OSError as error:
        draft.discard()
        raise unwritable(target, error) from None
    except BaseException:
        draft.discard()
        raise


def _columns(log: Log, group: Group) -> Mapping[str, Any] | None:
    """The stored columns of a group, None if the log hasn't got it."""
    if group.path in BESIDE:
        track = {"truth": log.truth, "reference": log.reference, "clocks": log.clocks}[group.path]
        return None if track is None else track._asdict()
    sensor = log[group.path.removeprefix("sensors/")]
    own: dict[str, Any] = {"time": sensor.time, "counts": sensor.counts, "status": sensor.status}
    own["temperature_counts"] = sensor.temperature_counts
    return {name: own[name] if name in own else sensor.compensated(name) for name, _, _ in group.columns}


def _stretches(log: Log, group: Group) -> Iterator[dict[str, Any]]:
    """The rows of a group, many at a time."""
    columns = None if group.path == NOTES else _columns(log, group)
    if columns is None:
        return
    for start in range(0, len(columns["time"]), _ROWS):
        yield {name: np.asarray(column[start : start + _ROWS]) for name, column in columns.items()}


def _compare(log: Log, copy: Log, groups: tuple[Group, ...]) -> None:
    """LogError unless the copy holds, bit by bit, what the log holds."""
    for group in groups:
        for ours, theirs in zip(_stretches(log, group), _stretches(copy, group), strict=True):
            if any(ours[name].tobytes() != theirs[name].tobytes() for name in ours):
                raise LogError(f"{log.path}: its finished copy differs in /{group.path}; the log is left as it was")
    if (log.phases, log.events) != (copy.phases, copy.events):
        raise LogError(f"{log.path}: its finished copy differs in phases or events; the log is left as it was")


def _sweep(path: Path, lock: JournalLock | None) -> None:
    """Remove what a finished log does not need: journal, reserve, and the copies of processes that are gone."""
    if lock is not None:
        lock.remove()
    reserve_of(path).unlink(missing_ok=True)
    for part in path.parent.glob(f".{path.name.replace('[', '[[]')}.*.part"):
        owner = part.name.removeprefix(f".{path.name}.").split(".")[0]
        if owner.isdigit() and not _is_alive(int(owner)):
            part.unlink(missing_ok=True)
    sync_folder(path)


def _is_alive(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except OSError:
        return True
    return True
