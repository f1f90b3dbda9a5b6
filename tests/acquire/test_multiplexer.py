"""PCA9544A: one write of 0x04 ... 0x07 a switch (PCA-03), by itself (PCA-06); after a failure no state is assumed."""

from __future__ import annotations

from collections.abc import Sequence

import pytest
from hypothesis import given
from hypothesis import strategies as st

from imuarray.acquire.bus_segment import Pca9544a
from imuarray.array import parse_array
from imuarray.bus import open_bus


class Wires:
    """Notes every transaction; fails those whose index is in `failing`."""

    def __init__(self, failing: Sequence[int] = ()) -> None:
        self.seen: list[tuple[int, bytes, int]] = []
        self.failing = set(failing)

    def transfer(self, address: int, write: bytes = b"", read: int = 0) -> bytes:
        self.seen.append((address, write, read))
        if len(self.seen) - 1 in self.failing:
            raise OSError(121, "Remote I/O error")
        return bytes(read)

    @property
    def switches(self) -> list[bytes]:
        return [write for address, write, _ in self.seen if address == 0x70]


@pytest.mark.parametrize(("channel", "code"), [(0, 0x04), (1, 0x05), (2, 0x06), (3, 0x07)])
def test_each_channel_has_its_code(channel: int, code: int) -> None:
    bus = Wires()
    assert Pca9544a(bus, 0x70).channel(channel).transfer(0x53, b"\x32", 6) == bytes(6)
    assert bus.seen == [(0x70, bytes([code]), 0), (0x53, b"\x32", 6)]


def test_a_switch_is_one_write() -> None:
    bus = Wires()
    mux = Pca9544a(bus, 0x70)
    first, second = mux.channel(0), mux.channel(1)
    for channel in (first, first, second, second, second, first):
        channel.transfer(0x53)
    assert bus.switches == [b"\x04", b"\x05", b"\x04"]


def test_two_handles_of_one_channel_share_the_selection() -> None:
    bus = Wires()
    mux = Pca9544a(bus, 0x70)
    mux.channel(3).transfer(0x53)
    mux.channel(3).transfer(0x1D)
    assert bus.switches == [b"\x07"]


def test_the_selection_is_unknown_after_a_failed_reading() -> None:
    bus = Wires(failing=[1])
    channel = Pca9544a(bus, 0x70).channel(2)
    with pytest.raises(OSError, match="Remote"):
        channel.transfer(0x53)
    channel.transfer(0x53)
    channel.transfer(0x53)
    assert bus.switches == [b"\x06", b"\x06"]


def test_after_a_failed_switch_nothing_is_sent_and_the_selection_is_unknown() -> None:
    bus = Wires(failing=[1 + 1])
    mux = Pca9544a(bus, 0x70)
    mux.channel(0).transfer(0x53)
    with pytest.raises(OSError, match="Remote"):
        mux.channel(1).transfer(0x53, b"\x2d\x08")
    assert bus.seen[-1] == (0x70, b"\x05", 0)  # channel 0's chip never gets the bytes for channel 1's
    mux.channel(0).transfer(0x53)  # may or may not be connected: select anew
    assert bus.switches == [b"\x04", b"\x05", b"\x04"]


@pytest.mark.parametrize("channel", [-1, 4])
def test_a_channel_out_of_range_is_refused(channel: int) -> None:
    bus = Wires()
    with pytest.raises(ValueError, match="does not fit"):
        Pca9544a(bus, 0x70).channel(channel).transfer(0x53)
    assert bus.seen == []


@given(st.lists(st.tuples(st.integers(0, 3), st.booleans()), max_size=40))
def test_after_any_failure_the_sensor_of_the_selected_channel_is_reached(calls: list[tuple[int, bool]]) -> None:
    """Against a model of the mux: 0x04 + k connects channel k; its state after a failed transaction is unknown."""
    connected: list[int | None] = [None]
    reached: list[int | None] = []
    fails = [False]

    class Model:
        def transfer(self, address: int, write: bytes = b"", read: int = 0) -> bytes:
            if address == 0x70:
                connected[0] = write[0] - 4
            else:
                reached.append(connected[0])
            if fails[0]:
                connected[0] = None  # a glitch: unknown
                raise OSError(6, "No such device or address")
            return b""

    mux = Pca9544a(Model(), 0x70)
    for channel, failing in calls:
        fails[0] = failing
        reached.clear()
        try:
            mux.channel(channel).transfer(0x53)
        except OSError:
            assert failing
        else:
            assert reached == [channel]


def test_each_channel_of_the_emulated_board_reaches_its_chip() -> None:
    head = '[array]\nname="a"\nmux={chip="pca9544a",address=0x70}\n'
    sensor = '[[sensor]]\nname="S{0}"\nchip="adxl345"\naddress=0x53\nrange=2\nchannel={0}\n'
    array = parse_array(head + "".join(sensor.format(channel) for channel in range(4)))
    with open_bus("emulated:", array) as bus:
        mux = Pca9544a(bus, 0x70)
        for channel in range(4):
            mux.channel(channel).transfer(0x53, bytes([0x1E, 10 + channel]))
        for channel in (2, 0, 3, 1):
            assert mux.channel(channel).transfer(0x53, b"\x1e", 1) == bytes([10 + channel])
            assert bus.transfer(0x70, read=1) == bytes([4 + channel])
