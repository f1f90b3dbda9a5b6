"""Times of rows that stall or arrive in bursts, made with known lengths and rates, and their descriptions."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from imuarray.gap.recording.recordings import recording_of, sources_of
from imuarray.log import Block, LogWriter, open_log
from imuarray.log.format import LOST_BEFORE, Phase, SensorHeader
from imuarray.log.row_timing import (
    EvenRows,
    RowTiming,
    _is_burst,
    even_rows,
    notes_of,
    row_timing,
)

Times = npt.NDArray[np.int64]


def log_with(
    path: Path,
    time_s: npt.NDArray[np.float64],
    counts: npt.NDArray[np.int16] | None = None,
    status: npt.NDArray[np.uint16] | None = None,
) -> Path:
    """A sensor of an unheard-of chip that was read at these times, at rest."""
    header = SensorHeader("S", "unheard_of", "specific_force", "g", 4.0, 8000.0)
    if counts is None:
        noise = np.random.default_rng(4).normal([0, 0, 8000], 9, (len(time_s), 3))
        counts = np.rint(noise).astype(np.int16)
    end_ns = round(time_s[-1] * 1e9)
    with LogWriter(path, [header], source="imported", epoch="1970-01-01T00:00:00Z") as log:
        flags = np.zeros(len(counts), np.uint16) if status is None else status
        log.append("S", Block(np.rint(time_s * 1e9).astype(np.int64), counts, flags))
        log.phase(Phase(0, end_ns, "static", "+Z"))
    return path


def timing_of(path: Path, time_s: npt.NDArray[np.float64]) -> RowTiming:
    with open_log(log_with(path, time_s)) as log:
        return row_timing(log["S"])


def stalling(rows: int, every: int, interval_s: float, stall_s: float) -> npt.NDArray[np.float64]:
    """A row every `interval_s`, and after each given number of rows none for `stall_s`."""
    row = np.arange(rows)
    stalls = row // every
    return (row - stalls) * interval_s + stalls * stall_s


def bursts(rows: int, rate_hz: float, seed: int = 0) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Times of readings, evenly, and of their arrival at a host that reads all available readings, one a
    millisecond, and pauses for 60 ms on average.
    """
    rng = np.random.default_rng(seed)
    read_s = 1 + np.arange(rows) / rate_hz
    arrived, now = np.empty(rows), 0.0
    for row in range(rows):
        if read_s[row] > now:
            now = read_s[row] + rng.exponential(0.06)
        now += 0.001
        arrived[row] = now
    return read_s, arrived


@pytest.mark.parametrize(("every", "stall_s"), [(51, 2.83), (7, 0.4), (200, 11.0)])
def test_periodic_stalls_are_described_with_their_period(tmp_path: Path, every: int, stall_s: float) -> None:
    timing = timing_of(tmp_path / "log.h5", stalling(every * 40, every, 0.017, stall_s))
    assert (timing.kind, timing.period_rows, timing.gaps) == ("stalls", every, 39)
    assert timing.gap_s == pytest.approx(stall_s, rel=1e-6)
    assert timing.gaps_s == pytest.approx(39 * stall_s, rel=1e-6)
    (note,) = notes_of([("Acc", timing), ("Gyro", timing)])
    assert note.startswith(f"Acc, Gyro: rows stall for {stall_s:.3g} s after every {every} rows: no rows in ")
    assert note.endswith("between the stalls they are 17 ms apart (58.82 Hz).")


@pytest.mark.parametrize(("share", "period_rows"), [(0.9, 20), (0.6, 0)])
def test_stalls_without_a_period_are_counted(tmp_path: Path, share: float, period_rows: int) -> None:
    """A share of stalls follows 20 rows, the others 30."""
    lengths = np.where(np.arange(60) % 10 < round(10 * share), 20, 30)
    stalls = np.repeat(np.arange(60), lengths)
    timing = timing_of(tmp_path / "log.h5", np.arange(len(stalls)) * 0.01 + stalls * 1.0)
    assert (timing.kind, timing.period_rows) == ("stalls", period_rows)
    assert ("59 times" in timing.sentence) == (period_rows == 0)


@pytest.mark.parametrize(("every", "is_irregular"), [(9, True), (11, False)])
def test_frequent_gaps_without_a_period_are_irregular_intervals(tmp_path: Path, every: int, is_irregular: bool) -> None:
    """One interval in so many is 40 ms and the others 10 ms, in random order: of every ninth, 879 of 10 ms and 110 of
    40 ms between the first row and the last, or 989 rows in 13.19 s.
    """
    intervals_s = np.where(np.arange(990) % every == 0, 0.04, 0.01)
    timing = timing_of(tmp_path / "log.h5", np.cumsum(np.random.default_rng(2).permutation(intervals_s)))
    assert timing.sentence.startswith("intervals between rows are irregular: 10 ms in the median") == is_irregular
    assert ("40 ms in the median of the longest 11 %; the mean rate is 74.98 Hz" in timing.sentence) == is_irregular
    assert ("rows stall for 0.04 s" in timing.sentence) != is_irregular


