"""The journal of a log that is being written: blocks of rows in the order of their arrival, appended and never changed;
and the groups of equally long columns (`ColumnGroup`) whose rows it holds.

::

    "imuarray journal 2\\n"  length u32  preamble (JSON)  crc32 u32                         twice
    group u16  tag u16  rows u32  crc32 u32  rows of the group                            for each block

All little-endian. A block of rows is the columns of its group one after the other. The groups are those of the sensors
in their order, then those of `TRACK_COLUMNS`, then `notes` (phases and events, one line of JSON each, as bytes).

The CRC of each block continues from that of the previous one (the first from that of the preamble), so that stale data
after the last good block are rejected after a crash or a power cut. After damage in the middle, blocks are accepted
again from the position at which the chain continues in blocks with the tag of this log, which is derived from its
identity. Journals of earlier versions ("imuarray journal 1") have their preamble once, and the oldest have the tag 0;
they can also be read.
"""

from __future__ import annotations

import itertools
import json
import math
import os
import sys
import time
import zlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple, Self

import numpy as np
import numpy.typing as npt

from imuarray.arrays import Integers
from imuarray.errors import LogBusyError, LogError
from imuarray.log.format import SINGLE_PRECISION, TRACK_COLUMNS, ColumnTypes, Event, Phase, Preamble, SensorHeader
from imuarray.log.salvage import CRC, HEAD, LONGEST_BLOCK, Mark, Record, Salvage
from imuarray.log.untrusted_input import check_note
from imuarray.printable import encodable

if sys.platform != "win32":  # where logs can be read but not recorded
    import fcntl

MAGIC = b"imuarray journal 2\n"
MAGIC_1 = b"imuarray journal 1\n"
LONGEST_PREAMBLE = 1 << 24

_TRIES, _PAUSE_S = 20, 0.005
"""Number of attempts to lock a journal that readers hold for a moment, and the pause between them in s."""


Columns = Mapping[str, npt.NDArray[Any]]
"""The columns of a stretch of rows."""

NOTES = "notes"
_TEXT = "text"


@dataclass(frozen=True)
class ColumnGroup:
    """A group of equally long columns; each is (name, little-endian type, shape of a row)."""

    path: str
    columns: tuple[tuple[str, str, tuple[int, ...]], ...]

    @property
    def row_bytes(self) -> int:
        """The number of bytes of one row, all columns together."""
        return sum(np.dtype(kind).itemsize * math.prod(tail) for _, kind, tail in self.columns)

    def checked(self, columns: Columns) -> dict[str, npt.NDArray[Any]]:
        """Return the columns in order and converted to their types; ValueError unless names match and lengths agree."""
        names = {name for name, _, _ in self.columns}
        if columns.keys() != names or len({len(rows) for rows in columns.values()}) != 1:
            lengths = ", ".join(f"{name} {len(rows)}" for name, rows in columns.items())
            expected = ", ".join(name for name, _, _ in self.columns)
            raise ValueError(f"/{self.path}: columns {expected} of one length; got {lengths}")
        checked = {name: np.ascontiguousarray(columns[name], kind) for name, kind, _ in self.columns}
        for name, _, tail in self.columns:
            if checked[name].shape[1:] != tail:
                raise ValueError(f"/{self.path}: column {name}: rows of shape {tail}; got {checked[name].shape[1:]}")
        return checked

    def encode(self, columns: Columns) -> bytes:
        """Return `checked` columns as bytes."""
        return b"".join([columns[name].tobytes() for name, _, _ in self.columns])

    def decode(self, payload: bytes | memoryview, rows: int) -> dict[str, npt.NDArray[Any]]:
        """Return the columns of `rows` rows, without copying."""
        columns, start = {}, 0
        for name, kind, tail in self.columns:
            count = rows * math.prod(tail)
            columns[name] = np.frombuffer(payload, kind, count, start).reshape(rows, *tail)
            start += count * np.dtype(kind).itemsize
        return columns

    def joined(self, parts: Sequence[Columns]) -> dict[str, npt.NDArray[Any]]:
        """Concatenate blocks of columns; empty columns if there is none."""
        return {
            name: np.concatenate([np.empty((0, *tail), kind), *(part[name] for part in parts)])
            for name, kind, tail in self.columns
        }


