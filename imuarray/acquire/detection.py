"""Detects which chips answer on a bus, compares them with the configuration, and proposes a configuration for them;
only a self-test changes settings.

An address that a kernel driver owns answers as well, so the owner is determined first. The directions of the axes in a
proposed configuration are determined by `calibrate axes`.
"""

from __future__ import annotations

import contextlib
import errno
from collections import Counter
from collections.abc import Callable, Container, Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Any

import tomli_w

from imuarray.acquire.bus_segment import Pca9544a, routes_of
from imuarray.acquire.sample_buffer import SensorRoute
from imuarray.array import IIO, ArrayConfig, SensorConfig
from imuarray.bus.iio import IioBus, IioDevice
from imuarray.bus.protocol import Bus, OpenBus
from imuarray.chips import CHIPS, HALVES, die_of
from imuarray.drivers import DRIVERS, RemarkingDriver, SelfTest
from imuarray.drivers.iio import rates_of
from imuarray.errors import SensorError
from imuarray.facts import pca9544a
from imuarray.facts.registers import Register
from imuarray.printable import printable


def _identities() -> tuple[tuple[str, tuple[int, ...], Register], ...]:
    """Return the chips that may be at an address, with the identity register and the value in it that identifies them.
    Chips with the same identity share an entry.
    """
    names: dict[tuple[tuple[int, ...], Register], list[str]] = {}
    for chip, spec in CHIPS.items():
        dies = names.setdefault((spec.addresses, spec.identity), [])
        if die_of(chip) not in dies:
            dies.append(die_of(chip))
    return tuple((" or ".join(sorted(chips)), addresses, identity) for (addresses, identity), chips in names.items())


_IDENTITIES = _identities()

MUX = "pca9544a"


@dataclass(frozen=True)
class Detection:
    """One line of `detect`: a place, what the configuration expects there ("" if nothing), what answered, and whether
    that is right.

    A known chip that the configuration does not name has no `sensor` and no `expected`; it is reported, but is no
    error.
    """

    place: str
    sensor: str
    expected: str
    found: str
    ok: bool
    self_test: str = ""
    """The result of the chip's self-test, if that was requested."""
    channel: int | None = None
    """Channel of the multiplexer (None: the trunk) and address of a chip that the configuration does not name."""
    address: int | None = None
    undetermined: bool = False
    """True if the self-test could not determine whether the chip is good."""
    owner: str = ""
    """The kernel driver that owns the address, if there is one; the chip is not addressed then."""
    remark: str = ""
    """Remarks on the chip's present settings."""
    rates_hz: Mapping[str, float] = field(default_factory=dict)
    """Data rate of each triad of a device behind a kernel driver, by quantity."""


_VERDICTS: Mapping[bool | None, str] = MappingProxyType({True: "passed", False: "FAILED", None: "undetermined"})


def owner_of(address: int, bus: OpenBus) -> str:
    """Return which kernel driver owns an address of the root bus, or a place on it; "" for none, and for a bus that
    does not know owners (LNX-12).
    """
    ask: Callable[[int, str | None], None] | None = getattr(bus, "claim", None)
    try:
        if ask is not None:
            ask(address, None)
    except SensorError as error:
        return str(error)
    except OSError as error:
        if error.errno == errno.EBUSY:
            return f"address {address:#04x} belongs to a driver of the kernel; unbind that driver"
    return ""


def detect(array: ArrayConfig, bus: OpenBus, *, self_test: bool = False) -> list[Detection]:
    """Check every sensor of `array` (with `self_test`, also run its self-test), then look for chips that `array` does
    not name.

    Nothing is sent to an address that a kernel driver owns, nor through a multiplexer that the kernel switches
    (LNX-24).
    """
    mux = array.mux.address if array.mux else None
    owner = "" if mux is None else owner_of(mux, bus)
    detections = [] if mux is None else [_check_mux(mux, owner, bus)]
    for route in routes_of(array, bus):
        if owner and route.sensor.channel is not None:
            sensor, text = route.sensor, "not checked: its multiplexer belongs to the kernel"
            detections.append(Detection(sensor.place, sensor.name, sensor.chip, text, False))
        else:
            detections.append(_check_sensor(route, self_test))
    occupied = {(sensor.channel, sensor.address) for sensor in array.sensors if sensor.bus is None}
    owned = _find_owned_addresses(bus)
    occupied |= {(None, line.address) for line in owned if line.address is not None}
    configured = {mux, *(sensor.address for sensor in array.sensors)}  # they are in the list already
    detections += [line for line in owned if line.address not in configured]
    return detections if owner else detections + _unconfigured_chips(mux, occupied, bus)


