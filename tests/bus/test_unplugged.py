"""An adapter that is unplugged while it is in use: detected, released to the kernel, identified when it returns."""

from __future__ import annotations

import errno
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from firmware_emulator.array import EmulatedBus, open_array
from imuarray.acquire.recorder import record
from imuarray.array import ArrayConfig, parse_array
from imuarray.bus import linux
from imuarray.bus.identity import adapters, is_alone, ports, search
from imuarray.bus.linux import LinuxBus
from imuarray.bus.serial_port import UsualPort
from imuarray.bus.transcript import RecordingBus
from imuarray.cli import main
from imuarray.log import open_log
from imuarray.log.format import LOST_BEFORE, RECONFIGURED
from tests.bus.machine import Machine
from tests.bus.serial_bench import Bench as SerialBench
from tests.selection import some

SECOND = 1_000_000_000
TRUNK = """[array]
name = "a"
mux = { chip = "pca9544a", address = 0x70 }
[[sensor]]
name = "A"
chip = "adxl345"
channel = 0
address = 0x53
range = 4
rate_hz = 800
[[sensor]]
name = "B"
chip = "bma180"
channel = 1
address = 0x40
range = 2
"""
CHANNELS = (
    TRUNK.replace('mux = { chip = "pca9544a", address = 0x70 }\n', "")
    .replace("channel = 0", 'bus = "/dev/i2c-11"')
    .replace("channel = 1", 'bus = "/dev/i2c-12"')
)


class Bench:
    """An emulated array behind adapters of a machine; `at` does things at times, in s of the recording."""

    def __init__(self, folder: Path, text: str) -> None:
        self.array: ArrayConfig = parse_array(text)
        self.board: EmulatedBus = open_array(self.array)
        wires = self.board.wires
        self.machine = Machine(
            folder,
            {
                **dict.fromkeys((1, 3, 5), self.board.wire),
                **{number: wires[f"/dev/i2c-{number}"] for number in (11, 12) if f"/dev/i2c-{number}" in wires},
            },
        )
        for number in (21, 22):
            if f"/dev/i2c-{number - 10}" in wires:
                self.machine.wires[number] = wires[f"/dev/i2c-{number - 10}"]

    def lose_supply(self) -> None:
        for chip in self.board.chips.values():
            chip.power_on(self.board.clock.now_ns())

    def bus(self) -> LinuxBus:
        return LinuxBus("/dev/i2c-1", devices=self.machine.devices, clock=self.board.clock)

    def record(self, path: Path, seconds: float, at: dict[float, Callable[[], Any]]) -> Any:
        todo, events = sorted(at.items()), list[Any]()
        with self.bus() as bus:
            begun: list[int] = []

            def stopped() -> bool:
                begun.append(bus.clock.now_ns())
                self.machine.work()
                while todo and begun[-1] - begun[0] >= todo[0][0] * SECOND:
                    todo.pop(0)[1]()
                return False

            done = record(
                self.array,
                bus,
                path,
                rate_hz=50,
                seconds=seconds,
                stopped=stopped,
                on_event=events.append,  # type: ignore[arg-type]
            )
        assert not todo
        return done, [(event.time_ns / SECOND, event.sensor, event.kind, event.message) for event in events]


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Callable[..., Bench]]:
    opened: list[Any] = []

    def make(text: str = TRUNK) -> Bench:
        made = Bench(tmp_path / "sys", text)
        serving = made.machine.serving()
        serving.__enter__()
        opened.append(serving)
        return made

    yield make
    for serving in opened:
        serving.__exit__(None, None, None)


@pytest.mark.slow
def test_a_recording_continues_when_the_adapter_returns_with_another_number(
    bench: Callable[..., Bench], tmp_path: Path
) -> None:
    """Away from 2 s to 6 s; then another adapter has its number, and its chips lost their supply."""
    it = bench()
    machine = it.machine
    machine.plug(1, "1-1", "array")

    def plug_others() -> None:
        machine.plug(1, "1-4", "somebody", vendor="1c40")

    def plug_in() -> None:
        it.lose_supply()
        machine.plug(3, "1-1", "array")

    done, events = it.record(tmp_path / "r.h5", 12, {2.0: lambda: machine.unplug(1), 4.0: plug_others, 6.0: plug_in})
    (removal, again) = [event for event in events if event[2] == "adapter"]
    assert 2.0 <= removal[0] < 2.1
    assert removal[3] == (
        "the adapter /dev/i2c-1 (USB 0403:c631 serial array at port 1-1, i2c-tiny-usb at bus # device #, interface 1.0)"
        " was removed (errno 19)"
    )
    assert 6.0 < again[0] < 6.6
    assert again[3].startswith("the adapter is back as /dev/i2c-3, its sensors are configured again")
    assert sorted(event[1] for event in events if event[2] == "reconfigured") == ["A", "B"]
    assert len(events) <= 8
    assert done.silent == []
    with open_log(tmp_path / "r.h5") as log:
        for name in "AB":
            time, status = np.asarray(log[name].time) / SECOND, np.asarray(log[name].status)
            (back,) = np.flatnonzero(status & RECONFIGURED)
            assert status[back] & LOST_BEFORE
            assert 6.0 < time[back] < 7.0
            assert time[back - 1] < 2.1
            assert time[-1] > 11.9
            assert len(time) + done.lost[name] == pytest.approx(done.frames, abs=2)
            z = np.asarray(log[name].counts)[back:, 2] / {"A": 256, "B": 4096}[name]  # ADX-40, BMA-72
            assert np.abs(z - 1.0).max() < 0.4


