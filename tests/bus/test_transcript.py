"""Transcripts: transactions are recorded and replayed, errors included; a first difference is refused with its line."""

from __future__ import annotations

import io
import json
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Self

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from imuarray.acquire import record
from imuarray.array import ArrayConfig, parse_array
from imuarray.bus import open_bus
from imuarray.bus.replay import ReplayBus
from imuarray.bus.transcript import RecordingBus
from imuarray.errors import BusUrlError, OutputExistsError, SensorError
from imuarray.log import open_log
from tests.bus.serial_bench import Bench
from tests.selection import some


class Script:
    """A bus that gives the answers of a list: bytes, or an errno."""

    source = "i2c"

    def __init__(self, answers: list[bytes | int]) -> None:
        self.answers = list(answers)
        self.clock = self
        self.now = 0
        self.closed = 0

    def now_ns(self) -> int:
        self.now += 1000
        return self.now

    def sleep_until(self, at_ns: int) -> None:
        self.now = max(self.now, at_ns)

    def transfer(self, address: int, write: bytes = b"", read: int = 0) -> bytes:
        answer = self.answers.pop(0)
        if isinstance(answer, int):
            raise OSError(answer, "no")
        return answer

    def channel_bus(self, path: str) -> Script:
        return self

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.closed += 1


def lines(path: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in path.read_text().splitlines()]


def transcript(tmp_path: Path, *rows: dict[str, Any] | str) -> Path:
    path = tmp_path / "t.jsonl"
    path.write_text("".join((row if isinstance(row, str) else json.dumps(row)) + "\n" for row in rows))
    return path


def test_lines_are_as_documented(tmp_path: Path) -> None:
    path = tmp_path / "t.jsonl"
    with RecordingBus(Script([b"\xe5", 121, b""]), path) as bus:
        bus.transfer(0x53, b"\x00", 1)
        with pytest.raises(OSError, match="no"):
            bus.transfer(0x1D, b"\x00", 6)
        bus.channel_bus("/dev/i2c-5").transfer(0x70, b"\x04")
    assert lines(path) == [
        {"to": "53", "write": "00", "at_ns": 1000, "read": "e5", "end_ns": 2000},
        {"to": "1d", "write": "00", "at_ns": 3000, "count": 6, "errno": 121, "error": "no", "end_ns": 4000},
        {"to": "70", "write": "04", "at_ns": 5000, "bus": "/dev/i2c-5", "read": "", "end_ns": 6000},
    ]


TRANSACTIONS = st.tuples(
    st.sampled_from(["", "/dev/i2c-11", "/dev/i2c-12"]),
    st.integers(0, 127),
    st.binary(max_size=20),
    st.one_of(st.binary(max_size=30), st.sampled_from([5, 6, 110, 121])),
    st.integers(0, 40),
)


@given(st.lists(TRANSACTIONS, max_size=12))
def test_a_recorded_conversation_is_replayed(
    tmp_path_factory: pytest.TempPathFactory, talk: list[tuple[str, int, bytes, bytes | int, int]]
) -> None:
    path = tmp_path_factory.mktemp("t") / "t.jsonl"

    def say(bus: Any) -> list[bytes | int | None]:
        answers: list[bytes | int | None] = []
        for device, address, write, answer, count in talk:
            target = bus.channel_bus(device) if device else bus
            try:
                answers.append(target.transfer(address, write, len(answer) if isinstance(answer, bytes) else count))
            except OSError as error:
                answers.append(error.errno)
        return answers

    with RecordingBus(Script([answer for *_, answer, _ in talk]), path) as recording:
        first = say(recording)
    with ReplayBus(path) as replay:
        assert say(replay) == first == [answer for *_, answer, _ in talk]
        replay.finished()
        with pytest.raises(SensorError, match=f"ends after {len(talk)} transactions"):
            replay.transfer(0x53)


GOOD = {"to": "53", "write": "00", "read": "e5", "at_ns": 5}


