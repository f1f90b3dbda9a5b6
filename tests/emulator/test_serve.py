"""The emulated array behind a real socket: a small USB/IP client enumerates it and talks I2C through it."""

from __future__ import annotations

import shutil
import socket
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from types import SimpleNamespace
from typing import Self

import pytest

from firmware_emulator import __main__ as program
from firmware_emulator import serve
from firmware_emulator.array import open_array
from firmware_emulator.serve import UsbipServer

CONFIG = Path(__file__).parents[2] / "configs" / "martin2013.toml"


def sensor(name: str, chip: str, address: int, channel: int | None, bus: str | None = None) -> SimpleNamespace:
    return SimpleNamespace(
        name=name, chip=chip, address=address, channel=channel, bus=bus, range=None, orientation=None
    )


ARRAY = SimpleNamespace(
    name="mine",
    mux=SimpleNamespace(chip="pca9544a", address=0x70),
    sensors=(
        sensor("ADXL1", "adxl345", 0x53, 0),
        sensor("BMP180", "bmp180", 0x77, 0),
        sensor("Gyro3", "l3g4200d", 0x68, 1),
        sensor("Gyro9", "l3g4200d", 0x69, None, "/dev/i2c-11"),
    ),
)


class Client:
    """As Linux: import, then control transfers one after the other."""

    def __init__(self, address: tuple[str, int], busid: bytes = b"1-1") -> None:
        self.socket = socket.create_connection(address, timeout=5)
        self.socket.sendall(bytes.fromhex("0111 8003 00000000") + busid.ljust(32, b"\0"))
        self.status = struct.unpack(">HHI", self.take(8))[2]
        self.sequence = 0
        if self.status == 0:
            place = struct.unpack_from(">II", self.take(312), 0x120)
            self.devid = place[0] << 16 | place[1]

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.socket.close()

    def take(self, count: int) -> bytes:
        got = b""
        while len(got) < count:
            more = self.socket.recv(count - len(got))
            if not more:
                raise ConnectionError("closed")
            got += more
        return got

    def control(self, setup: bytes, data: bytes = b"") -> tuple[int, bytes]:
        """Status and data."""
        inwards, length = setup[0] >> 7, struct.unpack_from("<H", setup, 6)[0]
        self.sequence += 1
        head = struct.pack(">10I", 1, self.sequence, self.devid, inwards, 0, 0, length, 0, 0, 0)
        self.socket.sendall(head + setup + data)
        answer = self.take(48)
        command, sequence = struct.unpack_from(">II", answer)
        assert (command, sequence) == (3, self.sequence)
        status, actual = struct.unpack_from(">iI", answer, 0x14)
        return status, self.take(actual) if inwards else b""

    def i2c(self, *messages: tuple[int, bytes | int]) -> list[bytes]:
        """(address, bytes to write or count to read) in one transaction; OSError(6) as Linux has it."""
        got = []
        for index, (address, what) in enumerate(messages):
            request = 4 | (index == 0) | 2 * (index == len(messages) - 1)
            if isinstance(what, int):
                status, data = self.control(struct.pack("<BBHHH", 0xC1, request, 1, address, what))
                got.append(data)
            else:
                status, _ = self.control(struct.pack("<BBHHH", 0x41, request, 0, address, len(what)), what)
            assert status == 0
            if self.control(struct.pack("<BBHHH", 0xC1, 3, 0, 0, 1)) == (0, b"\x02"):
                raise OSError(6, "no acknowledge")
        return got


@pytest.fixture
def log() -> list[str]:
    return []


@pytest.fixture
def server(log: list[str]) -> Iterator[UsbipServer]:
    bus = open_array(ARRAY, clock="real")
    with UsbipServer(bus.wires, ARRAY.name, port=0, log=log.append) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        yield server
        server.shutdown()
        thread.join(5)
        assert not thread.is_alive()


def eventually(log: list[str], part: str) -> str:
    for _ in range(200):
        for line in list(log):
            if part in line:
                return line
        time.sleep(0.02)
    raise AssertionError(f"{part!r} is not in {log}")


def test_a_client_enumerates_the_adapter(server: UsbipServer) -> None:
    with Client(server.address) as client:
        status, descriptor = client.control(struct.pack("<BBHHH", 0x80, 6, 0x0100, 0, 64))
        assert status == 0
        assert struct.unpack_from("<HH", descriptor, 8) == (0x0403, 0xC631)
        assert client.control(struct.pack("<BBHHH", 0x00, 9, 1, 0, 0)) == (0, b"")
        assert client.control(struct.pack("<BBHHH", 0x80, 6, 0x0600, 0, 10)) == (-32, b"")
        assert client.control(struct.pack("<BBHHH", 0x41, 2, 10, 0, 0)) == (0, b"")


def test_chips_behind_the_multiplexer_have_their_identities(server: UsbipServer) -> None:
    with Client(server.address) as client:
        with pytest.raises(OSError, match="no acknowledge"):
            client.i2c((0x53, b"\x00"), (0x53, 1))
        client.i2c((0x70, b"\x04"))
        assert client.i2c((0x53, b"\x00"), (0x53, 1)) == [b"\xe5"]  # ADX-10
        assert client.i2c((0x77, b"\xd0"), (0x77, 1)) == [b"\x55"]  # BMP-11
        client.i2c((0x70, b"\x05"))
        assert client.i2c((0x68, b"\x0f"), (0x68, 1)) == [b"\xd3"]  # L3G-10
        with pytest.raises(OSError, match="no acknowledge"):
            client.i2c((0x53, b"\x00"), (0x53, 1))


