"""Reads a log that is being written, or whose writing was interrupted, as a complete log; nothing is changed.

Such a log is stored twice: in the HDF5 file up to its last commit, and in the journal. Both contain the preamble with
checksums, so each can replace what is damaged in the other. Attributes come from the preamble. Rows come from the HDF5
file, commit by commit, each checked before its rows are returned; rows of a damaged commit, and all rows after the last
commit, come from the journal. If HDF5 can't read its file at all, the whole log is rebuilt from the journal, in a
temporary file.
"""

from __future__ import annotations

import tempfile
import zlib
from collections.abc import Mapping
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import h5py
import numpy as np
import numpy.typing as npt

from imuarray.errors import LogError
from imuarray.log.columns import Column, LiveGroup
from imuarray.log.commits import COMMITS, CommittedRows, read_commits
from imuarray.log.format import PREAMBLE, PREAMBLE_CRC, TRACK_COLUMNS, Event, Phase, Preamble
from imuarray.log.hdf5_writer import Draft, log_attributes, sensor_attributes
from imuarray.log.inspection import UnclosedFile, inspect, is_marked_open, refuse_hostile
from imuarray.log.journal import NOTES, ColumnGroup, Columns, JournalReader, Notes, groups_of, journal_of
from imuarray.log.untrusted_input import DAMAGE

SENSORS = "sensors/"


class LiveView:
    """The whole log, which replaces an HDF5 file: its attributes and groups."""

    def __init__(self, file: h5py.File, journal: JournalReader | None, content: _Content) -> None:
        """Take ownership of the file and the journal: `close` closes both."""
        self._file, self._journal, self._committed = file, journal, content.committed
        self.preamble, self.losses = content.preamble, content.losses
        self.has_journal = journal is not None
        self.attrs = log_attributes(self.preamble)
        attributes = {SENSORS + header.name: sensor_attributes(header) for header in self.preamble.sensors}
        parts = {}
        for number, (group, tail) in enumerate(zip(groups_of(self.preamble.sensors), content.tail, strict=True)):
            columns = {name: _column(content.committed, number, group, name, tail[name]) for name in tail}
            parts[group.path] = LiveGroup(f"/{group.path}", attributes.get(group.path, {}), columns)
        notes = Notes()
        notes.add({"text": np.asarray(parts.pop(NOTES)["text"])})
        end_ns = max((int(part["time"][-1]) + 1 for part in parts.values() if len(part["time"])), default=0)
        tracks = {name: part for name in TRACK_COLUMNS if len((part := parts.pop(name))["time"])}
        self._items: dict[str, Any] = {
            "sensors": {path.removeprefix(SENSORS): parts[path] for path in sorted(parts)},
            "phases": _table(("start", "end", "name", "up"), notes.phases_until(end_ns)),
            "events": _table(("time", "sensor", "kind", "message"), notes.events),
            **tracks,
        }

    @property
    def damaged_commits(self) -> int:
        """Number of damaged commits of the HDF5 file so far, whose rows come from the journal."""
        return self._committed.damaged

    def get(self, name: str) -> Any:
        """Return a group; None if the log has none of that name."""
        return self._items.get(name)

    def __getitem__(self, name: str) -> Any:
        return self._items[name]

    def __bool__(self) -> bool:
        return bool(self._file)

    def close(self) -> None:
        """Close the files."""
        self._file.close()
        if self._journal is not None:
            self._journal.close()


class _Content(NamedTuple):
    """The content of file and journal together: committed rows, and the later rows of every group."""

    preamble: Preamble
    committed: CommittedRows
    tail: list[Columns]
    losses: tuple[str, ...]


def _column(committed: CommittedRows, number: int, group: ColumnGroup, name: str, tail: npt.NDArray[Any]) -> Column:
    stored = partial(committed.read, number, name)
    return Column(f"/{group.path}/{name}", tail, committed.rows[number], stored)


def _table(names: tuple[str, ...], rows: list[Phase] | list[Event]) -> dict[str, npt.NDArray[Any]]:
    """Return the columns of named tuples."""
    table = {name: np.empty(len(rows), object) for name in names}
    for index, row in enumerate(rows):
        for name, value in zip(names, row, strict=True):
            table[name][index] = value
    return table


class RebuiltFile(h5py.File):  # type: ignore[misc]  # h5py ships no types
    """A log that was rebuilt from its journal, in a temporary file that is already unlinked."""

    preamble: Preamble
    losses: tuple[str, ...]
    has_journal = True


def open_interrupted(
    path: Path, *, thorough: bool = False, journal_fd: int | None = None
) -> LiveView | RebuiltFile | None:
    """Return the view of an unfinished log at `path`; None if it is finished or no log; LogError.

    `thorough` checks every commit at once, as is always done if the journal is missing. `journal_fd` is the open
    journal, for callers that can't rely on its name; the log then counts as unfinished. If the writer finishes the log
    meanwhile (its journal is removed), the file is opened again.
    """
    with ExitStack() as opened:
        version = _version(path)
        file = _open(path)
        if file is not None:
            opened.callback(file.close)
        is_live, preamble = _marks(path, file)
        journal, failure = _journal(path, journal_fd, preamble)
        if journal is not None:
            opened.callback(journal.close)
        if file is not None and not is_live and journal_fd is None and (journal is None or _is_sound(path, file)):
            return None
        if preamble is not None and journal is not None and journal.preamble.identity != preamble.identity:
            journal.close()
            journal, failure = None, "belongs to another log"
        view = _view(path, file, preamble, journal, failure, thorough) if file is not None and is_live else None
        if view is not None:
            opened.pop_all()  # the view closes them
            return view
        if journal is not None:
            return rebuild(journal)
    if journal_fd is None and _version(path) != version:
        return open_interrupted(path, thorough=thorough)
    raise LogError(f"{path}: was not finished, and is damaged; its journal {failure}")


