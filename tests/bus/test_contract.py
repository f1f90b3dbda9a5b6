"""One contract for every kind of `Bus`: the same conversations over the emulated root, a mux channel, a recording, its
replay, and Linux, whose kernel side is played by the emulated wire.

The device is an ADXL345: DEVID 0xE5 at 0x00 (ADX-10), offsets at 0x1E ... 0x20 that keep what is written (ADX-12),
BW_RATE 0x0A after power-on (ADX-30), pointer that counts on (ADX-03).
"""

from __future__ import annotations

import errno
import os
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import pytest

from firmware_emulator.device_file import Adapter, device_files
from imuarray.acquire.bus_segment import Pca9544a
from imuarray.array import ArrayConfig, parse_array
from imuarray.bus import Bus, open_bus
from imuarray.bus.linux import LinuxBus
from imuarray.bus.replay import ReplayBus
from imuarray.bus.transcript import RecordingBus
from imuarray.errors import BusUrlError
from tests.bus.conversations import CONVERSATIONS, DEVICE, MUX, NOBODY, ON_CHANNEL, ON_TRUNK

ON_KERNEL_BUS = ON_TRUNK + 'bus="/dev/i2c-7"\n'


@contextmanager
def linux(wires: dict[str, Any]) -> Iterator[None]:
    """These wires as the adapters of this machine, of the most restricted kind; in the end no device is left open."""
    with device_files({path: Adapter(wire, "bcm2835") for path, wire in wires.items()}):
        yield
        for path in wires:
            LinuxBus(path).__exit__(None, None, None)  # one that is still open is still locked


def emulated(text: str, url: str) -> tuple[Any, ArrayConfig]:
    array = parse_array(text)
    return open_bus(f"emulated:?{url}", array), array


Conversation = Callable[[Bus], None]


def over_root(talk: Conversation, url: str, folder: Path) -> None:
    with emulated(ON_TRUNK, url)[0] as bus:
        talk(bus)


def over_mux_channel(talk: Conversation, url: str, folder: Path) -> None:
    with emulated(ON_CHANNEL, url)[0] as bus:
        talk(Pca9544a(bus, MUX).channel(2))


def over_kernel_channel(talk: Conversation, url: str, folder: Path) -> None:
    with emulated(ON_KERNEL_BUS, url)[0] as bus:
        talk(bus.channel_bus("/dev/i2c-7"))


def over_recording(talk: Conversation, url: str, folder: Path) -> None:
    with RecordingBus(emulated(ON_TRUNK, url)[0], folder / "t.jsonl") as bus:
        talk(bus)


def over_recorded_channel(talk: Conversation, url: str, folder: Path) -> None:
    with RecordingBus(emulated(ON_KERNEL_BUS, url)[0], folder / "t.jsonl") as bus:
        talk(bus.channel_bus("/dev/i2c-7"))


def over_replay(talk: Conversation, url: str, folder: Path) -> None:
    over_recording(talk, url, folder)
    with ReplayBus(folder / "t.jsonl") as bus:
        talk(bus)
        bus.finished()


def over_replayed_channel(talk: Conversation, url: str, folder: Path) -> None:
    over_recorded_channel(talk, url, folder)
    with ReplayBus(folder / "t.jsonl") as bus:
        talk(bus.channel_bus("/dev/i2c-7"))
        bus.finished()


def over_linux(talk: Conversation, url: str, folder: Path) -> None:
    wire = emulated(ON_TRUNK, url)[0].wire
    with linux({"/dev/i2c-1": wire}), LinuxBus("/dev/i2c-1") as bus:
        talk(bus)


def over_linux_channel(talk: Conversation, url: str, folder: Path) -> None:
    root = emulated(ON_KERNEL_BUS, url)[0]
    with linux({"/dev/i2c-1": root.wire, "/dev/i2c-7": root.channel_bus("/dev/i2c-7")}), LinuxBus("/dev/i2c-1") as bus:
        talk(bus.channel_bus("/dev/i2c-7"))


KINDS = [
    over_root,
    over_mux_channel,
    over_kernel_channel,
    over_recording,
    over_recorded_channel,
    over_replay,
    over_replayed_channel,
    over_linux,
    over_linux_channel,
]


