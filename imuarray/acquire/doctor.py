"""Diagnoses why a bus does not work: one line per check, with advice; nothing is changed.

The checks cover the machine (device files, permissions), what the kernel reports about an I2C bus (adapter, clock,
capabilities, drivers that own the array's addresses), the port of a microcontroller, and the folder for logs. A
`Machine` is a file tree below a root folder, a user, and functions that return what only a running kernel reports, so
that a test can construct one.
"""

from __future__ import annotations

import errno
import fcntl
import os
import struct
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

from imuarray.array import IIO, SPI_DEVICE, ArrayConfig, SensorConfig
from imuarray.bus.iio import IioDevice, devices
from imuarray.drivers import DRIVERS
from imuarray.errors import ImuArrayError, SensorError
from imuarray.facts import bmp180
from imuarray.log.disk_space import RESERVE, WATERMARK, free_bytes
from imuarray.log.format import header_of
from imuarray.log.journal import is_running, sensor_group

I2C_FUNCS = 0x0705  # LNX-03


class Check(NamedTuple):
    """The result of a check: its subject, whether it passed, what was observed, and advice if it failed."""

    name: str
    ok: bool
    found: str
    advice: str = ""


def functionality(device: Path) -> int | None:
    """Return the bits with which an adapter states its capabilities (LNX-30); None if it can't be asked."""
    try:
        fd = os.open(device, os.O_RDWR | os.O_CLOEXEC)
    except OSError:
        return None
    try:
        answer = fcntl.ioctl(fd, I2C_FUNCS, bytes(struct.calcsize("L")))
        return int(struct.unpack("L", answer)[0])
    except OSError:
        return None
    finally:
        os.close(fd)


def free_bytes_in(folder: Path) -> int:
    """Return the bytes that can still be written in a folder; OSError."""
    return free_bytes(folder / "RUN.h5")


@dataclass(frozen=True)
class Machine:
    """A machine: its file tree, the user, and functions that return what only a running kernel reports."""

    root: Path = Path("/")
    user: int = field(default_factory=os.getuid)
    groups: frozenset[int] = field(default_factory=lambda: frozenset((*os.getgroups(), os.getgid())))
    functionality: Callable[[Path], int | None] = functionality
    free_bytes: Callable[[Path], int] = free_bytes_in

    def path(self, absolute: str) -> Path:
        """Return the path of a file of this machine."""
        return self.root / absolute.lstrip("/")

    def text(self, absolute: str) -> str:
        """Return the line in a file of the kernel's; "" if it does not exist."""
        try:
            return self.path(absolute).read_text(encoding="utf-8", errors="replace").strip()
        except OSError:
            return ""


def check_permission(machine: Machine, device: str) -> Check:
    """Check whether this user may read and write an existing device file."""
    try:
        status = machine.path(device).stat()
    except OSError as error:
        return Check("permission", False, f"{device}: {error.strerror}", "check the folders above it")
    shift = 6 if status.st_uid == machine.user else 3 if status.st_gid in machine.groups else 0
    group = _group(machine, status.st_gid)
    state = f"{device}: group {group}, mode {status.st_mode & 0o777:04o}"
    if machine.user == 0 or status.st_mode >> shift & 0o6 == 0o6:
        return Check("permission", True, state)
    if status.st_mode & 0o060 == 0o060 and status.st_gid:
        return Check("permission", False, state, f"sudo adduser $USER {group}, then log in again")
    kinds = {SPI_DEVICE: ("spi", "spidev*"), "/dev/iio:": ("iio", "iio:device*")}
    group, files = next((kind for start, kind in kinds.items() if device.startswith(start)), ("i2c", "i2c-[0-9]*"))
    advice = f'sudo groupadd --system {group}; a udev rule: KERNEL=="{files}", GROUP="{group}", MODE="0660"'
    return Check("permission", False, state, advice)