def test_an_unplugged_adapter_is_closed(bench: Callable[..., Bench]) -> None:
    it = bench()
    it.machine.plug(1, "1-1")
    with it.bus() as bus:
        assert bus.transfer(0x70, read=1) == b"\x00"
        assert it.machine.opened(1) == 1
        it.machine.unplug(1)
        with pytest.raises(OSError, match=r"the adapter /dev/i2c-1 .* was removed") as error:
            bus.transfer(0x70, read=1)
        assert error.value.errno == errno.ENODEV
        assert it.machine.opened(1) == 0
        assert bus.where is None
    assert it.machine.opened(1) == 0


def test_an_error_of_a_plugged_adapter_is_passed_on(bench: Callable[..., Bench]) -> None:
    it = bench()
    it.machine.plug(1, "1-1")
    with it.bus() as bus:
        it.machine.there.clear()  # it fails, and is not unplugged
        with pytest.raises(OSError, match="Input/output error"):
            bus.transfer(0x70, read=1)
        it.machine.there.add(1)
        assert bus.transfer(0x70, read=1) == b"\x00"


def test_an_unplugged_adapter_is_searched_at_intervals(
    bench: Callable[..., Bench], monkeypatch: pytest.MonkeyPatch
) -> None:
    it = bench()
    it.machine.plug(1, "1-1")
    looks: list[int] = []
    with it.bus() as bus:
        it.machine.unplug(1)

        def counted(*arguments: Any, **keywords: Any) -> None:
            looks.append(1)

        monkeypatch.setattr(linux, "search", counted)
        for _ in range(1000):
            it.board.clock.sleep_until(it.board.clock.now_ns() + SECOND // 100)
            with pytest.raises(OSError, match="was removed"):
                bus.transfer(0x70)
        assert 45 <= len(looks) <= 51  # 10 s, every 0.2 s


@pytest.mark.slow
def test_channels_of_the_kernel_return_with_their_adapter(bench: Callable[..., Bench], tmp_path: Path) -> None:
    """Each channel's removal waits until it is closed, the adapter's until all of them are; nothing is on the adapter
    itself. The multiplexer is set up again from outside; the channels have other numbers then.
    """
    it = bench(CHANNELS)
    machine = it.machine
    machine.plug(1, "1-1", channels={0: 11, 1: 12})

    def plug_in() -> None:
        it.lose_supply()
        machine.plug(3, "1-1", channels={0: 21, 1: 22})

    done, events = it.record(tmp_path / "r.h5", 12, {2.0: lambda: machine.unplug(12, 11, 1), 6.0: plug_in})
    messages = [event[3] for event in events if event[2] == "adapter"]
    assert sorted(message.split(",")[0] for message in messages[2:]) == [
        "the adapter is back as /dev/i2c-21",
        "the adapter is back as /dev/i2c-22",
    ]
    assert all("multiplexer 0070 channel-" in message for message in messages[:2])
    assert done.silent == []
    with open_log(tmp_path / "r.h5") as log:
        for name in "AB":
            time, status = np.asarray(log[name].time) / SECOND, np.asarray(log[name].status)
            (back,) = np.flatnonzero(status & RECONFIGURED)
            assert time[back - 1] < 2.1
            assert 6.0 < time[back] < 7.0
            assert time[-1] > 11.9


@pytest.mark.slow
def test_an_adapter_that_stays_unplugged_is_reported_until_the_end(bench: Callable[..., Bench], tmp_path: Path) -> None:
    it = bench()
    it.machine.plug(1, "1-1")
    done, events = it.record(tmp_path / "r.h5", 3600, {2.0: lambda: it.machine.unplug(1)})
    assert done.silent == ["A", "B"]
    assert len(events) <= 6
    adapter = [event for event in events if event[2] == "adapter"]
    assert adapter[1][3] == "still present when the log ended, after 3598.0 s"
    assert sum(done.lost.values()) == pytest.approx(2 * 3598 * 50, abs=10)


class TestIdentity:
    def known_adapters(self, machine: Machine) -> dict[str, int]:
        return {entry.name: entry.mark for entry in adapters(machine.devices).values()}

    @pytest.fixture
    def machine(self, tmp_path: Path) -> Machine:
        return Machine(tmp_path, {})

    @pytest.mark.parametrize(
        ("serial", "others", "again", "expected"),
        [
            ("", (), ("1-1", ""), "i2c-9"),  # the same port
            ("", (), ("1-2", ""), "i2c-9"),  # another port, and it was the only one of its kind
            ("", ("",), ("1-2", ""), None),  # another port: it could be the other one
            ("", ("",), ("1-1", ""), "i2c-9"),
            ("S1", (), ("1-2", "S1"), "i2c-9"),  # the same serial number
            ("S1", (), ("1-1", "S2"), None),  # another adapter at its port
            ("S1", ("S2",), ("1-2", "S1"), "i2c-9"),
            ("S1", ("S1",), ("1-2", "S1"), None),  # cheap adapters share a serial number
            ("S1", ("S1",), ("1-1", "S1"), "i2c-9"),
        ],
    )
    def test_the_adapter_is_identified_by_serial_number_or_port(
        self, machine: Machine, serial: str, others: tuple[str, ...], again: tuple[str, str], expected: str | None
    ) -> None:
        machine.plug(1, "1-1", serial)
        for index, other in enumerate(others):
            machine.plug(2 + index, f"1-{5 + index}", other)
        wanted = adapters(machine.devices)["i2c-1"].identity
        alone = is_alone(wanted, adapters(machine.devices))
        machine.unplug(1)
        machine.work()
        known = self.known_adapters(machine)
        assert search(wanted, adapters(machine.devices), known, alone=alone) is None
        machine.plug(9, again[0], again[1])
        assert search(wanted, adapters(machine.devices), known, alone=alone) == expected

    def test_a_built_in_adapter_is_identified_by_its_address(self, tmp_path: Path) -> None:
        devices = tmp_path / "bus"
        devices.mkdir()
        for number, parent in ((0, "fe804000.i2c"), (1, "fe205000.i2c")):
            folder = tmp_path / "devices/platform/soc" / parent / f"i2c-{number}"
            folder.mkdir(parents=True)
            (folder / "name").write_text(f"bcm2835 ({parent})\n")
            (devices / f"i2c-{number}").symlink_to(folder)
        entries = adapters(devices)
        assert [entry.identity.text.partition(",")[0] for entry in entries.values()] == [
            "bcm2835 (fe804000.i2c) of fe804000.i2c",
            "bcm2835 (fe205000.i2c) of fe205000.i2c",
        ]
        assert is_alone(entries["i2c-0"].identity, entries)

    def test_a_serial_port_is_identified_by_its_usb_device(self, tmp_path: Path) -> None:
        for name, part in (("ttyACM0", "1-2:1.0"), ("ttyUSB0", "1-3:1.0/ttyUSB0")):
            port = part.partition(":")[0]
            folder = tmp_path / "devices/usb1" / port / part
            (folder / "tty" / name).mkdir(parents=True)
            (tmp_path / "devices/usb1" / port / "idVendor").write_text("2341\n")
            (tmp_path / "devices/usb1" / port / "idProduct").write_text("0043\n")
            (tmp_path / "class").mkdir(exist_ok=True)
            (tmp_path / "class" / name).symlink_to(folder / "tty" / name)
            (folder / "tty" / name / "device").symlink_to(folder)
        entries = ports(tmp_path / "class")
        assert [(name, entry.identity.text) for name, entry in entries.items()] == [
            ("ttyACM0", "USB 2341:0043 at port 1-2, interface 1.0"),
            ("ttyUSB0", "USB 2341:0043 at port 1-3, interface 1.0"),
        ]

    def test_without_sysfs_no_device_is_listed(self, tmp_path: Path) -> None:
        assert adapters(tmp_path / "none") == {}
        assert ports(tmp_path / "none") == {}


@pytest.mark.slow
@pytest.mark.parametrize(("for_s", "expected"), some([(100.0, 1), (3.0, 0)], 1))
def test_a_log_whose_adapter_stays_unplugged_ends_with_an_error(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], for_s: float, expected: int
) -> None:
    (tmp_path / "a.toml").write_text(TRUNK)
    (tmp_path / "n.toml").write_text(f'[[fault]]\nkind="adapter_unplugged"\nat_s=3.0\nfor_s={for_s}\n')
    url, run = f"emulated:?faults={tmp_path / 'n.toml'}", str(tmp_path / "r.h5")
    assert main(["log", str(tmp_path / "a.toml"), "--bus", url, "--seconds", "10", "-o", run]) == expected
    errors = capsys.readouterr().err
    assert "adapter: the emulated adapter is unplugged (errno 19)" in errors
    assert ("no sensor answered when the recording ended" in errors) == bool(expected)
    assert ("adapter: the adapter is back" in errors) == (not expected)


