"""A log that is being written, or whose writing was cut short, looked at as if it were whole; nothing is changed.

Its rows are those that the HDF5 file has up to its last good commit, and behind them what the journal holds since.
Where the HDF5 file itself was damaged, all of it is made again from the journal, in a temporary file.
"""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple, cast

import h5py
import numpy as np
import numpy.typing as npt

from imuarray.errors import LogError
from imuarray.log.column import Column, LiveGroup
from imuarray.log.commits import COMMITS, Commit, read_commits, stored_crc
from imuarray.log.draft import Draft
from imuarray.log.format import Event, Phase
from imuarray.log.guard import DAMAGE
from imuarray.log.inspection import refuse_hostile
from imuarray.log.journal import JournalReader, journal_of
from imuarray.log.layout import BESIDE, NOTES, Columns, Group, Notes, groups_of
from imuarray.log.live import PREAMBLE
from imuarray.log.preamble import Preamble
from imuarray.log.unclosed import Unclosed, says_unclosed


class LiveView:
    """The whole log, in the place of an HDF5 file: its attributes and groups."""

    def __init__(self, file: h5py.File, tail: _Tail) -> None:
        self._file = file
        self.attrs = file.attrs
        self.preamble = tail.preamble
        self.losses = tail.losses
        self.has_journal = tail.has_journal
        parts = {}
        for group, rows, columns in zip(groups_of(tail.preamble.sensors), tail.rows, tail.columns, strict=True):
            parts[group.path] = _joined(file[group.path], group, rows, columns)
        notes = Notes()
        notes.add({"text": np.asarray(parts.pop(NOTES)["text"])})
        end_ns = max((int(part["time"][-1]) + 1 for part in parts.values() if len(part["time"])), default=0)
        beside = {name: part for name in BESIDE if len((part := parts.pop(name))["time"])}
        self._items: dict[str, Any] = {
            "sensors": {path.removeprefix("sensors/"): parts[path] for path in sorted(parts)},
            "phases": _table(("start", "end", "name", "up"), notes.phases_until(end_ns)),
            "events": _table(("time", "sensor", "kind", "message"), notes.events),
            **beside,
        }

    def get(self, name: str) -> Any:
        """A part, None if the log has none of that name."""
        return self._items.get(name)

    def __getitem__(self, name: str) -> Any:
        return self._items[name]

    def __bool__(self) -> bool:
        return bool(self._file)

    def close(self) -> None:
        """Close the file."""
        self._file.close()


class _Tail(NamedTuple):
    """What the journal adds to a file that is good for `rows`."""

    preamble: Preamble
    rows: tuple[int, ...]
    columns: list[Mapping[str, npt.NDArray[Any]]]
    losses: tuple[str, ...]
    has_journal: bool


def _joined(group: h5py.Group, layout: Group, rows: int, tail: Columns) -> LiveGroup:
    """A group's rows in the file, and behind them those of the journal; LogError."""
    for name, kind, shape in layout.columns:
        dataset = group[name]
        if dataset.dtype != np.dtype(kind) or dataset.shape[1:] != shape or len(dataset) < rows:
            raise LogError(f"{group.name}/{name}: not as the preamble says")
    return LiveGroup(group, {name: Column(group[name], rows, tail[name]) for name, _, _ in layout.columns})


def _table(names: tuple[str, ...], rows: list[Phase] | list[Event]) -> dict[str, npt.NDArray[Any]]:
    """Columns of named tuples."""
    table = {name: np.empty(len(rows), object) for name in names}
    for index, row in enumerate(rows):
        for name, value in zip(names, row, strict=True):
            table[name][index] = value
    return table


class Rebuilt(h5py.File):  # type: ignore[misc]  # h5py ships no types
    """A log made again from its journal, in a file that has no name any more."""

    preamble: Preamble
    losses: tuple[str, ...]
    has_journal = True


def open_interrupted(path: Path, *, thorough: bool = False) -> LiveView | Rebuilt | None:
    """The view of an unfinished log at `path`, None if it is none; LogError.

    `thorough` looks at every commit, not only at the last: all of the file is read.
    """
    journal, why = _journal(path)
    file = _open(path)
    try:
        if file is not None and not _is_live(file):
            file.close()
            return None
        view = None if file is None else _view(path, file, journal, why, thorough)
        if view is None and journal is None:
            raise LogError(f"{path}: was not finished, and is damaged; its journal is missing or damaged too")
        return view or rebuilt(cast(JournalReader, journal))
    finally:
        if journal is not None:
            journal.close()


