"""How far an HDF5 file that is being written is good: a table in it with a row for every commit.

A row is written after its data are on the disk, and says: where the journal stood (position, CRC), the CRC of the rows
that this commit added, the number of rows of every group, and its own CRC, which goes on from the log's identity.
"""

from __future__ import annotations

import zlib
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import h5py
import numpy as np
import numpy.typing as npt

from imuarray.log.journal import Mark
from imuarray.log.layout import Group

COMMITS = "commits"
_FIXED = 3
_LONGEST_COMMIT = 1 << 30


class Commit(NamedTuple):
    """A state of the file: everything in the journal before `mark` is in it, as the first `rows` rows of its groups."""

    mark: Mark
    crc: int
    rows: tuple[int, ...]


def width(groups: Sequence[Group]) -> int:
    """Columns of the table."""
    return _FIXED + len(groups) + 1


def row_of(commit: Commit, identity: str) -> npt.NDArray[np.int64]:
    """A commit as a row of the table."""
    words = np.array([*commit.mark, commit.crc, *commit.rows], "<i8")
    return np.append(words, _own_crc(words, identity))


def read_commits(table: npt.NDArray[Any], identity: str, groups: Sequence[Group]) -> list[Commit]:
    """The commits up to the first row that is not whole, or that adds less than nothing or more than a block holds."""
    found: list[Commit] = []
    before: tuple[int, ...] = (0,) * len(groups)
    if table.ndim != 2 or table.shape[1] != width(groups) or table.dtype != np.dtype("<i8"):
        return found
    for row in table:
        if int(row[-1]) != _own_crc(row[:-1], identity):
            break
        position, chain, crc, *rows = row.tolist()[:-1]
        added = [(end - start) * group.row_bytes for start, end, group in zip(before, rows, groups, strict=True)]
        if min(added) < 0 or sum(added) > _LONGEST_COMMIT or position < 0:
            break
        before = tuple(rows)
        found.append(Commit(Mark(position, chain), crc, before))
    return found


def _own_crc(words: npt.NDArray[np.int64], identity: str) -> int:
    return zlib.crc32(words.tobytes(), zlib.crc32(identity.encode()))


def block_crc(groups: Sequence[Group], stretches: Mapping[int, Mapping[str, npt.NDArray[Any]]]) -> int:
    """The CRC of rows of several groups, by number."""
    crc = 0
    for number in sorted(stretches):
        for name, kind, _ in groups[number].columns:
            crc = zlib.crc32(np.ascontiguousarray(stretches[number][name], kind).data.cast("B"), crc)
    return crc


def stored_crc(file: h5py.File, groups: Sequence[Group], before: Sequence[int], commit: Commit) -> int:
    """The CRC of what the file holds of one commit; `before` are the rows of the commit before it."""
    stretches = {
        number: {name: file[group.path][name][start:end] for name, _, _ in group.columns}
        for number, (group, start, end) in enumerate(zip(groups, before, commit.rows, strict=True))
        if end > start
    }
    return block_crc(groups, stretches)