@pytest.mark.parametrize(
    ("address", "write", "read", "message"),
    [
        (0x1D, b"\x00", 1, "recorded 0x53 write 00 read 1, now 0x1d write 00 read 1"),
        (0x53, b"\x01", 1, "recorded 0x53 write 00 read 1, now 0x53 write 01 read 1"),
        (0x53, b"\x00", 2, "recorded 0x53 write 00 read 1, now 0x53 write 00 read 2"),
        (0x53, b"", 0, "recorded 0x53 write 00 read 1, now 0x53 write nothing read 0"),
    ],
)
def test_the_first_difference_is_refused_with_its_line(
    tmp_path: Path, address: int, write: bytes, read: int, message: str
) -> None:
    path = transcript(tmp_path, GOOD, GOOD, GOOD)
    with ReplayBus(path) as bus:
        assert bus.transfer(0x53, b"\x00", 1) == b"\xe5"
        with pytest.raises(SensorError) as refused:
            bus.transfer(address, write, read)
    hint = "replay with the configuration and the options of the recording"
    assert str(refused.value) == f"{path}, line 2: {message}; {hint}"


def test_another_bus_is_a_difference(tmp_path: Path) -> None:
    path = transcript(tmp_path, {**GOOD, "bus": "/dev/i2c-11"}, {**GOOD, "bus": "/dev/i2c-11"})
    with ReplayBus(path) as bus:
        assert bus.channel_bus("/dev/i2c-11").transfer(0x53, b"\x00", 1) == b"\xe5"
        with pytest.raises(SensorError, match="line 2: recorded /dev/i2c-11 0x53"):
            bus.channel_bus("/dev/i2c-12").transfer(0x53, b"\x00", 1)


def test_an_unfinished_transcript_is_reported(tmp_path: Path) -> None:
    with ReplayBus(transcript(tmp_path, GOOD, GOOD, GOOD)) as bus:
        bus.transfer(0x53, b"\x00", 1)
        with pytest.raises(SensorError, match="2 recorded transactions were not repeated"):
            bus.finished()


@pytest.mark.parametrize(
    "line",
    [
        "",
        "nonsense",
        "5",
        "null",
        "[]",
        "{}",
        '{"to": "53"}',
        '{"to": 83, "write": ""}',
        '{"to": "zz", "write": ""}',
        '{"to": "53", "write": "0"}',
        '{"to": "53", "write": "00", "read": "e"}',
        '{"to": "53", "write": "00", "read": 5}',
        '{"to": "53", "write": "00", "errno": "x", "count": 1}',
        '{"to": "53", "write": "00", "errno": null, "count": 1}',
        '{"to": "53", "write": "00", "read": "e5", "at_ns": "soon"}',
        '{"to": "53", "write": "00", "read": "e5", "at_ns": null}',
        '{"to": "53", "write": "00", "read": "e5", "at_ns": 1e400}',
    ],
)
def test_a_malformed_line_is_named(tmp_path: Path, line: str) -> None:
    path = transcript(tmp_path, GOOD, line, GOOD)
    with ReplayBus(path) as bus:
        bus.transfer(0x53, b"\x00", 1)
        with pytest.raises(BusUrlError) as refused:
            bus.transfer(0x53, b"\x00", 1)
    assert str(refused.value) == f"{path}, line 2: not a transaction of a transcript"


def test_a_path_that_is_no_text_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / "b").write_bytes(b"\xff\xfe\x00")
    for path in (tmp_path / "none.jsonl", tmp_path, tmp_path / "b"):
        with pytest.raises(BusUrlError, match="replay:"):
            ReplayBus(path)


def test_a_transcript_is_overwritten_only_with_force(tmp_path: Path) -> None:
    path = transcript(tmp_path, GOOD)
    with pytest.raises(OutputExistsError):
        RecordingBus(Script([]), path)
    assert lines(path) == [GOOD]
    with RecordingBus(Script([b""]), path, force=True) as bus:
        bus.transfer(0x20)
    assert [line["to"] for line in lines(path)] == ["20"]


def test_a_refused_transfer_is_not_in_the_transcript(tmp_path: Path) -> None:
    class Refusing(Script):
        def transfer(self, address: int, write: bytes = b"", read: int = 0) -> bytes:
            raise ValueError("too long")

    path = tmp_path / "t.jsonl"
    with RecordingBus(Refusing([]), path) as bus, pytest.raises(ValueError, match="too long"):
        bus.transfer(0x53, b"\x00", 9000)
    assert lines(path) == []


