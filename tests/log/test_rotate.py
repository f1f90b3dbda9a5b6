"""A recording in parts: every row in the part of its time, none lost, each part finished while the next is written."""

from __future__ import annotations

import contextlib
import threading
import time
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from imuarray.errors import DiskFullError, OutputExistsError
from imuarray.log import Block, LogWriter, RotatingWriter, Stimulus, open_log
from imuarray.log.format import Event, Phase, SensorHeader
from tests.selection import examples

HEADERS = tuple(SensorHeader(name, "l3g4200d", "angular_rate", "dps", 250.0, 114.3) for name in ("A", "B"))
SECOND = 1_000_000_000


def rows(first: int, count: int, offset: int = 0) -> Block:
    """Ten rows a second."""
    row = np.arange(first, first + count)
    return Block(
        row * (SECOND // 10) + offset, np.stack([row] * 3, axis=1).astype(np.int16), np.zeros(count, np.uint16)
    )


def rotating(path: Path, every_s: float = 1.0, *, force: bool = False) -> RotatingWriter:
    return RotatingWriter(path, HEADERS, every_s=every_s, source="i2c", epoch="2026-01-01T00:00:00Z", force=force)


@pytest.mark.slow
def test_each_part_has_its_rows_phases_and_truth(tmp_path: Path) -> None:
    with rotating(tmp_path / "run.h5") as log:
        log.keep()
        log.phase(Phase(SECOND // 2, 10**15, "static", "+Z"))
        for first in range(0, 35, 7):
            log.append("A", rows(first, 7))
            log.append("B", rows(first, 7, 3))
            log.stimulus("truth", Stimulus(rows(first, 7).time, np.ones((7, 3)), np.ones((7, 3)), np.ones(7)))
            log.event(Event(int(rows(first, 1).time[0]), "A", "note", str(first)))
        log.flush()
        assert log.acknowledged == {"A": 35, "B": 35}
        for _ in range(500):
            with open_log(tmp_path / "run_001.h5") as part:
                if part.state == "finished":
                    break
            time.sleep(0.01)
        else:
            pytest.fail("the first part is not finished while the last one is written")
    assert [path.name for path in log.paths] == [f"run_00{number}.h5" for number in (1, 2, 3, 4)]
    assert sorted(tmp_path.iterdir()) == log.paths
    for number, path in enumerate(log.paths):
        with open_log(path) as part:
            for name, offset in (("A", 0), ("B", 3)):
                expected = rows(number * 10, 10 if number < 3 else 5, offset)
                np.testing.assert_array_equal(part[name].time[:], expected.time)
                np.testing.assert_array_equal(part[name].counts[:], expected.counts)
            assert part.epoch == "2026-01-01T00:00:00Z"
            end_ns = (number + 1) * SECOND if number < 3 else 34 * SECOND // 10 + 3 + 1
            assert part.phases == (Phase(max(number * SECOND, SECOND // 2), end_ns, "static", "+Z"),)
            assert part.truth is not None
            assert len(part.truth.time) == len(part["A"])
            assert {int(event.message) // 10 for event in part.events} <= {number, number - 1}  # late ones go on


@pytest.mark.slow
@settings(max_examples=examples(10), deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(lengths=st.lists(st.integers(1, 30), min_size=1, max_size=6), every_s=st.sampled_from([0.3, 1.0, 2.5]))
def test_no_row_is_lost_for_any_blocks(tmp_path: Path, lengths: list[int], every_s: float) -> None:
    """Also where one sensor falls silent: parts do not wait for it for ever."""
    with rotating(tmp_path / "run.h5", every_s, force=True) as log:
        first = 0
        for length in lengths:
            log.append("A", rows(first, length))
            first += length
        log.append("B", rows(0, 1))
    assert len(log.paths) >= first * 0.1 // every_s
    back = []
    for path in log.paths:
        with open_log(path) as part:
            back += part["A"].time[:].tolist()
    assert back == rows(0, first).time.tolist()


def test_an_error_keeps_a_kept_log_and_leaves_no_drafts(tmp_path: Path) -> None:
    for kept in (True, False):
        with pytest.raises(RuntimeError, match="mine"), rotating(tmp_path / f"{kept}.h5") as log:
            if kept:
                log.keep()
            log.append("A", rows(0, 5))
            raise RuntimeError("mine")
    assert [path.name for path in tmp_path.iterdir()] == ["True_001.h5"]
    with open_log(tmp_path / "True_001.h5") as log:
        assert len(log["A"]) == 5


@pytest.mark.slow
@pytest.mark.parametrize(("is_kept", "fails"), [(False, False), (True, True)])
def test_the_phases_of_the_last_part_are_written_when_the_recording_ends(
    tmp_path: Path, is_kept: bool, fails: bool
) -> None:
    """After an orderly end, and, in a log that is kept, after an error."""
    with contextlib.suppress(RuntimeError), rotating(tmp_path / "run.h5") as log:
        if is_kept:
            log.keep()
        log.phase(Phase(0, 10**15, "static", "+Z"))
        for name in ("A", "B"):
            log.append(name, rows(0, 5))
        if fails:
            raise RuntimeError("mine")
    with open_log(tmp_path / "run_001.h5") as part:
        assert part.phases == (Phase(0, 4 * SECOND // 10 + 1, "static", "+Z"),)


def test_existing_files_are_not_overwritten(tmp_path: Path) -> None:
    (tmp_path / "run_002.h5").write_text("precious")
    with pytest.raises(OutputExistsError, match=r"run_002\.h5"), rotating(tmp_path / "run.h5") as log:
        log.append("A", rows(0, 15))
    assert (tmp_path / "run_002.h5").read_text() == "precious"
    with pytest.raises(ValueError, match="a positive length"):
        rotating(tmp_path / "x.h5", 0)


def parts_made_by(monkeypatch: pytest.MonkeyPatch) -> list[tuple[str, bool]]:
    """Name of each file that is created, and whether appending had to wait for it."""
    made: list[tuple[str, bool]] = []
    real = LogWriter.keep

    def noted(self: LogWriter) -> None:
        made.append((self.path.name, threading.current_thread() is threading.main_thread()))
        real(self)

    monkeypatch.setattr(LogWriter, "keep", noted)
    return made


@pytest.mark.slow
def test_appending_does_not_wait_for_the_next_part(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made = parts_made_by(monkeypatch)
    with rotating(tmp_path / "run.h5") as log:
        log.keep()
        for first in range(30):
            log.append("A", rows(first, 1))
            log.append("B", rows(first, 1, 3))
    assert made == [("run_001.h5", True)] + [(f"run_00{number}.h5", False) for number in (2, 3, 4)]
    assert sorted(tmp_path.iterdir()) == log.paths  # the fourth was never needed
    assert [path.name for path in log.paths] == ["run_001.h5", "run_002.h5", "run_003.h5"]


@pytest.mark.slow
def test_the_error_of_a_part_created_ahead_is_raised_when_it_is_required(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its error is raised when the part is required, and not where it never is."""
    real = LogWriter.keep

    def full(self: LogWriter) -> None:
        if self.path.name == "run_002.h5":
            raise DiskFullError(self.path, "no room")
        real(self)

    monkeypatch.setattr(LogWriter, "keep", full)
    for count in (10, 11):
        with ExitStack() as stack:
            if count == 11:
                stack.enter_context(pytest.raises(DiskFullError, match=r"run_002\.h5: no room"))
            log = stack.enter_context(rotating(tmp_path / "run.h5", force=True))
            log.keep()
            for first in range(count):
                log.append("A", rows(first, 1))
        with open_log(tmp_path / "run_001.h5") as first_part:
            assert len(first_part["A"]) == 10


@pytest.mark.slow
def test_an_older_log_is_replaced_when_its_part_begins_and_not_before(tmp_path: Path) -> None:
    for name in ("run_002.h5", "run_003.h5"):
        (tmp_path / name).write_text("older")
    with rotating(tmp_path / "run.h5", force=True) as log:
        log.keep()
        for first in range(19):
            log.append("A", rows(first, 1))
    with open_log(tmp_path / "run_002.h5") as part:
        assert len(part["A"]) == 9
    assert (tmp_path / "run_003.h5").read_text() == "older"


@pytest.mark.slow
def test_a_part_without_rows_is_not_written(tmp_path: Path) -> None:
    """No sensor had a row in the second part, which was created ahead; it is removed, and later parts exist."""
    with rotating(tmp_path / "run.h5") as log:
        log.keep()
        for first in (8, 20, 30, 40):
            log.append("A", rows(first, 2))
            log.append("B", rows(first, 2, 3))
    assert [path.name for path in log.paths] == ["run_001.h5", "run_003.h5", "run_004.h5", "run_005.h5"]
    assert sorted(tmp_path.iterdir()) == log.paths


@pytest.mark.slow
def test_parts_are_counted_from_the_first_frame(tmp_path: Path) -> None:
    with rotating(tmp_path / "run.h5") as log:
        log.keep()
        log.starts(SECOND // 4)
        log.phase(Phase(0, 10**15, "static"))
        log.event(Event(1, "A", "note", "before it"))
        for first in range(20):
            log.append("A", rows(first, 1, SECOND // 4))
            log.append("B", rows(first, 1, SECOND // 4))
    assert [path.name for path in log.paths] == ["run_001.h5", "run_002.h5"]
    spans = []
    for path in log.paths:
        with open_log(path) as part:
            assert len(part["A"]) == 10
            spans += [(phase.start_ns, phase.end_ns) for phase in part.phases]
    assert spans == [(0, 5 * SECOND // 4), (5 * SECOND // 4, 2_150_000_001)]
