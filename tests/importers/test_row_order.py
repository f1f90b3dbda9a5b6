"""Rows out of order are sorted by time or refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from imuarray.errors import ConfigError, SourceError
from imuarray.importers.cells import CellBlock
from imuarray.importers.guess import guess_map
from imuarray.importers.mapping import parse_map
from imuarray.importers.row_order import MOST_ROWS_LATE, RowOrder
from imuarray.importers.table import import_table
from imuarray.log import open_log
from tests.selection import some

MAP = """
time = {{ column = "t", unit = "s"{more} }}
[[sensor]]
name = "A"
chip = "x"
quantity = "specific_force"
columns = ["ax", "ay", "az"]
unit = "g"
range = 2
sensitivity = 16384
"""


def table(times_s: np.ndarray, first: np.ndarray) -> bytes:
    """x numbers the rows in the order of time, so that the sorted log has 0, 1, 2, ..."""
    rows = [f"{time:.4f},{int(x)},1,16384" for time, x in zip(times_s, first, strict=True)]
    return "\n".join(["t,ax,ay,az", *rows, ""]).encode()


def imported(folder: Path, data: bytes, more: str) -> tuple[np.ndarray, list[str]]:
    (folder / "data.csv").write_bytes(data)
    (folder / "map.toml").write_text(MAP.format(more=more))
    summary = import_table(folder / "data.csv", folder / "map.toml", folder / "run.h5", force=True)
    with open_log(folder / "run.h5") as log:
        return np.asarray(log["A"].counts)[:, 0], list(summary.remarks)


SWAPPED = np.r_[0:300, 310:320, 300:310, 320:1000]


def test_late_rows_are_sorted_and_counted(tmp_path: Path) -> None:
    """Rows 300 to 309 are after 310 to 319: ten rows are late."""
    data = table(0.01 * SWAPPED + 1, SWAPPED)
    counts, remarks = imported(tmp_path, data, ", sort = true")
    np.testing.assert_array_equal(counts, np.arange(1000))
    assert "10 rows out of order in the file sorted by time; the file's order is not kept" in remarks
    with pytest.raises(SourceError, match=r"line 312, .* for rows out of order, sort = true"):
        imported(tmp_path, data, "")


@pytest.mark.slow
def test_rows_of_two_blocks_are_sorted_together(tmp_path: Path) -> None:
    """Blocks have 4096 rows: the late rows are in the second block."""
    order = np.r_[0:4090, 4100:4200, 4090:4100, 4200:9000]
    counts, _ = imported(tmp_path, table(0.01 * order + 1, order), ", sort = true")
    np.testing.assert_array_equal(counts, np.arange(9000))


def test_padding_stays_at_the_end(tmp_path: Path) -> None:
    data = table(0.01 * SWAPPED + 1, SWAPPED) + b"0,0,0,0\n" * 5
    counts, remarks = imported(tmp_path, data, ", sort = true")
    np.testing.assert_array_equal(counts, np.arange(1000))
    assert any("5 rows of zeros only" in text for text in remarks)


@pytest.mark.slow
def test_the_guess_sorts_late_rows_but_not_a_clock_step(tmp_path: Path) -> None:
    (tmp_path / "data.csv").write_bytes(table(0.01 * SWAPPED + 1, SWAPPED))
    text = guess_map(tmp_path / "data.csv")
    assert "sort = true   # rows are out of order, and fit between the others" in text
    assert "# ~ 10 rows out of order in the file sorted by time" in text
    set_back = 0.01 * np.arange(1000) + 1
    set_back[700:] -= 2.004
    (tmp_path / "data.csv").write_bytes(table(set_back, np.arange(1000)))
    text = " ".join(guess_map(tmp_path / "data.csv").replace("\n#  ", "").split())
    assert "# ~ the times went back 1 time, by 1.994 s" in text
    assert "restarts = true # ?" in text and "sort = true #" not in text


def test_sort_and_a_wrapping_counter_exclude_each_other() -> None:
    with pytest.raises(ConfigError, match="sort can't be combined with times that restart"):
        parse_map(MAP.format(more=", sort = true, wraps_at = 65536"), "m")


@settings(max_examples=100)
@given(st.lists(st.integers(0, 50), max_size=40), st.integers(1, 7))
def test_any_order_within_the_buffer_is_sorted(times: list[int], rows: int) -> None:
    assert len(times) <= MOST_ROWS_LATE
    blocks = [
        (CellBlock("s", list(range(at, at + len(part))), [[str(t) for t in part], np.arange(at, at + len(part))]), [0])
        for at in range(0, len(times), rows)
        if (part := times[at : at + rows])
    ]
    order = RowOrder(lambda block, where: np.array([int(text) for text in block.columns[where[0]]], np.int64))
    out = [
        (int(text), line)
        for block, _ in order.in_order(iter(blocks))
        for text, line in zip(block.columns[0], block.lines, strict=True)
    ]
    assert out == sorted(zip(times, range(len(times)), strict=True))
    assert order.late == sum(time < max(times[:at], default=0) for at, time in enumerate(times))


@pytest.mark.slow
@pytest.mark.parametrize("overlap", some([2, 300, 4096], 1))
def test_rows_of_an_overlap_are_kept_once(tmp_path: Path, overlap: int) -> None:
    rows = np.r_[0:6000, 6000 - overlap : 8000]
    counts, remarks = imported(tmp_path, table(0.01 * rows + 1, rows), ", sort = true")
    np.testing.assert_array_equal(counts, np.arange(8000))
    assert f"{overlap} rows that the file holds twice kept once" in remarks


def test_equal_readings_of_a_coarse_clock_are_kept(tmp_path: Path) -> None:
    """Four rows have the same time, and two of them the same reading."""
    rows = np.arange(1000)
    counts, remarks = imported(tmp_path, table(0.01 * (rows // 4) + 1, rows // 2), ", sort = true, ties = true")
    np.testing.assert_array_equal(counts, rows // 2)
    assert not [text for text in remarks if "twice" in text]


def test_a_column_that_numbers_rows_is_not_a_time(tmp_path: Path) -> None:
    rows = "".join(f"{number},1,2,16384\n" for number in range(200))
    (tmp_path / "data.csv").write_text("sample,ax,ay,az\n" + rows)
    text = " ".join(guess_map(tmp_path / "data.csv").replace("\n#  ", "").split())
    assert "column 'sample' counts the rows and says nothing about time" in text
    assert "rate_hz = 100 # ? enter the true rate" in text


@pytest.mark.slow
def test_the_rate_of_a_wrapping_counter(tmp_path: Path) -> None:
    """A row every 20 ms, with a 16-bit counter of milliseconds: 50 rows per second."""
    rows = "".join(f"{20 * number % 65536},1,2,16384\n" for number in range(9000))
    (tmp_path / "data.csv").write_text("ms,ax,ay,az\n" + rows)
    text = guess_map(tmp_path / "data.csv")
    assert "wraps_at = 65536" in text and " 50 rows a second" in text
