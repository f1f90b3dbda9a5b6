"""Import of MIMU4444 recordings: counts, time, flags, events, and refusals."""

from __future__ import annotations

import itertools
import struct
from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from imuarray.errors import OutputExistsError, SourceError
from imuarray.importers.guess import guess_map
from imuarray.importers.mimu4444 import import_file, sensors
from imuarray.importers.plausibility import report_of
from imuarray.importers.table import import_table
from imuarray.log import Log, open_log
from imuarray.log.format import LOST_BEFORE, SATURATED
from tests.selection import examples, some

EXTRACT = Path(__file__).parent.parent / "data" / "mimu4444" / "exp_1_extract.bin"
PERIOD = 1_024_000
"""64 MHz / 62.5 Hz."""


def packet(number: int, ticks: int, axes: Sequence[int] = tuple(range(48))) -> bytes:
    body = struct.pack(">BHBI48h", 0xAA, number % 65536, 100, ticks % 2**32, *axes)
    return body + struct.pack(">H", sum(body) % 65536)


def run(numbers: Sequence[int]) -> bytes:
    """Packets of these numbers, each at its nominal time."""
    return b"".join(packet(number, number * PERIOD) for number in numbers)


@pytest.fixture
def out(tmp_path: Path) -> Path:
    return tmp_path / "out.h5"


def source(tmp_path: Path, content: bytes) -> Path:
    path = tmp_path / "data.bin"
    path.write_bytes(content)
    return path


def kinds(log: Log) -> list[str]:
    return [event.kind for event in log.events]


@pytest.mark.slow
def test_packets_are_recognised_by_the_guess(tmp_path: Path, out: Path) -> None:
    """`--guess` proposes the format, and the proposal imports it."""
    recording = source(tmp_path, b"\xa0\x28\x00\xc8" + run(range(20)))
    (tmp_path / "map.toml").write_text(guess_map(recording))
    summary = import_table(recording, tmp_path / "map.toml", out)
    assert (len(summary.sensors), summary.rows) == (16, 20)
    with pytest.raises(SourceError):
        guess_map(source(tmp_path, bytes(range(256)) * 40))


@pytest.mark.slow
def test_a_finding_of_all_sensors_is_one_short_sentence(tmp_path: Path, out: Path) -> None:
    """Rows are missing in all sixteen sensors, in the order of the log: accelerometer, gyroscope, accelerometer."""
    import_file(source(tmp_path, run([*range(100), *range(150, 250)])), out)
    with open_log(out) as log:
        texts = [text for text in report_of(log).quirks if "gap between rows" in text]
    assert len(texts) == 1 and texts[0].startswith("IMU1_acc to IMU8_acc, IMU1_gyro to IMU8_gyro: 1 gap between rows")


def test_headers_of_the_sixteen_sensors() -> None:
    headers = {header.name: header for header in sensors()}
    assert list(headers) == [f"IMU{unit}_{part}" for unit in range(1, 9) for part in ("acc", "gyro")]
    assert {header.chip for header in headers.values()} == {"mpu9150"}
    # The rotation that the recordings' authors give for the units on the other side.
    other = ((0, -1, 0), (-1, 0, 0), (0, 0, -1))
    same = ((1, 0, 0), (0, 1, 0), (0, 0, 1))
    for unit in range(1, 9):
        for part in ("acc", "gyro"):
            assert headers[f"IMU{unit}_{part}"].orientation == (same if unit % 2 else other)
    assert headers["IMU3_acc"].position_mm == (-9.45, -9.45, 1.0)
    assert headers["IMU6_gyro"].position_mm == (9.45, 9.45, -1.0)
    assert np.sum([header.position_mm for header in headers.values()], axis=0).tolist() == [0, 0, 0]


@pytest.mark.slow
def test_counts_are_assigned_to_their_sensors(tmp_path: Path, out: Path) -> None:
    summary = import_file(source(tmp_path, run([5, 6])), out)
    assert (summary.rows, summary.lost, summary.seconds, summary.events) == (2, 0, 0.016, {})
    with open_log(out) as log:
        assert log["IMU1_acc"].counts[:].tolist() == [[0, 1, 2]] * 2
        assert log["IMU1_gyro"].counts[:].tolist() == [[3, 4, 5]] * 2
        assert log["IMU8_gyro"].counts[:].tolist() == [[45, 46, 47]] * 2
        assert log["IMU8_gyro"].counts.dtype == np.int16
        assert log["IMU1_acc"].time[:].tolist() == [0, 16_000_000]
        assert (log["IMU1_acc"].sensitivity, log["IMU1_acc"].range, log["IMU1_acc"].unit) == (2048, 16, "g")
        assert (log["IMU1_gyro"].sensitivity, log["IMU1_gyro"].range, log["IMU1_gyro"].unit) == (16.4, 2000, "dps")
        assert log["IMU1_gyro"].rate_hz == 62.5
        assert (log.source, log.epoch) == ("imported", "1970-01-01T00:00:00.000000Z")
        (event,) = log.events
        assert "without wall-clock time" in event.message