def _group(machine: Machine, number: int) -> str:
    """Return a group's name from the list of groups of the machine."""
    for line in machine.text("/etc/group").splitlines():
        name, _, rest = line.partition(":")
        if rest.split(":")[1:2] == [str(number)]:
            return name
    return str(number)


DEVICES = "/sys/bus/i2c/devices"
DEFAULT_HZ = 100_000
"""Usual clock in Hz of i2c-bcm2835 and of most other adapters (LNX-17)."""
_FUNC_I2C = 1
_QUIRKS = {
    "bcm2835": "has no clock stretching (LNX-11), allows one read per transaction (LNX-10)",
    "i2c-gpio": "is driven by software: times are less accurate",
}
_FASTER = (
    "on a Raspberry Pi dtparam=i2c_arm_baudrate=400000 in config.txt; elsewhere clock-frequency in the device tree"
)


def buses_of(array: ArrayConfig | None, path: str) -> list[str]:
    """Return the device files that an array needs: the root bus of the URL, then the buses that sensors name."""
    named = [sensor.bus for sensor in array.sensors if sensor.bus and sensor.on_i2c] if array else []
    return list(dict.fromkeys([path or (named[0] if named else ""), *named]))


def i2c_checks(machine: Machine, array: ArrayConfig | None, buses: Sequence[str], rate_hz: float) -> list[Check]:
    """Run all checks of each of `buses`; a missing bus is not checked further. Without an array the addresses of its
    sensors are unknown, so kernel drivers are listed without a verdict.
    """
    checks: list[Check] = []
    for device in buses:
        check = check_adapter(machine, device)
        checks.append(check)
        if check.ok:
            checks += [check_permission(machine, device), *check_abilities(machine, device)]
            checks += (
                check_owners(machine, array, device, device == buses[0])
                if array
                else list_kernel_drivers(machine, device)
            )
    if checks and checks[0].ok:
        checks.append(check_clock(machine, array, buses[0], rate_hz))
    return [*checks, *(check_address_0x77(machine, array) if array else [])]


def _number(machine: Machine, device: str) -> str:
    """Return N of /dev/i2c-N, also if the name is a link to it."""
    return os.path.realpath(machine.path(device)).rpartition("-")[2]


def check_adapter(machine: Machine, device: str) -> Check:
    """Check whether the adapter and its device file exist."""
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
    return Check("adapter", False, f"{device or 'no bus named'}; there are {', '.join(files)}", "name one that exists")


def check_abilities(machine: Machine, device: str) -> Iterator[Check]:
    """Check whether the adapter can transfer plain I2C messages, and report unusual properties."""
    bits = machine.functionality(machine.path(device))
    if bits is not None and not bits & _FUNC_I2C:
        yield Check("abilities", False, f"{device}: SMBus only", "plain I2C messages are needed: use another adapter")
    elif bits is not None:
        yield Check("abilities", True, f"{device}: plain I2C (functionality {bits:#010x})")
    name = machine.text(f"{DEVICES}/i2c-{_number(machine, device)}/name")
    for adapter, property_text in _QUIRKS.items():
        if adapter in name:
            yield Check("quirks", True, f"{device}: {adapter} {property_text}")


def check_owners(machine: Machine, array: ArrayConfig, device: str, is_root: bool) -> Iterator[Check]:
    """Check whether a kernel driver owns one of the array's addresses on this bus (LNX-12)."""
    number = _number(machine, device)
    on_i2c = [sensor for sensor in array.sensors if sensor.on_i2c]
    names = {sensor.address: sensor.name for sensor in on_i2c if _is_on(sensor, device, is_root)}
    if is_root and array.mux is not None:
        names[array.mux.address] = "the multiplexer"
    for address, name in sorted(names.items()):
        link = machine.path(f"{DEVICES}/{number}-{address:04x}/driver")
        if link.is_symlink():
            driver = link.readlink().name
            unbind = f"echo {number}-{address:04x} | sudo tee /sys/bus/i2c/drivers/{driver}/unbind"
            channels = _channels(machine, f"{DEVICES}/{number}-{address:04x}")
            if channels:
                unbind += f"; or leave out mux and give each sensor its bus: {channels}"
            yield Check("kernel driver", False, f"{device} {address:#04x} ({name}) belongs to {driver}", unbind)
    if not any(machine.path(f"{DEVICES}/{number}-{address:04x}/driver").is_symlink() for address in names):
        yield Check("kernel driver", True, f"{device}: none owns an address of this array")