def test_a_recording_bus_passes_on_the_attributes_of_its_inner_bus() -> None:
    array = parse_array('[array]\nname="a"\n[[sensor]]\nname="A"\nchip="adxl345"\naddress=0x53\nrange=2\n')
    with open_bus("emulated:", array) as inner:
        bus = RecordingBus(inner, "/dev/null", force=True)
        with bus:
            assert bus.source == "emulated"
            assert bus.clock.now_ns() == inner.clock.now_ns()
            assert bus.truth(0).force_box == (0.0, 0.0, 9.80665)
            assert not hasattr(bus, "no_such_thing")


def test_the_inner_bus_is_closed(tmp_path: Path) -> None:
    inner = Script([])
    with RecordingBus(inner, tmp_path / "t.jsonl"):
        pass
    assert inner.closed == 1


@pytest.mark.slow
@pytest.mark.parametrize(
    ("rate_hz", "bit_rate"),
    some([(100, 400_000), (125, 100_000), (350, 100_000)], 1),
)
def test_a_replayed_recording_gives_the_same_log(tmp_path: Path, rate_hz: int, bit_rate: int) -> None:
    text = '[array]\nname="a"\nmux={chip="pca9544a",address=0x70}\n'
    for name, chip, channel, address, extra in (
        ("A", "adxl345", 0, 0x53, "range=4"),
        ("B", "bma180", 1, 0x40, "range=2"),
        ("P", "bmp180", 1, 0x77, "rate_hz=8"),
        ("G", "l3g4200d", 0, 0x68, "range=250"),
    ):
        text += f'[[sensor]]\nname="{name}"\nchip="{chip}"\nchannel={channel}\naddress={address}\n{extra}\n'
    array = parse_array(text)
    with RecordingBus(open_bus(f"emulated:?bit_rate={bit_rate}", array), tmp_path / "t.jsonl") as bus:
        record(array, bus, tmp_path / "live.h5", rate_hz=rate_hz, seconds=2)
    with ReplayBus(tmp_path / "t.jsonl") as replay:
        record(array, replay, tmp_path / "again.h5", rate_hz=rate_hz, seconds=2)
        replay.finished()
    with open_log(tmp_path / "live.h5") as live, open_log(tmp_path / "again.h5") as again:
        assert again.source == "replay"
        for name in "ABPG":
            assert len(live[name]) == len(again[name]) > 5
            assert (live[name].counts[:] == again[name].counts[:]).all()
            assert (live[name].status[:] == again[name].status[:]).all()


NIGHT = """
[[fault]]
kind = "unplugged"
sensor = "B"
at_s = 3.0
for_s = 1.5
[[fault]]
kind = "reset"
sensor = "A"
at_s = 4.2
[[fault]]
kind = "no_acknowledge"
sensor = "G"
at_s = 5.0
for_s = 0.3
[[fault]]
kind = "stuck_bus"
at_s = 6.5
for_s = 0.4
[[fault]]
kind = "wrong_channel"
at_s = 8.0
for_s = 0.3
[[fault]]
kind = "kernel_driver"
sensor = "B"
at_s = 9.0
for_s = 1.1
[[fault]]
kind = "clock_held"
sensor = "G"
at_s = 11.5
for_s = 0.5
[[fault]]
kind = "stall"
at_s = 12.5
for_s = 0.5
[[fault]]
kind = "frozen"
sensor = "B"
at_s = 13.5
for_s = 2.0
until_set_up = true
"""


class JumpingClock:
    """A clock of a machine that does other things too: it moves whenever it is looked at, never twice alike."""

    def __init__(self, clock: Any) -> None:
        self._clock = clock
        self._draw = np.random.default_rng(5)

    def now_ns(self) -> int:
        self._clock.advance(int(self._draw.integers(1_000, 300_000)))
        now_ns: int = self._clock.now_ns()
        return now_ns

    def sleep_until(self, at_ns: int) -> None:
        self._clock.sleep_until(at_ns + int(self._draw.integers(0, 2_000_000)))