@pytest.mark.slow
def test_the_ends_of_the_code_span_are_saturated(tmp_path: Path, out: Path) -> None:
    axes = [0] * 48
    axes[1], axes[9] = 32767, -32768
    import_file(source(tmp_path, packet(1, 0, axes) + packet(2, PERIOD)), out)
    with open_log(out) as log:
        full = {name: sensor.status[:].tolist() for name, sensor in log.sensors.items() if np.any(sensor.status[:])}
    assert full == {"IMU1_acc": [SATURATED, 0], "IMU2_gyro": [SATURATED, 0]}


def test_a_gap_gives_a_flag_and_an_event_and_no_rows(tmp_path: Path, out: Path) -> None:
    summary = import_file(source(tmp_path, run([1, 2, 6, 7])), out)
    assert (summary.rows, summary.lost, summary.events) == (4, 3, {"lost": 1})
    with open_log(out) as log:
        for sensor in log.sensors.values():
            assert sensor.status[:].tolist() == [0, 0, LOST_BEFORE, 0]
            assert sensor.time[:].tolist() == [0, 16_000_000, 80_000_000, 96_000_000]
        assert log.events[1] == (80_000_000, "", "lost", "3 packets missing before packet 6")


@pytest.mark.slow
def test_a_broken_packet_is_lost_and_garbage_loses_no_packet(tmp_path: Path, out: Path) -> None:
    wrong = bytearray(run([2]))
    wrong[60] ^= 1
    content = run([1]) + bytes(wrong) + run([3]) + b"garbage" + run([4]) + run([5])[:99]
    summary = import_file(source(tmp_path, content), out)
    assert (summary.rows, summary.lost) == (3, 1)
    assert summary.events == {"checksum": 1, "lost": 1, "garbage": 1, "cut_off": 1}
    with open_log(out) as log:
        assert log["IMU5_acc"].status[:].tolist() == [0, LOST_BEFORE, 0]
        assert [event.message for event in log.events if event.kind in ("garbage", "cut_off")] == [
            "7 bytes that belong to no packet left out",
            "99 bytes at the end are not a whole packet",
        ]


@pytest.mark.slow
def test_a_repeated_packet_is_one_row(tmp_path: Path, out: Path) -> None:
    summary = import_file(source(tmp_path, run([1, 2, 2, 3])), out)
    assert (summary.rows, summary.lost, summary.events) == (3, 0, {"repeated": 1})


@pytest.mark.slow
def test_a_counter_that_jumps_is_noted(tmp_path: Path, out: Path) -> None:
    content = packet(1, 0) + packet(2, PERIOD) + packet(3, 64_000_000)
    assert import_file(source(tmp_path, content), out).events == {"clock": 1}
    with open_log(out) as log:
        assert log["IMU1_acc"].time[:].tolist() == [0, 16_000_000, 1_000_000_000]
        assert "0.984 s by the counter, 0.016 s by the packet numbers" in log.events[1].message


@pytest.mark.slow
def test_events_are_bounded_and_counted(tmp_path: Path, out: Path) -> None:
    summary = import_file(source(tmp_path, run(range(0, 502, 2))), out, block_bytes=1000)
    assert (summary.rows, summary.lost, summary.events) == (251, 250, {"lost": 250})
    with open_log(out) as log:
        assert kinds(log) == ["imported", *["lost"] * 101]
        assert log.events[-1].message == "150 more events of this kind"
        assert np.count_nonzero(log["IMU1_acc"].status[:] == LOST_BEFORE) == 250


STEPS = st.lists(st.one_of(st.just(1), st.integers(1, 100), st.integers(1, 60_000)), max_size=8)


@pytest.mark.slow
@settings(max_examples=examples(20), deadline=None)
@given(st.integers(0, 65535), st.integers(0, 2**32 - 1), STEPS, st.integers(-1000, 1000), st.integers(1, 600))
def test_time_and_losses_are_right_through_every_wrap(
    number: int, ticks: int, steps: list[int], drift: int, block: int
) -> None:
    """Counter and packet number begin at any value, gaps are up to 16 minutes long, the clock has an error of up to 0.1
    %.
    """
    packets = [0, *itertools.accumulate(steps)]
    content = b"".join(packet(number + at, ticks + at * (PERIOD + drift)) for at in packets)
    with TemporaryDirectory() as folder:
        out = Path(folder) / "out.h5"
        summary = import_file(source(Path(folder), content), out, block_bytes=block)
        with open_log(out) as log:
            times = log["IMU4_gyro"].time[:].tolist()
    exact = [Fraction(at * (PERIOD + drift), 64_000_000) * 10**9 for at in packets]
    assert all(abs(time - at) <= Fraction(1, 2) for time, at in zip(times, exact, strict=True))
    assert summary.lost == sum(step - 1 for step in steps)
    assert "clock" not in summary.events


