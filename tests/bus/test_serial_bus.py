"""The host's end of the link: a bus like any other, lists that are executed, and lines that fail."""

from __future__ import annotations

import errno
import os
import threading
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from imuarray.acquire.bus_segment import Pca9544a
from imuarray.array import parse_array
from imuarray.bus import Bus, open_bus, serial_bus, serial_session
from imuarray.bus.serial_bus import SerialBus
from imuarray.bus.serial_link import ANSWER, LinkError, PollList, Request, frame_payload
from imuarray.errors import BusUrlError
from tests.bus.conversations import CONVERSATIONS, DEVICE, MUX, ON_CHANNEL, ON_TRUNK
from tests.bus.serial_bench import Bench, Handle

ARRAY = parse_array(ON_TRUNK)
DEVID = Request(DEVICE, b"\x00", 1)
MS = 1_000_000


def received(bus: SerialBus, number: int, count: int) -> tuple[list[int], np.ndarray, np.ndarray]:
    """At least `count` frames of one list: numbers, times, payloads."""
    pieces = []
    for _ in range(50 + count):
        batches = bus.receive()
        if number in batches:
            pieces.append(batches[number])
        if sum(len(samples.numbers) for samples in pieces) >= count:
            break
    parts = [(samples.numbers, samples.sent_ns, samples.payload) for samples in pieces]
    numbers, times, payloads = (np.concatenate(column) for column in zip(*parts, strict=True))
    return numbers.tolist(), times, payloads


@pytest.mark.parametrize("talk", CONVERSATIONS)
def test_contract(talk: Callable[[Bus], None]) -> None:
    with Bench(ARRAY).bus() as bus:
        talk(bus)
    with Bench(parse_array(ON_CHANNEL)).bus() as bus:
        talk(Pca9544a(bus, MUX).channel(2))


def test_a_serial_bus_states_its_source_and_its_limits() -> None:
    bench = Bench(ARRAY)
    with bench.bus() as bus:
        assert bus.source == "serial"
        assert bus.clock is bench
        assert bus.capacity.version == 1
        assert not bus.streaming
        with pytest.raises(OSError, match="does not read buses of the kernel"):
            bus.channel_bus("/dev/i2c-7")
        with pytest.raises(ValueError, match="7 bits"):
            bus.transfer(0x80)
        with pytest.raises(ValueError, match="holds 1024"):
            bus.transfer(DEVICE, b"\x00", 1024)
        assert len(bus.transfer(DEVICE, b"\x00", 1023)) == 1023
    assert [handle.closed for handle in bench.handles] == [True]


def test_a_clock_held_low_is_a_time_out() -> None:
    class HeldClock(Bench):
        def transfer(self, address: int, write: bytes = b"", read: int = 0) -> bytes:
            raise OSError(110, "held")

    with HeldClock(ARRAY).bus() as bus, pytest.raises(TimeoutError) as refused:
        bus.transfer(DEVICE)
    assert refused.value.errno == errno.ETIMEDOUT


@pytest.mark.parametrize("lost", ["command", "answer"])
def test_a_lost_command_or_answer_is_repeated_and_executed_once(lost: str) -> None:
    bench = Bench(ARRAY)
    with bench.bus() as bus:
        kept = iter([b""])  # the next piece disappears, the others arrive
        if lost == "command":
            bench.heard = lambda piece: next(kept, piece)
        else:
            bench.delivered = lambda piece: next(kept, piece)
        before = len(bench.taps)
        assert bus.transfer(DEVICE, b"\x00", 1) == b"\xe5"
        assert len(bench.taps) == before + 1


def test_answers_in_pieces_within_garbage_are_read() -> None:
    bench = Bench(ARRAY)
    with bench.bus() as bus:
        bench.delivered = lambda piece: b"\xa5\x5a\x30\x00noise\xa5" + piece + b"\xa5\x5a"
        for _ in range(5):
            assert bus.transfer(DEVICE, b"\x00", 1) == b"\xe5"
        assert bus.skipped >= 5 * 10


def test_a_late_answer_to_another_command_is_ignored() -> None:
    bench = Bench(ARRAY)
    with bench.bus() as bus:
        stale = frame_payload(0x02 | ANSWER, 0x1234, b"\x00\x99")
        bench.delivered = lambda piece: stale + piece
        assert bus.transfer(DEVICE, b"\x00", 1) == b"\xe5"


