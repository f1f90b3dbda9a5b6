"""The search for good blocks behind damage in a journal.

A block that the search finds must not be a stale sector of another log of the same shape. It counts if the check sum of
the block before leads on to it, and that check sum is this log's; or if the block bears this log's tag and its check
sum leads to the next one.

Damage costs only the data that it hit: where the bad bytes are one block whose head alone is wrong, the head is
reconstructed (the check sum of the block covers head and payload), and where the next block continues from the check
sum that the payload should have, the stored check sum alone was wrong.

Each reader has a budget of bytes that it searches and checks, so that no journal takes longer than about a second.
"""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

HEAD = struct.Struct("<HHI")
"""Header of a block in a journal: group, tag, rows."""
CRC = struct.Struct("<I")
OVERHEAD = HEAD.size + CRC.size
"""Bytes of a block before its payload."""

LONGEST_BLOCK = 1 << 28

SEARCH_BYTES = 1 << 26
"""The number of bytes after damage in which one reader searches for good blocks, in all."""

CHECK_BYTES = 1 << 26
"""Bytes that one reader checks as possible blocks, in all."""

_LEAST_CHECK = 4096
"""The least cost of a check; with `CHECK_BYTES` it bounds the number of checks."""

_WINDOWS = (1 << 12, 1 << 16, 1 << 20)
"""Bytes that are searched at a time: most damage is short."""

_LONGEST_GAP = 1 << 20
"""Bytes of damage that may be one block with a wrong head."""

_SECTOR = 512
_PAGE = 4096


class JournalBlock(NamedTuple):
    """A block: the number of its group, its rows, its payload."""

    group: int
    rows: int
    payload: bytes


class Resumption(NamedTuple):
    """The place where good blocks go on: byte position and chain. `block` is the bad one before, if it could be
    restored.
    """

    position: int
    chain: int
    block: JournalBlock | None


class LastBlock(NamedTuple):
    """A restored block at the end of a journal, and its check sum."""

    block: JournalBlock
    chain: int


