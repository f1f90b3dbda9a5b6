"""The emulated microcontroller behind a pseudo-terminal, and `imuarray log` at its other end."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from firmware_emulator.array import open_bus
from firmware_emulator.serial_firmware import Firmware
from firmware_emulator.serial_port import SerialPort
from imuarray.array import load_array
from imuarray.bus import serial_session
from imuarray.bus.serial_bus import open_serial
from imuarray.bus.serial_link import PollList, Request
from imuarray.cli import main
from imuarray.errors import BusUrlError
from imuarray.log import open_log

SMALL = (
    '[array]\nname="small"\nmux={chip="pca9544a",address=0x70}\n'
    '[[sensor]]\nname="A"\nchip="adxl345"\nchannel=1\naddress=0x53\nrange=4\nrate_hz=800\n'
    '[[sensor]]\nname="B"\nchip="adxl345"\nchannel=2\naddress=0x53\nrange=2\nrate_hz=400\n'
)


class Tap:
    """The bus of the microcontroller, and (begun, channel, answer) of every burst that an ADXL345 gave on it."""

    def __init__(self, bus: Any) -> None:
        self.bus = bus
        self.channel = -1
        self.bursts: list[tuple[int, int, bytes]] = []

    def transfer(self, address: int, write: bytes = b"", read: int = 0) -> bytes:
        begun_ns = time.monotonic_ns()
        answer: bytes = self.bus.transfer(address, write, read)
        if address == 0x70 and write:
            self.channel = write[0] & 3
        elif write == b"\x30" and read == 8:
            self.bursts.append((begun_ns, self.channel, answer))
        return answer


@contextmanager
def served(config: Path, **firmware: Any) -> Iterator[tuple[SerialPort, Tap]]:
    bus = open_bus({"clock": "real", "world": "shaking", "still_s": "0.1"}, load_array(config))
    tap = Tap(bus)
    with SerialPort(Firmware(tap, bus.clock, **firmware)) as port:
        thread = threading.Thread(target=port.serve_forever)
        thread.start()
        try:
            yield port, tap
        finally:
            port.shutdown()
            thread.join()


@pytest.fixture
def config(tmp_path: Path) -> Path:
    (tmp_path / "small.toml").write_text(SMALL)
    return tmp_path / "small.toml"


def test_a_log_through_the_port_equals_the_data_of_the_emulated_bus(config: Path, tmp_path: Path) -> None:
    run = tmp_path / "run.h5"
    with served(config, drift=1e-3, counter_us=(1 << 32) - 600_000) as (port, tap):
        words = ["log", str(config), "--bus", f"serial:{port.path}", "-o", str(run), "--seconds", "0.4"]
        begun_ns = time.monotonic_ns()
        assert main([*words, "--rate-hz", "100"]) == 0
    with open_log(run) as log:
        assert log.source == "serial"
        for name, channel in (("A", 1), ("B", 2)):
            wire = [(at_ns, data) for at_ns, where, data in tap.bursts if where == channel and at_ns > begun_ns]
            wire_counts = np.array([np.frombuffer(data[2:], "<i2") for _, data in wire])
            time_ns, counts = log[name].time[:], log[name].counts[:]
            assert len(counts) >= 3  # of 40; a busy machine logs fewer
            # Counts of noise and shaking repeat by chance: where does the log begin on the wire?
            starts = range(len(wire_counts) - len(counts) + 1)
            (start,) = [at for at in starts if (wire_counts[at : at + len(counts)] == counts).all()]
            wire_ns = np.array([at_ns for at_ns, _ in wire[start : start + len(counts)]])
            spacing = (time_ns - time_ns[0]) - (wire_ns - wire_ns[0])
            # Of 10 ms. A busy machine delays what we note of some rows, and so of the first.
            assert np.median(np.abs(spacing - np.median(spacing))) < 5_000_000


@pytest.fixture
def hasty(monkeypatch: pytest.MonkeyPatch) -> None:
    """These tests do not depend on the clock fit."""
    monkeypatch.setattr(serial_session, "PING_S", 0.0)


@pytest.mark.usefixtures("hasty")
def test_one_program_at_a_time_uses_the_port(config: Path) -> None:
    with served(config) as (port, _):
        for _ in range(2):
            bus = open_serial(port.path)
            bus.start([PollList(1, 0, (Request(0x70, b"\x05", 0), *[Request(0x53, b"\x00", 57)] * 8))], 500)
            bus._session.port.close()  # killed: the stream continues without a reader
            time.sleep(0.05)
        with open_serial(port.path) as bus:
            bus.transfer(0x70, b"\x05")
            assert bus.transfer(0x53, b"\x00", 1) == b"\xe5"
            with pytest.raises(BusUrlError, match="another program has locked this port"):
                open_serial(port.path)
        assert port.firmware.due_ns is None


@pytest.mark.usefixtures("hasty")
def test_unread_frames_are_dropped_whole(config: Path) -> None:
    with served(config) as (port, _):
        with open_serial(port.path) as bus:
            bus.start([PollList(1, 0, (Request(0x70, b"\x05", 0), *[Request(0x53, b"\x00", 57)] * 8))], 500)
            until = time.monotonic() + 5
            while port.dropped < 3 and time.monotonic() < until:
                time.sleep(0.01)
            batches = [bus.receive() for _ in range(3)]
            numbers = np.concatenate([samples[0].numbers for samples in batches if samples])
        assert port.dropped >= 3
        assert bus.skipped == 0
        assert (np.diff(numbers) > 0).all()


@pytest.mark.slow
def test_the_papers_array_is_logged_from_another_process(tmp_path: Path) -> None:
    run, configs = tmp_path / "run.h5", Path(__file__).parents[2] / "configs"
    arguments = [str(configs / "martin2013.toml"), "--serial"]
    in_a_terminal = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler)"  # a shell's & doesn't
    program = f"{in_a_terminal}; import sys; from firmware_emulator.__main__ import main; sys.exit(main({arguments!r}))"
    command = [sys.executable, "-c", program]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, text=True, env=os.environ | {"PYTHONUNBUFFERED": "1"}
    ) as process:
        assert process.stdout is not None
        try:
            name, url = process.stdout.readline().split()
            assert name == "martin2013:"
            assert main(["log", "martin2013", "--bus", url, "-o", str(run), "--seconds", "5", "--rate-hz", "50"]) == 0
        finally:
            process.send_signal(signal.SIGINT)
            assert process.wait(60) == 130
    with open_log(run) as log:
        for sensor in ("ADXL1", "BMA3", "Gyro3"):
            time_s = log[sensor].time[:].astype(float) * 1e-9
            assert 2.5 < np.ptp(time_s) < 5.5  # a busy machine may lose some of the 250 frames
            # frames of this process are late on a busy machine and never early; tests/acquire has their exact times
            assert 0.0198 < np.median(np.diff(time_s)) < 0.1
            assert abs(np.linalg.norm(log["BMA3"].counts[:].mean(axis=0)) - 5461) < 800  # g at 1.5 g full scale