@pytest.mark.parametrize("counter_us", [5_000_000, (1 << 32) - 1_000_000])
def test_answers_of_earlier_boots_are_refused(counter_us: int) -> None:
    """Commands are numbered from 1 in each session, so that an earlier boot has answered the same numbers."""
    earlier = Bench(ARRAY, counter_us=counter_us)
    kept: list[bytes] = []
    earlier.delivered = lambda piece: kept.append(piece) or piece  # type: ignore[func-returns-value]
    with earlier.bus() as bus:
        for _ in range(40):
            bus.transfer(DEVICE, b"\x1e", 1)  # 0: not the value that the other command reads
    bench = Bench(ARRAY, counter_us=900_000_000)
    with bench.bus() as bus:
        draw = np.random.default_rng(2)
        bench.delivered = lambda piece: b"".join(kept[at] for at in draw.permutation(len(kept))) + piece
        assert [bus.transfer(DEVICE, b"\x00", 1) for _ in range(40)] == [b"\xe5"] * 40
        bench.delivered = lambda piece: piece
        bus.start([PollList(1, 0, (DEVID,))], 5000)
        bench.sent += b"".join(kept)  # a START of the earlier boot among them would begin anew
        numbers, _, payloads = received(bus, 0, 20)
        assert numbers == list(range(len(numbers)))
        assert set(payloads[:, 2].tolist()) == {0xE5}
        assert sum(bus.refused.values()) == 41 * len(kept)


def test_a_left_over_answer_to_hello_does_not_set_the_clock() -> None:
    """It is of the first command's number, and arrives before the true one."""
    bench = Bench(ARRAY, counter_us=900_000_000)
    stale = iter([frame_payload(0x01 | ANSWER, 2, b"\x01\x80\x00\x06", 77_000_000)])
    count = 0

    def delivered(piece: bytes) -> bytes:
        nonlocal count
        count += 1
        return next(stale, b"") + piece if count == 2 else piece  # the second HELLO is the first that sets the clock

    bench.delivered = delivered
    with bench.bus() as bus:
        assert bus.transfer(DEVICE, b"\x00", 1) == b"\xe5"


def test_a_silent_port_is_an_error_until_it_answers() -> None:
    bench = Bench(ARRAY)
    with bench.bus() as bus:
        bench.delivered = lambda piece: b""
        with pytest.raises(LinkError, match="does not answer"):
            bus.transfer(DEVICE)
        begun_ns = bench.now_ns()
        with pytest.raises(OSError, match="was disconnected") as error:
            bus.transfer(DEVICE)
        assert error.value.errno == 19
        assert bench.now_ns() - begun_ns < 1000 * MS
        bench.delivered = lambda piece: piece
        bench.sleep_until(bench.now_ns() + 2000 * MS)
        assert bus.transfer(0x53, b"\x00", 1) == b"\xe5"


def test_a_port_without_the_link_protocol_is_refused() -> None:
    bench = Bench(ARRAY)
    bench.delivered = lambda piece: b"AT+OK\r\n"
    with pytest.raises(LinkError, match="does not answer"):
        bench.bus()
    assert [handle.closed for handle in bench.handles] == [True]


def test_another_version_of_the_link_is_refused() -> None:
    bench = Bench(ARRAY)
    bench.delivered = lambda piece: frame_payload(0x81, int.from_bytes(piece[5:7], "little"), b"\x02\x80\x00\x06")
    with pytest.raises(LinkError, match="speaks version 2 of the link, not 1"):
        bench.bus()


def test_lists_arrive_in_their_frames_with_numbers_and_times() -> None:
    bench = Bench(ARRAY, drift=3e-3, counter_us=77)
    with bench.bus() as bus:
        begun_ns = bench.now_ns()
        bus.start([PollList(1, 0, (DEVID,)), PollList(3, 2, (Request(DEVICE, b"\x2c", 1), DEVID))], 5000)
        assert bus.streaming
        numbers, times, payloads = received(bus, 0, 200)
        assert numbers == list(range(len(numbers)))
        np.testing.assert_allclose(np.diff(times), 5 * MS / 1.003, atol=3000)  # microseconds, and a fit that converges
        taps = [tap.at_ns for tap in bench.taps if tap.write == b"\x00" and tap.at_ns >= begun_ns]
        assert abs(times[0] - taps[0] - 93_700) < 50_000  # the age: one transaction, BUS-07
        assert {bytes(row) for row in payloads} == {bytes([94, 0, 0xE5]), bytes([93, 0, 0xE5])}
        bus.stop()
        assert not bus.streaming


def test_a_list_of_every_third_frame_arrives_in_its_frames() -> None:
    with Bench(ARRAY).bus() as bus:
        bus.start([PollList(3, 2, (Request(DEVICE, b"\x2c", 1), DEVID))], 5000)
        numbers, _, payloads = received(bus, 0, 20)
        assert numbers == list(range(2, 3 * len(numbers), 3))
        assert {(row[2], row[5]) for row in payloads.tolist()} == {(0x0A, 0xE5)}


@pytest.mark.parametrize("silent_frames", [65_400, 65_536 * 3 + 20_000])
@pytest.mark.parametrize("counter_us", [(1 << 32) - 700_000, 0])
def test_counters_that_wrap_in_mid_stream_are_extended(counter_us: int, silent_frames: int) -> None:
    bench = Bench(ARRAY, counter_us=counter_us)
    with bench.bus() as bus:
        bus.start([PollList(1, 0, (DEVID,))], 5000)
        before = received(bus, 0, 10)[0][-1]
        bench.clock.advance(silent_frames * 5 * MS)  # the microcontroller did something else, and leaves frames out
        numbers, times, _ = received(bus, 0, 200)
        assert abs(numbers[0] - before - silent_frames) < 3
        assert set(np.diff(numbers)) == {1}
        assert numbers[-1] > 65_536
        np.testing.assert_allclose(np.diff(times), 5 * MS, atol=150_000)  # the first begins late


