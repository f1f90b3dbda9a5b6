"""The firmware as a process behind a pseudo-terminal, and the logger at its other end: stored rows were read, and
acknowledged commands were executed, for any failure of the line. The process is compiled with the compiler's
sanitizers.
"""

from __future__ import annotations

import json
import os
import subprocess
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from firmware_emulator.array import open_bus
from firmware_emulator.microcontroller_bus import MicrocontrollerBus
from imuarray.acquire import connect
from imuarray.acquire.recording import RecordingCounts, RecordingOptions
from imuarray.acquire.stream import Streaming, streams
from imuarray.array import parse_array
from imuarray.bus import serial_session
from imuarray.bus.serial_bus import SerialBus, open_serial
from imuarray.bus.serial_link import FIRST_SELECT, OVERHEAD, LinkError, PollList, Request
from imuarray.bus.serial_port import usual_port
from imuarray.cli import main
from imuarray.log import open_log
from imuarray.log.format import LOST_BEFORE, OVERRUN, RECONFIGURED, SUSPECT
from imuarray.log.writer import LogWriter
from tests.firmware.host_build import ADXL345, BURST, BadLine, HostBuild, NumberedBus, damage, reading
from tests.selection import some

CONFIG = '[array]\nname="a"\n[[sensor]]\nname="A"\nchip="adxl345"\naddress=0x53\nrange=4\nrate_hz=800\n'
RATE_HZ = 100.0


@contextmanager
def hosted(program: Path, folder: Path, *options: str) -> Iterator[tuple[HostBuild, NumberedBus]]:
    bus = NumberedBus(open_bus({"clock": "real"}, parse_array(CONFIG)))
    with HostBuild(program, bus, folder / "ttyACM0", *options) as host:
        yield host, bus


@pytest.fixture
def hasty(monkeypatch: pytest.MonkeyPatch) -> None:
    """These tests do not depend on the clock fit."""
    monkeypatch.setattr(serial_session, "PING_S", 0.0)


def record(line: BadLine, path: Path, wire: NumberedBus, bursts: int) -> RecordingCounts:
    """Log the array behind `line`, as the command does, until there were so many bursts on the wire."""
    with SerialBus(line, patience_s=3.0) as bus:
        routes = connect(parse_array(CONFIG), bus)
        assert streams(bus, routes)
        headers = [route.header for route in routes]
        with LogWriter(path, headers, source=bus.source, epoch="1970-01-01T00:00:00Z") as log:
            recording = Streaming(routes, bus, log, RecordingOptions(RATE_HZ), bus.clock.now_ns())
            recording.run(None, lambda: len(wire.bursts) > bursts)
    return recording.summary


def check_rows(path: Path, bus: NumberedBus) -> np.ndarray:
    """Each row is one burst of the wire, in order and none twice; a gap is flagged. The numbers of the bursts (n,).

    A busy machine makes the process late, which then reads nothing: flagged, and no gap on the wire. That nothing else
    is flagged, and the times, are tested on the emulator's clock (`tests.firmware.kinds`, `test_resend`).
    """
    with open_log(path) as log:
        counts, status = log["A"].counts[:], np.asarray(log["A"].status[:])
    number_of = {tuple(reading(number).tolist()): number for number in range(len(bus.bursts))}
    numbers = np.array([number_of[tuple(row)] for row in counts.tolist()])
    steps = np.diff(numbers)
    assert (steps > 0).all()
    flagged = (status & LOST_BEFORE) != 0
    assert flagged[1:][steps > 1].all()
    return numbers


def test_a_transaction_is_made_through_the_process(host_program: Path, tmp_path: Path, hasty: None) -> None:
    with (
        hosted(host_program, tmp_path) as (host, _),
        SerialBus(BadLine(host.path)) as bus,
    ):
        assert bus.transfer(ADXL345, b"\x00", 1) == b"\xe5"
        with pytest.raises(OSError, match="address 0x1d") as refused:
            bus.transfer(0x1D)
        assert refused.value.errno == 121
        assert bus.capacity == (1, 128, 4096, 7, 8, 32768)


@pytest.mark.parametrize("seed", some(range(4), 1))
def test_hostile_bytes_leave_the_process_responsive(host_program: Path, tmp_path: Path, hasty: None, seed: int) -> None:
    draw = np.random.default_rng(seed)
    with hosted(host_program, tmp_path) as (host, _):
        port: Any = usual_port(str(host.path), 115_200)
        for _ in range(60):
            head = [b"", b"\xa5\x5a", b"\xa5\x5a\xff\xff", b"\xa5\x5a\x00\x04", b"\xa5\x5a\x00\x00"]
            port.write(head[int(draw.integers(5))] + draw.bytes(int(draw.integers(200))))
            port.read(port.in_waiting)
        port.close()
        with SerialBus(BadLine(host.path)) as bus:
            assert bus.transfer(ADXL345, b"\x00", 1) == b"\xe5"


