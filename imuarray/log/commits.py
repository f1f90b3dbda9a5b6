"""The commit table of an HDF5 file that is being written: each row records up to where the file is complete.

A row is written after its data are on the disk. It holds the state of the journal (position, CRC), the CRC of the rows
that this commit added, the number of rows of every group, and its own CRC, which continues from the log's identity.
Rows are returned only after their commit was checked; rows of a damaged commit are read from the journal.
"""

from __future__ import annotations

import errno
import time
import zlib
from bisect import bisect_right
from collections import OrderedDict
from collections.abc import Mapping, Sequence
from itertools import pairwise, takewhile
from typing import Any, NamedTuple

import h5py
import numpy as np
import numpy.typing as npt

from imuarray.arrays import Integers
from imuarray.errors import LogError
from imuarray.log.journal import NOTES, ColumnGroup, Columns, JournalReader
from imuarray.log.salvage import Mark
from imuarray.log.untrusted_input import DAMAGE
from imuarray.printable import counted

COMMITS = "commits"
_FIXED = 3
_LONGEST_COMMIT = 1 << 30
_TRIES, _PAUSE_S = 3, 0.01
"""Number of attempts to read rows, and the pause between them in s: the writer may be changing the page of the file
that holds their position.
"""
_KEPT_REPLACEMENTS = 4
"""Number of commits whose rows from the journal stay in memory."""


class Commit(NamedTuple):
    """A state of the file: it contains everything in the journal before `mark`, as the first `rows` rows of its
    groups.

    `crc` is that of the rows that this commit added; None if the previous commit can't be read, because the range of
    these rows is then unknown.
    """

    mark: Mark
    crc: int | None
    rows: tuple[int, ...]


def width(groups: Sequence[ColumnGroup]) -> int:
    """Return the number of columns of the table."""
    return _FIXED + len(groups) + 1


def row_of(mark: Mark, crc: int, rows: Sequence[int], identity: str) -> Integers:
    """Return a commit as a row of the table."""
    words = np.array([*mark, crc, *rows], "<i8")
    return np.append(words, _own_crc(words, identity))


def read_commits(table: npt.NDArray[Any], identity: str, groups: Sequence[ColumnGroup]) -> list[Commit]:
    """Return the undamaged commits of the log with this identity, in order."""
    commits: list[Commit] = []
    if table.ndim != 2 or table.shape[1] != width(groups) or table.dtype != np.dtype("<i8"):
        return commits
    previous: tuple[int, ...] = (0,) * len(groups)
    follows = True
    for row in table:
        position, chain, crc, *rows = row.tolist()[:-1]
        added = [(end - start) * group.row_bytes for start, end, group in zip(previous, rows, groups, strict=True)]
        is_whole = int(row[-1]) == _own_crc(row[:-1], identity)
        if not is_whole or min(added) < 0 or sum(added) > _LONGEST_COMMIT or position < 0:
            follows = False
            continue
        previous = tuple(rows)
        commits.append(Commit(Mark(position, chain), crc if follows else None, previous))
        follows = True
    return commits


def _own_crc(words: Integers, identity: str) -> int:
    return zlib.crc32(words.tobytes(), zlib.crc32(identity.encode()))


def block_crc(groups: Sequence[ColumnGroup], stretches: Mapping[int, Mapping[str, npt.NDArray[Any]]]) -> int:
    """Return the CRC of rows of several groups, by number."""
    crc = 0
    for number in sorted(stretches):
        for name, kind, _ in groups[number].columns:
            crc = zlib.crc32(np.ascontiguousarray(stretches[number][name], kind).data.cast("B"), crc)
    return crc


class Segment(NamedTuple):
    """The rows that one commit added: its number, and the row counts of every group before and after it."""

    number: int
    start: tuple[int, ...]
    end: tuple[int, ...]


