"""Where a journal is good again behind damage: a search for blocks that can't be anything but this log's.

What is found must not be a stale sector of another log that had the same shape. So a block counts if the check sum of
the block before leads on to it, and that check sum is this log's; or if it bears this log's tag and leads to the next.
"""

from __future__ import annotations

import re
import struct
import zlib
from collections.abc import Callable, Iterator, Sequence

HEAD = struct.Struct("<HHI")
"""Of a block in a journal: group, tag, rows."""
CRC = struct.Struct("<I")

_SECTOR = 512
_PAGE = 4096


def next_good(
    data: bytes, end: tuple[int, int], row_bytes: Sequence[int], tag: int, is_good: Callable[[int, int], bool]
) -> tuple[int, int] | None:
    """The first place (bytes from the start, CRC to go on from) from where a journal is good again; None if none.

    `data` stands at `end`, the place of the bad block; `row_bytes` are those of the groups; `is_good` says of a place
    whether a good block stands there.
    """
    position, _ = end
    chains = _chains(data, end, row_bytes)
    for at in _heads(data, tag):
        group, own, rows = HEAD.unpack_from(data, at)
        if not rows or group >= len(row_bytes):
            continue
        for chain in chains if at else ():
            if is_good(position + at, chain):
                return position + at, chain
        behind = at + HEAD.size + CRC.size + rows * row_bytes[group]
        (stored,) = CRC.unpack_from(data, at + HEAD.size)
        if own == tag and behind < len(data) and is_good(position + behind, stored):
            return position + behind, stored
    return None


def _heads(data: bytes, tag: int) -> Iterator[int]:
    """Where a block may begin; those of earlier versions bear the tag 0."""
    tags = b"|".join(re.escape(HEAD.pack(0, one, 0)[2:4]) for one in (tag, 0))
    for found in re.finditer(b"(?=.[\x00-\x02](?:" + tags + b"))", data, re.DOTALL):
        if found.start() + HEAD.size + CRC.size <= len(data):
            yield found.start()


def _chains(data: bytes, end: tuple[int, int], row_bytes: Sequence[int]) -> list[int]:
    """What the block behind the bad one may go on from: the bad one's check sum as it should be, and as it stands.

    As it stands only if it is this log's for certain: written in one sector with the end of the block before it.
    """
    position, chain = end
    head = HEAD.size + CRC.size
    if len(data) < head:
        return []
    group, _, rows = HEAD.unpack_from(data)
    size = rows * row_bytes[group] if group < len(row_bytes) else 0
    should_be = zlib.crc32(data[head : head + size], zlib.crc32(data[: HEAD.size], chain))
    into = position % _SECTOR
    return [should_be, *(CRC.unpack_from(data, HEAD.size) if 0 < into <= _SECTOR - head else ())]


def never_written(data: bytes, position: int) -> bool:
    """Whether a stretch of a journal that begins at `position` is zeros up to the end of one of its pages, from that
    page's beginning or from its own: what a power cut makes of a page that was not on the disk yet.
    """
    ends = range(_PAGE - position % _PAGE, len(data) + 1, _PAGE)
    return any(not any(data[max(0, end - _PAGE) : end]) for end in ends)