@pytest.mark.parametrize(
    "content", some([b"", b"t,ax,ay,az\n1,2,3,4\n" * 50, bytes(1000), bytes.fromhex("a02800c8"), run([1])[:105]], 2)
)
def test_a_file_without_a_packet_is_refused_and_no_log_remains(tmp_path: Path, out: Path, content: bytes) -> None:
    path = source(tmp_path, content)
    with pytest.raises(SourceError, match=r"data\.bin: no MIMU4444 packet in it; expected packets of 106 bytes"):
        import_file(path, out)
    assert list(tmp_path.iterdir()) == [path]


def test_a_constant_counter_is_refused(tmp_path: Path, out: Path) -> None:
    path = source(tmp_path, packet(1, 5) + packet(2, 5))
    with pytest.raises(SourceError, match=r"data\.bin: packet 2: it has the time stamp of the packet before it"):
        import_file(path, out)
    assert list(tmp_path.iterdir()) == [path]


def test_unreadable_sources_are_refused(tmp_path: Path, out: Path) -> None:
    with pytest.raises(SourceError, match=r"none\.bin: no such file"):
        import_file(tmp_path / "none.bin", out)
    with pytest.raises(SourceError, match="is a folder"):
        import_file(tmp_path, out)
    path = source(tmp_path, run([1]))
    with pytest.raises(SourceError, match="is also the output"):
        import_file(path, path, force=True)
    assert path.read_bytes() == run([1])


@pytest.mark.slow
def test_an_output_is_replaced_only_with_force_and_when_complete(tmp_path: Path, out: Path) -> None:
    good, bad = source(tmp_path, run([1, 2])), tmp_path / "bad.bin"
    bad.write_bytes(b"nothing")
    import_file(good, out)
    before = out.read_bytes()
    with pytest.raises(OutputExistsError):
        import_file(good, out)
    with pytest.raises(SourceError):
        import_file(bad, out, force=True)
    assert out.read_bytes() == before
    import_file(source(tmp_path, run([1, 2, 3])), out, force=True)
    with open_log(out) as log:
        assert len(log["IMU1_acc"]) == 3


@pytest.fixture(scope="module")
def extract(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("extract") / "extract.h5"
    summary = import_file(EXTRACT, out)
    # Packets 505 to 34499 of the recording, 12500 of which are in the extract; all other figures follow from this.
    assert (summary.rows, summary.lost, summary.events) == (12_500, 34_500 - 505 - 12_500, {"lost": 20})
    return out


def box(log: Log, name: str, rows: slice) -> npt.NDArray[np.float64]:
    """Readings of one sensor in its unit, turned into the box frame."""
    sensor = log[name]
    return np.asarray(sensor.counts[rows] / sensor.sensitivity @ sensor.orientation.T)


@pytest.mark.slow
def test_the_rate_of_the_extract(extract: Path) -> None:
    with open_log(extract) as log:
        time = log["IMU2_acc"].time[:]
    assert (34_499 - 505) / (time[-1] * 1e-9) == pytest.approx(62.5, abs=0.001)
    assert np.diff(time[:500]).min() > 15_650_000
    assert np.diff(time[:500]).max() < 16_001_000


@pytest.mark.slow
def test_the_extract_has_twenty_static_orientations(extract: Path) -> None:
    with open_log(extract) as log:
        poses = np.array(
            [
                np.mean(
                    [box(log, f"IMU{unit}_acc", slice(500 * pose, 500 * (pose + 1))) for unit in range(1, 9)], axis=0
                )
                for pose in range(20)
            ]
        )
    assert poses.std(axis=1).max() < 0.003
    means = poses.mean(axis=1)
    assert np.linalg.norm(means, axis=1) == pytest.approx(np.ones(20), abs=0.03)
    cosines = (means @ means.T)[np.triu_indices(20, 1)]
    assert np.degrees(np.arccos(cosines.max())) > 15


@pytest.mark.slow
def test_the_two_sides_of_the_board_agree_in_the_box_frame(extract: Path) -> None:
    """Rates of the shaken stretch without saturated rows: both sides read the same after the rotation."""
    rows = slice(10_000, 12_500)
    with open_log(extract) as log:
        sound = np.all([log[f"IMU{unit}_gyro"].status[rows] & SATURATED == 0 for unit in range(1, 9)], axis=0)
        rates = [box(log, f"IMU{unit}_gyro", rows)[sound] for unit in range(1, 9)]
    assert np.count_nonzero(sound) > 1000
    for other in rates[1:]:
        for axis in range(3):
            assert np.corrcoef(rates[0][:, axis], other[:, axis])[0, 1] > 0.999