@pytest.mark.parametrize(
    ("stalls", "stall_s", "kind"),
    [
        (60, 0.023, "steady"),  # rows that were lost, and the next one late: 2.3 intervals of 0.01 s
        (60, 0.045, "stalls"),
        (6, 2.0, "steady"),
        (12, 2.0, "stalls"),
        (20, 0.035, "steady"),  # 3.5 % of the time
        (20, 0.075, "stalls"),  # 7.5 %
    ],
)
def test_rows_that_are_late_occasionally_are_no_stall(tmp_path: Path, stalls: int, stall_s: float, kind: str) -> None:
    rows = 2000 if stalls == 20 else 900
    assert timing_of(tmp_path / "log.h5", stalling(rows, rows // stalls - 1, 0.01, stall_s)).kind == kind


@pytest.mark.parametrize("rate_hz", [25.0, 99.3, 400.0])
def test_bursts_are_described_with_the_rate_of_the_readings(tmp_path: Path, rate_hz: float) -> None:
    read_s, arrived_s = bursts(12_000, rate_hz)
    with open_log(log_with(tmp_path / "log.h5", arrived_s)) as log:
        result, line = row_timing(log["S"]), even_rows(log["S"])
        assert result.kind == "bursts"
        assert result.rate_hz == pytest.approx(rate_hz, rel=2e-3)
        assert f"The true rate is {result.rate_hz:.4g} Hz" in result.sentence
        even_s = line.stamps(0, 12_000) * 1e-9
        apart_s = even_s - read_s
        assert (
            np.ptp(apart_s) < 0.05 < 0.3 < np.ptp(arrived_s - read_s)
        )  # all are equally late, for a reader that waits
        assert (np.diff(even_s) > 0).all()
        np.testing.assert_array_equal(line.stamps(700, 800), line.stamps(0, 800)[700:])
        assert line.rows_per_s == pytest.approx(rate_hz, rel=2e-3)


def test_equal_groups_of_fast_rows_are_bursts(tmp_path: Path) -> None:
    """A queue of 32 readings, drained at once when it is full, and a recorder that stalls after 32 rows."""
    drained = stalling(32 * 60, 32, 0.0003, 0.32)
    assert timing_of(tmp_path / "queue.h5", drained).kind == "bursts"
    assert timing_of(tmp_path / "stalls.h5", stalling(32 * 60, 32, 0.01, 0.32)).kind == "stalls"


def test_equal_stamps_within_bursts_are_accepted(tmp_path: Path) -> None:
    """A host that reads the queue of a driver of 99.3 Hz every 70 ms, and stamps some rows up to 2 ms later, others
    with the same time (apart by 100 ns in the log).
    """
    arrived_s = np.ceil(np.arange(6000) / 99.3 / 0.07) * 0.07 + np.random.default_rng(6).uniform(0, 0.002, 6000)
    timing = timing_of(tmp_path / "log.h5", np.maximum.accumulate(arrived_s) + 1e-7 * np.arange(6000))
    assert timing.kind == "bursts"
    assert timing.rate_hz == pytest.approx(99.3, rel=2e-3)
    assert timing.gap_s == pytest.approx(0.069, abs=0.002)


def test_bursts_are_decided_by_spread_and_speed() -> None:
    rng = np.random.default_rng(8)
    length_s, other = rng.uniform(0.5, 1.5, (2, 4000))
    standing = (length_s - 1) / length_s.std(), (other - 1) / other.std()
    for correlation, expected in ((0.4, False), (0.7, True)):
        mixed = correlation * standing[0] + np.sqrt(1 - correlation**2) * standing[1]
        assert _is_burst(length_s, np.rint(1000 * (10 + mixed)).astype(np.int64), 5.0) == expected
    behind = np.rint(1000 * (10 + standing[0])).astype(np.int64)
    for scatter, expected in ((0.035, False), (0.07, True)):  # lengths that are all equal decide nothing
        assert _is_burst(1 + scatter * standing[0], behind, 5.0) == expected
    for hurry, expected in ((7.0, False), (14.0, True)):
        assert _is_burst(np.ones(50), np.full(50, 32), hurry) == expected


def test_a_steady_log_has_no_note(tmp_path: Path) -> None:
    jitter = np.random.default_rng(2).uniform(0, 0.004, 3000)
    steady = timing_of(tmp_path / "log.h5", np.arange(3000) * 0.01 + jitter)
    assert (steady.kind, notes_of([("S", steady)])) == ("steady", [])
    with open_log(log_with(tmp_path / "short.h5", np.array([0.5]))) as log:
        assert row_timing(log["S"]).kind == "steady"


def test_knots_are_2048_rows_apart(tmp_path: Path) -> None:
    with open_log(log_with(tmp_path / "log.h5", np.arange(3 * 2048) * 0.01)) as log:
        line = even_rows(log["S"])
    assert line.knot_rows.tolist() == [1023.5, 3071.5, 5119.5]
    assert line.stamps(0, 6144).tolist() == [row * 10_000_000 for row in range(6144)]


def test_bursts_are_compared_at_the_times_of_their_readings(tmp_path: Path) -> None:
    """A line at 20 Hz in the readings stays one, in counts and at its frequency."""
    read_s, arrived_s = bursts(12_000, 99.3)
    line = 300 * np.sin(2 * np.pi * 20.0 * read_s)
    counts = np.rint(np.random.default_rng(4).normal([0, 0, 8000], 9, (12_000, 3)) + line[:, None]).astype(np.int16)
    with open_log(log_with(tmp_path / "log.h5", arrived_s, counts)) as log:
        result = recording_of(log)
        assert any("rows arrive in bursts" in note for note in result.notes)
        _, timeline = result.experiment.plan.sensors["S"]
        assert isinstance(timeline, EvenRows)
        (source,) = sources_of(result).values()
        begin_ns, end_ns = 20 * 10**9, 100 * 10**9
        blocks = list(source.blocks(begin_ns, end_ns))
        assert sum(len(block.time) for block in blocks) == source.rows(begin_ns, end_ns) == pytest.approx(7944, abs=2)
        times = np.concatenate([block.time for block in blocks])
        assert begin_ns <= times[0] < times[-1] < end_ns
        own = np.concatenate([block.counts[:, 0] for block in blocks])
    wave = np.exp(-2j * np.pi * 20.0 * times * 1e-9)
    assert 2 * abs(np.mean(own * wave)) == pytest.approx(300, rel=0.1)
    first = int(np.searchsorted(arrived_s, times[0] * 1e-9 - 0.2))
    assert own[:100].tolist() in [counts[at : at + 100, 0].tolist() for at in range(first, first + 60)]


def test_rows_that_return_to_the_grid_after_a_stall_are_no_burst(tmp_path: Path) -> None:
    """A frame that begins late and the next one on time are closer together than others, once for each stall; longer
    stalls are followed by more rows here, as bursts would be.
    """
    time_s, at_s = [np.zeros(1)], 0.0
    for number in range(12):
        stall_s, rows = 0.8 + 0.05 * number, np.arange(100 + 10 * number) * 0.05
        time_s += [np.array([at_s + stall_s - 0.02]), at_s + stall_s + rows]
        at_s += stall_s + rows[-1]
    timing = timing_of(tmp_path / "log.h5", np.concatenate(time_s))
    assert timing.kind == "stalls"
    assert (timing.gaps, timing.usual_s) == (12, pytest.approx(0.05))


@pytest.mark.parametrize(("flagged", "kind"), [(0.0, "bursts"), (0.4, "bursts"), (0.6, "steady"), (1.0, "steady")])
def test_gaps_flagged_as_lost_are_not_described_as_bursts(tmp_path: Path, flagged: float, kind: str) -> None:
    """Times that look like bursts, where the recorder counted its losses in a share of the gaps."""
    _, arrived_s = bursts(3000, 99.3)
    gaps = np.flatnonzero(np.diff(arrived_s) > 3 * np.median(np.diff(arrived_s))) + 1
    status = np.zeros(3000, np.uint16)
    status[gaps[: round(flagged * len(gaps))]] = LOST_BEFORE
    with open_log(log_with(tmp_path / "log.h5", arrived_s, status=status)) as log:
        timing = row_timing(log["S"])
    assert timing.kind == kind
    assert timing.gaps == len(gaps)
    assert bool(timing.sentence) == (kind == "bursts")


def test_the_usual_interval_is_that_of_most_rows(tmp_path: Path) -> None:
    """A logger that polls at 200 Hz until its buffer is full, and at 100 Hz from then on."""
    intervals_s = np.where(np.arange(200_000) < 1 << 16, 0.005, 0.01)
    timing = timing_of(tmp_path / "a.h5", np.cumsum(intervals_s))
    assert timing.usual_s == pytest.approx(0.01)
    assert timing.kind == "steady"
