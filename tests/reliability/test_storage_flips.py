"""A flipped bit anywhere in a log: every value that is read is as it was written, and missing rows are reported.

A log has rows of noise and rows of zeros, events, a phase, a track of truth. One bit of one of its files is flipped at
a time. A row is identified by its time. Rows may be missing, or a text be another, only if the log reports it: by
`Log.losses`, or by a LogError for reads of them, and `verify` must report it too. It is refused only where nothing else
has its rows.
"""

from __future__ import annotations

import random
import shutil
from collections import Counter
from collections.abc import Iterable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

import imuarray.log.writer as writing
from imuarray.errors import LogError
from imuarray.log import Block, Log, LogWriter, Stimulus
from imuarray.log.format import Event, Phase, SensorHeader
from imuarray.log.journal import journal_of
from imuarray.log.reader import verify
from imuarray.log.writer import recover
from tests.selection import some

EPOCH, CONFIG = "2026-01-01T00:00:00Z", '# toml\nname = "x"\n' * 20
PERIOD_NS = 10_000_000
ROWS, BATCH, CHUNK = 2000, 400, 1500
"""A commit comes with the fourth batch; the rows of the fifth are in the journal alone."""
RUN, JOURNAL = "run.h5", "run.h5.journal"
HEADERS = (
    SensorHeader("Noise", "bma180", "specific_force", "g", 16.0, 512.0, has_temperature=True),
    SensorHeader("Zeros", "l3g4200d", "angular_rate", "dps", 250.0, 114.3, delay_ns=7),
    SensorHeader(
        "Baro",
        "bmp180",
        "pressure",
        "Pa",
        0,
        0,
        columns=("ut", "up"),
        compensated=("temperature", "pressure"),
        extra={"AC1": 408},
    ),
)
EVENTS = tuple(Event(number * 50 * PERIOD_NS, "Noise", "note", f"event {number}") for number in range(20))
PHASE = Phase(0, 5 * PERIOD_NS, "static", "+Z")
ATTRIBUTES = ("chip", "quantity", "unit", "range", "sensitivity", "rate_hz", "bandwidth_hz", "axes")


def block(sensor: int, row: np.ndarray[Any, np.dtype[np.int64]]) -> Block:
    """The rows of a sensor with these numbers (n,)."""
    status = np.zeros(len(row), np.uint16)
    if sensor == 2:
        counts = np.stack([row + 27_898, row + 20_000], axis=1).astype(np.int32)
        return Block(row * 10 * PERIOD_NS, counts, status, None, {"temperature": row + 0.5, "pressure": row + 99e3})
    if sensor == 1:
        return Block(row * PERIOD_NS, np.zeros((len(row), 3), np.int16), status)
    counts = (row[:, None] * 7919 + np.array([1, 12_345, 30_011])) % 65_521 - 32_760
    return Block(row * PERIOD_NS, counts.astype(np.int16), (row % 64).astype(np.uint16), (row % 251).astype(np.int16))