@pytest.mark.parametrize(("seed", "commands"), some([(0, 25), (1, 60), (2, 60)], 1))
def test_acknowledged_commands_were_executed_once(
    host_program: Path, tmp_path: Path, hasty: None, monkeypatch: pytest.MonkeyPatch, seed: int, commands: int
) -> None:
    """Commands and answers are lost, damaged and late, after the command was repeated."""
    monkeypatch.setattr(serial_session, "ANSWER_S", 0.02)
    draw = np.random.default_rng(seed)
    worse = False

    def late(piece: bytes) -> bytes:
        if worse and draw.random() < 0.2:
            time.sleep(0.03)
        return spoiled_read(piece) if worse else piece

    spoiled_read, spoiled_write = damage(seed, 0.2), damage(seed + 100, 0.2)
    with hosted(host_program, tmp_path) as (host, wire):
        line = BadLine(host.path, late, lambda piece: spoiled_write(piece) if worse else piece)
        acknowledged = []
        with SerialBus(line) as bus:
            worse = True
            for value in range(commands):
                try:
                    bus.transfer(ADXL345, bytes([0x1E, value]))  # OFSX: any value is allowed
                except LinkError:
                    bus._lost = False  # no further check: the line is as bad as before
                except OSError:
                    pass
                else:
                    acknowledged.append(value)
            worse = False
        done = [write[1] for address, write in wire.written if write[:1] == b"\x1e"]
        assert len(acknowledged) > 5
        assert set(acknowledged) <= set(done)
        assert len(done) == len(set(done))
        assert done == sorted(done)


@pytest.mark.slow
def test_unread_frames_are_dropped_whole(host_program: Path, tmp_path: Path, hasty: None) -> None:
    with hosted(host_program, tmp_path) as (host, wire), SerialBus(BadLine(host.path)) as bus:
        bus.start([PollList(1, 0, (Request(ADXL345, BURST, 8), *[Request(ADXL345, b"\x00", 57)] * 12))], 5000)
        until_s = time.monotonic() + 60
        while len(wire.bursts) < 40 and time.monotonic() < until_s:
            time.sleep(0.01)
        received = [bus.receive() for _ in range(3)]
        numbers = np.concatenate([samples[0].numbers for samples in received if samples])
        assert bus.skipped == 0
        assert (np.diff(numbers) > 0).all()
        assert numbers[0] == 0


