"""The memory that an export takes does not grow with the log."""

from __future__ import annotations

import tracemalloc
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from imuarray.export import export
from imuarray.importers import importer_of
from imuarray.log import Block, LogWriter
from tests.export.conftest import ACC, EPOCH


def log_of(path: Path, rows: int) -> Path:
    with LogWriter(path, [ACC], source="simulated", epoch=EPOCH) as log:
        zeros = np.zeros(rows, np.uint16)
        log.append("Acc", Block(np.arange(rows) * 1000, np.ones((rows, 3), np.int16), zeros, zeros.astype(np.int16)))
    return path


def peak(work: Callable[[], object]) -> int:
    tracemalloc.start()
    work()
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    return most


@pytest.mark.slow
@pytest.mark.parametrize(
    ("suffix", "few", "many"),
    [
        ("csv", 1500, 3000),
        ("npz", 8_000, 40_000),
        ("parquet", 8_000, 40_000),
        ("mcap", 1500, 3000),
        ("ros2.mcap", 1500, 3000),
    ],
)
def test_memory_of_export_and_import_does_not_grow_with_the_log(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, suffix: str, few: int, many: int
) -> None:
    """A row takes half a kilobyte as text, and 16 bytes as an array: held, they would show, as nearly twice as much or
    more. When garbage is collected differs from run to run.
    """
    monkeypatch.setattr("imuarray.export.tables.ExportTable.blocks.__defaults__", (250,))
    monkeypatch.setattr("imuarray.export.mcap_file._BLOCK", 250)
    monkeypatch.setattr("imuarray.export.mcap_file._CHUNK_BYTES", 1 << 14)
    monkeypatch.setattr("imuarray.export.parquet_files._GROUP_ROWS", 2000)
    monkeypatch.setattr("imuarray.importers.exported_npz._ROWS", 250)
    monkeypatch.setattr("imuarray.importers.exported_parquet._ROWS", 2000)
    monkeypatch.setattr("imuarray.importers.cells.TextTable.blocks.__defaults__", (250, None))
    monkeypatch.setattr("imuarray.log.writer.CHUNK", 250)
    monkeypatch.setattr("imuarray.log.columns.CACHED_BYTES", 1 << 14)
    monkeypatch.setattr("imuarray.log.columns._BLOCK_ROWS", 250)

    def peaks(rows: int) -> tuple[int, int]:
        run, out = log_of(tmp_path / f"{rows}.h5", rows), tmp_path / f"{rows}.{suffix}"
        written = peak(lambda: export(run, out, tool="ros2" if suffix == "ros2.mcap" else None))
        importer = importer_of(out)
        return written, 0 if importer is None else peak(lambda: importer(out, tmp_path / "back.h5", force=True))

    peaks(500)  # modules are loaded
    for less, more in zip(peaks(few), peaks(many), strict=True):
        assert more <= 1.5 * less