class CommittedRows:
    """The rows of an unfinished HDF5 file; `rows` is their number in each group."""

    def __init__(
        self, file: h5py.File, groups: Sequence[ColumnGroup], commits: Sequence[Commit], journal: JournalReader | None
    ) -> None:
        """`journal` holds the same rows, if there is one; it must stay open as long as this object is used."""
        self._file, self._groups, self._commits, self._journal = file, groups, commits, journal
        zero = (0,) * len(groups)
        ends = [commit.rows for commit in commits]
        self._segments = [Segment(number, *rows) for number, rows in enumerate(pairwise([zero, *ends]))]
        self._columns: dict[tuple[int, str], h5py.Dataset] = {}
        self._is_good: dict[int, bool] = {}
        self._replacements: OrderedDict[int, list[Columns]] = OrderedDict()
        self._rest: dict[int, list[Columns]] = {}
        self._count()

    def _count(self) -> None:
        """Determine where the segments of each group begin and end."""
        table = np.cumsum([[0] * len(self._groups), *map(self._lengths, self._segments)], axis=0)
        self._edges: list[list[int]] = table.T.tolist()
        self.rows = tuple(edges[-1] for edges in self._edges)

    def _lengths(self, segment: Segment) -> list[int]:
        """Return the rows of each group in a segment, as far as they can be read."""
        if segment.number in self._rest:
            return [len(next(iter(columns.values()))) for columns in self._rest[segment.number]]
        return [end - start for start, end in zip(segment.start, segment.end, strict=True)]

    def check(self) -> list[str]:
        """Check every commit. Rows damaged both here and in the journal are reported, and omitted from now on."""
        lost_rows = np.zeros(len(self._groups), np.int64)
        for segment in self._segments:
            if not self._fits(segment) and self._replace(segment) is None:
                lost_rows += self._lengths(segment)
                self._rest[segment.number] = self._salvage(segment)
                lost_rows -= self._lengths(segment)
        self._count()
        counts = [
            f"{counted(rows, 'byte' if group.path == NOTES else 'row')} of {group.path}"
            for group, rows in zip(self._groups, lost_rows.tolist(), strict=True)
            if rows
        ]
        return [f"damaged, and not in the journal: {', '.join(counts)}"] if counts else []

    def _salvage(self, segment: Segment) -> list[Columns]:
        """Return the rows, by group, that the journal has of a commit that is damaged in both places."""
        if self._journal is None:
            return [group.joined([]) for group in self._groups]
        start, end = self._marks(segment)
        records = self._journal.records(start)
        return self._journal.columns(takewhile(lambda record: record.after.position <= end.position, records))

    def _marks(self, segment: Segment) -> tuple[Mark | None, Mark]:
        """Return the marks between which the journal has the rows of a commit."""
        start = self._commits[segment.number - 1].mark if segment.number else None
        return start, self._commits[segment.number].mark

    @property
    def damaged(self) -> int:
        """The number of commits that were damaged so far."""
        return sum(not good for good in self._is_good.values())

    def read(self, number: int, name: str, start: int, stop: int) -> npt.NDArray[Any]:
        """Return the rows `start` to `stop` of a column of the group of this number; OSError if they are damaged."""
        kind, tail = next((kind, tail) for column, kind, tail in self._groups[number].columns if column == name)
        pieces: list[npt.NDArray[Any]] = [np.empty((0, *tail), kind)]
        edges = self._edges[number]
        position = start
        while position < stop:
            index = bisect_right(edges, position) - 1
            segment, offset = self._segments[index], position - edges[index]
            count = min(stop, edges[index + 1]) - position
            if self._fits(segment):
                first = segment.start[number] + offset
                pieces.append(self._read_stored(number, name, first, first + count))
            else:
                replaced = self._replace(segment)
                if replaced is None:
                    raise OSError(errno.EBADMSG, "rows are damaged, and the journal does not have them")
                pieces.append(replaced[number][name][offset : offset + count])
            position += count
        return pieces[1] if len(pieces) == 2 else np.concatenate(pieces)

    def _read_stored(self, number: int, name: str, start: int, stop: int) -> npt.NDArray[Any]:
        """Return rows of the file, as stored."""
        if (number, name) not in self._columns:  # HDF5 takes longer to open a column than to read a commit's rows
            self._columns[number, name] = self._file[self._groups[number].path][name]
        column = self._columns[number, name]
        for _ in range(_TRIES - 1):
            try:
                return np.asarray(column[start:stop])
            except OSError:
                time.sleep(_PAUSE_S)
        return np.asarray(column[start:stop])

    def _fits(self, segment: Segment) -> bool:
        """Return whether the rows of a commit are undamaged."""
        if segment.number not in self._is_good:
            try:
                crc = self._commits[segment.number].crc
                self._is_good[segment.number] = crc is not None and self._crc(segment) == crc
            except DAMAGE:
                self._is_good[segment.number] = False
        return self._is_good[segment.number]

    def _crc(self, segment: Segment) -> int:
        stretches = {
            number: {name: self._read_stored(number, name, start, end) for name, _, _ in group.columns}
            for number, (group, start, end) in enumerate(zip(self._groups, segment.start, segment.end, strict=True))
            if end > start
        }
        return block_crc(self._groups, stretches)

    def _replace(self, segment: Segment) -> list[Columns] | None:
        """Return the rows of a commit from the journal, by group; None if the journal lacks some of them, unless
        `check` has accepted the loss.
        """
        if segment.number in self._rest:
            return self._rest[segment.number]
        if self._journal is None:
            return None
        if segment.number not in self._replacements:
            try:
                rows = self._journal.columns(self._journal.between(*self._marks(segment)))
            except (LogError, OSError):
                return None
            lengths = [len(next(iter(columns.values()))) for columns in rows]
            if lengths != self._lengths(segment):
                return None
            self._replacements[segment.number] = rows
            if len(self._replacements) > _KEPT_REPLACEMENTS:
                self._replacements.popitem(last=False)
        self._replacements.move_to_end(segment.number)
        return self._replacements[segment.number]