@pytest.mark.parametrize("talk", CONVERSATIONS)
@pytest.mark.parametrize("kind", KINDS)
def test_contract(kind: Callable[[Conversation, str, Path], None], talk: Conversation, tmp_path: Path) -> None:
    kind(talk, "errno=121", tmp_path)


@pytest.mark.parametrize("number", [6, 121])
@pytest.mark.parametrize("kind", KINDS)
def test_the_adapters_own_errno_arrives(
    kind: Callable[[Conversation, str, Path], None], number: int, tmp_path: Path
) -> None:
    def refused(bus: Bus) -> None:
        with pytest.raises(OSError, match=r".") as error:
            bus.transfer(NOBODY, b"\x00", 1)
        assert error.value.errno == number

    kind(refused, f"errno={number}", tmp_path)


@pytest.mark.parametrize(
    ("write", "read", "clocks"),
    [(b"", 0, 9), (b"\x00", 0, 18), (b"\x1e\x00", 0, 27), (b"\x00", 1, 36), (b"\x32", 6, 81), (b"", 2, 27)],
)
@pytest.mark.parametrize("through", ["emulated", "linux"])
def test_one_call_is_one_transaction_of_the_right_length(through: str, write: bytes, read: int, clocks: int) -> None:
    # BUS-02 ... BUS-04: 9 clocks a byte, addresses included; one STOP (LNX-06).
    wire = emulated(ON_TRUNK, "")[0].wire
    with ExitStack() as stack:
        bus: Bus = wire
        if through == "linux":
            stack.enter_context(linux({"/dev/i2c-1": wire}))
            bus = stack.enter_context(LinuxBus("/dev/i2c-1"))
        bus.transfer(DEVICE, write, read)
    assert (wire.transactions, wire.scl_clocks) == (1, clocks)


class TestLinux:
    def test_messages_that_the_kernel_refuses_are_never_sent(self) -> None:
        wire = emulated(ON_TRUNK, "")[0].wire
        with linux({"/dev/i2c-1": wire}), LinuxBus("/dev/i2c-1") as bus:
            assert len(bus.transfer(DEVICE, b"\x00", 8192)) == 8192  # LNX-05
            before = wire.transactions
            for write, read in ((bytes(8193), 0), (b"\x00", 8193), (b"", 70000)):  # LNX-33: 70000 would become 4464
                with pytest.raises(ValueError, match=r"0x53: \d+ bytes, a message carries at most 8192"):
                    bus.transfer(DEVICE, write, read)
            assert wire.transactions == before

    def test_other_errors_keep_their_class(self) -> None:
        class Stuck:
            def send(self, address: int, data: bytes) -> None:
                raise TimeoutError(errno.ETIMEDOUT, os.strerror(errno.ETIMEDOUT))  # LNX-43

        with linux({"/dev/i2c-1": Stuck()}), LinuxBus("/dev/i2c-1") as bus, pytest.raises(TimeoutError) as refused:
            bus.transfer(DEVICE)
        assert refused.value.errno == 110

    def test_a_channel_is_opened_once_and_closed_with_the_root(self) -> None:
        root = emulated(ON_KERNEL_BUS, "")[0]
        files = {"/dev/i2c-1": root.wire, "/dev/i2c-7": root.channel_bus("/dev/i2c-7")}
        with linux(files), LinuxBus("/dev/i2c-1") as bus:
            assert bus.channel_bus("/dev/i2c-7") is bus.channel_bus("/dev/i2c-7")
            assert bus.channel_bus("/dev/i2c-1") is bus
            with pytest.raises(BusUrlError, match="/dev/i2c-7: another program"):
                LinuxBus("/dev/i2c-7")

    def test_a_linux_bus_states_its_source_and_has_a_clock(self) -> None:
        with linux({"/dev/i2c-1": emulated(ON_TRUNK, "")[0].wire}), LinuxBus("/dev/i2c-1") as bus:
            assert bus.source == "i2c"
            first = bus.clock.now_ns()
            assert bus.clock.now_ns() >= first