def faulty_night(tmp_path: Path, hurried: bool) -> tuple[Any, Any, ArrayConfig]:
    """The summary of the recording live.h5, and of its replay again.h5."""
    (tmp_path / "night.toml").write_text(NIGHT)
    text = '[array]\nname="a"\nmux={chip="pca9544a",address=0x70}\n'
    for name, chip, channel, address, extra in (
        ("A", "adxl345", 0, 0x53, "range=4"),
        ("B", "bma180", 1, 0x40, "range=2"),
        ("C", "bma180", 0, 0x40, "range=16"),
        ("P", "bmp180", 1, 0x77, "rate_hz=8"),
        ("G", "l3g4200d", 0, 0x68, "range=250\nrate_hz=100\nfifo=true"),
    ):
        text += f'[[sensor]]\nname="{name}"\nchip="{chip}"\nchannel={channel}\naddress={address}\n{extra}\n'
    array = parse_array(text)
    inner = open_bus(f"emulated:?faults={tmp_path / 'night.toml'}&bit_rate=400000", array)
    if hurried:
        inner.clock = JumpingClock(inner.clock)
        inner.truth = None  # type: ignore[attr-defined]  # hardware has none: no read of the clock for it
    start = datetime(2026, 3, 1, tzinfo=UTC)
    with RecordingBus(inner, tmp_path / "t.jsonl") as bus:
        live = record(array, bus, tmp_path / "live.h5", rate_hz=50, seconds=18, wall_time=start)
    with open_bus(f"replay:{tmp_path / 't.jsonl'}", array) as replay:
        again = record(array, replay, tmp_path / "again.h5", rate_hz=50, seconds=18, wall_time=start)
        replay.finished()  # type: ignore[attr-defined]
    return live, again, array


@pytest.mark.slow
@pytest.mark.parametrize("hurried", some([False, True], 1))
def test_a_recording_with_faults_replays_frame_by_frame(tmp_path: Path, hurried: bool) -> None:
    live_summary, again_summary, array = faulty_night(tmp_path, hurried)
    with open_log(tmp_path / "live.h5") as live, open_log(tmp_path / "again.h5") as again:
        kinds = {event.kind for event in live.events}
        assert {"lost", "reconfigured", "configuration", "bus", "taken"} <= kinds
        assert again.events == live.events
        for sensor in array.sensors:
            ours, theirs = live[sensor.name], again[sensor.name]
            np.testing.assert_array_equal(theirs.time[:], ours.time[:])
            np.testing.assert_array_equal(theirs.counts[:], ours.counts[:])
            np.testing.assert_array_equal(theirs.status[:], ours.status[:])
    assert (again_summary.frames, again_summary.late, again_summary.missed, again_summary.lost) == (
        live_summary.frames,
        live_summary.late,
        live_summary.missed,
        live_summary.lost,
    )


@pytest.mark.slow
def test_the_first_difference_from_a_recording_with_faults_names_its_line(tmp_path: Path) -> None:
    _, _, array = faulty_night(tmp_path, False)
    rows = (tmp_path / "t.jsonl").read_text().splitlines()
    at = next(index for index, row in enumerate(rows) if index > 2000 and '"write": "30"' in row)
    rows[at] = rows[at].replace('"write": "30"', '"write": "31"')
    (tmp_path / "other.jsonl").write_text("\n".join(rows) + "\n")
    with (
        open_bus(f"replay:{tmp_path / 'other.jsonl'}", array) as replay,
        pytest.raises(SensorError, match=rf"other\.jsonl, line {at + 1}: recorded 0x53 write 31 read .*, now 0x53 wri"),
    ):
        record(array, replay, tmp_path / "other.h5", rate_hz=50, seconds=18)


def test_checks_of_address_owners_are_recorded(tmp_path: Path) -> None:
    class Owned(Script):
        def claim(self, address: int, path: str | None = None) -> None:
            if address == 0x53:
                raise OSError(16, "Device or resource busy")
            if address == 0x40:
                raise SensorError("belongs to the kernel")

    def ask(bus: Any) -> list[str]:
        claims = []
        for address, path in ((0x1E, None), (0x53, None), (0x40, "/dev/i2c-11")):
            try:
                bus.claim(address, path)
                claims.append("")
            except (OSError, SensorError) as error:
                claims.append(f"{type(error).__name__} {getattr(error, 'errno', error)}")
        return claims

    with RecordingBus(Owned([]), tmp_path / "t.jsonl") as bus:
        first = ask(bus)
    assert lines(tmp_path / "t.jsonl")[1:] == [
        {"claim": "53", "at_ns": 3000, "errno": 16, "end_ns": 4000},
        {"claim": "40", "at_ns": 5000, "bus": "/dev/i2c-11", "error": "belongs to the kernel", "end_ns": 6000},
    ]
    with ReplayBus(tmp_path / "t.jsonl") as replay:
        assert ask(replay) == first == ["", "OSError 16", "SensorError belongs to the kernel"]
        replay.finished()
    with (
        ReplayBus(tmp_path / "t.jsonl") as replay,
        pytest.raises(SensorError, match="line 1: recorded 0x1e: owner query"),
    ):
        replay.transfer(0x1E)
    with RecordingBus(Script([]), tmp_path / "u.jsonl") as bus:
        assert not hasattr(bus, "claim")