def list_kernel_drivers(machine: Machine, device: str) -> Iterator[Check]:
    """Check for kernel drivers that own addresses on this bus. One blocks a sensor only at the same address."""
    number = _number(machine, device)
    places = sorted(path for path in machine.path(DEVICES).glob(f"{number}-*") if (path / "driver").is_symlink())
    for path in places:
        owner = (path / "driver").readlink().name
        address = int(path.name.partition("-")[2], 16)
        yield Check("kernel driver", True, f"{device} {address:#04x} belongs to {owner}: no sensor there can be read")
    if not places:
        yield Check("kernel driver", True, f"{device}: none owns an address")


def _is_on(sensor: SensorConfig, device: str, is_root: bool) -> bool:
    return sensor.bus == device or (sensor.bus is None and is_root)


def _channels(machine: Machine, place: str) -> str:
    """Return the buses behind a multiplexer that the kernel drives (LNX-21)."""
    links = sorted(machine.path(place).glob("channel-[0-9]*"))
    return ", ".join(f"{link.name} is /dev/{link.resolve().name}" for link in links)


def check_clock(machine: Machine, array: ArrayConfig | None, device: str, rate_hz: float) -> Check:
    """Check that the bus is fast enough for frames at `rate_hz`."""
    path = machine.path(f"{DEVICES}/i2c-{_number(machine, device)}/of_node/clock-frequency")
    try:
        clock_hz = int.from_bytes(path.read_bytes()[:4], "big")
    except OSError:
        clock_hz = 0
    clock_text = f"{clock_hz / 1000:g} kHz" if clock_hz else f"unknown; {DEFAULT_HZ / 1000:g} kHz is usual"
    if array is None:
        return Check("bus clock", True, clock_text)
    most_hz = (clock_hz or DEFAULT_HZ) / frame_clocks(array)
    finding = f"{clock_text}: at most {most_hz:.0f} frames of this array a second"
    return Check("bus clock", most_hz >= rate_hz or not clock_hz, finding, _FASTER)


def frame_clocks(array: ArrayConfig) -> int:
    """Return the clocks of a frame that reads every sensor once, without read-back: BUS-02, BUS-04."""
    channels = {sensor.channel for sensor in array.sensors if sensor.channel is not None}
    on_i2c = [sensor for sensor in array.sensors if sensor.on_i2c]
    return sum(9 * (DRIVERS[sensor.chip].burst + 3) for sensor in on_i2c) + 18 * len(channels)


_NO_DRIVER = "the device tree, or new_device of the bus, makes a driver bind; detect --bus iio: lists what there is"


def spi_checks(machine: Machine, array: ArrayConfig | None) -> list[Check]:
    """Check whether every chip select that the array names exists and this user may open it."""
    named = dict.fromkeys(str(sensor.bus) for sensor in array.sensors if sensor.on_spi) if array else {}
    checks: list[Check] = []
    for device in named:
        if machine.path(device).exists():
            checks += [Check("chip select", True, device), check_permission(machine, device)]
        else:
            files = sorted(f"/dev/{path.name}" for path in machine.path("/dev").glob("spidev*"))
            listing = f"there are {', '.join(files)}" if files else "there is none"
            advice = (
                "enable SPI: on a Raspberry Pi raspi-config, or dtparam=spi=on in config.txt; more chip selects than"
                " two need an overlay or cs-gpios in the device tree"
            )
            checks.append(Check("chip select", False, f"{device}; {listing}", advice))
    return checks


