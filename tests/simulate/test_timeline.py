"""Times of rows: the recorder's own poll loop over the emulated bus is the other derivation."""

from __future__ import annotations

import pickle
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from imuarray.acquire import record
from imuarray.array import ArrayConfig, load_array, parse_array
from imuarray.bus import open_bus
from imuarray.errors import ConfigError
from imuarray.log import Block, LogWriter, open_log
from imuarray.log.format import LOST_BEFORE, SensorHeader
from imuarray.simulate.timeline import GapFilledTimes, LogTimes, filled, poll
from tests.selection import examples

CONFIG = Path(__file__).parents[2] / "configs" / "martin2013.toml"


@pytest.fixture(scope="module")
def array() -> ArrayConfig:
    return load_array(CONFIG)


@pytest.fixture(scope="module")
def recorded(array: ArrayConfig, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("timeline") / "run.h5"
    with open_bus("emulated:", array) as bus:
        record(array, bus, path, rate_hz=48.0, seconds=20.0)
    return path


@pytest.mark.slow
def test_rows_have_the_times_of_the_recorder(array: ArrayConfig, recorded: Path) -> None:
    lines = poll(array, 48.0, 20.0)
    with open_log(recorded) as log:
        for name, sensor in log.sensors.items():
            if sensor.quantity == "pressure":
                continue  # depends on when it was first asked
            stamps = lines[name].stamps(0, lines[name].rows)
            times = np.asarray(sensor.time)
            assert len(stamps) == len(times), name
            # spacing alternates on the way there and back; to within a third of a millisecond of polls and self-checks
            assert np.abs(np.diff(stamps) - np.diff(times)).max() < 400_000, name


@pytest.mark.slow
def test_the_barometer_has_the_number_of_rows_of_the_recorder(array: ArrayConfig, recorded: Path) -> None:
    lines = poll(array, 48.0, 20.0)
    with open_log(recorded) as log:
        assert abs(lines["BMP180"].rows - len(log["BMP180"])) <= 1


def test_stamps_increase_and_do_not_depend_on_the_block(array: ArrayConfig) -> None:
    for line in poll(array, 48.0, 30.0).values():
        whole = line.stamps(0, line.rows)
        assert (np.diff(whole) > 0).all()
        np.testing.assert_array_equal(line.stamps(5, 17), whole[5:17])
        assert whole[-1] < 30e9 + 1e7


def test_a_queue_gives_a_row_for_every_sample() -> None:
    array = parse_array(
        '[array]\nname = "a"\n[[sensor]]\nname = "G"\nchip = "l3g4200d"\naddress = 0x68\nrange = 250\nrate_hz = 400\n'
        "fifo = true"
    )
    line = poll(array, 50.0, 10.0)["G"]
    assert (line.rows, line.rows_per_s) == (4000, 400.0)
    assert line.stamps(0, 3).tolist() == [0, 2_500_000, 5_000_000]


def test_frames_are_counted_as_the_recorder_does(array: ArrayConfig) -> None:
    """At 48 Hz a 961st frame would begin 20 ns before the end, by the rounding of the period alone."""
    assert [poll(array, rate_hz, 20.0)["BMA1"].rows for rate_hz in (48.0, 50.0, 9.0)] == [960, 1000, 180]


def test_the_times_of_a_recorded_sensor_are_used(recorded: Path) -> None:
    with open_log(recorded) as log:
        line = LogTimes(log["Gyro1"])
        np.testing.assert_array_equal(line.stamps(10, 20), log["Gyro1"].time[10:20])
        assert line.rows_per_s == pytest.approx(48.0, rel=1e-3)


@pytest.mark.slow
def test_a_recorded_line_is_read_from_its_log_after_pickling(recorded: Path) -> None:
    with open_log(recorded) as log:
        line = LogTimes(log["Gyro1"])
        line.stamps(0, 1), line.stamps(3, 9)
        pickled = pickle.dumps(line)
        again = pickle.loads(pickled)  # noqa: S301
        assert len(pickled) < 1000
        assert (again.rows, again.rows_per_s) == (line.rows, line.rows_per_s)
        np.testing.assert_array_equal(again.stamps(5, 50), log["Gyro1"].time[5:50])
        np.testing.assert_array_equal(again.stamps(7, 8), log["Gyro1"].time[7:8])


class Listed:
    """A timeline with the times that it is given."""

    rows_per_s = 100.0

    def __init__(self, times: Sequence[int]) -> None:
        self._times = np.array(times, np.int64)
        self.rows = len(times)

    def stamps(self, start: int, stop: int) -> np.ndarray:
        assert 0 <= start <= stop <= self.rows
        return self._times[start:stop]


@st.composite
def holed(draw: st.DrawFn) -> tuple[GapFilledTimes, list[int]]:
    """A line with holes, and all its times one by one."""
    missing = draw(st.lists(st.integers(0, 6), min_size=1, max_size=25))
    whole = [draw(st.integers(-(10**17), 10**17))]
    recorded = whole[:]
    for lost in missing:
        end = whole[-1] + draw(st.integers(lost + 1, 10**15))
        whole += [recorded[-1] + (end - recorded[-1]) * step // (lost + 1) for step in range(1, lost + 2)]
        recorded.append(end)
    holes = [(row, lost) for row, lost in enumerate(missing, start=1) if lost]
    before, lost_rows = (np.array([hole[at] for hole in holes], np.int64) for at in (0, 1))
    return GapFilledTimes(Listed(recorded), before, lost_rows), whole


@given(holed(), st.data())
def test_any_block_of_a_line_with_filled_holes_equals_the_whole(
    made: tuple[GapFilledTimes, list[int]], data: st.DataObject
) -> None:
    line, whole = made
    assert line.rows == len(whole)
    start, stop = sorted(data.draw(st.tuples(*[st.integers(0, len(whole))] * 2)))
    stamps = line.stamps(start, stop)
    assert stamps.dtype == np.int64
    assert stamps.tolist() == whole[start:stop]
    assert (np.diff(stamps) > 0).all()
    assert [line.stamps(row, row + 1).item() for row in range(len(whole))] == whole


def log_of(path: Path, times: np.ndarray, lost_before: Sequence[int] | np.ndarray) -> Path:
    """One accelerometer, read at these times; the rows `lost_before` have the flag."""
    header = SensorHeader("A", "bma180", "specific_force", "g", 4.0, 2048.0, rate_hz=2400.0)
    status = np.zeros(len(times), np.uint16)
    status[list(lost_before)] = LOST_BEFORE
    with LogWriter(path, [header], source="imported", epoch="2024-01-01T00:00:00Z", force=True) as log:
        log.append("A", Block(np.asarray(times, np.int64), np.zeros((len(times), 3), np.int16), status))
    return path


@pytest.mark.slow
@settings(max_examples=examples(30))
@given(
    lost=st.lists(st.booleans(), min_size=1, max_size=60), period_ns=st.integers(1000, 10**8), seed=st.integers(0, 99)
)
def test_an_even_line_is_completed(
    tmp_path_factory: pytest.TempPathFactory, lost: list[bool], period_ns: int, seed: int
) -> None:
    """Times off the grid by a twentieth of its period at most, and by so little that the longest hole's rows can be
    counted where the usual interval is known from one; lost rows are restored to within that.
    """
    kept = np.array([True, True, *(not entry for entry in lost), True])
    rows = np.flatnonzero(kept)
    off = min(0.05, 0.2 / (np.diff(rows).max() + 1))
    apart = np.random.default_rng(seed).uniform(-off, off, len(kept)) * period_ns
    times = np.rint(np.arange(len(kept)) * period_ns + apart).astype(np.int64)
    path = log_of(
        tmp_path_factory.mktemp("even") / "log.h5", times[rows], np.flatnonzero(np.diff(rows, prepend=-1) > 1)
    )
    with open_log(path) as log:
        line = filled(log["A"])
        stamps = line.stamps(0, line.rows)
        assert line.rows == len(kept)
        assert isinstance(line, GapFilledTimes) != kept.all()
        assert line.rows_per_s == pytest.approx(1e9 / period_ns, rel=0.1)
        np.testing.assert_array_equal(stamps[kept], times[kept])
        assert np.abs(stamps - times).max() <= 2 * off * period_ns + 1


def test_holes_with_a_flag_and_room_for_rows_are_filled(tmp_path: Path) -> None:
    """Of those with the flag the ones with room for a row; a gap without the flag stays one."""
    times = np.cumsum([5, 10, 10, 14, 10, 16, 10, 24, 26, 30, 10])
    with open_log(log_of(tmp_path / "log.h5", times, [0, 3, 5, 8, 9])) as log:
        line = filled(log["A"])
        assert isinstance(line, GapFilledTimes)
        assert line.before.tolist() == [5, 8, 9]
        assert line.missing.tolist() == [1, 2, 2]
        assert line.stamps(4, 8).tolist() == [49, 57, 65, 75]
        assert line.rows_per_s == pytest.approx(15 / 160e-9)
        assert list(line.holes()) == [(49, 65, 1), (99, 125, 2), (125, 155, 2)]


def test_holes_are_filled_across_blocks_of_a_long_log(tmp_path: Path) -> None:
    """Blocks of 65536 rows; in the last hundred rows every second one is lost."""
    kept = np.ones(80_000, bool)
    kept[[65_536, 70_000]] = False
    kept[-100::2] = False
    rows = np.flatnonzero(kept)
    flagged = np.flatnonzero(np.diff(rows) > 1) + 1
    assert rows[65_536] == 65_537
    with open_log(log_of(tmp_path / "log.h5", rows * 10_000_000, flagged)) as log:
        line = pickle.loads(pickle.dumps(filled(log["A"])))  # noqa: S301
        np.testing.assert_array_equal(line.stamps(0, line.rows), np.arange(80_000) * 10_000_000)
        assert len(line.before) == 52


def test_a_log_without_flags_has_no_holes(tmp_path: Path) -> None:
    times = np.array([0, 10, 20, 50, 60])
    with open_log(log_of(tmp_path / "log.h5", times, [])) as log:
        assert isinstance(filled(log["A"]), LogTimes)
    with open_log(log_of(tmp_path / "one.h5", times[:1], [0])) as log:
        assert filled(log["A"]).rows == 1
    with open_log(log_of(tmp_path / "two.h5", times[:2], [0, 1])) as log:  # the usual interval is unknown
        assert filled(log["A"]).rows == 2


PERIOD_NS = 10_000_000


def regular(rows: int, missing: Sequence[int], jitter: float = 0.02, seed: int = 0) -> np.ndarray:
    """Times of rows at 100 Hz, a little off the grid, without those that are missing."""
    kept = np.setdiff1d(np.arange(rows), missing)
    return np.rint((kept + np.random.default_rng(seed).normal(0, jitter, len(kept))) * PERIOD_NS).astype(np.int64)


@pytest.mark.parametrize("rows", [1000, 65_610, 70_000])
def test_missing_rows_of_a_regular_record_are_lost_also_without_a_flag(tmp_path: Path, rows: int) -> None:
    """Gaps of one, two and three rows at uneven distances, one of them where blocks of 65536 rows meet, and one in the
    last block, however short that is.
    """
    missing = [50, 61, 62, 300, 301, 302, 700, *([65_537, rows - 30] if rows > 65_536 else [])]
    times = regular(rows, missing)
    with open_log(log_of(tmp_path / "log.h5", times, [])) as log:
        line = filled(log["A"])
        assert isinstance(line, GapFilledTimes)
        assert line.rows == rows
        assert line.missing.tolist() == [1, 2, 3, 1, *([1, 1] if rows > 65_536 else [])]
        assert np.abs(line.stamps(0, rows) - np.arange(rows) * PERIOD_NS).max() < 0.12 * PERIOD_NS


def test_a_late_row_is_not_a_lost_row(tmp_path: Path) -> None:
    """A busy host reads some rows most of a period late: the next rows are early by as much."""
    late = regular(1000, [])
    late[[100, 430, 431, 800]] += PERIOD_NS * 7 // 10
    with open_log(log_of(tmp_path / "log.h5", late, [])) as log:
        assert isinstance(filled(log["A"]), LogTimes)


@pytest.mark.slow
def test_other_gaps_are_no_losses_of_a_regular_record(tmp_path: Path) -> None:
    """Evenly spaced gaps, gaps that do not fit the period, long ones, and any gap among irregular times."""
    rng = np.random.default_rng(1)
    uneven = [57, 130, 390, 444, 910]
    pauses = regular(1000, [])
    for row in uneven:
        pauses[row:] += PERIOD_NS * 55 // 100
    records = {
        "beat": regular(1000, list(range(37, 1000, 90))),
        "pauses": pauses,
        "long": regular(1000, list(range(300, 330))),
        "few": regular(150, [20, 33, 90]),
        "irregular": np.cumsum(rng.exponential(PERIOD_NS, 1000).astype(np.int64) + 1),
    }
    for name, times in records.items():
        with open_log(log_of(tmp_path / f"{name}.h5", times, [])) as log:
            assert isinstance(filled(log["A"]), LogTimes), name


@pytest.mark.parametrize("flagged", [False, True])
def test_pauses_of_the_recorder_do_not_change_the_rate(tmp_path: Path, *, flagged: bool) -> None:
    """At 100 Hz, one row lost in a hundred, and pauses of six seconds and two, which are 8 s of 18; where rows are
    flagged as lost, so are those of the pauses.
    """
    missing = [*range(37, 1800, 100), *range(200, 800), *range(900, 1100)]
    times = regular(1800, missing, jitter=0.0)
    (gaps,) = np.nonzero(np.diff(times) > 1.5 * PERIOD_NS)
    with open_log(log_of(tmp_path / "log.h5", times, gaps + 1 if flagged else [])) as log:
        assert filled(log["A"]).rows_per_s == pytest.approx(100.0, rel=0.01 if flagged else 0.02)
        assert LogTimes(log["A"]).rows_per_s == pytest.approx(100.0 * 0.99, rel=0.01)


def test_flagged_losses_are_filled_among_evenly_spaced_gaps(tmp_path: Path) -> None:
    times = regular(1000, list(range(37, 1000, 90)))
    (gaps,) = np.nonzero(np.diff(times) > 1.5 * PERIOD_NS)
    with open_log(log_of(tmp_path / "log.h5", times, gaps[3:5] + 1)) as log:
        line = filled(log["A"])
        assert isinstance(line, GapFilledTimes)
        assert line.before.tolist() == (gaps[3:5] + 1).tolist()


THREE_CHANNELS = """
[array]
name = "three"
mux = { chip = "pca9544a", address = 0x70 }
""" + "".join(
    f"""
[[sensor]]
name = "A{channel}"
chip = "adxl345"
address = 0x53
channel = {channel}
range = 2
"""
    for channel in range(3)
)


def test_a_rate_that_the_bus_cannot_keep_is_an_error() -> None:
    """Three bursts of 11 bytes and two switches of the multiplexer, 3 * 99 + 2 * 19 clocks at 400 kHz, take 0.8375 ms.
    The first sensor of a frame is the last one of the next, 0.59 ms later: at 1695 frames a second both have one time.
    """
    array = parse_array(THREE_CHANNELS)
    assert all(np.diff(line.stamps(0, 100)).min() > 0 for line in poll(array, 1690.0, 1.0).values())
    with pytest.raises(ConfigError, match=r"1695 frames per second: the bus needs 0.837 ms .* at most 1194 frames"):
        poll(array, 1695.0, 1.0)


def test_bursts_on_spi_take_eight_clocks_a_byte() -> None:
    """At 1 MHz, a register and 14 bytes take 120 us; nothing is switched."""
    halves = "".join(
        f"""
[[sensor]]
name = "I{number}_{kind}"
chip = "icm42688"
bus = "/dev/spidev0.{number}"
spi_clock_hz = 1_000_000
fifo = false
range = {span}
rate_hz = 1000
"""
        for number in range(2)
        for kind, span in (("acc", 4), ("gyro", 500))
    )
    lines = poll(parse_array(f"[array]\nname = 'two'\n{halves}"), 100.0, 1.0)
    first, second = (int(lines[name].stamps(0, 1)[0]) for name in ("I0_acc", "I1_acc"))
    assert second - first == 2 * 120_000
