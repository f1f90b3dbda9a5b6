"""Finishing a log: its rows are copied into a compressed file, the copy is compared with the original row by row and
replaces it, and the journal is removed. The log remains complete if this is interrupted at any point.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Iterator, Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from imuarray.errors import DiskFullError, LogError
from imuarray.log.disk_space import reserve_of, sync_folder, unwritable
from imuarray.log.draft import Draft, sweep
from imuarray.log.format import Event
from imuarray.log.journal import JournalLock, JournalReader, journal_of
from imuarray.log.layout import NOTES, TRACK_COLUMNS, ColumnGroup, Notes, groups_of
from imuarray.log.reader import Log

_ROWS = 1 << 16
_UNCHANGED = "the log is unchanged"


class Recovery(NamedTuple):
    """The result of finishing a log: rows by sensor; `changed` is False if there was nothing to do. `kept` is the name
    of a journal that has unreadable data or belongs to another log.
    """

    rows: dict[str, int]
    changed: bool
    kept: str | None = None


def recover(
    path: Path,
    output: Path | None = None,
    progress: Callable[[int], None] = lambda rows: None,
    *,
    force: bool = False,
    now: datetime | None = None,
) -> Recovery:
    """Finish the interrupted log at `path`, in place or as `output`; a log that is already finished is copied to
    `output`.

    A log whose journal is missing is finished only with `force`. An event in the log records the time (`now`; None: the
    current time) and the number of rows. LogBusyError, DiskFullError, LogError.
    """
    try:
        lock = JournalLock(path, create=False)
    except FileNotFoundError:
        lock = None
    try:
        with Log(path, thorough=True) as log:
            rows = {name: len(sensor) for name, sensor in log.sensors.items()}
            changed, losses = log.preamble is not None, log.losses
            keep = bool(losses) if changed else not _is_journal_of(log)
            if changed:
                if not log.has_journal and not force:
                    raise LogError(
                        f"{path}: {losses[0]}; copy {path.name} and {journal_of(path).name} together, or use --force"
                        " to finish it without them"
                    )
                _rewrite(log, output or path, progress, (*_losses(log), _trace(log, now or datetime.now(UTC))))
        kept = _sweep(path, lock, keep=keep) if output is None else None
        if output is not None and not changed:
            _copy(path, output)
    finally:
        if lock is not None:
            lock.close()
    return Recovery(rows, changed, None if kept is None else kept.name)


def _is_journal_of(log: Log) -> bool:
    """Return whether the journal beside a finished log belongs to it (same epoch and sensors), because the process was
    killed just before it removed the journal.
    """
    try:
        with JournalReader(log.path) as journal:
            preamble = journal.preamble
    except FileNotFoundError:
        return True
    except (LogError, OSError):
        return journal_of(log.path).stat().st_size == 0
    return preamble.epoch == log.epoch and {header.name for header in preamble.sensors} == set(log.sensors)


def finish(path: Path, lock: JournalLock) -> None:
    """Finish the log at `path`, whose writer has closed it and holds its `lock`; DiskFullError, LogError."""
    with Log(path, journal_fd=lock.fd) as log:
        losses = log.losses
        _rewrite(log, path, lambda rows: None, _losses(log))
    _sweep(path, lock, keep=bool(losses))


def _end_ns(log: Log) -> int:
    """Return the time of the last row of all."""
    return max((int(sensor.time[-1]) for sensor in log.sensors.values() if len(sensor)), default=0)


def _losses(log: Log) -> tuple[Event, ...]:
    """Return an event for each loss of an unfinished log."""
    return tuple(Event(_end_ns(log), "", "damaged", loss) for loss in log.losses)


def _trace(log: Log, now: datetime) -> Event:
    """Return the event that says that the log was interrupted and recovered."""
    rows = sum(len(sensor) for sensor in log.sensors.values())
    when = now.astimezone(UTC).isoformat(timespec="seconds").replace("+00:00", "Z")
    return Event(_end_ns(log), "", "recovered", f"the log was interrupted; its {rows} rows were recovered {when}")


def _copy(path: Path, output: Path) -> None:
    """Copy a finished log to another name; LogError."""
    part = output.with_name(f".{output.name}.{os.getpid()}.part")
    try:
        shutil.copyfile(path, part)
        part.replace(output)
    except OSError as error:
        raise unwritable(output, error, _UNCHANGED) from None
    finally:
        part.unlink(missing_ok=True)
    sync_folder(output)


def _rewrite(log: Log, target: Path, progress: Callable[[int], None], added: tuple[Event, ...]) -> None:
    """Write a finished copy of an unfinished log with the events `added`, check that it is equal, and rename it to
    `target`.
    """
    if log.preamble is None:
        raise LogError(f"{log.path}: is finished")
    try:
        draft = Draft(target, log.preamble, durable=True)
    except DiskFullError as error:
        raise DiskFullError(target, error.why, _UNCHANGED) from None
    try:
        done = 0
        for number, group in enumerate(draft.groups):
            for rows in _stretches(log, group):
                draft.append(number, rows)
                done += len(rows["time"])
                progress(done)
        draft.notes = Notes(list(log.phases), [*log.events, *added])
        draft.close()
        with Log(draft.part) as copy:
            _compare(log, copy, groups_of(log.preamble.sensors), added)
        draft.publish(target)
        sync_folder(target)
    except DiskFullError as error:
        raise DiskFullError(target, error.why, _UNCHANGED) from None
    except OSError as error:
        raise unwritable(target, error, _UNCHANGED) from None
    finally:
        draft.discard()


def _columns(log: Log, group: ColumnGroup) -> Mapping[str, Any] | None:
    """Return the stored columns of a group; None if the log has no such group."""
    if group.path in TRACK_COLUMNS:
        track = {"truth": log.truth, "reference": log.reference, "clocks": log.clocks}[group.path]
        return None if track is None else track._asdict()
    sensor = log[group.path.removeprefix("sensors/")]
    own: dict[str, Any] = {"time": sensor.time, "counts": sensor.counts, "status": sensor.status}
    own["temperature_counts"] = sensor.temperature_counts
    return {name: own[name] if name in own else sensor.compensated(name) for name, _, _ in group.columns}


def _stretches(log: Log, group: ColumnGroup) -> Iterator[dict[str, Any]]:
    """Yield the rows of a group in large blocks."""
    columns = None if group.path == NOTES else _columns(log, group)
    if columns is None:
        return
    for start in range(0, len(columns["time"]), _ROWS):
        yield {name: np.asarray(column[start : start + _ROWS]) for name, column in columns.items()}


def _compare(log: Log, copy: Log, groups: tuple[ColumnGroup, ...], added: tuple[Event, ...]) -> None:
    """Raise LogError unless the copy has, bit by bit, the contents of the log and the events `added`."""
    for group in groups:
        for ours, theirs in zip(_stretches(log, group), _stretches(copy, group), strict=True):
            if any(ours[name].tobytes() != theirs[name].tobytes() for name in ours):
                raise LogError(f"{log.path}: its finished copy differs in /{group.path}; {_UNCHANGED}")
    if (log.phases, (*log.events, *added)) != (copy.phases, copy.events):
        raise LogError(f"{log.path}: its finished copy differs in phases or events; {_UNCHANGED}")


def _sweep(path: Path, lock: JournalLock | None, *, keep: bool) -> Path | None:
    """Remove the files that a finished log does not need: its journal (renamed instead, with `keep`), the reserve, and
    copies of terminated processes. Return the new name of the journal if it was renamed.
    """
    kept = None
    if lock is not None and keep:
        kept = lock.put_aside()
    elif lock is not None:
        lock.remove()
    reserve_of(path).unlink(missing_ok=True)
    sweep(path)
    sync_folder(path)
    return kept
