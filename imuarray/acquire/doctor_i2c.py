"""What the kernel says of an I2C bus: adapter, device file, clock, abilities, drivers at our addresses."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence

from imuarray.acquire.doctor_machine import Check, Machine, permission
from imuarray.array import ArrayConfig, SensorConfig
from imuarray.drivers import DRIVERS
from imuarray.facts import bmp180

DEVICES = "/sys/bus/i2c/devices"
DEFAULT_HZ = 100_000
"""Of i2c-bcm2835, and of most others (LNX-17)."""
_FUNC_I2C = 1
_QUIRKS = {
    "bcm2835": "can't wait for a chip that holds the clock (LNX-11), takes one read a transaction (LNX-10)",
    "i2c-gpio": "is moved by software: times are less certain",
}
_FASTER = (
    "on a Raspberry Pi dtparam=i2c_arm_baudrate=400000 in config.txt; elsewhere clock-frequency in the device tree"
)


def buses_of(array: ArrayConfig | None, path: str) -> list[str]:
    """The device files that an array needs: the root bus of the URL, then the buses that sensors name."""
    named = [sensor.bus for sensor in array.sensors if sensor.bus] if array else []
    return list(dict.fromkeys([path or (named[0] if named else ""), *named]))


def i2c_checks(machine: Machine, array: ArrayConfig | None, buses: Sequence[str], rate_hz: float) -> list[Check]:
    """All of them, for each of `buses`; one that isn't there is not asked further. Without an array nobody knows whose
    addresses are meant: drivers of the kernel are named, and not judged.
    """
    checks: list[Check] = []
    for device in buses:
        found = there(machine, device)
        checks.append(found)
        if found.ok:
            checks += [permission(machine, device), *abilities(machine, device)]
            checks += owners(machine, array, device, device == buses[0]) if array else bound(machine, device)
    if checks and checks[0].ok:
        checks.append(clock(machine, array, buses[0], rate_hz))
    return [*checks, *(address_0x77(machine, array) if array else [])]


def _number(machine: Machine, device: str) -> str:
    """N of /dev/i2c-N, also where the name is a link to it."""
    return os.path.realpath(machine.path(device)).rpartition("-")[2]


def there(machine: Machine, device: str) -> Check:
    """Is there an adapter, and a device file for it?"""
    adapters = sorted(path.name for path in machine.path(DEVICES).glob("i2c-[0-9]*"))
    if not adapters:
        advice = "enable I2C: on a Raspberry Pi raspi-config, or dtparam=i2c_arm=on in config.txt; then restart"
        return Check("adapter", False, "this machine has no I2C bus", advice)
    if machine.path(device).exists() and device:
        name = machine.text(f"{DEVICES}/i2c-{_number(machine, device)}/name") or "without a name"
        return Check("adapter", True, f"{device}: {name}")
    if not machine.path("/sys/class/i2c-dev").is_dir():
        advice = "sudo modprobe i2c-dev; for good: echo i2c-dev | sudo tee /etc/modules-load.d/i2c-dev.conf"
        return Check("module i2c-dev", False, f"not loaded: no {device or 'device file'} for {adapters[0]}", advice)
    files = sorted(f"/dev/{path.name}" for path in machine.path("/dev").glob("i2c-[0-9]*"))
    return Check(
        "adapter", False, f"{device or 'no bus named'}; there are {', '.join(files)}", "name one that is there"
    )


def abilities(machine: Machine, device: str) -> Iterator[Check]:
    """Can it carry plain I2C messages, and what is odd about it?"""
    bits = machine.functionality(machine.path(device))
    if bits is not None and not bits & _FUNC_I2C:
        yield Check("abilities", False, f"{device}: SMBus only", "plain I2C messages are needed: use another adapter")
    elif bits is not None:
        yield Check("abilities", True, f"{device}: plain I2C (functionality {bits:#010x})")
    name = machine.text(f"{DEVICES}/i2c-{_number(machine, device)}/name")
    for known, odd in _QUIRKS.items():
        if known in name:
            yield Check("quirks", True, f"{device}: {known} {odd}")


def owners(machine: Machine, array: ArrayConfig, device: str, is_root: bool) -> Iterator[Check]:
    """Has a driver of the kernel one of our addresses on this bus (LNX-12)?"""
    number = _number(machine, device)
    ours = {sensor.address: sensor.name for sensor in array.sensors if _is_on(sensor, device, is_root)}
    if is_root and array.mux is not None:
        ours[array.mux.address] = "the multiplexer"
    for address, name in sorted(ours.items()):
        link = machine.path(f"{DEVICES}/{number}-{address:04x}/driver")
        if link.is_symlink():
            driver = link.readlink().name
            unbind = f"echo {number}-{address:04x} | sudo tee /sys/bus/i2c/drivers/{driver}/unbind"
            channels = _channels(machine, f"{DEVICES}/{number}-{address:04x}")
            if channels:
                unbind += f"; or leave out mux and give each sensor its bus: {channels}"
            yield Check("kernel driver", False, f"{device} {address:#04x} ({name}) belongs to {driver}", unbind)
    if not any(machine.path(f"{DEVICES}/{number}-{address:04x}/driver").is_symlink() for address in ours):
        yield Check("kernel driver", True, f"{device}: none has one of our addresses")


def bound(machine: Machine, device: str) -> Iterator[Check]:
    """Which drivers of the kernel have addresses on this bus? One is in the way of a sensor at its own alone."""
    number = _number(machine, device)
    places = sorted(path for path in machine.path(DEVICES).glob(f"{number}-*") if (path / "driver").is_symlink())
    for path in places:
        owner = (path / "driver").readlink().name
        address = int(path.name.partition("-")[2], 16)
        yield Check("kernel driver", True, f"{device} {address:#04x} belongs to {owner}: no sensor there can be read")
    if not places:
        yield Check("kernel driver", True, f"{device}: none has an address")


def _is_on(sensor: SensorConfig, device: str, is_root: bool) -> bool:
    return sensor.bus == device or (sensor.bus is None and is_root)


def _channels(machine: Machine, place: str) -> str:
    """The buses behind a multiplexer that the kernel drives (LNX-21)."""
    links = sorted(machine.path(place).glob("channel-[0-9]*"))
    return ", ".join(f"{link.name} is /dev/{link.resolve().name}" for link in links)


def clock(machine: Machine, array: ArrayConfig | None, device: str, rate_hz: float) -> Check:
    """How fast is the bus, and is that enough for frames at `rate_hz`?"""
    path = machine.path(f"{DEVICES}/i2c-{_number(machine, device)}/of_node/clock-frequency")
    try:
        clock_hz = int.from_bytes(path.read_bytes()[:4], "big")
    except OSError:
        clock_hz = 0
    said = f"{clock_hz / 1000:g} kHz" if clock_hz else f"not told; {DEFAULT_HZ / 1000:g} kHz is usual"
    if array is None:
        return Check("bus clock", True, said)
    most_hz = (clock_hz or DEFAULT_HZ) / frame_clocks(array)
    found = f"{said}: at most {most_hz:.0f} frames of this array a second"
    return Check("bus clock", most_hz >= rate_hz or not clock_hz, found, _FASTER)


def frame_clocks(array: ArrayConfig) -> int:
    """Clocks of a frame that reads every sensor once, without its checks: BUS-02, BUS-04."""
    channels = {sensor.channel for sensor in array.sensors if sensor.channel is not None}
    return sum(9 * (DRIVERS[sensor.chip].burst + 3) for sensor in array.sensors) + 18 * len(channels)


def address_0x77(machine: Machine, array: ArrayConfig) -> list[Check]:
    """A multiplexer at 0x77 and a BMP180, which has no other address, answer together (PCA-11)."""
    (address,) = bmp180.ADDRESSES
    advice = "strap the multiplexer's address pins to one of 0x70 to 0x76, or no BMP180 behind it can be read"
    if array.mux is not None and array.mux.address == address:
        return [Check("address 0x77", False, "the multiplexer has the BMP180's address", advice)]
    shared = []
    for sensor in array.sensors:
        if sensor.chip == "bmp180" and sensor.bus is not None:
            parent = machine.path(f"{DEVICES}/i2c-{_number(machine, sensor.bus)}/mux_device")
            if parent.is_symlink() and parent.readlink().name.endswith(f"-{address:04x}"):
                shared.append(sensor.name)
    found = f"{', '.join(shared)}: the multiplexer before it has its address"
    return [Check("address 0x77", False, found, advice)] if shared else []
