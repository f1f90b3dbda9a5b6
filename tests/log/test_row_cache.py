"""Rows that stay in memory after they were read."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from imuarray.errors import LogError
from imuarray.log.columns import NamedColumn, RowCache

ROWS = 250_000


class Counted:
    """A column that counts the rows that are read of it."""

    def __init__(self, values: Any) -> None:
        self.values, self.shape, self.dtype, self.rows_read = values, values.shape, values.dtype, 0

    def __len__(self) -> int:
        return len(self.values)

    def __getitem__(self, key: Any) -> Any:
        self.rows_read += len(self.values[key])
        return self.values[key].copy()


def cached(column: Any, name: str, limit_bytes: int | None = None) -> NamedColumn:
    cache = RowCache(limit_bytes)
    cache.use(0)
    return NamedColumn(column, name, cache)


def test_any_slice_equals_that_of_the_column() -> None:
    values = np.random.default_rng(1).integers(-32768, 32767, (ROWS, 3), dtype=np.int16)
    column = cached(Counted(values), "counts")
    ends = np.random.default_rng(2).integers(-ROWS, 2 * ROWS, (200, 2))
    for start, stop in [*ends.tolist(), (0, ROWS), (65_536, 131_072), (65_535, 131_073), (5, 5), (9, 3)]:
        np.testing.assert_array_equal(column[start:stop], values[start:stop])
    np.testing.assert_array_equal(column[10:ROWS:7], values[10:ROWS:7])
    np.testing.assert_array_equal(column[:], values)


def test_rows_are_read_once_while_the_cache_has_room() -> None:
    counted = Counted(np.arange(ROWS))
    column = cached(counted, "time", 8 * ROWS)
    for _ in range(3):
        for start in range(0, ROWS, 16_384):
            column[start : start + 16_384]
    assert counted.rows_read == ROWS


@pytest.mark.parametrize(("size_bytes", "blocks"), [(8 * ROWS, 4), (1 << 30, 2)])
def test_the_most_recent_rows_of_a_long_log_stay_cached(
    monkeypatch: pytest.MonkeyPatch, size_bytes: int, blocks: int
) -> None:
    """Four blocks of half a megabyte; a log of a gigabyte may keep two."""
    monkeypatch.setattr("imuarray.log.columns.RECENT_BYTES", 1 << 20)
    counted, cache = Counted(np.arange(ROWS)), RowCache()
    cache.use(size_bytes)
    column = NamedColumn(counted, "time", cache)  # type: ignore[arg-type]
    starts = range(0, ROWS, 65_536)
    for start in (*starts, *reversed(starts)):
        column[start : start + 65_536]
    again = sum(len(counted.values[start : start + 65_536]) for start in starts[: 4 - blocks])
    assert counted.rows_read == ROWS + again


def test_a_few_cached_rows_are_not_read_again() -> None:
    counted = Counted(np.arange(ROWS) ** 2)
    column = cached(counted, "time")
    assert column[70_000:70_010].tolist() == [row**2 for row in range(70_000, 70_010)] and counted.rows_read == 10
    column[0:131_072]
    read = counted.rows_read
    for start, stop in ((0, 1), (65_530, 65_536), (65_536, 65_540), (131_071, 131_072)):
        assert column[start:stop].tolist() == [row**2 for row in range(start, stop)]
    assert (int(column[5]), int(column[65_536]), int(column[65_537 - ROWS])) == (25, 65_536**2, 65_537**2)
    assert counted.rows_read == read
    column[65_530:65_540]  # in two blocks
    assert counted.rows_read == read + 10
    with pytest.raises(IndexError):
        cached(np.arange(ROWS), "time")[ROWS]


def test_the_most_recently_used_blocks_stay_cached() -> None:
    counted = Counted(np.arange(ROWS))
    column = cached(counted, "time", 2 * 8 * 65_536)
    for start in (0, 65_536, 0, 131_072, 0):  # the third block takes the place of the second
        column[start : start + 65_536]
    assert counted.rows_read == 3 * 65_536
    column[65_536:131_072]
    assert counted.rows_read == 4 * 65_536


def test_changing_a_returned_slice_does_not_change_the_cache() -> None:
    column = cached(Counted(np.arange(ROWS)), "time")
    column[0:5000][:] = -1
    assert column[0:5000].tolist() == list(range(5000))


def test_a_few_rows_are_read_without_their_block() -> None:
    counted = Counted(np.arange(ROWS))
    column = cached(counted, "time")
    assert column[-1:].tolist() == [ROWS - 1] and column[7:71].tolist() == list(range(7, 71))
    assert counted.rows_read == 65


def test_rows_next_to_damaged_rows_can_be_read(tmp_path: Path) -> None:
    values, chunk = np.arange(20_000), 4096
    with h5py.File(tmp_path / "log.h5", "w") as file:
        file.create_dataset("time", data=values, chunks=(chunk,), fletcher32=True)
        place = file["time"].id.get_chunk_info(2).byte_offset
    with (tmp_path / "log.h5").open("r+b") as raw:
        raw.seek(place + 100)
        raw.write(b"\xff" * 8)
    with h5py.File(tmp_path / "log.h5", "r") as file:
        column = cached(file["time"], "time")
        np.testing.assert_array_equal(column[: 2 * chunk], values[: 2 * chunk])
        np.testing.assert_array_equal(column[3 * chunk :], values[3 * chunk :])
        with pytest.raises(LogError, match=r"time: rows 0 to 19999 are damaged"):
            column[:]


def test_rows_are_not_cached_by_default(tmp_path: Path) -> None:
    counted = Counted(np.arange(ROWS))
    column = NamedColumn(counted, "time", RowCache())  # type: ignore[arg-type]
    for _ in range(2):
        column[:5000]
    assert counted.rows_read == 10_000