def sensor_group(header: SensorHeader) -> ColumnGroup:
    """Return the columns of `/sensors/<NAME>`."""
    width = (len(header.columns),)
    counts = "<i2" if header.columns == ("x", "y", "z") and header.count_bits <= 16 else "<i4"
    columns: ColumnTypes = (("time", "<i8", ()), ("counts", counts, width), ("status", "<u2", ()))
    if header.has_temperature:
        columns += (("temperature_counts", "<i2", ()),)
    further = ((name, "<f4" if name in SINGLE_PRECISION else "<f8", ()) for name in header.compensated)
    return ColumnGroup(f"sensors/{header.name}", (*columns, *further))


def groups_of(sensors: Iterable[SensorHeader]) -> tuple[ColumnGroup, ...]:
    """Return all groups of a log with these sensors, in their order."""
    tracks = (ColumnGroup(name, columns) for name, columns in TRACK_COLUMNS.items())
    return (*(sensor_group(header) for header in sensors), *tracks, ColumnGroup(NOTES, ((_TEXT, "<u1", ()),)))


class OpenPhase(Phase):
    """A phase that has begun and whose end is not known yet; `end_ns` is the latest possible end."""


@dataclass
class Notes:
    """The phases and events of a log."""

    phases: list[Phase] = field(default_factory=list)
    events: list[Event] = field(default_factory=list)
    begun: list[OpenPhase] = field(default_factory=list)

    def add(self, columns: Columns) -> None:
        """Read rows of the group `notes`; LogError."""
        try:
            for line in np.asarray(columns[_TEXT], np.uint8).tobytes().decode("ascii").splitlines():
                ((kind, fields),) = json.loads(line).items()
                check_note(fields, 1 if kind == "event" else 2)
                if kind == "phase":
                    self.phases.append(Phase(*fields))
                elif kind == "event":
                    self.events.append(Event(*fields))
                else:
                    self.begun.append(OpenPhase(*fields))
        except (ValueError, TypeError, AttributeError, KeyError, RecursionError) as error:
            raise LogError(f"phases and events can't be read: {error}") from None

    def phases_until(self, end_ns: int) -> list[Phase]:
        """Return all phases of a log that ends at `end_ns`; a phase that was never ended lasts until then."""
        ended = {(phase.start_ns, phase.name) for phase in self.phases}
        open_ended = (begun for begun in self.begun if (begun.start_ns, begun.name) not in ended)
        unfinished = (Phase(*begun)._replace(end_ns=min(begun.end_ns, end_ns)) for begun in open_ended)
        return [*self.phases, *(phase for phase in unfinished if phase.end_ns > phase.start_ns)]


def note_columns(note: Phase | Event | OpenPhase) -> dict[str, npt.NDArray[np.uint8]]:
    """Return a note as rows of the group `notes`."""
    kind = "begun" if isinstance(note, OpenPhase) else "event" if isinstance(note, Event) else "phase"
    fields = [encodable(each) if isinstance(each, str) else each for each in note]
    line = json.dumps({kind: fields}, default=lambda number: number.item()) + "\n"
    return {_TEXT: np.frombuffer(line.encode("ascii"), np.uint8)}


def journal_of(path: Path) -> Path:
    """Return the path of the journal of the log at `path`."""
    return path.with_name(f"{path.name}.journal")


def tag_of(identity: str) -> int:
    """Return the tag of every block in the journal of a log with this identity."""
    return zlib.crc32(identity.encode()) & 0xFFFF or 1


def is_running(path: Path) -> bool:
    """Return whether a process is writing the log at `path` now."""
    try:
        fd = os.open(journal_of(path), os.O_RDONLY | os.O_CLOEXEC | getattr(os, "O_NONBLOCK", 0))
    except OSError:
        return False
    try:
        return not _try_lock(fd, exclusive=False)
    finally:
        os.close(fd)


