"""Inspects a file from an unknown source before anything in it is trusted.

Nothing in a log may lead outside it (links, external storage, virtual datasets, references), use a filter that would
have to be loaded, declare more data than the file can hold, or be reachable twice. Links, headers, declared sizes and
texts are inspected here; no numbers are read.

An HDF5 file that was never closed is opened for reading without changing it (`UnclosedFile`). Its superblock marks
it as open for writing, so HDF5 opens it only as a reader of a file with an active writer (SWMR). This reader waits for
damaged blocks to be repaired, each time twice as long; after a power cut no writer will repair them. HDF5 is
therefore given the file with that flag cleared and with its actual end: the superblock states the end at the last flush
of the whole file, and a chunk that was flushed alone may follow it.

Text heaps are validated before HDF5 reads them: texts of varying length are stored in global heaps, which have no check
sum. A damaged heap sends HDF5 (2.0 and earlier) into an endless loop, because an object of size 0 or of nearly 2^64
bytes leads back to its own position. The bytes are therefore read here first, and an inconsistent heap is reported as a
disk error.

One length is not checked here: that in the reference to a text (32 bits). HDF5 allocates memory of that length before
it notices that the text is shorter, and reports an error.
"""

from __future__ import annotations

import errno
import io
import os
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import groupby
from operator import attrgetter
from pathlib import Path
from typing import Any, NamedTuple

import h5py
import numpy as np
from h5py import h5a, h5d, h5fd, h5g, h5i, h5l, h5o, h5s, h5t, h5z

from imuarray.errors import LogError
from imuarray.log.format import FORMAT, MOST_SENSORS, PLOTS
from imuarray.log.untrusted_input import DAMAGE, MAX_TEXT_BYTES, TEXT, read_texts
from imuarray.printable import printable

_SIGN = b"GCOL"
_HEAD = 16
"""Bytes before the first object of a heap, and before the data of an object (HDF5 file format, III.E)."""
LONGEST = 1 << 24
"""Largest size of a heap in bytes. A heap holds the texts that fit into 4 KiB, or one longer text; the longest one is a
configuration.
"""


class HeapCheckedFile(io.RawIOBase):
    """The bytes of a file, for h5py's driver for Python files; OSError (EBADMSG) for an inconsistent heap."""

    def __init__(self, path: Path, *, check_heaps: bool = True) -> None:
        """Open the file. `check_heaps` must be off while numbers are read, because they may contain any bytes."""
        self._file = path.open("rb", buffering=0)
        self._check_heaps = check_heaps
        self._position = 0
        self._good: set[int] = set()

    def readable(self) -> bool:
        """Always True."""
        return True

    def seekable(self) -> bool:
        """Always True."""
        return True

    def seek(self, offset: int, whence: int = os.SEEK_SET, /) -> int:
        """Move or return the position, as of any file."""
        start = (0, self._position, os.fstat(self._file.fileno()).st_size)[whence]
        self._position = start + offset
        return self._position

    def tell(self) -> int:
        """Move or return the position, as of any file."""
        return self._position

    def readinto(self, buffer: Any, /) -> int:
        """Read bytes, and check the heaps among them."""
        view = memoryview(buffer).cast("B")
        count = os.preadv(self._file.fileno(), [view], self._position)
        if self._check_heaps:
            self._check(bytes(view[:count]))
        self._position += count
        return count

    def _check(self, data: bytes) -> None:
        """Check heaps that begin in these bytes or just before them, since HDF5 may read a heap in two pieces."""
        previous = os.pread(
            self._file.fileno(), min(self._position, len(_SIGN) - 1), max(self._position - len(_SIGN) + 1, 0)
        )
        data, start = previous + data, self._position - len(previous)
        offset = data.find(_SIGN)
        while offset >= 0:
            if start + offset not in self._good:
                if not _adds_up(self._file.fileno(), start + offset):
                    raise OSError(errno.EBADMSG, "a heap of texts is damaged")
                self._good.add(start + offset)
            offset = data.find(_SIGN, offset + 1)

    def close(self) -> None:
        """Close the file."""
        self._file.close()
        super().close()