def test_a_full_disk_ends_the_transcript_and_not_the_bus(tmp_path: Path) -> None:
    class Full(io.StringIO):
        def write(self, text: str) -> int:
            raise OSError(28, "No space left on device")

    with RecordingBus(Script([b"\x01", b"\x02"]), tmp_path / "t.jsonl") as bus:
        bus._file.close()
        bus._file = Full()
        assert bus.transfer(0x53, b"\x00", 1) == b"\x01"
        assert bus.failed == f"transcript {tmp_path / 't.jsonl'}: not complete: No space left on device"
        assert bus.transfer(0x53, b"\x00", 1) == b"\x02"


@pytest.mark.slow
def test_a_microcontroller_is_polled_while_a_transcript_is_written(tmp_path: Path) -> None:
    text = '[array]\nname="a"\n[[sensor]]\nname="A"\nchip="adxl345"\naddress=0x53\nrange=2\n'
    array = parse_array(text)
    bench = Bench(array)
    with RecordingBus(bench.bus(), tmp_path / "t.jsonl") as bus:
        assert "one transaction at a time and does not stream" in bus.remark
        assert len(bus.remark.splitlines()) == 1
        record(array, bus, tmp_path / "live.h5", rate_hz=50, seconds=2)
    with ReplayBus(tmp_path / "t.jsonl") as replay:
        record(array, replay, tmp_path / "again.h5", rate_hz=50, seconds=2)
        replay.finished()
    with open_log(tmp_path / "live.h5") as live, open_log(tmp_path / "again.h5") as again:
        assert len(live["A"]) >= 90
        np.testing.assert_array_equal(live["A"].time[:], again["A"].time[:])
        np.testing.assert_array_equal(live["A"].counts[:], again["A"].counts[:])


@given(st.lists(st.one_of(st.text(max_size=30), st.sampled_from([json.dumps(GOOD), "[" * 5000, "9" * 5000]))))
def test_any_text_is_read_or_refused(tmp_path_factory: pytest.TempPathFactory, rows: list[str]) -> None:
    path = tmp_path_factory.mktemp("t") / "t.jsonl"
    path.write_text("\n".join(rows), encoding="utf-8", errors="replace")
    try:
        with ReplayBus(path) as bus:
            for _ in range(len(rows) + 1):
                bus.transfer(0x53, b"\x00", 1)
    except (SensorError, BusUrlError) as refused:
        assert len(str(refused).splitlines()) == 1


@pytest.mark.slow
def test_a_stopped_log_replays_to_its_end_with_its_own_times(tmp_path: Path) -> None:
    array = parse_array('[array]\nname="a"\n[[sensor]]\nname="A"\nchip="adxl345"\naddress=0x53\nrange=4\n')
    start, frames = datetime(2026, 3, 1, 12, tzinfo=UTC), iter([False] * 37 + [True] * 9)
    with RecordingBus(open_bus("emulated:", array), tmp_path / "t.jsonl") as bus:
        live = record(array, bus, tmp_path / "live.h5", rate_hz=50, wall_time=start, stopped=lambda: next(frames, True))
    with ReplayBus(tmp_path / "t.jsonl") as replay:
        again = record(array, replay, tmp_path / "again.h5", rate_hz=50)
        replay.finished()
        assert replay.stopped
    assert again.frames == live.frames == 37
    with open_log(tmp_path / "live.h5") as first, open_log(tmp_path / "again.h5") as other:
        assert other.epoch == first.epoch == "2026-03-01T12:00:00.000000Z"
        np.testing.assert_array_equal(other["A"].time[:], first["A"].time[:])