def _journal(path: Path) -> tuple[JournalReader | None, str]:
    """The journal of a log, None and why if it can't be had."""
    try:
        return JournalReader(path), ""
    except FileNotFoundError:
        return None, "is missing"
    except (OSError, LogError):
        return None, "is damaged"


def _open(path: Path) -> h5py.File | None:
    """The HDF5 file, None if HDF5 can't open it."""
    try:
        return h5py.File(Unclosed(path, looks=False), "r")
    except DAMAGE:
        return None


def _is_live(file: h5py.File) -> bool:
    """Whether a file was begun as one that grows."""
    return PREAMBLE in file.attrs and isinstance(file.get(COMMITS, getlink=True), h5py.HardLink)


def may_be_unfinished(path: Path) -> bool:
    """Whether a log should be looked at so: it says so, it has a journal, or HDF5 can't open it."""
    try:
        return journal_of(path).is_file() if not path.is_file() else says_unclosed(path) or journal_of(path).is_file()
    except OSError:
        return False


def _view(path: Path, file: h5py.File, journal: JournalReader | None, why: str, thorough: bool) -> LiveView | None:
    """The file as far as it is good, and the journal from there on (or `why` there is none); else None, and the file is
    closed.
    """
    view = None
    try:
        with h5py.File(Unclosed(path), "r") as inspected:
            refuse_hostile(file, inspected, str(path))
        tail = _tail(path, file, journal, why, thorough)
        view = None if tail is None else LiveView(file, tail)
    except LogError:
        if journal is None:
            raise
    except DAMAGE:
        pass
    finally:
        if view is None:
            file.close()
    return view


def _tail(path: Path, file: h5py.File, journal: JournalReader | None, why: str, thorough: bool) -> _Tail | None:
    """How far the file is good, and what is in the journal behind that; None where the journal alone is better."""
    preamble = Preamble.from_json(str(file.attrs[PREAMBLE]))
    if journal is not None and journal.preamble != preamble:
        journal, why = None, "is another log's"
    groups = groups_of(preamble.sensors)
    commits = read_commits(file[COMMITS][:], preamble.identity, groups)
    good = _good(file, groups, commits, thorough)
    if good < len(file[COMMITS]) and journal is not None and (thorough or good == 0):
        return None
    rows = commits[good - 1].rows if good else (0,) * len(groups)
    parts: list[list[Columns]] = [[] for _ in groups]
    losses = [f"its journal {journal_of(path).name} {why}: rows since the last commit are not here"]
    if journal is not None:
        for record in journal.records(commits[good - 1].mark if good else None, _newest_ns(file, groups, rows)):
            parts[record.group].append(groups[record.group].decode(record.payload, record.rows))
        losses = journal.damage
    joined: list[Columns] = [group.joined(some) for group, some in zip(groups, parts, strict=True)]
    return _Tail(preamble, rows, joined, tuple(losses), journal is not None)


def _newest_ns(file: h5py.File, groups: tuple[Group, ...], rows: tuple[int, ...]) -> dict[int, int]:
    """The last times of sensors that have that many rows, by number."""
    counted = zip(groups, rows, strict=True)
    times = ((number, group.path, count) for number, (group, count) in enumerate(counted) if count)
    return {number: int(file[path]["time"][count - 1]) for number, path, count in times if path.startswith("sensors/")}


def _good(file: h5py.File, groups: tuple[Group, ...], commits: list[Commit], thorough: bool) -> int:
    """How many commits can be relied upon: up to the last whose rows are as written, or, if thorough, those before the
    first whose rows aren't.
    """
    if thorough:
        bad = (index for index in range(len(commits)) if not _fits(file, groups, commits, index))
        return next(bad, len(commits))
    good = len(commits)
    while good and not _fits(file, groups, commits, good - 1):
        good -= 1
    return good


def _fits(file: h5py.File, groups: tuple[Group, ...], commits: list[Commit], index: int) -> bool:
    """Whether the rows of a commit are those that were written."""
    before = commits[index - 1].rows if index else (0,) * len(groups)
    try:
        return stored_crc(file, groups, before, commits[index]) == commits[index].crc
    except DAMAGE:
        return False


def rebuilt(journal: JournalReader) -> Rebuilt:
    """The log that a journal holds, made anew in a temporary file that is gone when it is closed; LogError."""
    with tempfile.TemporaryDirectory(prefix="imuarray-") as folder:
        draft = Draft(Path(folder) / "rebuilt.h5", journal.preamble)
        try:
            for record in journal.records():
                draft.append(record.group, journal.groups[record.group].decode(record.payload, record.rows))
            draft.close()
            file = Rebuilt(draft.part, "r")
            file.preamble, file.losses = journal.preamble, tuple(journal.damage)
            return file
        finally:
            draft.discard()