class Salvage:
    """Looks into one journal (an open file descriptor). `row_bytes` are those of the groups, `tags` those that the
    blocks of this log may bear; the first is its own.
    """

    def __init__(self, fd: int, row_bytes: Sequence[int], tags: Sequence[int]) -> None:
        self._fd, self._row_bytes, self._tags = fd, tuple(row_bytes), tuple(tags)
        self._search_bytes, self._check_bytes = SEARCH_BYTES, CHECK_BYTES

    @property
    def _end(self) -> int:
        """The length of the journal, now."""
        return os.fstat(self._fd).st_size

    def _read(self, size: int, position: int) -> bytes:
        """Bytes of the journal; memory is asked for only as far as there are any."""
        return os.pread(self._fd, max(0, min(size, self._end - position)), position)

    @property
    def is_spent(self) -> bool:
        """True if the budget is used up: behind the last place that was searched there may be more good blocks."""
        return self._search_bytes <= 0 or self._check_bytes <= 0

    def is_good(self, position: int, chain: int) -> bool:
        """Return whether a good block is at `position` and continues from `chain`."""
        self._check_bytes -= _LEAST_CHECK
        if self._check_bytes <= 0:
            return False
        head = self._read(OVERHEAD, position)
        size = self._declared(head)
        if size is None or size > min(LONGEST_BLOCK, self._check_bytes):
            return False
        payload = self._read(size, position + OVERHEAD)
        self._check_bytes -= size
        return len(payload) == size and head[HEAD.size :] == CRC.pack(_chained(head, payload, chain))

    def _declared(self, head: bytes) -> int | None:
        """Bytes of payload that a head declares; None unless it can be the head of a block of this log."""
        if len(head) < OVERHEAD:
            return None
        group, tag, rows = HEAD.unpack_from(head)
        if tag not in self._tags or not rows or group >= len(self._row_bytes):
            return None
        return int(rows * self._row_bytes[group])

    def resume(self, position: int, chain: int) -> Resumption | None:
        """Return where good blocks go on behind the bad one at `position`, which should go on from `chain`; None if
        nowhere that the budget reaches.
        """
        chains = self._chains(position, chain)
        for at in self._heads(position):
            if self.is_spent:
                break
            head = self._read(OVERHEAD, at)
            size = self._declared(head)
            if size is None:
                continue
            for candidate in chains if at > position else ():
                if self.is_good(at, candidate):
                    return Resumption(at, candidate, self._gap(position, chain, at, candidate))
            behind, (stored,) = at + OVERHEAD + size, CRC.unpack_from(head, HEAD.size)
            own = HEAD.unpack_from(head)[1] == self._tags[0]
            if own and self.is_good(behind, stored):
                return Resumption(behind, stored, self._gap(position, chain, behind, stored))
        return None

    def last(self, position: int, chain: int) -> LastBlock | None:
        """The block that stands from `position` to the end of the journal, if its head alone is wrong."""
        block = self._reheaded(position, chain, self._end)
        if block is None:
            return None
        return LastBlock(block, CRC.unpack(self._read(CRC.size, position + HEAD.size))[0])

    def _gap(self, position: int, chain: int, end: int, after: int) -> JournalBlock | None:
        """The bad bytes as one block, if its payload can be proved good: by its own check sum under another head, or by
        the block behind it, which goes on from `after`.
        """
        head = self._read(OVERHEAD, position)
        size = self._declared(head)
        if size is not None and position + OVERHEAD + size == end:
            payload = self._read(size, position + OVERHEAD)
            group, _, rows = HEAD.unpack_from(head)
            return JournalBlock(group, rows, payload) if _chained(head, payload, chain) == after else None
        return self._reheaded(position, chain, end)

    def _reheaded(self, position: int, chain: int, end: int) -> JournalBlock | None:
        """The bytes from `position` to `end` as one block under the head that its check sum wants."""
        if not OVERHEAD < end - position <= _LONGEST_GAP:
            return None
        content = self._read(end - position, position)
        (stored,), payload = CRC.unpack_from(content, HEAD.size), content[OVERHEAD:]
        for group, row_bytes in enumerate(self._row_bytes):
            rows, rest = divmod(len(payload), row_bytes)
            self._check_bytes -= 0 if rest else len(payload)
            if not rest and _chained(HEAD.pack(group, self._tags[0], rows), payload, chain) == stored:
                return JournalBlock(group, rows, payload)
        return None

    def _chains(self, position: int, chain: int) -> list[int]:
        """Return what the block behind the bad one may go on from: the bad one's check sum as it should be, and as it
        stands.

        As it stands only if it is this log's for certain: written in one sector with the end of the block before it.
        """
        head = self._read(OVERHEAD, position)
        if len(head) < OVERHEAD:
            return []
        size = self._declared(head) or 0
        payload = self._read(min(size, LONGEST_BLOCK, self._check_bytes), position + OVERHEAD)
        self._check_bytes -= len(payload)
        is_own = 0 < position % _SECTOR <= _SECTOR - OVERHEAD
        return [_chained(head, payload, chain), *(CRC.unpack_from(head, HEAD.size) if is_own else ())]

    def _heads(self, position: int) -> Iterator[int]:
        """Positions from `position` on where a block of this log may begin, by tag, group and rows."""
        end = self._end
        windows = iter(_WINDOWS)
        length = next(windows)
        while position < end and self._search_bytes > 0:
            data = self._read(length + OVERHEAD - 1, position)
            self._search_bytes -= len(data)
            for at in _plausible(data, self._tags, len(self._row_bytes)):
                yield position + at
            position += length
            length = next(windows, length)

    def is_torn(self, position: int) -> bool:
        """Return whether the bytes from `position` to the end are what a crash or a power cut leaves there: the first
        bytes of a block, and zeros of pages that never reached the disk.
        """
        length = self._end - position
        size = self._declared(self._read(OVERHEAD, position))
        if length < OVERHEAD or (size is not None and OVERHEAD + size > length):
            return True
        if size is not None and OVERHEAD + size == length:
            return False  # all of the block is there: a page of zeros in it may be its payload
        if size is not None:
            return self._is_zero(position + OVERHEAD + size)
        page_end = position + _PAGE - position % _PAGE
        return self._is_zero(page_end if page_end < position + OVERHEAD else position)

    def _is_zero(self, position: int) -> bool:
        """Return whether nothing but zeros stands from `position` on."""
        while piece := self._read(1 << 20, position):
            if piece.count(0) < len(piece):
                return False
            position += len(piece)
        return True

    def has_hole(self, start: int, end: int) -> bool:
        """Return whether a page between two positions is all zeros: a power cut may have kept it from the disk."""
        data = self._read(min(end - start, SEARCH_BYTES), start)
        ends = range(_PAGE - start % _PAGE, len(data) + 1, _PAGE)
        return any(not any(data[max(0, stop - _PAGE) : stop]) for stop in ends)


def _chained(head: bytes, payload: bytes, chain: int) -> int:
    """Return the check sum of a block that continues from `chain`."""
    return zlib.crc32(payload, zlib.crc32(head[: HEAD.size], chain))


def _plausible(data: bytes, tags: Sequence[int], groups: int) -> list[int]:
    """Offsets at which `data` can be the head of a block: one of the tags, a group that there is, rows."""
    count = len(data) - OVERHEAD + 1
    if count <= 0:
        return []
    content = np.frombuffer(data, np.uint8)
    fits = np.zeros(count, bool)
    for tag in tags:
        low, high = tag & 0xFF, tag >> 8
        fits |= (content[2 : 2 + count] == low) & (content[3 : 3 + count] == high)
    has_rows = content[4 : 4 + count] != 0
    for byte in (5, 6, 7):
        has_rows |= content[byte : byte + count] != 0
    at = np.flatnonzero(fits & has_rows)
    group = content[at].astype(np.uint16) | content[at + 1].astype(np.uint16) << 8
    return [int(offset) for offset in at[group < groups]]
