"""Ways to reach a chip: Linux, a microcontroller, a recorded transcript, the emulated array. All of them are a `Bus`.

A bus is named by a URL: ``i2c:/dev/i2c-1``, ``spi:``, ``iio:``, ``serial:/dev/ttyACM0``, ``replay:T.jsonl``,
``emulated:?clock=real&world=tumble``.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import cast
from urllib.parse import parse_qsl

from imuarray.array import ArrayConfig, load_array
from imuarray.bus.protocol import Bus, OpenBus
from imuarray.errors import BusUrlError
from imuarray.spelling import guess

__all__ = ["Bus", "OpenBus", "open_bus"]


def open_bus(url: str, array: ArrayConfig) -> OpenBus:
    """Open the bus that `url` names, for the sensors of `array`; a context manager.

    BusUrlError if the URL names no bus, or the bus can't be opened.

    >>> from imuarray import load_array
    >>> with open_bus("emulated:", load_array("configs/martin2013.toml")) as bus:
    ...     selected = bus.transfer(0x70, b"\\x04")  # the multiplexer: channel 0, from the STOP on
    ...     bus.transfer(0x53, b"\\x00", 1).hex()  # register 0 of an ADXL345
    'e5'
    """
    if not hasattr(array, "sensors"):
        raise BusUrlError(f"array: {array!r} given; allowed is an ArrayConfig, as load_array returns")
    scheme, colon, rest = url.partition(":")
    if not colon or scheme not in _SCHEMES:
        device = next((name for prefix, name in _DEVICES.items() if url.startswith(prefix)), "")
        near = f"; did you mean {device}:{url}?" if device else guess(f"{scheme}:", [f"{name}:" for name in _SCHEMES])
        raise BusUrlError(f"bus {url!r}: allowed are {', '.join(_EXAMPLES)}{near}")
    return _SCHEMES[scheme](rest, array)


def _linux(rest: str, array: ArrayConfig) -> OpenBus:
    """Open ``i2c:/dev/i2c-1``; without a path, the first bus that a sensor names (kernel-driven channels need no root
    bus).
    """
    from imuarray.bus.linux import LinuxBus

    path = rest or next((sensor.bus for sensor in array.sensors if sensor.bus and sensor.on_i2c), "")
    if not path:
        raise BusUrlError("bus 'i2c:': name the device, as in i2c:/dev/i2c-1")
    return LinuxBus(path)


def _spi(rest: str, array: ArrayConfig) -> OpenBus:
    """Open ``spi:``; each sensor names its chip select."""
    from imuarray.bus.linux import SpiBus

    if rest:
        raise BusUrlError(f'bus \'spi:{rest}\': use "spi:" alone, and give each sensor bus = "/dev/spidevN.M"')
    return SpiBus()


def _iio(rest: str, array: ArrayConfig) -> OpenBus:
    """Open ``iio:``; each sensor names its device. ``iio:/folder`` has the folders sys and dev of another machine."""
    from imuarray.bus.iio import IioBus

    return IioBus(Path(rest or "/"))


def _serial(rest: str, array: ArrayConfig) -> OpenBus:
    """Open ``serial:/dev/ttyACM0``, ``serial:/dev/ttyUSB0?baud=921600``."""
    from imuarray.bus.serial_bus import open_serial

    return open_serial(rest)


def _replay(rest: str, array: ArrayConfig) -> OpenBus:
    """Open ``replay:T.jsonl``."""
    from imuarray.bus.replay import ReplayBus

    return ReplayBus(rest)


def _open_emulated(rest: str, array: ArrayConfig) -> OpenBus:
    """Open ``emulated:?name=value&...``; ``board=other.toml`` builds the emulated board from another file than the one
    in use.

    The emulator is imported by name: nothing else in this package depends on it."""
    query = dict(parse_qsl(rest.removeprefix("?"), keep_blank_values=True))
    board = query.get("board")
    try:
        bus = import_module("firmware_emulator").open_bus(query, array if board is None else load_array(board))
    except ValueError as error:
        raise BusUrlError(f"bus 'emulated:{rest}': {error}") from None
    return cast(OpenBus, bus)


_SCHEMES: dict[str, Callable[[str, ArrayConfig], OpenBus]] = {
    "i2c": _linux,
    "spi": _spi,
    "iio": _iio,
    "serial": _serial,
    "replay": _replay,
    "emulated": _open_emulated,
}

_DEVICES = {"/dev/i2c": "i2c", "/dev/tty": "serial"}
"""Beginnings of the paths of devices, and the scheme of their buses."""

_EXAMPLES = ("i2c:/dev/i2c-1", "serial:/dev/ttyACM0", "replay:T.jsonl", "spi:", "iio:", "emulated:")