def _version(path: Path) -> tuple[int, int, int] | None:
    """Return a value that changes when the file is replaced or written to; None if there is no file."""
    try:
        status = path.stat()
    except OSError:
        return None
    return status.st_ino, status.st_size, status.st_mtime_ns


def _marks(path: Path, file: h5py.File | None) -> tuple[bool, Preamble | None]:
    """Return whether the file is that of an unfinished log, as far as HDF5 can tell, and the preamble in it."""
    try:
        is_live = file is not None and is_unfinished(file)
        return is_live, stored_preamble(path) if is_live else None
    except DAMAGE:
        return True, None


def _journal(path: Path, fd: int | None, known: Preamble | None) -> tuple[JournalReader | None, str]:
    """Open the journal of a log; return None and the reason if it can't be read."""
    try:
        return JournalReader(path, fd=fd, known=known), ""
    except FileNotFoundError:
        return None, "is missing"
    except (OSError, LogError):
        return None, "is damaged"


def _open(path: Path) -> h5py.File | None:
    """Open the HDF5 file; return None if HDF5 can't open it."""
    try:
        return h5py.File(UnclosedFile(path, check_heaps=False), "r")
    except DAMAGE:
        return None


def is_unfinished(file: h5py.File) -> bool:
    """Return whether a file was created as a growing log and never finished; a finished log has neither mark."""
    return PREAMBLE in file.attrs or file.get(COMMITS, getlink=True) is not None


def stored_preamble(path: Path) -> Preamble | None:
    """Return the preamble in the unfinished file at `path`; None if it is damaged or missing. On damage h5py may raise
    its own errors.

    Its heap of texts is checked before HDF5 reads it (`imuarray.log.inspection`).
    """
    with h5py.File(UnclosedFile(path), "r") as inspected:
        text = inspected.attrs.get(PREAMBLE)
        stored_crc = inspected.attrs.get(PREAMBLE_CRC)
    if not isinstance(text, str):
        return None
    if stored_crc is not None and stored_crc != zlib.crc32(text.encode()):  # logs of earlier versions have none
        return None
    try:
        return Preamble.from_json(text)
    except LogError:
        return None


def _is_sound(path: Path, file: h5py.File) -> bool:
    """Return whether a finished file can be read. If not, its journal, if it still exists, has all rows."""
    try:
        return not inspect(path, file)
    except LogError:
        return False


def may_be_unfinished(path: Path) -> bool:
    """Return whether a log should be opened as unfinished: it is marked so, it has a journal, or HDF5 can't open it."""
    try:
        return journal_of(path).is_file() if not path.is_file() else is_marked_open(path) or journal_of(path).is_file()
    except OSError:
        return False


def _view(
    path: Path,
    file: h5py.File,
    own_preamble: Preamble | None,
    journal: JournalReader | None,
    failure: str,
    thorough: bool,
) -> LiveView | None:
    """Combine the undamaged part of the file and the journal; without a journal, `failure` is the reason. None if the
    file is unusable.
    """
    preamble = own_preamble if journal is None else journal.preamble
    try:
        with h5py.File(UnclosedFile(path), "r") as inspected:
            refuse_hostile(file, inspected, str(path))
        if preamble is not None:
            return LiveView(file, journal, _content(path, file, preamble, journal, failure, thorough))
    except LogError:
        if journal is None:
            raise
    except DAMAGE:
        pass
    return None


def _content(
    path: Path, file: h5py.File, preamble: Preamble, journal: JournalReader | None, failure: str, thorough: bool
) -> _Content:
    groups = groups_of(preamble.sensors)
    for group in groups:
        for name, kind, shape in group.columns:
            dataset = file[group.path][name]
            if dataset.dtype != np.dtype(kind) or dataset.shape[1:] != shape:
                raise LogError(f"/{group.path}/{name}: differs from the preamble")
    commits = read_commits(file[COMMITS][:], preamble.identity, groups)
    committed = CommittedRows(file, groups, commits, journal)
    losses = committed.check() if thorough or journal is None else []
    if journal is None:
        tail: list[Columns] = [group.joined([]) for group in groups]
        losses.append(f"its journal {journal_of(path).name} {failure}: rows since the last commit are missing")
    else:
        mark = commits[-1].mark if commits else None
        tail = journal.columns(journal.records(mark, _newest_ns(groups, committed)))
        losses += journal.damage
    return _Content(preamble, committed, tail, tuple(losses))


def _newest_ns(groups: tuple[ColumnGroup, ...], committed: CommittedRows) -> Mapping[int, int]:
    """Return the last times of the sensors that have rows, by number."""
    counted = enumerate(zip(groups, committed.rows, strict=True))
    sensors = ((number, rows) for number, (group, rows) in counted if rows and group.path.startswith(SENSORS))
    newest = {}
    for number, rows in sensors:
        try:
            newest[number] = int(committed.read(number, "time", rows - 1, rows)[0])
        except OSError:  # damaged in both files: later rows can't be checked
            continue
    return newest


def rebuild(journal: JournalReader) -> RebuiltFile:
    """Rebuild the log that a journal holds, in a temporary file that is deleted when it is closed; LogError."""
    with tempfile.TemporaryDirectory(prefix="imuarray-") as folder:
        draft = Draft(Path(folder) / "rebuilt.h5", journal.preamble)
        try:
            for record in journal.records():
                draft.append(record.group, journal.groups[record.group].decode(record.payload, record.rows))
            draft.close()
            file = RebuiltFile(draft.part, "r")
            file.preamble, file.losses = journal.preamble, tuple(journal.damage)
            return file
        finally:
            draft.discard()