class TestSerialPort:
    def plug(self, folder: Path, name: str, port: str, product: str = "0043") -> None:
        interface = folder / "devices/usb1" / port / f"{port}:1.0"
        (interface / "tty" / name).mkdir(parents=True)
        (interface.parent / "idVendor").write_text("2341\n")
        (interface.parent / "idProduct").write_text(f"{product}\n")
        (folder / "class").mkdir(exist_ok=True)
        (folder / "class" / name).symlink_to(interface / "tty" / name)
        (interface / "tty" / name / "device").symlink_to(interface)

    def unplug(self, folder: Path, name: str, port: str) -> None:
        (folder / "class" / name).unlink()
        # Kept elsewhere, or the next entry may get its inode: ext4 does so at once, sysfs counts on.
        removed = folder / "removed"
        removed.mkdir(exist_ok=True)
        (folder / "devices/usb1" / port).rename(removed / f"{len(list(removed.iterdir()))}")

    def test_the_same_device_is_reopened_under_its_new_number(self, tmp_path: Path) -> None:
        opened: list[str] = []

        def open_port(path: str, baud: int) -> Any:
            opened.append(path)

        self.plug(tmp_path, "ttyACM0", "1-1")
        port = UsualPort("/dev/ttyACM0", 115_200, devices=tmp_path / "class", open_port=open_port)
        port()
        port()
        self.unplug(tmp_path, "ttyACM0", "1-1")
        with pytest.raises(FileNotFoundError, match=r"USB 2341:0043 at port 1-1, interface 1\.0 was removed"):
            port()
        self.plug(tmp_path, "ttyACM0", "1-2", "0042")  # another device takes the number
        with pytest.raises(FileNotFoundError):
            port()
        self.plug(tmp_path, "ttyACM1", "1-1")
        port()
        assert opened == ["/dev/ttyACM0", "/dev/ttyACM0", "/dev/ttyACM1"]

    def test_without_sysfs_the_path_is_reopened(self, tmp_path: Path) -> None:
        opened: list[str] = []
        port = UsualPort("/dev/ttyS0", 9600, devices=tmp_path, open_port=lambda path, baud: opened.append(path))  # type: ignore[func-returns-value,arg-type,return-value]
        port()
        port()
        assert opened == ["/dev/ttyS0", "/dev/ttyS0"]


