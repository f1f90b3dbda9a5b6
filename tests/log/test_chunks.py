"""Chunks that are filtered here are those that HDF5 writes and reads."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from imuarray.log import chunks
from imuarray.log.chunks import ColumnWriter
from tests.selection import some

FILTERS: dict[str, dict[str, Any]] = {
    "of a log": {"compression": "gzip", "compression_opts": 1, "shuffle": True, "fletcher32": True},
    "compressed": {"compression": "gzip", "compression_opts": 4},
    "with a check sum": {"fletcher32": True},
    "none": {},
    "another one": {"compression": "lzf", "shuffle": True},
}
CHUNK = 64

rng = np.random.default_rng(7)
COLUMNS = {
    "time": np.cumsum(rng.integers(9_900_000, 10_100_000, 1000)),
    "counts": np.rint(rng.normal(0, 300, (1000, 3))).astype(np.int16),
    "status": np.zeros(1000, np.uint16),
    "used": rng.integers(0, 2, (1000, 6)).astype(np.uint8),
    "truth": rng.normal(0, 9, (1000, 3)),
    "variance": np.full((1000, 6), 0.1, np.float32),
}


def _create(file: h5py.File, values: np.ndarray, filters: dict[str, Any]) -> h5py.Dataset:
    tail = values.shape[1:]
    return file.create_dataset(
        "column", (0, *tail), values.dtype, maxshape=(None, *tail), chunks=(CHUNK, *tail), **filters
    )


@pytest.mark.parametrize("filters", FILTERS.values(), ids=list(FILTERS))
@pytest.mark.parametrize("name", some(COLUMNS, 2))
@pytest.mark.parametrize("lengths", [(1000,), (10, 600, 0, 54, 336), (640, 360)])
def test_chunks_are_those_of_hdf5(tmp_path: Path, name: str, filters: dict[str, Any], lengths: tuple[int, ...]) -> None:
    values = COLUMNS[name]
    with h5py.File(tmp_path / "ours.h5", "w") as ours, h5py.File(tmp_path / "theirs.h5", "w") as theirs:
        column, reference = _create(ours, values, filters), _create(theirs, values, filters)
        writer, begin = ColumnWriter(column), 0
        for length in lengths:
            writer.append(values[begin : begin + length])
            begin += length
        reference.resize(len(values), axis=0)
        reference[:] = values
        ours.flush()
        theirs.flush()
        for start in range(0, len(values), CHUNK):
            place = (start, *[0] * (values.ndim - 1))
            stored = column.id.read_direct_chunk(place)
            if start + CHUNK <= len(values):
                assert stored == reference.id.read_direct_chunk(place)
    with h5py.File(tmp_path / "ours.h5") as ours:  # HDF5 compares the check sums
        assert np.array_equal(ours["column"][:], values)


def test_values_of_another_type_are_converted_by_hdf5(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "ours.h5", "w") as file:
        column = _create(file, COLUMNS["counts"], FILTERS["of a log"])
        ColumnWriter(column).append(np.full((CHUNK, 3), 70_000))
        assert (column[:] == 32767).all()


def test_without_compiled_code_hdf5_writes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(chunks, "COMPILED", False)
    with h5py.File(tmp_path / "ours.h5", "w") as file:
        column = _create(file, COLUMNS["truth"], FILTERS["of a log"])
        ColumnWriter(column).append(COLUMNS["truth"])
        assert np.array_equal(column[:], COLUMNS["truth"])


@pytest.mark.skipif(not chunks.COMPILED, reason="installed without a C compiler")
@pytest.mark.parametrize(("text", "expected"), [(b"abcde", 0xF04FC729), (b"abcdef", 0x56502D2A)])
def test_check_sum_of_letters(text: bytes, expected: int) -> None:
    """Words of two bytes, the lower first in the usual tables: HDF5's words have the higher first, so bytes change
    places here.
    """
    padded = text + b"\0" * (len(text) % 2)
    swapped = bytes(padded[at ^ 1] for at in range(len(padded)))
    assert chunks.fletcher32(swapped) == expected