def test_frames_of_an_earlier_program_are_ignored() -> None:
    bench = Bench(ARRAY)
    old = bench.bus()
    old.start([PollList(1, 0, (DEVID, DEVID))], 2000)
    bench.sleep_until(bench.now_ns() + 300 * MS)  # it ended without a STOP; no program reads
    with bench.bus() as bus:
        bus.start([PollList(1, 0, (DEVID,))], 5000)
        numbers, _, payloads = received(bus, 0, 20)
        assert numbers == list(range(len(numbers)))
        assert payloads.shape[1] == 3


@settings(deadline=None)
@given(st.lists(st.tuples(st.integers(0, 255), st.integers(0, 0xFFFF), st.binary(max_size=8)), max_size=20))
def test_whole_frames_of_unknown_meaning_are_ignored(strange: list[tuple[int, int, bytes]]) -> None:
    bench = Bench(ARRAY)
    with bench.bus() as bus:
        bus.start([PollList(1, 0, (DEVID,))], 5000)
        received(bus, 0, 3)
        time_us = bench.firmware.time_us()
        bench.sent += b"".join(frame_payload(kind, number, payload, time_us) for kind, number, payload in strange)
        for _ in range(3):
            for number, samples in bus.receive().items():
                assert number == 0
                assert samples.payload.shape == (len(samples.numbers), 3)
                assert (np.diff(samples.sent_ns) >= 0).all()
        bus.stop()
        assert bus.transfer(DEVICE, b"\x00", 1) == b"\xe5"


def test_lists_beyond_the_capacity_are_refused() -> None:
    with Bench(ARRAY).bus() as bus:
        with pytest.raises(OSError, match=r"129 lists with 516 bytes of requests; .* room for 128 with 1536") as full:
            bus.start([PollList(1, 0, (DEVID,))] * 129, 5000)
        assert full.value.errno == errno.ENOSPC
        with pytest.raises(OSError, match="list 0"):
            bus.start([PollList(1, 1, (DEVID,))], 5000)  # no frame has this remainder


def test_a_port_that_disappears_is_reopened() -> None:
    bench = Bench(ARRAY)
    with bench.bus() as bus:
        bus.start([PollList(1, 0, (DEVID,))], 5000)
        received(bus, 0, 10)
        bench.unplug()
        with pytest.raises(LinkError, match=r"the port fails: .*Input/output error"):
            bus.receive()
        with pytest.raises(LinkError, match="No such file"):
            bus.reconnect(0.5)
        bench.unplugged = False
        bus.reconnect(0.5)
        assert bus.transfer(DEVICE, b"\x00", 1) == b"\xe5"
        assert [handle.closed for handle in bench.handles] == [True, False]


def test_a_port_that_cannot_be_written_is_refused() -> None:
    bench = Bench(ARRAY)

    def dead() -> Handle:
        handle = bench.open()
        handle.dead = True
        return handle

    with pytest.raises(LinkError, match="the port fails"):
        SerialBus(dead, bench, patience_s=0.5)
    assert bench.now_ns() < 600 * MS


def refusal(url: str) -> str:
    with pytest.raises(BusUrlError) as refused:
        open_bus(url, ARRAY)
    assert "\n" not in str(refused.value)
    return str(refused.value)


def test_invalid_urls_and_ports_are_refused(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(serial_bus, "PATIENCE_S", 0.0)
    monkeypatch.setattr(serial_session, "ANSWER_S", 0.05)
    assert refusal("serial:") == "bus 'serial:': name the port, as in serial:/dev/ttyACM0"
    no_port = "serial:/dev/null: is no serial port; ports are /dev/ttyACM* and /dev/ttyUSB* (group dialout)"
    assert refusal("serial:/dev/null") == no_port
    for query in ("?speed=9600", "?baud=fast", "?baud=0", "?baud=9600&parity=E"):
        assert refusal(f"serial:/dev/ttyACM0{query}").endswith(
            "after the port only ?baud= and a whole number are allowed"
        )
    assert refusal("serial:/dev/no-such-port").startswith("serial:/dev/no-such-port: No such file or directory; ports")
    (tmp_path / "file").touch()
    assert refusal(f"serial:{tmp_path / 'file'}").startswith(f"serial:{tmp_path / 'file'}: ")


def test_a_terminal_without_an_answer_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(serial_bus, "PATIENCE_S", 0.0)
    monkeypatch.setattr(serial_session, "ANSWER_S", 0.05)
    ours, theirs = os.openpty()
    drain = threading.Thread(target=lambda: os.read(ours, 65536))
    drain.start()
    try:
        message = refusal(f"serial:{os.ttyname(theirs)}?baud=9600")
        assert message.endswith("the microcontroller does not answer; its firmware must implement the serial link")
    finally:
        drain.join()
        os.close(ours)
        os.close(theirs)