def _wired_checks(machine: Machine, array: ArrayConfig | None, rate_hz: float) -> list[Check]:
    """Check the I2C buses and chip selects that sensors name."""
    buses = list(dict.fromkeys(sensor.bus for sensor in array.sensors if sensor.bus and sensor.on_i2c)) if array else []
    return (i2c_checks(machine, array, buses, rate_hz) if buses else []) + spi_checks(machine, array)


def iio_checks(machine: Machine, array: ArrayConfig | None) -> list[Check]:
    """Check whether the kernel serves every device that the array names, and this user may capture from it."""
    if array is None:
        listed = ", ".join(str(device) for device in devices(machine.root))
        return [Check("device", bool(listed), listed or "the kernel exposes none", _NO_DRIVER)]
    checks: list[Check] = []
    for bus, is_captured in {str(sensor.bus): sensor.fifo for sensor in array.sensors if sensor.on_iio}.items():
        device = IioDevice(bus.removeprefix(IIO), machine.root)
        try:
            checks.append(Check("device", True, f"{bus}: {device.name} at {device.place}"))
        except SensorError as error:
            checks.append(Check("device", False, str(error), _NO_DRIVER))
            continue
        if is_captured:
            checks.append(check_permission(machine, f"/{device.device_file.relative_to(machine.root)}"))
    return checks


def check_address_0x77(machine: Machine, array: ArrayConfig) -> list[Check]:
    """Check for a multiplexer at 0x77 and a BMP180, which has no other address: both would answer (PCA-11)."""
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
    finding = f"{', '.join(shared)}: the multiplexer before it has its address"
    return [Check("address 0x77", False, finding, advice)] if shared else []


NIGHT_S = 12 * 3600.0
_LIVE = 2.0
"""Disk space of a log while it is written, relative to that of its rows: each row is in the log and in its journal."""


def log_checks(machine: Machine, array: ArrayConfig | None, folder: Path, rate_hz: float) -> list[Check]:
    """Run all checks of the folder for logs."""
    if not folder.is_dir():
        return [Check("folder", False, f"{folder}: it does not exist", f"mkdir -p {folder}")]
    writable = os.access(folder, os.W_OK | os.X_OK)
    checks = [Check("folder", writable, f"{folder}", "choose another, or change its owner")]
    return [*checks, check_disk(machine, array, folder, rate_hz), *list_unfinished(machine, folder)]


def check_disk(machine: Machine, array: ArrayConfig | None, folder: Path, rate_hz: float) -> Check:
    """Check how long this array can be logged before the disk is full; without an array, whether there is any space."""
    free = machine.free_bytes(folder)
    advice = f"free some space: a log ends when less than {WATERMARK >> 20} MiB are free; --rotate 1h needs half"
    if array is None:
        return Check("disk", free > WATERMARK + RESERVE, f"{free / 2**20:.0f} MiB free", advice)
    rate = _LIVE * sum(
        sensor_group(header_of(sensor, {}, is_estimated=sensor.estimates_times)).row_bytes
        * (sensor.chip_rate_hz if sensor.fifo else min(rate_hz, sensor.chip_rate_hz))
        for sensor in array.sensors
    )
    seconds = max(0.0, free - WATERMARK - RESERVE) / rate
    finding = f"{free / 2**20:.0f} MiB free: about {_duration_text(seconds / 3600)} at {rate_hz:g} frames a second"
    return Check("disk", seconds >= NIGHT_S, finding, advice)


def _duration_text(hours: float) -> str:
    """Format hours, rounded to the precision of the estimate."""
    if hours < 10:
        return f"{hours:.1f} h"
    return f"{hours:.0f} h" if hours < 48 else f"{hours / 24:.0f} days"


