"""Rows written to a log are read back, for any sizes of blocks; invalid rows are refused."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import imuarray.log.writer as writing
from imuarray.errors import LogError, OutputExistsError
from imuarray.log import Block, LogWriter, Stimulus, first_at, open_log
from imuarray.log.format import Event, Phase, SensorHeader
from imuarray.log.untrusted_input import open_file
from tests.selection import examples

Writer = Callable[..., LogWriter]
HEADER = SensorHeader("S", "l3g4200d", "angular_rate", "dps", 250.0, 114.3, has_temperature=True)
EPOCH = "2026-01-01T00:00:00Z"


def rows_of(generator: np.random.Generator, count: int) -> Block:
    return Block(
        np.cumsum(generator.integers(1, 10**9, count)),
        generator.integers(-(2**15), 2**15, (count, 3)).astype(np.int16),
        generator.integers(0, 64, count).astype(np.uint16),
        generator.integers(-128, 128, count).astype(np.int16),
    )


def slices(lengths: list[int]) -> list[slice]:
    ends = np.cumsum(lengths).tolist()
    return [slice(end - length, end) for end, length in zip(ends, lengths, strict=True)]


def columns(path: Path) -> dict[str, np.ndarray]:
    with open_log(path) as log:
        sensor = log["S"]
        assert sensor.temperature_counts is not None
        return {
            "time": sensor.time[:],
            "counts": sensor.counts[:],
            "status": np.asarray(sensor.status[:]),
            "temperature_counts": sensor.temperature_counts[:],
        }


@settings(max_examples=examples(25), deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(lengths=st.lists(st.integers(0, 25), max_size=12), seed=st.integers(0, 2**32 - 1), chunk=st.integers(1, 16))
def test_rows_round_trip_for_any_blocks_and_chunks(tmp_path: Path, lengths: list[int], seed: int, chunk: int) -> None:
    rows = rows_of(np.random.default_rng(seed), sum(lengths))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(writing, "CHUNK", chunk)
        with LogWriter(tmp_path / "r.h5", [HEADER], source="simulated", epoch=EPOCH, force=True) as log:
            for part in slices(lengths):
                log.append("S", Block(*(column[part] for column in rows[:4])))
    back = columns(tmp_path / "r.h5")
    for name, expected in zip(("time", "counts", "status", "temperature_counts"), rows[:4], strict=True):
        np.testing.assert_array_equal(back[name], expected)
        assert back[name].dtype == expected.dtype


def test_blocks_across_chunks_are_read_back(tmp_path: Path) -> None:
    rows = rows_of(np.random.default_rng(1), 10_000)
    for name, lengths in (("one", [10_000]), ("odd", [4095, 1, 1, 4097, 1806]), ("many", [100] * 100)):
        with LogWriter(tmp_path / f"{name}.h5", [HEADER], source="simulated", epoch=EPOCH) as log:
            for part in slices(lengths):
                log.append("S", Block(*(column[part] for column in rows[:4])))
        back = columns(tmp_path / f"{name}.h5")
        for column, expected in zip(back.values(), rows[:4], strict=True):
            np.testing.assert_array_equal(column, expected)


def test_a_column_that_is_read_caches_two_chunks_and_little_more(tmp_path: Path) -> None:
    """27 columns of nine triads then keep at most 7 MB, not 27 MB that fill up over the first two hours of a log."""
    with LogWriter(tmp_path / "r.h5", [HEADER], source="simulated", epoch=EPOCH) as log:
        log.append("S", rows_of(np.random.default_rng(1), 5))
        log.stimulus("truth", Stimulus(np.arange(5), np.zeros((5, 3)), np.zeros((5, 3)), np.zeros(5)))
    with open_file(tmp_path / "r.h5") as file:
        cached = file.id.get_access_plist().get_cache()[2]
        chunks = [
            int(np.prod(column.chunks)) * column.dtype.itemsize
            for group in (file["sensors/S"], file["truth"])
            for column in group.values()
            if column.chunks
        ]
    assert max(chunks) == 4096 * 3 * 8
    assert 2 * max(chunks) <= cached <= 1 << 18


TEXT = st.text(st.characters(codec="utf-8", exclude_characters="\x00"), max_size=12)


@pytest.mark.slow
@settings(max_examples=examples(20), deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    phases=st.lists(
        st.tuples(st.integers(0, 2**62), st.integers(0, 2**62), TEXT, st.sampled_from(["", "+Z", "-X"])), max_size=4
    ),
    events=st.lists(st.tuples(st.integers(-(2**62), 2**62), TEXT, TEXT, TEXT), max_size=4),
    config=TEXT,
)
def test_phases_events_and_texts_are_read_back(
    tmp_path: Path, phases: list[tuple], events: list[tuple], config: str
) -> None:
    path = tmp_path / "t.h5"
    with LogWriter(path, [HEADER], source="imported", epoch=EPOCH, config=config, force=True) as log:
        for phase in phases:
            log.phase(Phase(*phase))
        for event in events:
            log.event(Event(*event))
    with open_log(path) as log:
        assert log.phases == tuple(Phase(*phase) for phase in phases)
        assert log.events == tuple(Event(*event) for event in events)
        assert (log.config, log.source, log.epoch) == (config, "imported", EPOCH)
        assert len(log["S"]) == 0
        assert list(log) == ["S"]
        assert "S" in log
        assert "T" not in log
        assert log.truth is None
        assert log.reference is None


def test_stimuli_are_read_back(tmp_path: Path) -> None:
    generator = np.random.default_rng(2)
    rows = Stimulus(
        np.arange(7) * 3, generator.normal(size=(7, 3)), generator.normal(size=(7, 3)), generator.normal(size=7)
    )
    with LogWriter(tmp_path / "s.h5", [HEADER], source="simulated", epoch=EPOCH) as log:
        log.stimulus("reference", Stimulus(*(column[:4] for column in rows)))
        log.stimulus("reference", Stimulus(*(column[4:] for column in rows)))
    with open_log(tmp_path / "s.h5") as log:
        track = log.reference
        assert track is not None
        for column, expected in zip(track, rows, strict=True):
            assert column is not None
            np.testing.assert_array_equal(column[:], expected)


@pytest.mark.parametrize("times", [[0, 0], [1, 0], [0, 5, 5], [3, 2, 4]])
def test_time_must_increase_within_a_block(tmp_path: Path, writer: Writer, times: list[int]) -> None:
    count = len(times)
    with (
        writer(tmp_path / "t.h5") as log,
        pytest.raises(ValueError, match="sensor Gyro: time is not strictly increasing"),
    ):
        log.append("Gyro", Block(np.array(times), np.zeros((count, 3), np.int16), np.zeros(count, np.uint16)))


def test_time_must_increase_across_blocks(tmp_path: Path, writer: Writer) -> None:
    row = Block(np.array([5]), np.zeros((1, 3), np.int16), np.zeros(1, np.uint16))
    with writer(tmp_path / "t.h5") as log:
        log.append("Gyro", row)
        with pytest.raises(ValueError, match="strictly increasing"):
            log.append("Gyro", row)
        log.append("Gyro", row._replace(time=np.array([6])))
    with open_log(tmp_path / "t.h5") as log:
        assert log["Gyro"].time[:].tolist() == [5, 6]


def test_columns_of_one_block_must_be_equally_long(tmp_path: Path, writer: Writer) -> None:
    with writer(tmp_path / "t.h5") as log:
        with pytest.raises(ValueError, match="Gyro"):
            log.append("Gyro", Block(np.array([1, 2, 3]), np.ones((2, 3), np.int16), np.zeros(3, np.uint16)))
        with pytest.raises(ValueError, match="Gyro"):
            log.append("Gyro", Block(np.array([4, 5]), np.ones((3, 3), np.int16), np.zeros(2, np.uint16)))


def test_an_exception_leaves_no_file(tmp_path: Path, writer: Writer) -> None:
    with pytest.raises(RuntimeError, match="mine"), writer(tmp_path / "t.h5") as log:
        log.append("Gyro", Block(np.array([1]), np.ones((1, 3), np.int16), np.zeros(1, np.uint16)))
        raise RuntimeError("mine")
    assert list(tmp_path.iterdir()) == []


def test_a_kept_log_survives_an_exception(tmp_path: Path, writer: Writer) -> None:
    with pytest.raises(RuntimeError, match="mine"), writer(tmp_path / "t.h5") as log:
        log.append("Gyro", Block(np.array([1]), np.ones((1, 3), np.int16), np.zeros(1, np.uint16)))
        log.keep()
        raise RuntimeError("mine")
    assert [path.name for path in tmp_path.iterdir()] == ["t.h5"]
    with open_log(tmp_path / "t.h5") as log:
        assert len(log["Gyro"]) == 1


def test_an_impossible_header_leaves_no_file(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="left-handed"):
        LogWriter(
            tmp_path / "t.h5",
            [SensorHeader("S", "c", "pressure", "Pa", 0, 0, axes="+X+Y-Z")],
            source="simulated",
            epoch=EPOCH,
        )
    assert list(tmp_path.iterdir()) == []


def test_the_name_appears_when_the_log_is_complete(tmp_path: Path, writer: Writer) -> None:
    path = tmp_path / "t.h5"
    with writer(path):
        assert not path.exists()
    assert [left.name for left in tmp_path.iterdir()] == ["t.h5"]


def test_a_log_is_overwritten_only_with_force(tmp_path: Path, writer: Writer) -> None:
    path = tmp_path / "t.h5"
    path.write_text("precious")
    with pytest.raises(OutputExistsError, match=r"t\.h5: exists already; .*--force"):
        writer(path)
    assert path.read_text() == "precious"
    assert len(list(tmp_path.iterdir())) == 1
    with pytest.raises(RuntimeError, match="mine"), writer(path, force=True):
        raise RuntimeError("mine")
    assert path.read_text() == "precious"  # the old file is replaced only when the new file is complete
    with writer(path, force=True):
        pass
    assert h5py.is_hdf5(path)


def test_a_path_that_cannot_be_written_is_refused(tmp_path: Path, writer: Writer) -> None:
    with pytest.raises(LogError, match=r"t\.h5: can't be written: No such file or directory"):
        writer(tmp_path / "none" / "t.h5")


@settings(max_examples=examples(30), deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(at=st.lists(st.integers(-10, 60_000), min_size=1, max_size=20), seed=st.integers(0, 1000))
def test_rows_are_located_by_time(tmp_path: Path, at: list[int], seed: int) -> None:
    time = np.cumsum(np.random.default_rng(seed).integers(1, 5, 20_000))
    with h5py.File(tmp_path / f"{os.getpid()}.h5", "w") as file:
        dataset = file.create_dataset("time", data=time, chunks=(4096,))
        for moment in at:
            assert first_at(dataset, moment) == np.count_nonzero(time < moment)