def _find_owned_addresses(bus: OpenBus) -> list[Detection]:
    """Report addresses of known chips that a kernel driver owns. The chip may be one of an array or a clock on the same
    bus, so this is no error.
    """
    known_addresses = sorted(
        {*pca9544a.ADDRESSES, *(address for _, addresses, _ in _IDENTITIES for address in addresses)}
    )
    owners = {address: owner_of(address, bus) for address in known_addresses}
    return [
        Detection(f"trunk address {address:#04x}", "", "", owner, True, address=address, owner=owner)
        for address, owner in owners.items()
        if owner
    ]


def _check_sensor(route: SensorRoute, self_test: bool) -> Detection:
    """Check one sensor: is it the configured chip, is its address free, and does it pass its self-test?"""
    sensor = route.sensor
    try:
        route.claim()
    except SensorError as error:
        owner = str(error).partition(": ")[2]
        return Detection(sensor.place, sensor.name, sensor.chip, owner, False, owner=owner)
    except OSError as error:
        return Detection(sensor.place, sensor.name, sensor.chip, f"the bus fails: {error.strerror or error}", False)
    try:
        route.driver.identify()
        remark = route.driver.remark() if isinstance(route.driver, RemarkingDriver) else ""
        result = route.driver.self_test() if self_test else SelfTest(True, "")
    except SensorError as error:
        return Detection(sensor.place, sensor.name, sensor.chip, str(error).partition(": ")[2], False)
    except OSError as error:
        return Detection(sensor.place, sensor.name, sensor.chip, f"the bus fails: {error.strerror or error}", False)
    verdict = f"self-test {_VERDICTS[result.passed]}: {result.text}" if self_test else ""
    unknown = result.passed is None
    is_ok = result.passed is not False
    return Detection(
        sensor.place, sensor.name, sensor.chip, sensor.chip, is_ok, verdict, undetermined=unknown, remark=remark
    )


def _check_mux(address: int, owner: str, bus: OpenBus) -> Detection:
    if owner:
        return Detection(f"trunk address {address:#04x}", "mux", MUX, owner, False, owner=owner)
    try:
        control = bus.transfer(address, read=1)[0]
        return Detection(f"trunk address {address:#04x}", "mux", MUX, f"{MUX}, control {control:#04x}", True)
    except OSError as error:
        return Detection(f"trunk address {address:#04x}", "mux", MUX, f"no answer: {error.strerror or error}", False)


def explore(bus: OpenBus) -> list[Detection]:
    """Return every known chip that answers, behind the multiplexer if there is one, on a bus without a
    configuration.

    Nothing is sent to an address that a kernel driver owns; a line names the driver. On the bus ``iio:``, every device
    that the kernel serves is returned.
    """
    if isinstance(bus, IioBus):
        return [_describe_kernel_device(device) for device in bus.devices()]
    owned = _find_owned_addresses(bus)
    occupied = {line.address for line in owned if line.address is not None}
    mux = _find_mux(bus, occupied)
    detections = [] if mux is None else [Detection(f"trunk address {mux:#04x}", "", "", MUX, True, address=mux)]
    return [*detections, *owned, *_unconfigured_chips(mux, {(None, address) for address in occupied}, bus)]


def _describe_kernel_device(device: IioDevice) -> Detection:
    """Return a description of a kernel device: its triads, and how they can be read."""
    try:
        captured = "captured or read" if device.elements() else "read"
        rates_hz = rates_of(device)
    except (SensorError, OSError) as error:
        return Detection(str(device), "", "", str(error), True)
    return Detection(str(device), "", "", f"{captured}: {', '.join(rates_hz) or 'no triad'}", True, rates_hz=rates_hz)