def test_two_devices_are_read_in_one_transaction(server: UsbipServer) -> None:
    with Client(server.address) as client:
        client.i2c((0x70, b"\x04"))
        got = client.i2c((0x53, b"\x00"), (0x53, 1), (0x77, b"\xd0"), (0x77, 1))
        assert got == [b"\xe5", b"\x55"]


def test_a_conversion_takes_real_time(server: UsbipServer) -> None:
    """Pressure with eight samples takes at most 25.5 ms (BMP-44), sco is 1 until then (BMP-46)."""
    with Client(server.address) as client:
        time.sleep(0.012)  # the chip's start-up: BMP-50
        client.i2c((0x70, b"\x04"))
        begun_ns = time.monotonic_ns()
        client.i2c((0x77, b"\xf4\xf4"))
        converting = client.i2c((0x77, b"\xf4"), (0x77, 1))[0][0] & 0x20
        assert converting or time.monotonic_ns() - begun_ns > 17_000_000  # or the machine was busy
        time.sleep(0.0255)
        assert not client.i2c((0x77, b"\xf4"), (0x77, 1))[0][0] & 0x20


def test_every_other_bus_is_a_separate_adapter(server: UsbipServer) -> None:
    assert server.titles == {"1-1": "mine", "1-2": "mine /dev/i2c-11"}
    with Client(server.address) as trunk, Client(server.address, b"1-2") as other:
        assert other.i2c((0x69, b"\x0f"), (0x69, 1)) == [b"\xd3"]
        with pytest.raises(OSError, match="no acknowledge"):
            trunk.i2c((0x69, b"\x0f"), (0x69, 1))


def test_one_client_at_a_time_and_its_bus_is_released_afterwards(server: UsbipServer, log: list[str]) -> None:
    with Client(server.address) as first:
        with Client(server.address) as second:
            assert second.status == 1
        first.i2c((0x70, b"\x04"))
        first.control(struct.pack("<BBHHH", 0x41, 4 | 1, 0, 0x53, 1), b"\x00")  # begun, never ended
    eventually(log, "detached 1-1")
    with Client(server.address) as third:
        assert third.i2c((0x53, 1)) == [b"\xe5"]


def test_invalid_data_closes_only_its_own_connection(server: UsbipServer, log: list[str]) -> None:
    with Client(server.address) as client, socket.create_connection(server.address, timeout=5) as junk:
        junk.sendall(b"GET / HTTP/1.1\r\n\r\n" * 5000)
        with suppress(ConnectionResetError):  # unread data resets the connection
            assert junk.recv(1) == b""
        eventually(log, "not USB/IP: version 0x4745; allowed is 0x0111")
        client.i2c((0x70, b"\x04"))
        assert client.i2c((0x53, b"\x00"), (0x53, 1)) == [b"\xe5"]
    assert all("\n" not in line for line in log)


def test_idle_and_excess_connections_are_closed(
    server: UsbipServer, log: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(serve, "PATIENCE_S", 0.2)
    idle = [socket.create_connection(server.address, timeout=5) for _ in range(serve.MAX_CONNECTIONS + 1)]
    eventually(log, "refused, 16 are connected")
    for connection in idle:
        assert connection.recv(1) == b""  # the server closed it: after a while, or at once
        connection.close()
    with Client(server.address) as client:
        assert client.status == 0


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("usbip") is None, reason="Debian's package usbip is not installed")
def test_usbip_lists_the_adapters(server: UsbipServer) -> None:
    command = ["usbip", "--tcp-port", str(server.address[1]), "list", "-r", "127.0.0.1"]
    shown = subprocess.run(command, capture_output=True, text=True, timeout=20, check=True).stdout
    assert "1-1: " in shown
    assert "1-2: " in shown
    assert shown.count("(0403:c631)") == 2


def test_the_command_prints_how_to_attach_and_serves() -> None:
    command = [sys.executable, "-m", "firmware_emulator", str(CONFIG), "--usbip", "--port", "0", "--query", "seed=4"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        try:
            words = process.stdout.readline().split()
            assert words[:3] == ["martin2013:", "usbip", "--tcp-port"]
            assert words[4:] == ["attach", "-r", "127.0.0.1", "-b", "1-1"]
            with Client(("127.0.0.1", int(words[3]))) as client:
                client.i2c((0x70, b"\x05"))
                assert client.i2c((0x68, b"\x0f"), (0x68, 1)) == [b"\xd3"]
        finally:
            process.terminate()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([str(CONFIG)], "give either --usbip or --serial"),
        ([str(CONFIG), "--usbip", "--query", "clock=virtual"], "clock=virtual; allowed is real"),
        ([str(CONFIG), "--usbip", "--query", "world=moon"], "allowed are still"),
        (["no/such.toml", "--usbip"], "no/such.toml"),
        ([str(CONFIG), "--usbip", "--port", "65536"], "0<=x<=65535"),
        ([str(CONFIG), "--usbip", "--host", "192.0.2.1"], "192.0.2.1 port 3240"),
    ],
)
def test_bad_arguments_are_one_line_and_exit_code_2(
    arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert program.main(arguments) == 2
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1
    assert message in lines[0]