def list_unfinished(machine: Machine, folder: Path) -> Iterator[Check]:
    """List logs that were never finished, and other files of terminated processes."""
    clean = True
    for journal in sorted(folder.glob("*.journal")):
        log = journal.with_suffix("")
        if is_running(log):
            yield Check("journal", True, f"{log.name} is being written")
        else:
            clean = False
            finding = f"{journal.name} remains: its log was never finished"
            yield Check("journal", False, finding, f"imuarray recover {log}")
    for part in sorted(folder.glob(".*.part")):
        process = part.name.split(".")[-2]
        if process.isdigit() and not machine.path(f"/proc/{process}").exists():
            clean = False
            yield Check("draft", False, f"{part.name} was left by a program that has ended", f"rm {part}")
    if clean:
        yield Check("left-overs", True, "none")


__all__ = ["Check", "Machine", "examine", "serial_checks"]


def examine(
    array: ArrayConfig | None,
    url: str,
    logs: Path,
    rate_hz: float,
    *,
    machine: Machine | None = None,
    talk: Callable[[], list[Check]] | None = None,
) -> list[Check]:
    """Run all checks for `array` on the bus `url` (empty: none is given) and for the folder `logs`; without an array,
    only those that need no sensors. `talk` communicates with the sensors; it is skipped if an earlier check explains
    why it can't work.
    """
    machine = machine or Machine()
    scheme, _, rest = url.partition(":")
    if scheme == "i2c":
        checks = i2c_checks(machine, array, buses_of(array, rest), rate_hz) + spi_checks(machine, array)
    elif scheme == "spi":
        checks = _wired_checks(machine, array, rate_hz)
    elif scheme == "iio":
        checks = iio_checks(machine, array) + _wired_checks(machine, array, rate_hz)
    elif scheme == "serial":
        checks = serial_checks(machine, rest.partition("?")[0])
    elif scheme == "replay":
        checks = [Check("transcript", Path(rest).is_file(), rest, "name a file that `log --transcript` wrote")]
    elif not url:
        advice = "give --bus i2c:/dev/i2c-1 (or serial:/dev/ttyACM0), or give [array] a bus"
        checks = [Check("bus", False, "none is named", advice)]
    else:
        checks = [Check("bus", scheme == "emulated", "emulated, no hardware" if scheme == "emulated" else url)]
    if talk is not None and scheme != "replay" and all(check.ok for check in checks):
        checks += _talk(talk)
    checks += log_checks(machine, array, logs, rate_hz)
    return [check._replace(advice="") if check.ok else check for check in checks]


def _talk(talk: Callable[[], list[Check]]) -> list[Check]:
    try:
        return talk()
    except ImuArrayError as error:
        return [Check("opening", False, str(error), "end the other program, or see the lines above")]
    except OSError as error:
        is_held = error.errno in (errno.ETIMEDOUT, errno.EAGAIN, errno.EBUSY)
        advice = "a device holds a wire low: unplug sensors one by one" if is_held else "check wires and supply"
        return [Check("talking", False, f"{error.strerror or error} (errno {error.errno})", advice)]


def serial_checks(machine: Machine, device: str) -> list[Check]:
    """Check a microcontroller's port: it exists, may be opened, and no other program uses it."""
    folder = machine.path("/dev")
    ports = sorted(f"/dev/{path.name}" for kind in ("ttyACM*", "ttyUSB*") for path in folder.glob(kind))
    if not device or not machine.path(device).exists():
        finding = f"{device or 'no port named'}; there are {', '.join(ports) or 'none'}"
        return [Check("port", False, finding, "plug it in with a cable that carries data; dmesg shows its name")]
    checks = [Check("port", True, device), check_permission(machine, device)]
    names = (path.read_text(errors="replace").strip() for path in machine.path("/proc").glob("[0-9]*/comm"))
    if "ModemManager" in names:
        advice = "it talks to every new port for some seconds: sudo systemctl disable --now ModemManager"
        checks.append(Check("ModemManager", False, "is running", advice))
    return checks