def _adds_up(fd: int, position: int) -> bool:
    length = int.from_bytes(os.pread(fd, _HEAD, position)[8:], "little")
    if not _HEAD <= length <= LONGEST:
        return False
    heap = os.pread(fd, length, position)
    if len(heap) < length:
        return False
    place = _HEAD
    while length - place >= _HEAD:
        number = int.from_bytes(heap[place : place + 2], "little")
        size = int.from_bytes(heap[place + 8 : place + _HEAD], "little")
        if number == 0 and size < _HEAD:  # the size of free space includes its head
            return False
        place += size if number == 0 else _HEAD + -(-size // 8) * 8
    return place <= length


_SIGNATURE = b"\x89HDF\r\n\x1a\n"
_FLAGS = 11
_END = slice(28, 36)
_LENGTH = 44
"""Bytes of a superblock of version 3 with 8-byte addresses; its check sum follows (HDF5 file format, II.A)."""


def is_marked_open(path: Path) -> bool:
    """Return whether a file is marked as open for writing."""
    with path.open("rb") as file:
        head = file.read(_LENGTH)
    return _is_version_3(head) and head[_FLAGS] != 0


def _is_version_3(head: bytes) -> bool:
    return len(head) == _LENGTH and head[:8] == _SIGNATURE and head[8] == 3 and head[9] == 8


class UnclosedFile(HeapCheckedFile):
    """The bytes of a file, with the flags of its superblock cleared and its actual end, for h5py's "fileobj" driver."""

    def __init__(self, path: Path, *, check_heaps: bool = True) -> None:
        """`check_heaps` as of `HeapCheckedFile`."""
        super().__init__(path, check_heaps=check_heaps)
        head = os.pread(self._file.fileno(), _LENGTH + 4, 0)
        self._head = head
        if _is_version_3(head[:_LENGTH]) and head[_LENGTH:] == _checksum(head[:_LENGTH]):
            end = max(int.from_bytes(head[_END], "little"), os.fstat(self._file.fileno()).st_size)
            ended = head[_FLAGS + 1 : _END.start] + end.to_bytes(8, "little") + head[_END.stop : _LENGTH]
            cleared = head[:_FLAGS] + b"\0" + ended
            self._head = cleared + _checksum(cleared)

    def readinto(self, buffer: Any, /) -> int:
        """Read bytes; those of the superblock are the corrected ones."""
        position = self._position
        count = super().readinto(buffer)
        if position < len(self._head):
            piece = self._head[position : position + count]
            memoryview(buffer).cast("B")[: len(piece)] = piece
        return count


def _checksum(data: bytes) -> bytes:
    """Compute Bob Jenkins' lookup3 (hashlittle, public domain, 2006), with which HDF5 checks its metadata."""
    mask = 0xFFFFFFFF
    words = [int.from_bytes(data[start : start + 4], "little") for start in range(0, -(-len(data) // 12) * 12, 4)]
    a = b = c = (0xDEADBEEF + len(data)) & mask

    def turned(value: int, by: int) -> int:
        return ((value << by) | (value >> (32 - by))) & mask

    for start in range(0, len(words), 3):
        a, b, c = (a + words[start]) & mask, (b + words[start + 1]) & mask, (c + words[start + 2]) & mask
        if start + 3 == len(words):
            break
        for by in (4, 6, 8, 16, 19, 4):
            a = ((a - c) & mask) ^ turned(c, by)
            c = (c + b) & mask
            a, b, c = b, c, a
    for by in (14, 11, 25, 16, 4, 14, 24):
        c = ((c ^ b) - turned(b, by)) & mask
        a, b, c = b, c, a
    return b.to_bytes(4, "little")


MAX_DEPTH = 4
MAX_OBJECTS = 4096
"""Largest number of groups and datasets of a file: `MOST_SENSORS` with six each, their plots, and the tables."""
MAX_ATTRIBUTES = 256
MAX_ATTRIBUTE_BYTES = 1 << 22
"""Largest size in bytes of all attributes of a group or dataset together."""
MAX_TEXTS = 256
"""Largest number of texts in one attribute: several can refer to the same bytes, so each may be as long as the file."""
MAX_NAME_BYTES = 255
MAX_ITEM_BYTES = 1 << 16
MAX_RANK = 4
MAX_CHUNK_BYTES = 1 << 20
"""Largest size of a chunk in bytes, because HDF5 reads whole chunks; chunks of a log have less than a tenth of this."""
SLACK_BYTES = 1 << 24
"""Bytes of rows that an interrupted log may have declared but not yet written."""
MOST_DEFLATED = 1032
"""Highest ratio of zlib's compression (RFC 1951: 258 bytes in two bits)."""

_PACKERS = frozenset({h5z.FILTER_DEFLATE, h5z.FILTER_LZF})
_FILTERS = _PACKERS | {h5z.FILTER_SHUFFLE, h5z.FILTER_FLETCHER32}
_PLAIN = frozenset({h5t.INTEGER, h5t.FLOAT, h5t.STRING, h5t.ENUM})
_SCALES = frozenset({b"DIMENSION_LIST", b"REFERENCE_LIST"})
"""Attributes with references, by which HDF5 links dimensions and scales; they are never followed here."""


def inspect(path: Path, file: h5py.File) -> list[str]:
    """Raise LogError if the open `file` is hostile; return the paths of damaged groups and datasets, which must not be
    opened again. A file of another kind passes, because it is not read further.
    """
    damaged: list[str] = []
    try:
        with h5py.File(HeapCheckedFile(path), "r") as inspected:
            _check_attributes(_OpenObject(h5o.open(file.id, b"/"), b""), f"{path}: /")
            kind = inspected.attrs.get("format")
            if isinstance(kind, str | bytes) and kind in (FORMAT, FORMAT.encode()):
                refuse_hostile(file, inspected, str(path), damaged)
    except DAMAGE as error:
        raise LogError(f"{path}: damaged or malformed: {printable(' '.join(str(error).split()))}") from None
    return damaged


def refuse_hostile(file: h5py.File, inspected: h5py.File, where: str, damaged: list[str] | None = None) -> None:
    """Raise LogError for anything that leads outside the file, is reached twice, or declares more than the file can
    hold.

    `inspected` is the same file opened through `HeapCheckedFile`. Its texts are read last, because that takes longest.
    If HDF5 can't decode an object, LogError is raised, or its path is added to `damaged` if that is given.
    """
    size = file.id.get_filesize()
    root = _OpenObject(h5o.open(file.id, b"/"), b"")
    bad = _Damage(damaged)
    places = list(_walk(root, where, bad))
    texts: list[_TextPlace] = []
    for place in places:
        with bad.damage_at(place.path):
            texts += _look_at(place, f"{where}: {place.name}", size)
    for place in (root, *places):
        with bad.damage_at(place.path):
            texts += _check_attributes(place, f"{where}: {place.name or '/'}")
    for path, of_object in groupby(texts, attrgetter("path")):
        with bad.damage_at(path):
            item = h5o.open(inspected.id, path)  # once for all its texts
            for text in of_object:
                _read_text(item, text, where)


class _Damage:
    """Collects the paths of objects that HDF5 can't decode; without a list, and at the root, an error is raised."""

    def __init__(self, paths: list[str] | None) -> None:
        self._paths = paths

    @contextmanager
    def damage_at(self, path: bytes) -> Iterator[None]:
        """Note damage inside the context as that of the object at `path`."""
        try:
            yield
        except DAMAGE:
            if self._paths is None or path in (b"", b"/"):
                raise
            if _printable_name(path) not in self._paths:
                self._paths.append(_printable_name(path))


def _walk(root: _OpenObject, where: str, bad: _Damage) -> Iterator[_OpenObject]:
    """Yield all groups and datasets, level by level; LogError for too many, too deep or one that is reached twice."""
    visited = {h5o.get_info(root.item).addr}
    level = [root]
    for depth in range(MAX_DEPTH + 2):
        children: list[_OpenObject] = []
        counts: dict[_OpenObject, int] = {}  # before any of them is opened
        for place in level:
            if isinstance(place.item, h5g.GroupID):
                with bad.damage_at(place.path):
                    counts[place] = place.item.get_num_objs()
        if len(visited) + sum(counts.values()) > MAX_OBJECTS:
            raise LogError(f"{where}: more than {MAX_OBJECTS} groups and datasets")
        for group, count in counts.items():
            if group.path == b"/sensors" and count > MOST_SENSORS:
                raise LogError(f"{where}: {count} sensors; at most {MOST_SENSORS}")
            names: list[bytes] = []
            with bad.damage_at(group.path):
                names = _names_in_group(group, where)
            for name in names:
                with bad.damage_at(group.path + b"/" + name):
                    place = _OpenObject(h5o.open(group.item, name), group.path + b"/" + name)
                    if depth > MAX_DEPTH:
                        raise LogError(f"{where}: groups nested deeper than {MAX_DEPTH}")
                    address = h5o.get_info(place.item).addr
                    if address in visited:
                        raise LogError(
                            f"{where}: {place.name}: reached twice, by links in a circle or to the same place"
                        )
                    visited.add(address)
                    children.append(place)
        yield from children
        level = children


class _OpenObject(NamedTuple):
    """An open object, and its path."""

    item: Any
    path: bytes

    @property
    def name(self) -> str:
        return _printable_name(self.path)


class _TextPlace(NamedTuple):
    """A place with texts: a column, or an attribute of an object with its shape."""

    path: bytes
    attribute: bytes | None = None
    shape: tuple[int, ...] = ()


def _printable_name(name: bytes) -> str:
    """Return a name, or a path of valid names, for a message."""
    return printable(name.decode(errors="backslashreplace"))


def _names_in_group(group: _OpenObject, where: str) -> list[bytes]:
    """Return the names in a group; LogError for links other than plain ones, and for names with invalid characters."""
    links: list[tuple[bytes, int]] = []
    group.item.links.iterate(lambda name, info: links.append((name, info.type)), info=True)
    names = []
    for name, kind in links:
        place = f"{group.name}/{_printable_name(name)[:MAX_NAME_BYTES]}"
        if _printable_name(name).encode() != name or len(name) > MAX_NAME_BYTES:
            raise LogError(f"{where}: {place}: an invalid name")
        if kind == h5l.TYPE_SOFT and _is_plot(group, name):
            continue
        if kind != h5l.TYPE_HARD:
            raise LogError(f"{where}: {place}: a link to another place; a log contains its own data")
        names.append(name)
    return names


def _is_plot(group: _OpenObject, name: bytes) -> bool:
    """Return whether a soft link is one of `/plots`: to the column of the same name, of the sensor with the name of its
    group. It is not followed; the column is inspected at its own place.
    """
    _, *path = group.path.split(b"/")
    target: bytes = group.item.links.get_val(name)
    return len(path) == 2 and path[0] == PLOTS.encode() and target == b"/sensors/" + path[1] + b"/" + name


def _look_at(node: _OpenObject, place: str, file_bytes: int) -> list[_TextPlace]:
    """Check the type and the header of one object; returns the places of its texts."""
    if isinstance(node.item, h5d.DatasetID):
        return _check_dataset(node, place, file_bytes)
    if not isinstance(node.item, h5g.GroupID):
        raise LogError(f"{place}: neither group nor dataset")
    node.item.get_create_plist()  # needed later to list its attributes; damage raises LogError only here
    return []


def _check_attributes(node: _OpenObject, place: str) -> list[_TextPlace]:
    """Check that attributes are numbers and texts and not too many; return the places of the texts."""
    texts: list[_TextPlace] = []
    info = h5o.get_info(node.item)
    if info.num_attrs > MAX_ATTRIBUTES:
        raise LogError(f"{place}: {info.num_attrs} attributes; at most {MAX_ATTRIBUTES}")
    heap_bytes = info.meta_size.attr.heap_size  # checked before an attribute is opened, which reads it
    if heap_bytes > MAX_ATTRIBUTE_BYTES:
        raise LogError(f"{place}: {heap_bytes} bytes of attributes; at most {MAX_ATTRIBUTE_BYTES}")
    sizes: dict[bytes, int] = {}
    h5a.iterate(node.item, lambda name, info: sizes.update({name: info.data_size}), info=True)
    for name, size in sizes.items():
        mistake = f"{size} bytes; at most {MAX_ATTRIBUTE_BYTES}" if size > MAX_ATTRIBUTE_BYTES else ""
        if not mistake and name not in _SCALES:
            attribute = h5a.open(node.item, name)
            kind = attribute.get_type()
            if kind.get_class() not in _PLAIN:
                mistake = "neither numbers nor text"
            elif isinstance(kind, h5t.TypeStringID) and kind.is_variable_str():
                space = attribute.get_space()
                count = 0 if space.get_simple_extent_type() == h5s.NULL else space.get_simple_extent_npoints()
                mistake = f"more than {MAX_TEXTS} texts" if count > MAX_TEXTS else ""
                if count:
                    texts.append(_TextPlace(node.path or b"/", name, space.get_simple_extent_dims()))
        if mistake:
            raise LogError(f"{place}: attribute {_printable_name(name)[:MAX_NAME_BYTES]}: {mistake}")
    return texts


def _check_dataset(node: _OpenObject, place: str, file_bytes: int) -> list[_TextPlace]:
    """Check type, storage and declared size of a dataset; return the place of its texts."""
    item = node.item
    kind, plan = item.get_type(), item.get_create_plist()
    if kind.get_class() not in _PLAIN:
        raise LogError(f"{place}: neither numbers nor text")
    layout = plan.get_layout()
    packed = _look_at_filters(plan, place)
    if layout not in (h5d.COMPACT, h5d.CONTIGUOUS, h5d.CHUNKED) or plan.get_external_count():
        raise LogError(f"{place}: data stored outside the file or behind an unknown filter")
    if item.get_space().get_simple_extent_type() == h5s.NULL:
        return []
    shape, width = item.shape, kind.get_size()
    if len(shape) > MAX_RANK or width > MAX_ITEM_BYTES:
        raise LogError(f"{place}: {len(shape)} dimensions of {width} bytes; at most {MAX_RANK} of {MAX_ITEM_BYTES}")
    declared = _product(shape) * width
    if layout == h5d.CHUNKED:
        chunk = _product(plan.get_chunk()) * width
        if chunk > MAX_CHUNK_BYTES:
            raise LogError(f"{place}: chunks of {chunk} bytes; at most {MAX_CHUNK_BYTES}")
        limit_bytes = file_bytes * (MOST_DEFLATED if packed else 1) + SLACK_BYTES
    else:
        limit_bytes = item.get_storage_size()
    if declared > limit_bytes:
        raise LogError(f"{place}: declares {declared} bytes, more than this file of {file_bytes} bytes can hold")
    varies = isinstance(kind, h5t.TypeStringID) and kind.is_variable_str()
    if not varies or not declared:
        return []
    if _text_bytes(item) > MAX_TEXT_BYTES:  # checked before any is read: all may refer to the same long text
        raise LogError(f"{place}: texts of more than {MAX_TEXT_BYTES} bytes")
    return [_TextPlace(node.path)]


def _text_bytes(item: h5d.DatasetID) -> int:
    """Return the total length that the descriptors of a column's texts state; 0 if it is not contiguous in the file.

    A descriptor is the length (32 bits), the address of a heap, and a number in it (HDF5 file format, III.E and
    IV.A.2.d).
    """
    offset, width = item.get_offset(), item.get_type().get_size()
    file = h5i.get_file_id(item)
    if offset is None or width < 4 or file.get_access_plist().get_driver() != h5fd.SEC2:
        return 0
    data = os.pread(file.get_vfd_handle(), _product(item.shape) * width, offset)
    lengths = np.frombuffer(data[: len(data) // width * width], np.uint8).reshape(-1, width)[:, :4]
    return int(np.ascontiguousarray(lengths).view("<u4").sum(dtype=np.int64))


def _read_text(item: Any, text: _TextPlace, where: str) -> None:
    """Read the texts of an object from a file whose heaps are checked."""
    if text.attribute is not None:
        h5a.open(item, text.attribute).read(np.empty(text.shape, object), TEXT)
    elif item.rank == 0:
        item.read(h5s.ALL, h5s.ALL, np.empty((), item.dtype))
    else:
        try:
            read_texts(h5py.Dataset(item))
        except ValueError as error:
            raise LogError(f"{where}: {_printable_name(text.path)}: {error}") from None


def _look_at_filters(plan: Any, place: str) -> bool:
    """Return whether data are compressed; LogError for filters that no log has, or one that occurs twice."""
    filters = [plan.get_filter(index)[0] for index in range(plan.get_nfilters())]
    if not _FILTERS.issuperset(filters) or len(set(filters)) < len(filters) or len(_PACKERS.intersection(filters)) > 1:
        raise LogError(f"{place}: data stored outside the file or behind an unknown filter")
    return not _PACKERS.isdisjoint(filters)


def _product(lengths: tuple[int, ...]) -> int:
    """Multiply whole numbers without overflow: lengths are 64 bits wide."""
    product = 1
    for length in lengths:
        product *= int(length)
    return product