def _find_mux(bus: OpenBus, owned: Container[int]) -> int | None:
    """Return the address that answers as a multiplexer. Some barometers share one of its eight addresses (PCA-11)."""
    for address in pca9544a.ADDRESSES:
        if address in owned:  # one that the kernel switches must not be written to: LNX-24
            continue
        with contextlib.suppress(OSError):
            if not _is_known(bus, address) and _keeps_control(bus, address):
                return address
    return None


def _is_known(bus: Bus, address: int) -> bool:
    """Return whether a known barometer, which may share this address, answers there."""
    return any(address in addresses and _answers(bus, address, register) for _, addresses, register in _IDENTITIES)


def _keeps_control(bus: OpenBus, address: int) -> bool:
    """Return whether the control byte reads back as written (PCA-02), with channel 1 connected and then with none. A
    chip with registers would take the byte as a register address.
    """
    for control in (pca9544a.ENABLE(1) | pca9544a.CHANNEL(1), pca9544a.ENABLE(0) | pca9544a.CHANNEL(0)):
        bus.transfer(address, bytes([control.value]))
        returned = bus.transfer(address, read=1)[0]
        if (pca9544a.ENABLE.of(returned), pca9544a.CHANNEL.of(returned)) != (
            pca9544a.ENABLE.of(control.value),
            pca9544a.CHANNEL.of(control.value),
        ):
            return False
    return True


def _unconfigured_chips(
    mux_address: int | None, occupied: set[tuple[int | None, int]], bus: OpenBus
) -> list[Detection]:
    """Find known chips at places (channel and address) that are not `occupied`.

    The trunk is searched while no channel is connected. What answers there answers on every channel, and is not
    searched for again. Only the control byte is sent to the multiplexer's own address.
    """
    if mux_address is None:
        return _find_on_segment(bus, None, {address for _, address in occupied})
    with contextlib.suppress(OSError):
        bus.transfer(mux_address, b"\x00")  # no channel: PCA-03
    upstream = {mux_address} | {address for channel, address in occupied if channel is None}
    detections = _find_on_segment(bus, None, upstream)
    upstream |= {address for _, addresses, _ in _IDENTITIES for address in addresses if _is_listed(detections, address)}
    mux = Pca9544a(bus, mux_address)
    for channel in pca9544a.CHANNELS:
        on_channel = {address for number, address in occupied if number == channel}
        detections += _find_on_segment(mux.channel(channel), channel, upstream | on_channel)
    return detections


def _find_on_segment(segment: Bus, channel: int | None, excluded: set[int]) -> list[Detection]:
    """Find chips that answer on one segment at addresses that are not `excluded`."""
    segment_name = "trunk" if channel is None else f"channel {channel}"
    return [
        Detection(f"{segment_name} address {address:#04x}", "", "", chip, True, channel=channel, address=address)
        for chip, addresses, register in _IDENTITIES
        for address in addresses
        if address not in excluded and _answers(segment, address, register)
    ]


def _is_listed(detections: Sequence[Detection], address: int) -> bool:
    return any(line.place.endswith(f" {address:#04x}") for line in detections)


def _answers(segment: Bus, address: int, register: Register) -> bool:
    try:
        return segment.transfer(address, bytes([register.address]), 1)[0] == register.reset
    except OSError:
        return False


_SAME_IDENTITY: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {"hmc5883 or hmc5883l": ("hmc5883l", "hmc5883"), "ak8963 or ak8975": ("ak8963", "ak8975")}
)
"""Chips with the same identity registers, the more common one first; only their self-tests distinguish them."""
_REMARKS = {
    "hmc5883 or hmc5883l": "or hmc5883, with range = 1.2: they identify themselves alike; --self-test fails for one",
    "ak8963 or ak8975": "or ak8975 (of an MPU-9150), with range = 12.29: they identify themselves alike",
}
"""Comment in the proposed file, by the chip that was identified."""

_HEAD = """\
# The chips that answered on {bus}. Settings can be changed; an error lists the allowed ones.
# `imuarray calibrate axes` determines the axes from three poses held by hand; without it, axes are "+X+Y+Z".

[array]
"""


