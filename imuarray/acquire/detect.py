"""What answers on a bus, and is it what the configuration says; nothing is changed unless a self-test is asked for."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from dataclasses import dataclass

from imuarray.acquire.stations import Station, route
from imuarray.array import ArrayConfig
from imuarray.bus.mux import Pca9544a
from imuarray.bus.protocol import Bus, OpenBus
from imuarray.drivers import SelfTest
from imuarray.errors import SensorError
from imuarray.facts import adxl345, bma180, bmp180, hmc5883, l3g4200d, pca9544a
from imuarray.facts.registers import Register

# What an address may hold, and how it is told: the identity register and the value that proves it.
_IDENTITIES: tuple[tuple[str, tuple[int, ...], Register], ...] = (
    ("adxl345", adxl345.ADDRESSES, adxl345.DEVID),
    ("bma180", bma180.ADDRESSES, bma180.CHIP_ID),
    ("l3g4200d", l3g4200d.ADDRESSES, l3g4200d.WHO_AM_I),
    ("bmp180", bmp180.ADDRESSES, bmp180.CHIP_ID),
    ("hmc5883 or hmc5883l", hmc5883.ADDRESSES, hmc5883.IDENTITY_A),
)


MUX = "pca9544a"


@dataclass(frozen=True)
class Found:
    """One line of `detect`: a place, what the configuration wants there ("" if nothing), what answered, and whether
    that is right.

    A known chip of which the configuration says nothing has no `sensor` and no `expected`; it is not wrong, only
    worth knowing.
    """

    place: str
    sensor: str
    expected: str
    found: str
    ok: bool
    self_test: str = ""
    """What the chip's self-test said, if it was asked for."""
    channel: int | None = None
    """Of the multiplexer (None: the trunk), with the address, of a chip that answered where nobody looked for it."""
    address: int | None = None


def detect(array: ArrayConfig, bus: OpenBus, *, self_test: bool = False) -> list[Found]:
    """Ask for every sensor of `array` (and let it test itself), then look for chips that `array` does not name."""
    found = [_ask_mux(array, bus)] if array.mux else []
    found += [_ask(station, self_test) for station in route(array, bus)]
    taken = {(sensor.channel, sensor.address) for sensor in array.sensors if sensor.bus is None}
    return found + _strangers(array.mux.address if array.mux else None, taken, bus)


def _ask(station: Station, self_test: bool) -> Found:
    """Is it the chip that the configuration says, and does it pass its self-test?"""
    sensor = station.sensor
    try:
        station.driver.identify()
        result = station.driver.self_test() if self_test else SelfTest(True, "")
    except SensorError as error:
        return Found(sensor.place, sensor.name, sensor.chip, str(error).partition(": ")[2], False)
    except OSError as error:
        return Found(sensor.place, sensor.name, sensor.chip, f"the bus fails: {error.strerror or error}", False)
    verdict = f"self-test {'passed' if result.passed else 'FAILED'}: {result.text}" if self_test else ""
    return Found(sensor.place, sensor.name, sensor.chip, sensor.chip, result.passed, verdict)


def _ask_mux(array: ArrayConfig, bus: OpenBus) -> Found:
    """Does the multiplexer answer?"""
    address = array.mux.address if array.mux else 0
    try:
        control = bus.transfer(address, read=1)[0]
        return Found(f"trunk address {address:#04x}", "mux", MUX, f"{MUX}, control {control:#04x}", True)
    except OSError as error:
        return Found(f"trunk address {address:#04x}", "mux", MUX, f"nobody: {error.strerror or error}", False)


def explore(bus: OpenBus) -> list[Found]:
    """Every known chip that answers, behind the multiplexer if there is one: for a bus that no file describes yet."""
    mux = _find_mux(bus)
    found = [] if mux is None else [Found(f"trunk address {mux:#04x}", "", "", MUX, True, "", None, mux)]
    return found + _strangers(mux, set(), bus)


def _find_mux(bus: OpenBus) -> int | None:
    """The address that answers as a multiplexer: some barometers have one of the eight addresses too (PCA-11)."""
    for address in pca9544a.ADDRESSES:
        with contextlib.suppress(OSError):
            if not _answers(bus, address, bmp180.CHIP_ID) and _keeps_control(bus, address):
                return address
    return None


def _keeps_control(bus: OpenBus, address: int) -> bool:
    """Does it read as it was written (PCA-02), with channel 1 connected and then with none? To a chip with registers
    the byte is where to read next.
    """
    for control in (pca9544a.ENABLE(1) | pca9544a.CHANNEL(1), pca9544a.ENABLE(0) | pca9544a.CHANNEL(0)):
        bus.transfer(address, bytes([control.value]))
        read = bus.transfer(address, read=1)[0]
        if (pca9544a.ENABLE.of(read), pca9544a.CHANNEL.of(read)) != (
            pca9544a.ENABLE.of(control.value),
            pca9544a.CHANNEL.of(control.value),
        ):
            return False
    return True


def _strangers(mux_address: int | None, taken: set[tuple[int | None, int]], bus: OpenBus) -> list[Found]:
    """Known chips at places, channel and address, that are not `taken`.

    The trunk is asked while no channel is connected; what answers there answers on every channel, and is not asked
    again. Nothing is sent to the mux's own address but its control byte.
    """
    if mux_address is None:
        return _look(bus, None, {address for _, address in taken})
    with contextlib.suppress(OSError):
        bus.transfer(mux_address, b"\x00")  # no channel: PCA-03
    upstream = {mux_address} | {address for channel, address in taken if channel is None}
    found = _look(bus, None, upstream)
    upstream |= {address for _, addresses, _ in _IDENTITIES for address in addresses if _is_found(found, address)}
    mux = Pca9544a(bus, mux_address)
    for channel in pca9544a.CHANNELS:
        here = {address for number, address in taken if number == channel}
        found += _look(mux.channel(channel), channel, upstream | here)
    return found


def _look(segment: Bus, channel: int | None, known: set[int]) -> list[Found]:
    """Chips that answer on one segment at addresses that are not `known`."""
    where = "trunk" if channel is None else f"channel {channel}"
    return [
        Found(f"{where} address {address:#04x}", "", "", chip, True, "", channel, address)
        for chip, addresses, register in _IDENTITIES
        for address in addresses
        if address not in known and _answers(segment, address, register)
    ]


def _is_found(found: Sequence[Found], address: int) -> bool:
    return any(line.place.endswith(f" {address:#04x}") for line in found)


def _answers(segment: Bus, address: int, register: Register) -> bool:
    """Does a chip with this identity sit at `address`?"""
    try:
        return segment.transfer(address, bytes([register.address]), 1)[0] == register.reset
    except OSError:
        return False
