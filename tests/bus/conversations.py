"""Conversations that every bus must carry."""

from __future__ import annotations

import pytest

from imuarray.bus import Bus

DEVICE, NOBODY, MUX = 0x53, 0x1D, 0x70
ON_TRUNK = f'[array]\nname="a"\n[[sensor]]\nname="A"\nchip="adxl345"\naddress={DEVICE}\nrange=2\n'
ON_CHANNEL = ON_TRUNK.replace('name="a"', 'name="a"\nmux={chip="pca9544a",address=0x70}') + "channel=2\n"


def asking_for_an_acknowledge(bus: Bus) -> None:
    assert bus.transfer(DEVICE) == b""
    with pytest.raises(OSError, match=r".") as refused:
        bus.transfer(NOBODY)
    assert refused.value.errno in (6, 121)
    assert bus.transfer(DEVICE) == b""


def writing_then_reading_in_one(bus: Bus) -> None:
    assert bus.transfer(DEVICE, b"\x00", 1) == b"\xe5"
    assert bus.transfer(DEVICE, b"\x2c", 1) == b"\x0a"


def writing_alone(bus: Bus) -> None:
    assert bus.transfer(DEVICE, b"\x1e\x12\x34\x56") == b""
    assert bus.transfer(DEVICE, b"\x1e", 3) == b"\x12\x34\x56"


def reading_alone(bus: Bus) -> None:
    assert bus.transfer(DEVICE, b"\x1e\x0a\x0b\x0c") == b""
    assert bus.transfer(DEVICE, b"\x1e") == b""
    assert bus.transfer(DEVICE, read=2) == b"\x0a\x0b"
    assert bus.transfer(DEVICE, b"", 1) == b"\x0c"


def long_messages(bus: Bus) -> None:
    assert bus.transfer(DEVICE, b"\x1d" + bytes(range(1, 12))) == b""
    assert bus.transfer(DEVICE, b"\x1d", 11) == bytes(range(1, 12))
    assert len(bus.transfer(DEVICE, b"\x00", 100)) == 100


def everything_that_comes_back_is_bytes(bus: Bus) -> None:
    for answer in (
        bus.transfer(DEVICE),
        bus.transfer(DEVICE, b"\x00"),
        bus.transfer(DEVICE, b"\x00", 4),
        bus.transfer(DEVICE, read=1),
    ):
        assert type(answer) is bytes


def nobody_at_home(bus: Bus) -> None:
    for write, read in ((b"", 0), (b"\x00", 0), (b"\x00", 1), (b"", 1), (b"\x00\x00", 6)):
        with pytest.raises(OSError, match=r".") as refused:
            bus.transfer(NOBODY, write, read)
        assert type(refused.value) is OSError
        assert refused.value.errno in (6, 121)
    assert bus.transfer(DEVICE, b"\x00", 1) == b"\xe5"


CONVERSATIONS = [
    asking_for_an_acknowledge,
    writing_then_reading_in_one,
    writing_alone,
    reading_alone,
    long_messages,
    everything_that_comes_back_is_bytes,
    nobody_at_home,
]