@pytest.mark.slow
def test_detect_reports_the_counts_of_the_firmware(
    host_program: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Frames that were sent, a chip that never answered, and bytes that were no frame, as counted by the firmware."""
    (tmp_path / "a.toml").write_text(CONFIG)
    with hosted(host_program, tmp_path, "--counter-us", "7000000") as (host, _):
        port = usual_port(str(host.path), 115_200)
        port.write(b"\x00\x01\x02\x03\x04")
        time.sleep(0.2)
        port.close()
        with open_serial(str(host.path)) as bus:
            bus.start([PollList(1, 0, (Request(0x53, b"\x30", 8), Request(0x11, b"\x00", 1)))], 50_000)
            time.sleep(0.5)
            bus.stop()
            frames = sum(len(samples.numbers) for samples in bus.receive().values())
        capsys.readouterr()
        words = ["detect", str(tmp_path / "a.toml"), "--bus", f"serial:{host.path}"]
        assert main([*words, "--json"]) == 0
        firmware = json.loads(capsys.readouterr().out)["firmware"]
        assert main(words) == 0
    counts = firmware["counts"]
    assert counts["sent"] >= frames > 4
    assert counts["failures"] == counts["sent"]
    assert counts["skipped"] == 5
    assert (counts["late"], counts["dropped"], counts["watchdog_reset"]) == (0, 0, False)
    assert 0 < counts["up_us"] < 60e6
    output = capsys.readouterr().out
    assert f"{counts['sent']} frames sent, 0 skipped for lack of time, 0 dropped because the line was full" in output
    assert f"{counts['failures']} requests failed, 5 bytes not understood" in output
    assert "1 of 1 as configured, 0 not" in output


@pytest.mark.slow
def test_the_command_logs_through_the_process(host_program: Path, tmp_path: Path) -> None:
    (tmp_path / "a.toml").write_text(CONFIG)
    run = tmp_path / "run.h5"
    with hosted(host_program, tmp_path, "--counter-us", str((1 << 32) - 900_000)) as (host, bus):
        words = ["log", str(tmp_path / "a.toml"), "--bus", f"serial:{host.path}", "-o", str(run)]
        assert main([*words, "--seconds", "2", "--rate-hz", "100"]) == 0
        assert len(check_rows(run, bus)) > 0
        with open_log(run) as log:
            assert log.source == "serial"


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_a_bad_line_invents_no_readings(host_program: Path, tmp_path: Path, seed: int) -> None:
    with hosted(host_program, tmp_path) as (host, bus):
        spoiled = damage(seed, 0.1)
        # Its chips are set up and the stream runs, with a good deal of luck, on a line that loses a tenth: not tested.
        line = BadLine(host.path, lambda piece: spoiled(piece) if len(bus.bursts) > 20 else piece)
        summary = record(line, tmp_path / "r.h5", bus, 400)
        numbers = check_rows(tmp_path / "r.h5", bus)
    assert len(numbers) + summary.lost["A"] == summary.frames
    assert len(numbers) > 0


@pytest.mark.slow
def test_a_restarted_and_replugged_process_is_logged_again(host_program: Path, tmp_path: Path) -> None:
    """The process is killed in the middle of a stream, and another boot begins, with another counter."""
    with hosted(host_program, tmp_path, "--counter-us", "5000000") as (host, bus):

        def accident() -> None:
            while len(bus.bursts) < 200:
                time.sleep(0.01)
            host.kill()
            time.sleep(0.5)
            host.start()

        thread = threading.Thread(target=accident)
        thread.start()
        summary = record(BadLine(host.path), tmp_path / "r.h5", bus, 500)
        thread.join()
        numbers = check_rows(tmp_path / "r.h5", bus)
    with open_log(tmp_path / "r.h5") as log:
        status = np.asarray(log["A"].status[:])
        kinds = {event.kind for event in log.events}
    assert len(numbers) + summary.lost["A"] == pytest.approx(summary.frames, abs=2)
    assert "link" in kinds
    (again,) = np.flatnonzero(status & RECONFIGURED)
    assert not (status[again:] & SUSPECT).any()
    assert 0 < again < len(numbers)


class EightChips:
    """Chip selects 0 to 7 of six-axis chips: a reading is how often the chip was read (4 bytes), then its number."""

    def __init__(self) -> None:
        self.reads = [0] * 8

    def transfer(self, address: int, write: bytes = b"", read: int = 0) -> bytes:
        chip = address - FIRST_SELECT
        self.reads[chip] += 1
        return self.reads[chip].to_bytes(4, "little") + bytes([chip]) * (read - 4)

    def set_select(self, select: int, mode: int, clock_hz: int) -> None:
        """Any mode and clock."""


@pytest.mark.slow
def test_eight_six_axis_chips_at_1_khz_are_streamed(host_program: Path, tmp_path: Path, hasty: None) -> None:
    """A frame has 144 bytes on the wire, as on paper: 15 of the link, the number of the list, and of each chip an age
    and 14 bytes. Each row is what its chip answered in that frame; frames for which there was no time are missing whole
    and counted.
    """
    asked = PollList(1, 0, tuple(Request(FIRST_SELECT + chip, b"\x9d", 14) for chip in range(8)))
    assert OVERHEAD + asked.size == 144
    chips: Any = EightChips()
    with HostBuild(host_program, chips, tmp_path / "ttyACM0") as host, SerialBus(BadLine(host.path)) as bus:
        bus.start([asked], 1000)
        numbers, payloads = [], []
        until_s = time.monotonic() + 60
        while sum(map(len, numbers)) < 500 and time.monotonic() < until_s:
            if (samples := bus.receive().get(0)) is not None:
                numbers.append(samples.numbers)
                payloads.append(samples.payload)
        bus.stop()
        counts: Any = bus.firmware_counts()
    frames, payload = np.concatenate(numbers), np.concatenate(payloads)
    assert len(frames) >= 500
    assert payload.shape[1] == asked.size - 1  # without the number of the list
    readings = payload.reshape(len(frames), 8, 16)[:, :, 2:]
    reads = np.ascontiguousarray(readings[:, :, :4]).view("<u4")[:, :, 0].astype(np.int64)
    assert (readings[:, :, 4:] == np.arange(8)[None, :, None]).all()
    assert (reads == reads[:, :1]).all()  # all chips in every frame, once
    assert (np.diff(frames) > 0).all()
    assert (np.diff(reads[:, 0]) > 0).all()
    assert (np.diff(reads[:, 0]) <= np.diff(frames)).all()
    assert counts.failures == 0
    assert counts.sent + counts.dropped == max(chips.reads)


def test_the_process_ends_when_its_bus_closes(host_program: Path) -> None:
    ours, theirs = os.pipe()
    os.close(theirs)
    try:
        ended = subprocess.run([host_program, "--bus", str(ours)], pass_fds=[ours], capture_output=True, timeout=20)
    finally:
        os.close(ours)
    assert (ended.returncode, ended.stderr) == (0, b"")


@pytest.mark.parametrize("words", [[], ["--bus"], ["--bus", "x"], ["--bus", "99999"]])
def test_invalid_arguments_are_refused(host_program: Path, words: list[str]) -> None:
    ended = subprocess.run([host_program, *words], capture_output=True, timeout=20)
    assert ended.returncode == 2
    assert len(ended.stderr.splitlines()) == 1


class QueueBus:
    """The microcontroller's bus of one six-axis chip on I2C, whose queue is drained by its count; `drained` are the
    records that went over the wires, in order.
    """

    def __init__(self, array: Any, register: int, size: int) -> None:
        self._bus, self._register, self._size = MicrocontrollerBus(array), register, size
        self.drained: list[bytes] = []
        self.set_select = self._bus.set_select

    def transfer(self, address: int, write: bytes = b"", read: int = 0) -> bytes:
        answer = self._bus.transfer(address, write, read)
        if write == bytes([self._register]) and len(answer) % self._size == 0:
            self.drained += [answer[at : at + self._size] for at in range(0, len(answer), self._size)]
        return answer


QUEUES = {  # address, rate, register of the queue, bytes of a record, and where in it the accelerometer is
    "lsm6dso": (0x6A, 104, 0x78, 7, slice(1, 7), "<i2"),
    "mpu6050": (0x68, 200, 0x74, 14, slice(0, 6), ">i2"),
}


@pytest.mark.slow
@pytest.mark.parametrize("die", some(QUEUES, 1, 0))
@pytest.mark.parametrize("fault", ["none", "bad line", "restart"])
def test_the_process_drains_a_queue(die: str, fault: str, host_program: Path, tmp_path: Path) -> None:
    """Each row is a record of the wire, in order and once; records that are no rows are flagged as a gap. The line
    damages a twentieth of its pieces, or the process is killed and another boot begins.
    """
    address, rate_hz, register, size, place, order = QUEUES[die]
    text = '[array]\nname="a"\n'
    for half, full_scale in (("acc", 4), ("gyro", 500)):
        text += f'[[sensor]]\nname="{half}"\nchip="{die}"\naddress={address}\nrange={full_scale}\n'
        text += f"rate_hz={rate_hz}\nfifo=true\n"
    array = parse_array(text)
    wire = QueueBus(open_bus({"clock": "real", "world": "shaking", "still_s": "0.1"}, array), register, size)
    enough = 14 * rate_hz  # records; with the temperatures of an LSM6DSO, of both halves
    with HostBuild(host_program, wire, tmp_path / "ttyACM0", "--counter-us", "5000000") as host:
        spoiled = damage(3, 0.05)

        def spoil(piece: bytes) -> bytes:
            return spoiled(piece) if fault == "bad line" and len(wire.drained) > rate_hz else piece

        def accident() -> None:
            while len(wire.drained) < 4 * rate_hz:
                time.sleep(0.01)
            host.kill()
            time.sleep(0.3)
            host.start()

        thread = threading.Thread(target=accident if fault == "restart" else list)
        with SerialBus(BadLine(host.path, spoil), patience_s=3.0) as bus:
            routes = connect(array, bus)
            assert streams(bus, routes)
            headers = [route.header for route in routes]
            with LogWriter(tmp_path / "r.h5", headers, source="serial", epoch="1970-01-01T00:00:00Z") as log:
                wire.drained.clear()
                thread.start()
                recording = Streaming(routes, bus, log, RecordingOptions(50.0), bus.clock.now_ns())
                recording.run(None, lambda: len(wire.drained) > enough)
        thread.join()
    mine = [record for record in wire.drained if die != "lsm6dso" or record[0] >> 3 == 2]
    rows = np.array([np.frombuffer(record[place], order) for record in mine])
    with open_log(tmp_path / "r.h5") as log:
        counts, status = log["acc"].counts[:], np.asarray(log["acc"].status[:])
    numbers, at = [], 0
    for row in counts:
        while not (rows[at] == row).all():  # IndexError for a row that is none of the wire, or out of order
            at += 1
        numbers.append(at)
        at += 1
    skipped = np.diff(numbers) > 1
    flagged = (status & (LOST_BEFORE | OVERRUN | RECONFIGURED)) != 0
    assert flagged[1:][skipped].all()
    assert len(numbers) > 0.5 * len(mine)
    if fault == "none":
        assert len(mine) - len(numbers) < 0.3 * rate_hz  # of the first and the last moments
        assert not (status & SUSPECT).any()
    if fault == "restart":
        assert (status & RECONFIGURED).any()