class Logs(NamedTuple):
    """Folders with the same log: cut short with its journal, and finished."""

    unfinished: Path
    finished: Path


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> Logs:
    finished = tmp_path_factory.mktemp("finished")
    unfinished = tmp_path_factory.mktemp("unfinished")
    options = {"source": "emulated", "epoch": EPOCH, "config": CONFIG, "frame_rate_hz": 100.0}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(writing, "CHUNK", CHUNK)
        with LogWriter(finished / "run.h5", HEADERS, **options) as log:  # type: ignore[arg-type]
            log.keep()
            for event in EVENTS:
                log.event(event)
            log.phase(PHASE)
            log.flush()
            for first in range(0, ROWS, BATCH):
                row = np.arange(first, first + BATCH)
                zeros = np.zeros((BATCH, 3))
                log.stimulus("truth", Stimulus(row * PERIOD_NS, zeros, zeros, np.zeros(BATCH)))
                for sensor, numbers in enumerate((row, row, row[::10] // 10)):
                    log.append(HEADERS[sensor].name, block(sensor, numbers))
                log.flush()
            for path in (finished / "run.h5", journal_of(finished / "run.h5")):
                shutil.copy(path, unfinished / path.name)
    return Logs(unfinished, finished)


class Outcome(NamedTuple):
    """The result of one flip."""

    wrong: tuple[str, ...]
    missing: int
    is_told: bool


def read(path: Path) -> Outcome:
    """Everything in a log, compared with the written values; LogError if it can't be opened."""
    wrong: list[str] = []
    missing, is_told = 0, False
    with Log(path) as log:
        is_told = bool(log.losses)
        for sensor, header in enumerate(HEADERS):
            rows = ROWS if sensor < 2 else ROWS // 10
            try:
                stored = log[header.name]
                row = np.asarray(stored.time[:]) // (PERIOD_NS * (10 if sensor == 2 else 1))
                good = block(sensor, row)
                columns = {"time": stored.time, "counts": stored.counts, "status": stored.status}
                columns["temperature_counts"] = stored.temperature_counts
                for name, column in columns.items():
                    expected = getattr(good, name)
                    if expected is not None and not np.array_equal(np.asarray(column[:]), expected):
                        wrong.append(f"{header.name}.{name}")
                for name, expected in good.compensated.items():
                    if not np.array_equal(np.asarray(stored.compensated(name)[:]), expected):
                        wrong.append(f"{header.name}.{name}")
                if len(row) and (row[0] < 0 or row[-1] >= rows):
                    wrong.append(f"{header.name}: rows that were never written")
                missing += rows - len(row)
                wrong += [
                    f"{header.name}.{name}" for name in ATTRIBUTES if getattr(stored, name) != getattr(header, name)
                ]
            except LogError:
                is_told = True
        try:
            truth = log.truth
            missing += ROWS - (0 if truth is None else len(truth.time))
            if truth is not None:
                zeros = (truth.specific_force, truth.angular_rate, truth.temperature)
                wrong += ["truth" for column in zeros if column is None or np.asarray(column[:]).any()]
                wrong += ["truth.time"] if (np.asarray(truth.time[:]) % PERIOD_NS).any() else []
        except LogError:
            is_told = True
        try:
            noted = [event for event in log.events if event.kind == "note"]
            others = [event for event in log.events if event.kind not in ("note", "damaged", "recovered")]
            wrong += [] if set(noted) <= set(EVENTS) and not others else ["events"]
            missing += len(EVENTS) - len(noted)
        except LogError:
            is_told = True
        try:
            wrong += [] if set(log.phases) <= {PHASE} else ["phases"]
            missing += 1 - len(log.phases)
        except LogError:
            is_told = True
        about = (log.source, log.epoch, log.config, log.frame_rate_hz)
        wrong += [] if about == ("emulated", EPOCH, CONFIG, 100.0) else ["attributes"]
    return Outcome(tuple(wrong), missing, is_told)


def flips(
    folder: Path, name: str, work: Path, places: Iterable[int], seed: int, others: Iterable[str] = ()
) -> Counter[str]:
    """Flip a bit of the file `name` at each of the `places`, with `others` in its folder; count the outcomes."""
    draw = random.Random(seed)
    content = (folder / name).read_bytes()
    for other in others:
        shutil.copy(folder / other, work / other)
    kinds: Counter[str] = Counter()
    for at in places:
        spoilt = bytearray(content)
        spoilt[at % len(content)] ^= 1 << draw.randrange(8)
        (work / name).write_bytes(spoilt)
        try:
            outcome = read(work / RUN)
        except LogError:
            kinds["refused"] += 1
            continue
        if outcome.is_told:
            assert verify(work / RUN).problems, f"bit in byte {at}: verify does not notice"
        elif draw.random() < 0.2:
            assert not verify(work / RUN).problems, f"bit in byte {at}: verify finds what reading does not"
        if outcome.wrong:
            assert outcome.is_told, f"bit in byte {at}: wrong and not told: {outcome.wrong}"
            kinds["wrong, told"] += 1
        elif outcome.missing:
            assert outcome.is_told, f"bit in byte {at}: {outcome.missing} rows or notes are missing, and it is not told"
            kinds["missing, told"] += 1
        else:
            kinds["told" if outcome.is_told else "whole"] += 1
    print(f"{name} of {folder.name}: {len(content)} bytes, {dict(kinds)}")
    return kinds


def places(count: int, seed: int) -> list[int]:
    draw = random.Random(seed)
    return [draw.randrange(1 << 40) for _ in range(count)]


COUNT = [10, pytest.param(300, marks=pytest.mark.campaign)]


@pytest.mark.parametrize("count", COUNT)
class TestFlips:
    @pytest.mark.slow
    def test_a_flip_in_the_journal_of_an_existing_file_loses_nothing_of_the_file(
        self, logs: Logs, tmp_path: Path, count: int
    ) -> None:
        """No row in the file is lost: three of five batches."""
        kinds = flips(logs.unfinished, JOURNAL, tmp_path, places(count, 1), 1, [RUN])
        assert kinds["whole"] + kinds["missing, told"] == count
        assert kinds["whole"] >= 0.6 * count - 3 * (0.6 * 0.4 * count) ** 0.5

    @pytest.mark.slow
    def test_a_flip_in_a_journal_alone_loses_one_block(self, logs: Logs, tmp_path: Path, count: int) -> None:
        """The rows of one block are lost, and reported."""
        kinds = flips(logs.unfinished, JOURNAL, tmp_path, places(count, 2), 2)
        assert kinds["whole"] + kinds["missing, told"] == count

    @pytest.mark.slow
    def test_a_flip_in_the_file_of_an_unfinished_log_loses_nothing(
        self, logs: Logs, tmp_path: Path, count: int
    ) -> None:
        """The journal contains all rows: nothing is lost, for a flip anywhere in the file."""
        kinds = flips(logs.unfinished, RUN, tmp_path, places(count, 3), 3, [JOURNAL])
        assert kinds["whole"] == count

    @pytest.mark.slow
    def test_a_flip_in_an_unfinished_log_without_its_journal_loses_one_commit(
        self, logs: Logs, tmp_path: Path, count: int
    ) -> None:
        """The rows of one commit are lost; refused if HDF5 can't read its own structures."""
        kinds = flips(logs.unfinished, RUN, tmp_path, places(count, 4), 4)
        assert kinds["missing, told"] + kinds["refused"] == count
        assert kinds["refused"] <= 0.1 * count + 3 * (0.09 * count) ** 0.5

    @pytest.mark.slow
    def test_a_flip_in_a_finished_log_is_reported(self, logs: Logs, tmp_path: Path, count: int) -> None:
        """Reading a damaged row is a LogError, a damaged sensor is left out, a changed text is reported;
        refused only if the root of the file is hit. This log is short: half of it are structures of HDF5.
        """
        kinds = flips(logs.finished, RUN, tmp_path, places(count, 5), 5)
        assert sum(kinds.values()) == count
        assert kinds["refused"] <= 0.1 * count + 3 * (0.09 * count) ** 0.5


@pytest.mark.slow
@pytest.mark.parametrize("step", [97, pytest.param(7, marks=pytest.mark.campaign)])
def test_a_flip_in_the_first_6_kb_of_an_unfinished_log_loses_nothing(logs: Logs, tmp_path: Path, step: int) -> None:
    """Superblock, headers, preamble, attributes: the journal alone suffices."""
    at = range(0, 6006, step)
    assert flips(logs.unfinished, RUN, tmp_path, at, 6, [JOURNAL])["whole"] == len(at)


@pytest.mark.slow
@pytest.mark.parametrize("share", some([0.1, 0.3, 0.5, 0.95], 1))
def test_recover_combines_the_good_rows_of_two_damaged_files(logs: Logs, tmp_path: Path, share: float) -> None:
    """One block of one sensor is lost at the most, and only if both files are hit there."""
    for name in (RUN, JOURNAL):
        content = bytearray((logs.unfinished / name).read_bytes())
        content[round(len(content) * share)] ^= 16
        (tmp_path / name).write_bytes(content)
    recover(tmp_path / RUN)
    outcome = read(tmp_path / RUN)
    assert outcome.wrong == ()
    assert outcome.missing <= BATCH
    with Log(tmp_path / RUN) as log:
        assert log.state == "finished"
        assert any(event.kind == "damaged" for event in log.events) == (outcome.missing > 0)
