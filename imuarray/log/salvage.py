"""Searches for good blocks after damage in a journal.

A block that the search finds must not be a stale sector of another log of the same shape. It is accepted if the
checksum of the previous block leads to it and that checksum belongs to this log; or if the block has this log's tag and
its checksum leads to the next block.

Only the damaged data are lost. If the bad bytes are one block of which only the head is wrong, the head is
reconstructed, because the checksum of the block covers head and payload. If the next block continues from the checksum
that the payload should have, only the stored checksum was wrong.

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
"""Number of bytes of a block before its payload."""

LONGEST_BLOCK = 1 << 28

SEARCH_BYTES = 1 << 26
"""Number of bytes after damage in which one reader searches for good blocks, in total."""

CHECK_BYTES = 1 << 26
"""Number of bytes that one reader checks as possible blocks, in total."""

_LEAST_CHECK = 4096
"""Least number of bytes that a check costs; with `CHECK_BYTES` it limits the number of checks."""

_WINDOWS = (1 << 12, 1 << 16, 1 << 20)
"""Numbers of bytes that are searched at a time, small ones first: most damage is short."""

_LONGEST_GAP = 1 << 20
"""Largest number of damaged bytes that may be one block with a wrong head."""

_SECTOR = 512
_PAGE = 4096


class Mark(NamedTuple):
    """A position between two blocks: bytes from the start, and the CRC from which the next block continues."""

    position: int
    chain: int


class Record(NamedTuple):
    """A block that was read: the number of its group, its rows as bytes, and the position after it."""

    group: int
    rows: int
    payload: bytes
    after: Mark


class Salvage:
    """Searches one journal (an open file descriptor). `row_bytes` are the sizes of the rows of the groups, `tags` the
    tags of the blocks of this log; the first is the tag of its identity.
    """

    def __init__(self, fd: int, row_bytes: Sequence[int], tags: Sequence[int]) -> None:
        self._fd, self._row_bytes, self._tags = fd, tuple(row_bytes), tuple(tags)
        self._search_bytes, self._check_bytes = SEARCH_BYTES, CHECK_BYTES

    @property
    def _end(self) -> int:
        return os.fstat(self._fd).st_size

    def _read_bytes(self, size: int, position: int) -> bytes:
        """Read bytes of the journal; memory is allocated only for bytes that exist."""
        return os.pread(self._fd, max(0, min(size, self._end - position)), position)

    @property
    def is_spent(self) -> bool:
        """True if the budget is used up; there may be more good blocks after the last position that was searched."""
        return self._search_bytes <= 0 or self._check_bytes <= 0

    def is_good(self, start: Mark) -> bool:
        """Return whether a good block is at a position."""
        position, chain = start
        self._check_bytes -= _LEAST_CHECK
        if self._check_bytes <= 0:
            return False
        head = self._read_bytes(OVERHEAD, position)
        size = self._payload_size(head)
        if size is None or size > min(LONGEST_BLOCK, self._check_bytes):
            return False
        payload = self._read_bytes(size, position + OVERHEAD)
        self._check_bytes -= size
        return len(payload) == size and head[HEAD.size :] == CRC.pack(_chain_checksum(head, payload, chain))

    def _payload_size(self, head: bytes) -> int | None:
        """Return the bytes of payload that a head declares; None unless it can be the head of a block of this log."""
        if len(head) < OVERHEAD:
            return None
        group, tag, rows = HEAD.unpack_from(head)
        if tag not in self._tags or not rows or group >= len(self._row_bytes):
            return None
        return int(rows * self._row_bytes[group])

    def resume(self, bad: Mark) -> tuple[Mark, Record | None] | None:
        """Return where good blocks resume after the bad one at `bad`, and the bad one if it could be restored; None if
        they do not resume within the budget.
        """
        chains = self._chains(bad)
        for head_position in self._heads(bad.position):
            if self.is_spent:
                break
            head = self._read_bytes(OVERHEAD, head_position)
            size = self._payload_size(head)
            if size is None:
                continue
            for chain in chains if head_position > bad.position else ():
                candidate = Mark(head_position, chain)
                if self.is_good(candidate):
                    return candidate, self._gap(bad, candidate)
            end = Mark(head_position + OVERHEAD + size, *CRC.unpack_from(head, HEAD.size))
            is_own = HEAD.unpack_from(head)[1] == self._tags[0]
            if is_own and self.is_good(end):
                return end, self._gap(bad, end)
        return None

    def last(self, bad: Mark) -> Record | None:
        """Return the block from `bad` to the end of the journal, if only its head is wrong."""
        end = self._end
        block = self._try_other_heads(bad, end)
        if block is None:
            return None
        (stored,) = CRC.unpack(self._read_bytes(CRC.size, bad.position + HEAD.size))
        return Record(*block, Mark(end, stored))

    def _gap(self, bad: Mark, after: Mark) -> Record | None:
        """Return the bad bytes as one block, if its payload can be proved good: by its own checksum under another head,
        or by the next block, which continues from `after`.
        """
        position, chain = bad
        head = self._read_bytes(OVERHEAD, position)
        size = self._payload_size(head)
        if size is not None and position + OVERHEAD + size == after.position:
            payload = self._read_bytes(size, position + OVERHEAD)
            group, _, rows = HEAD.unpack_from(head)
            return Record(group, rows, payload, after) if _chain_checksum(head, payload, chain) == after.chain else None
        block = self._try_other_heads(bad, after.position)
        return None if block is None else Record(*block, after)

    def _try_other_heads(self, bad: Mark, end: int) -> tuple[int, int, bytes] | None:
        """Return group, rows and payload of the bytes from `bad` to `end` as one block whose head fits its checksum."""
        position, chain = bad
        if not OVERHEAD < end - position <= _LONGEST_GAP:
            return None
        content = self._read_bytes(end - position, position)
        (stored,), payload = CRC.unpack_from(content, HEAD.size), content[OVERHEAD:]
        for group, row_bytes in enumerate(self._row_bytes):
            rows, rest = divmod(len(payload), row_bytes)
            self._check_bytes -= 0 if rest else len(payload)
            if not rest and _chain_checksum(HEAD.pack(group, self._tags[0], rows), payload, chain) == stored:
                return group, rows, payload
        return None

    def _chains(self, bad: Mark) -> list[int]:
        """Return the checksums from which the block after the bad one may continue: the bad block's checksum as it
        should be, and as it is stored.

        The stored one is valid only if it certainly belongs to this log: if it lies in the same sector as the end of
        the previous block.
        """
        position, chain = bad
        head = self._read_bytes(OVERHEAD, position)
        if len(head) < OVERHEAD:
            return []
        size = self._payload_size(head) or 0
        payload = self._read_bytes(min(size, LONGEST_BLOCK, self._check_bytes), position + OVERHEAD)
        self._check_bytes -= len(payload)
        is_own = 0 < position % _SECTOR <= _SECTOR - OVERHEAD
        return [_chain_checksum(head, payload, chain), *(CRC.unpack_from(head, HEAD.size) if is_own else ())]

    def _heads(self, position: int) -> Iterator[int]:
        """Yield positions from `position` on at which a block of this log may begin, by tag, group and rows."""
        end = self._end
        windows = iter(_WINDOWS)
        length = next(windows)
        while position < end and self._search_bytes > 0:
            data = self._read_bytes(length + OVERHEAD - 1, position)
            self._search_bytes -= len(data)
            for offset in _plausible(data, self._tags, len(self._row_bytes)):
                yield position + offset
            position += length
            length = next(windows, length)

    def is_torn(self, position: int) -> bool:
        """Return whether the bytes from `position` to the end are the result of a crash or a power cut: the first bytes
        of a block, and zeros of pages that never reached the disk.
        """
        length = self._end - position
        size = self._payload_size(self._read_bytes(OVERHEAD, position))
        if length < OVERHEAD or (size is not None and OVERHEAD + size > length):
            return True
        if size is not None and OVERHEAD + size == length:
            return False  # the block is complete: a page of zeros in it may be its payload
        if size is not None:
            return self._is_zero(position + OVERHEAD + size)
        page_end = position + _PAGE - position % _PAGE
        return self._is_zero(page_end if page_end < position + OVERHEAD else position)

    def _is_zero(self, position: int) -> bool:
        """Return whether there are only zeros from `position` on."""
        while piece := self._read_bytes(1 << 20, position):
            if piece.count(0) < len(piece):
                return False
            position += len(piece)
        return True

    def has_hole(self, start: int, end: int) -> bool:
        """Return whether a page between two positions is all zeros, as after a power cut that kept it from the disk."""
        data = self._read_bytes(min(end - start, SEARCH_BYTES), start)
        ends = range(_PAGE - start % _PAGE, len(data) + 1, _PAGE)
        return any(not any(data[max(0, stop - _PAGE) : stop]) for stop in ends)


def _chain_checksum(head: bytes, payload: bytes, chain: int) -> int:
    """Return the checksum of a block that continues from `chain`."""
    return zlib.crc32(payload, zlib.crc32(head[: HEAD.size], chain))


def _plausible(data: bytes, tags: Sequence[int], groups: int) -> list[int]:
    """Return the offsets at which `data` can be the head of a block: a valid tag, group and number of rows."""
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
    positions = np.flatnonzero(fits & has_rows)
    group = content[positions].astype(np.uint16) | content[positions + 1].astype(np.uint16) << 8
    return [int(offset) for offset in positions[group < groups]]