def _lock_alone(fd: int) -> bool:
    """Lock an open file exclusively. `is_running` holds a shared lock for a moment; wait until it is released. Return
    False if another process holds an exclusive lock, or a shared lock for longer.
    """
    for _ in range(_TRIES):
        if _try_lock(fd, exclusive=True):
            return True
        if not _try_lock(fd, exclusive=False):
            return False
        _unlock(fd)
        time.sleep(_PAUSE_S)
    return False


def _unlock(fd: int) -> None:
    if sys.platform != "win32":
        fcntl.flock(fd, fcntl.LOCK_UN)


def _try_lock(fd: int, *, exclusive: bool) -> bool:
    """Lock an open file, shared or exclusively; return False if another process holds it."""
    if sys.platform == "win32":
        return True
    try:
        fcntl.flock(fd, (fcntl.LOCK_EX if exclusive else fcntl.LOCK_SH) | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True


class JournalLock:
    """The journal of one log, open and locked: no other process writes or recovers that log meanwhile."""

    def __init__(self, path: Path, *, create: bool) -> None:
        """Lock the journal. LogBusyError if another process has locked it; FileNotFoundError if it does not exist and
        must not be created.
        """
        self.path = journal_of(path)
        flags = os.O_RDWR | os.O_CLOEXEC | (os.O_CREAT if create else 0)
        while True:
            self.fd = os.open(self.path, flags, 0o644)
            if not _lock_alone(self.fd):
                os.close(self.fd)
                raise LogBusyError(path)
            if self.is_named:
                return
            os.close(self.fd)  # it was removed between opening and locking, because another process finished that log

    @property
    def is_named(self) -> bool:
        """True if the journal still has its name: another process may have removed or replaced it."""
        try:
            return os.path.samestat(os.fstat(self.fd), self.path.stat())
        except FileNotFoundError:
            return False

    def remove(self) -> None:
        """Remove the journal: the log is complete without it."""
        if self.is_named:
            self.path.unlink(missing_ok=True)

    def put_aside(self) -> Path | None:
        """Rename a journal that has unreadable data or belongs to another log to `RUN.h5.journal.damaged`, with a
        number appended if that name exists. Return the new name.
        """
        if not self.is_named:
            return None
        name = self.path.with_name(f"{self.path.name}.damaged")
        for number in itertools.count(2):
            if not name.exists():
                break
            name = self.path.with_name(f"{self.path.name}.damaged.{number}")
        self.path.replace(name)
        return name

    def close(self) -> None:
        """Release the lock and close the journal."""
        if self.fd >= 0:
            os.close(self.fd)
            self.fd = -1


class JournalWriter:
    """Appends blocks to a locked journal. `mark` is the position after the last block; all before it is written."""

    def __init__(self, fd: int, preamble: Preamble) -> None:
        """Start the journal with an empty file."""
        head = _head(preamble)
        crc = zlib.crc32(head)
        self._fd = fd
        self._tag = tag_of(preamble.identity)
        os.ftruncate(fd, 0)
        os.lseek(fd, 0, os.SEEK_SET)
        self.mark = Mark(0, 0)
        self._write((head + CRC.pack(crc)) * 2, crc)

    def append(self, blocks: Sequence[tuple[int, int, bytes]]) -> None:
        """Append blocks (group, rows, bytes); after an OSError the journal has none of them."""
        chain, parts = self.mark.chain, []
        for group, rows, payload in blocks:
            head = HEAD.pack(group, self._tag, rows)
            chain = zlib.crc32(payload, zlib.crc32(head, chain))
            parts += [head, CRC.pack(chain), payload]
        self._write(b"".join(parts), chain)

    def _write(self, data: bytes, chain: int) -> None:
        rest = memoryview(data)
        try:
            while rest:
                rest = rest[os.write(self._fd, rest) :]
        except OSError:
            os.ftruncate(self._fd, self.mark.position)
            os.lseek(self._fd, self.mark.position, os.SEEK_SET)
            raise
        self.mark = Mark(self.mark.position + len(data), chain)

    def sync(self) -> None:
        """Wait until everything appended is on the disk."""
        getattr(os, "fdatasync", os.fsync)(self._fd)  # macOS has no fdatasync


class JournalReader:
    """An open journal; a context manager. `preamble` and `groups` are those with which it was created."""

    def __init__(self, path: Path, *, fd: int | None = None, known: Preamble | None = None) -> None:
        """Open the journal of the log at `path`, or read the open one `fd`; FileNotFoundError, LogError.

        `known` is the log's preamble from another source; it replaces a damaged one.
        """
        self.path = journal_of(path)
        if fd is None and self.path.exists() and not self.path.is_file():  # opening a pipe would wait for its writer
            raise LogError(f"{self.path}: is not a file")
        self._file: BinaryIO = self.path.open("rb") if fd is None else os.fdopen(os.dup(fd), "rb")
        try:
            self.preamble, self.start, version = self._read_preamble(known)
        except BaseException:
            self._file.close()
            raise
        self.groups: tuple[ColumnGroup, ...] = groups_of(self.preamble.sensors)
        self.damage: list[str] = []
        """The stretches that `records` skipped, one line each."""
        tag = tag_of(self.preamble.identity)
        self._tags = (tag,) if version == 2 else (tag, 0)

    def _read_preamble(self, known: Preamble | None) -> tuple[Preamble, Mark, int]:
        """Return the preamble, the position of the first block, and the version of the format."""
        fd = self._file.fileno()
        copy = _copy_at(fd, 0)
        if copy is None:
            second = os.pread(fd, 2 * LONGEST_PREAMBLE, 0).find(MAGIC, len(MAGIC))
            copy = None if second < 0 else _copy_at(fd, second)
        if copy is not None:
            return Preamble.from_json(copy.text), copy.blocks, copy.version
        start = os.pread(fd, len(MAGIC) + CRC.size, 0)
        if known is not None and len(start) == len(MAGIC) + CRC.size:
            head, version = _head(known), 1 if start.startswith(MAGIC_1) else 2
            return known, Mark(version * (len(head) + CRC.size), zlib.crc32(head)), version
        if start[: len(MAGIC)] not in (MAGIC, MAGIC_1) or len(start) < len(MAGIC) + CRC.size:
            raise LogError(f"{self.path}: not the journal of a log, or an empty one")
        raise LogError(f"{self.path}: the journal's beginning is damaged")

    def records(self, start: Mark | None = None, newest_ns: Mapping[int, int] | None = None) -> Iterator[Record]:
        """Yield the blocks from `start` (None: the beginning) to the last good one. Blocks that can't be read are
        skipped and reported in `damage`; the times of later blocks must be later than those before, and than
        `newest_ns` by group.
        """
        mark, newest = start or self.start, dict(newest_ns or {})
        salvage = Salvage(self._file.fileno(), [group.row_bytes for group in self.groups], self._tags)
        while True:
            for record in self._read_chain(mark):
                times = self._times(record)
                previous = newest.get(record.group, -(1 << 62))
                if self.damage and (np.diff(times, prepend=previous) <= 0).any():
                    self.damage.append(f"journal: damaged, or of another log, from byte {mark.position}")
                    return
                if len(times):
                    newest[record.group] = int(times[-1])
                mark = record.after
                yield record
            resumed = self._resume_after(mark, salvage)
            if resumed is None:
                return
            mark, restored = resumed
            if restored is not None:
                yield restored

    def columns(self, records: Iterable[Record]) -> list[Columns]:
        """Return the rows of blocks by group, in order; empty columns for groups without rows."""
        parts: list[list[Columns]] = [[] for _ in self.groups]
        for record in records:
            parts[record.group].append(self.groups[record.group].decode(record.payload, record.rows))
        return [group.joined(rows) for group, rows in zip(self.groups, parts, strict=True)]

    def between(self, start: Mark | None, end: Mark) -> list[Record]:
        """Return the blocks between two positions (None: from the beginning); LogError unless all of them are good."""
        mark, records = start or self.start, []
        for record in self._read_chain(mark):
            if record.after.position > end.position:
                break
            mark = record.after
            records.append(record)
        if mark != end:
            raise LogError(f"{self.path}: bytes {mark.position} to {end.position - 1} are damaged")
        return records

    def _times(self, record: Record) -> Integers:
        """Return the times of a sensor's block; none for other groups."""
        rows = record.rows if self.groups[record.group].path.startswith("sensors/") else 0
        return np.frombuffer(record.payload, "<i8", rows)

    def _resume_after(self, end: Mark, salvage: Salvage) -> tuple[Mark, Record | None] | None:
        """Return where good blocks resume after a bad one at `end`, and the bad block if it could be restored; None if
        no good block follows. Lost data are recorded in `damage`.
        """
        size = os.fstat(self._file.fileno()).st_size
        if size <= end.position:
            return None
        if salvage.is_good(end):  # the writer has completed it only now
            return end, None
        resumed = salvage.resume(end)
        if resumed is not None:
            mark, restored = resumed
            if restored is None:
                self._note(end.position, mark.position, salvage)
            return resumed
        last = salvage.last(end)
        if last is not None:
            return last.after, last
        if salvage.is_torn(end.position):
            return None
        if salvage.is_good(end):
            return end, None
        self._note(end.position, size, salvage)
        return None

    def _note(self, start: int, end: int, salvage: Salvage) -> None:
        """Record that rows between two positions are lost."""
        hole = salvage.has_hole(start, end)
        cause = "were not on the disk at a power cut, or are damaged" if hole else "are damaged"
        rest = "; not all of the journal could be searched for more" if salvage.is_spent else ""
        self.damage.append(f"journal: bytes {start} to {end - 1} {cause}, rows are lost{rest}")

    def _read_chain(self, start: Mark) -> Iterator[Record]:
        """Yield the blocks from `start` to the first that is not good."""
        position, chain = start
        self._file.seek(position)
        while len(head := self._file.read(HEAD.size + CRC.size)) == HEAD.size + CRC.size:
            group, tag, rows = HEAD.unpack_from(head)
            if tag not in self._tags or not rows or group >= len(self.groups):
                return
            expected = rows * self.groups[group].row_bytes
            if expected > min(LONGEST_BLOCK, os.fstat(self._file.fileno()).st_size - self._file.tell()):
                return
            payload = self._file.read(expected)
            chain = zlib.crc32(payload, zlib.crc32(head[: HEAD.size], chain))
            if len(payload) < expected or head[HEAD.size :] != CRC.pack(chain):
                return
            position += len(head) + len(payload)
            yield Record(group, rows, payload, Mark(position, chain))
            self._file.seek(position)

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()


def _head(preamble: Preamble) -> bytes:
    """Return the beginning of a journal, without its checksum."""
    text = preamble.to_json().encode("ascii")
    return MAGIC + CRC.pack(len(text)) + text


class _Copy(NamedTuple):
    """An undamaged copy of the preamble: its text, the position of the first block, and the version of the format."""

    text: bytes
    blocks: Mark
    version: int


def _copy_at(fd: int, position: int) -> _Copy | None:
    """Return the copy of the preamble at byte `position` of a journal; None if it is damaged or missing."""
    start = os.pread(fd, len(MAGIC) + CRC.size, position)
    magic = start[: len(MAGIC)]
    if magic not in (MAGIC, MAGIC_1) or len(start) < len(MAGIC) + CRC.size:
        return None
    (length,) = CRC.unpack_from(start, len(MAGIC))
    if length > LONGEST_PREAMBLE:
        return None
    text = os.pread(fd, length, position + len(start))
    crc = zlib.crc32(start + text)
    end = position + len(start) + length + CRC.size
    if os.pread(fd, CRC.size, end - CRC.size) != CRC.pack(crc):
        return None
    version = 2 if magic == MAGIC else 1
    return _Copy(text, Mark(2 * end if version == 2 and position == 0 else end, crc), version)