def distinguish_alike(detections: Sequence[Detection], bus: OpenBus) -> list[Detection]:
    """Distinguish chips with the same identity by which of their self-tests they pass; chips that pass none, or can't
    be asked often enough, keep their identity. Their settings are lost.
    """
    mux = next((line.address for line in detections if line.found == MUX), None)
    return [replace(line, found=_passing(line, mux, bus) or line.found) for line in detections]


def _passing(line: Detection, mux: int | None, bus: OpenBus) -> str | None:
    """Return the chip, among those with the same identity, whose self-test this one passes."""
    if line.address is None:
        return None
    segment: Bus = bus if line.channel is None or mux is None else Pca9544a(bus, mux).channel(line.channel)
    for chip in _SAME_IDENTITY.get(line.found, ()):
        sensor = SensorConfig(name="Unknown", chip=chip, address=line.address, **CHIPS[chip].proposed)
        try:
            if DRIVERS[chip](segment, sensor, bus.clock).self_test().passed:
                return chip
        except (OSError, SensorError):
            continue
    return None


def propose(detections: Sequence[Detection], bus: str, name: str = "array") -> str:
    """Return the text of a configuration for the detections of `explore`; SensorError if there is no known chip."""
    devices = [line for line in detections if line.rates_hz]
    if devices or bus.startswith(IIO):
        return _propose_devices(devices, bus, name)
    chips = [
        (chip, line)
        for line in detections
        if line.found != MUX and not line.owner
        for chip in HALVES.get(line.found, _SAME_IDENTITY.get(line.found, (line.found,))[:1])
    ]
    if not chips:
        advice = f"try `imuarray detect --bus {printable(bus)} --doctor`"
        raise SensorError(f"{bus}: no chip answered, so there is nothing to configure; {advice}")
    text = _HEAD.format(bus=printable(bus)) + tomli_w.dumps({"name": name, "bus": bus})
    text += "".join(
        f'mux = {{ chip = "{MUX}", address = {line.address:#04x} }}\n' for line in detections if line.found == MUX
    )
    counts = Counter(chip for chip, _ in chips)
    numbers: Counter[str] = Counter()
    for chip, line in chips:
        spec = CHIPS[chip]
        numbers[spec.label] += 1
        lone = counts[chip] == 1 and spec.quantity == "pressure"
        number = chip.removeprefix("bmp") if lone else str(numbers[spec.label])
        text += _sensor(spec.label.format(number), chip, line, spec.proposed)
    return text


_SUFFIXES = MappingProxyType({"specific_force": "acc", "angular_rate": "gyro", "magnetic_field": "mag"})
_POLLED_HZ = 50.0
"""Data rate in Hz that is proposed for a device whose driver states none: that of the frames."""
_DEVICES_HEAD = """\
# The devices that the kernel exposes on {bus}. `range` selects another scale. With `fifo = true` every sample comes
# from the kernel's buffer, if the device has one. Without `axes`, those of the device's mounting matrix are used.

[array]
"""


def _propose_devices(devices: Sequence[Detection], bus: str, name: str) -> str:
    """Return a configuration of the triads of kernel devices; SensorError if there is none."""
    if not devices:
        raise SensorError(f"{bus}: the kernel serves no accelerometer, gyroscope or magnetometer: nothing to configure")
    text = _DEVICES_HEAD.format(bus=printable(bus)) + tomli_w.dumps({"name": name, "bus": bus})
    for number, line in enumerate(devices, 1):
        for quantity, rate_hz in line.rates_hz.items():
            chip = line.place.removeprefix(IIO).partition("@")[0]
            table = {"name": f"IIO{number}_{_SUFFIXES[quantity]}", "chip": chip, "quantity": quantity}
            text += "\n[[sensor]]\n" + tomli_w.dumps({**table, "bus": line.place, "rate_hz": rate_hz or _POLLED_HZ})
    return text


def _sensor(name: str, chip: str, line: Detection, settings: Mapping[str, Any]) -> str:
    place = "" if line.channel is None else f"channel = {line.channel}\n"
    settings_text = "".join(f"{key} = {value}\n" for key, value in settings.items())
    remark = f"  # {_REMARKS[line.found]}" if line.found in _REMARKS else ""
    return (
        f'\n[[sensor]]\nname = "{name}"\nchip = "{chip}"{remark}\n{place}address = {line.address:#04x}\n{settings_text}'
    )
