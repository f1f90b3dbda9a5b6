"""Small arrays on the emulated bus, and a bus that records every transaction and fails on request."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple, Self

import numpy as np
import pytest

from imuarray.acquire import record
from imuarray.acquire.recording import RecordingCounts
from imuarray.array import ArrayConfig, parse_array
from imuarray.bus import open_bus
from imuarray.log import Log, open_log

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


class Board:
    """An array on its emulated bus, and the log into which it is recorded."""

    def __init__(self, array: ArrayConfig, bus: Tapped, path: Path) -> None:
        self.array, self.bus, self.path = array, bus, path
        self.begun_ns = 0
        """When the first frame began, or 0 before it."""

    def _note_begin(self) -> bool:
        self.begun_ns = self.begun_ns or self.bus.clock.now_ns()
        return False

    def record(self, rate_hz: float = 100, **options: Any) -> RecordingCounts:
        options.setdefault("stopped", self._note_begin)
        return record(self.array, self.bus, self.path, rate_hz=rate_hz, **options)

    def log(self) -> Log:
        return open_log(self.path)

    def rows(self, name: str, path: Path | None = None) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Times, counts and status of a sensor in the log, or in another one."""
        with open_log(path or self.path) as log:
            sensor = log[name]
            return sensor.time[:], sensor.counts[:], np.asarray(sensor.status[:])


@pytest.fixture(scope="session")
def board_at(an_array: Callable[..., ArrayConfig], tapped: Callable[..., Tapped]) -> Callable[..., Board]:
    """``board_at(path, "world=tumble", fails, A=0, G=1)``: these sensors on an emulated bus, and this log."""

    def make(
        path: Path, url: str = "", fails: Callable[[Call], bool] = lambda call: False, **channels: int | None
    ) -> Board:
        array = an_array(**channels)
        return Board(array, tapped(array, url, fails), path)

    return make


@pytest.fixture
def board(board_at: Callable[..., Board], tmp_path: Path) -> Callable[..., Board]:
    """``board("world=tumble", fails, A=0, G=1)``: these sensors on an emulated bus, and the log r.h5."""
    return partial(board_at, tmp_path / "r.h5")
