"""Small arrays on the emulated bus, and a bus that records every transaction and fails on request."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple, Self

import pytest

from imuarray.array import ArrayConfig, parse_array
from imuarray.bus import open_bus

SENSORS = {
    "A": 'chip="adxl345"\naddress=0x53\nrange=4\nrate_hz=800\n',
    "B": 'chip="bma180"\naddress=0x40\nrange=2\n',
    "G": 'chip="l3g4200d"\naddress=0x68\nrange=250\nrate_hz=800\nbandwidth_hz=110\n',
    "M": 'chip="hmc5883"\naddress=0x1E\nrange=1.2\nrate_hz=75\n',
    "P": 'chip="bmp180"\naddress=0x77\nrate_hz=8\n',
}


class Call(NamedTuple):
    """One transaction: its start time and its bytes."""

    at_ns: int
    address: int
    write: bytes
    read: int


class Tapped:
    """An open bus that notes every transaction; a call for which `fails(call)` is true reaches no chip: errno 121."""

    def __init__(self, bus: Any, fails: Callable[[Call], bool] = lambda call: False) -> None:
        self.bus, self.clock, self.source, self.fails = bus, bus.clock, bus.source, fails
        self.calls: list[Call] = []
        self.failed: list[Call] = []

    def transfer(self, address: int, write: bytes = b"", read: int = 0) -> bytes:
        call = Call(self.clock.now_ns(), address, write, read)
        self.calls.append(call)
        if self.fails(call):
            self.failed.append(call)
            raise OSError(121, "Remote I/O error")
        answer: bytes = self.bus.transfer(address, write, read)
        return answer

    def channel_bus(self, path: str) -> Any:
        return self.bus.channel_bus(path)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.bus, name)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        pass


@pytest.fixture(scope="session")
def an_array() -> Callable[..., ArrayConfig]:
    """``an_array(A=0, B=1, G=None)``: these sensors on these channels (None: on the trunk), named after their kind."""

    def make(mux: int = 0x70, **channels: int | None) -> ArrayConfig:
        text = f'[array]\nname="a"\nmux={{chip="pca9544a",address={mux}}}\n'
        for name, channel in channels.items():
            text += f'[[sensor]]\nname="{name}"\n{SENSORS[name[0]]}' + (
                "" if channel is None else f"channel={channel}\n"
            )
        return parse_array(text)

    return make


@pytest.fixture(scope="session")
def tapped() -> Callable[..., Tapped]:
    """``tapped(array, "world=tumble", fails)``: the emulated bus of `array`."""

    def make(array: ArrayConfig, url: str = "", fails: Callable[[Call], bool] = lambda call: False) -> Tapped:
        return Tapped(open_bus(f"emulated:?{url}", array), fails)

    return make