@pytest.mark.slow
def test_a_microcontroller_without_a_stream_is_reconnected(tmp_path: Path) -> None:
    """With a transcript, or queues, it does not stream. Unplugged for 5 s; its chips lose their supply."""
    array = parse_array(TRUNK)
    it = SerialBench(array)
    begun: list[int] = []

    def stopped() -> bool:
        begun.append(it.now_ns())
        since_s = (begun[-1] - begun[0]) / SECOND
        if 3 < since_s < 8 and not it.unplugged:
            it.unplug()
        if since_s > 8 and it.unplugged:
            it.unplugged = False
            for chip in it.emulated.chips.values():
                chip.power_on(it.now_ns())
        return False

    events: list[Any] = []
    with RecordingBus(it.bus(), tmp_path / "t.jsonl") as bus:
        done = record(array, bus, tmp_path / "r.h5", rate_hz=20, seconds=15, stopped=stopped, on_event=events.append)
    assert done.silent == []
    adapter = [event for event in events if event.kind == "adapter"]
    assert len(adapter) == 2
    assert 3 * SECOND < adapter[0].time_ns < 5 * SECOND
    assert 8 * SECOND < adapter[1].time_ns < 11 * SECOND
    with open_log(tmp_path / "r.h5") as log:
        for name in "AB":
            time, status = np.asarray(log[name].time) / SECOND, np.asarray(log[name].status)
            (back,) = np.flatnonzero(status & RECONFIGURED)
            assert 8.0 < time[back] < 12.0
            assert time[-1] > 14.9
