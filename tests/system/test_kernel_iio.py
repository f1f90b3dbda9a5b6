"""The kernel's own drivers on emulated chips, logged through IIO: a log's counts are the bytes that the chips gave.

The array is served over USB/IP by this process, which notes every byte that passes. In the guest the drivers
inv_mpu6050, st_lsm6dsx, st_gyro and st_magn of a mainline kernel bind to it. Three logs: through the attributes of the
devices; of buffers that a trigger fills; and of buffers that the drivers fill from the queues of the chips. For the
last two `build_kernel_modules` builds what Debian's kernel has not. It takes minutes, so it is a campaign: in
`tests/system/test_kernel_usbip.py` the kernel reads the emulated array, and `tests/acquire/test_iio.py` logs emulated
device files of IIO.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from firmware_emulator.array import open_bus
from imuarray.array import parse_array
from imuarray.log import Log, open_log
from tests.system.conftest import SHARE, HostGuest, module_bytes
from tests.system.usbip_tap import Rows, WireTap, lsm6dso_rows, mpu_rows, serve_array

pytestmark = pytest.mark.campaign

MODULES = (
    *("vhci-hcd", "i2c-tiny-usb", "i2c-dev"),
    *("inv-mpu6050-i2c", "st_lsm6dsx_i2c", "st_gyro_i2c", "st_magn_i2c"),
)
TRIGGER_MODULE, INTERRUPT_MODULE = "iio-trig-sysfs", "i2c_interrupt"
TIMEOUT_S = 1200.0
"""It takes 3 minutes on a quiet machine."""
ROOT = Path(__file__).parents[2]
BOARD = '[array]\nname = "kernel iio"\n' + "".join(
    f'[[sensor]]\nname = "{name}"\nchip = "{chip}"\naddress = {address:#x}\n{keys}\n'
    for name, chip, address, keys in (
        ("A1", "mpu6050", 0x68, "range = 2"),
        ("G1", "mpu6050", 0x68, "range = 500"),
        ("Gyro", "l3g4200d", 0x69, "range = 250"),
        ("A2", "lsm6dso", 0x6A, "range = 4"),
        ("G2", "lsm6dso", 0x6A, "range = 500"),
        ("Mag", "lis3mdl", 0x1C, "range = 4"),
    )
)
DATA = {  # by sensor: address, registers of x, y and z (a bit that counts on left out), byte order
    "A1": (0x68, (0x3B, 0x3D, 0x3F), "big"),
    "G1": (0x68, (0x43, 0x45, 0x47), "big"),
    "Gyro": (0x69, (0x28, 0x2A, 0x2C), "little"),
    "Mag": (0x1C, (0x28, 0x2A, 0x2C), "little"),
}
COUNTS_ON = {0x69: 0x80, 0x1C: 0x80}
"""By address: the bit of a register's address that makes a read go on to the next (L3G-03, LIS-03)."""


def sensor(name: str, device: str, chip: str, quantity: str, keys: str) -> str:
    return f'[[sensor]]\nname = "{name}"\nchip = "{chip}"\nquantity = "{quantity}"\nbus = "iio:{device}"\n{keys}\n'


HEAD = '[array]\nname = "kernel"\nbus = "iio:"\n'
FORCE, RATE, FIELD = "specific_force", "angular_rate", "magnetic_field"
TRIGGERED = 'rate_hz = 2\nfifo = true\ntrigger = "sysfstrig7"'
CONFIGS = {
    "polled": HEAD
    + sensor("A1", "mpu6050", "mpu6050", FORCE, "rate_hz = 50\nrange = 4")
    + sensor("G1", "mpu6050", "mpu6050", RATE, "rate_hz = 50\nrange = 1000"),
    "captured": HEAD
    + sensor("Gyro", "l3g4200d", "l3g4200d", RATE, f"range = 500\n{TRIGGERED}")
    + sensor("Mag", "lis3mdl", "lis3mdl", FIELD, f"range = 8\n{TRIGGERED}"),
    "queued": HEAD
    + sensor("A1", "mpu6050", "mpu6050", FORCE, "rate_hz = 20\nrange = 4\nfifo = true")
    + sensor("G1", "mpu6050", "mpu6050", RATE, "rate_hz = 20\nrange = 1000\nfifo = true")
    + sensor("A2", "lsm6dso_accel", "lsm6dso", FORCE, "rate_hz = 26\nrange = 8\nfifo = true")
    + sensor("G2", "lsm6dso_gyro", "lsm6dso", RATE, "rate_hz = 26\nrange = 250\nfifo = true"),
}
SENSITIVITY = {  # counts per unit of the data sheets: INV-40, INV-41, LSM-30, LSM-31, L3G-41, LIS-10
    "A1": 8192.0,
    "G1": 32.8,
    "A2": 1000 / 0.244,
    "G2": 1000 / 8.75,
    "Gyro": 1 / 0.0175,
    "Mag": 3421.0,
}
KERNEL_TIME = "CLOCK_MONOTONIC of the kernel's driver"


@pytest.fixture(scope="module")
def results(host_guest: HostGuest) -> tuple[Path, WireTap]:
    """The folder with the files of the guest, and the bytes of the chips."""
    folder = host_guest.share
    for name, text in CONFIGS.items():
        (folder / f"{name}.toml").write_text(text)
    for module in (TRIGGER_MODULE, INTERRUPT_MODULE):
        if (path := host_guest.module(module)) is not None:
            (folder / f"{module}.ko").write_bytes(module_bytes(path))
    wire = WireTap(open_bus({"clock": "real", "seed": "7"}, parse_array(BOARD)).wire)
    with serve_array({"": wire}, "kernel iio") as port:
        script = f"""#!/bin/sh
            export PATH=/usr/sbin:/usr/bin:/sbin:/bin HOME=/root PYTHONDONTWRITEBYTECODE=1 OPENBLAS_NUM_THREADS=1
            cd {ROOT}
            {sys.executable} -m tests.system.kernel_iio {SHARE} {port}
            /run/busybox poweroff -f
        """
        written = host_guest.run(script, MODULES, TIMEOUT_S)
    assert "Traceback" not in written, written
    return folder, wire


def needs(folder: Path, module: str) -> None:
    """Skip the test if a module is missing."""
    if not (folder / f"{module}.ko").exists():
        pytest.skip(f"no module {module}; tests/system/build_kernel_modules builds it")


def register_rows(wire: WireTap, name: str) -> Rows:
    """The triads of a sensor whose registers were read axis by axis."""
    address, registers, order = DATA[name]
    bit = COUNTS_ON.get(address, 0)
    axes = [
        [
            int.from_bytes(data, order, signed=True)  # type: ignore[arg-type]
            for at, register, data in wire.reads
            if at == address and register in (axis, axis | bit) and len(data) == 2
        ]
        for axis in registers
    ]
    return [list(row) for row in zip(*axes, strict=False)]


def queue_rows(wire: WireTap, name: str) -> Rows:
    """The triads of a sensor in the bytes of the queue of its chip."""
    is_force = name[0] == "A"
    if name[1] == "2":
        return lsm6dso_rows(wire, 0x6A, 2 if is_force else 1)
    return [row[:3] if is_force else row[3:] for row in mpu_rows(wire, 0x68)]


def check_log(log: Log, given_by: Callable[[WireTap, str], Rows], wire: WireTap, least: int) -> None:
    """The rows are the readings of the chip, in order and complete but for the ends."""
    assert log.source == "iio"
    for name, logged in log.sensors.items():
        counts: list[Any] = logged.counts[:].tolist()
        assert len(counts) >= least, name
        assert len({tuple(row) for row in counts}) >= 4, "or a constant would pass"
        given = given_by(wire, name)
        starts = [start for start in range(len(given)) if given[start : start + len(counts)] == counts]
        assert len(starts) == 1, (name, counts[:3], given[:8])
        assert (np.diff(logged.time[:]) > 0).all()
        assert logged.sensitivity == pytest.approx(SENSITIVITY[name], rel=1e-3)


def ended(folder: Path, name: str) -> int:
    """The exit code of a log. 1 is none that went wrong: in a slow guest the newest sample is seconds old by the time
    that a log ends.
    """
    code: int = json.loads((folder / "codes.json").read_text())[name]
    assert code in (0, 1), (folder / f"{name}.err").read_text()
    return code


def test_attributes_of_devices_are_logged(results: tuple[Path, WireTap]) -> None:
    folder, wire = results
    assert {"mpu6050", "lsm6dso_accel", "lsm6dso_gyro"} <= set(json.loads((folder / "names.json").read_text()))
    assert ended(folder, "detect") == 0, (folder / "detect.out").read_text()
    ended(folder, "polled")
    with open_log(folder / "polled.h5") as log:
        assert set(log.sensors) == {"A1", "G1"}
        check_log(log, register_rows, wire, least=5)


def test_buffers_that_a_trigger_fills_are_logged(results: tuple[Path, WireTap]) -> None:
    folder, wire = results
    needs(folder, TRIGGER_MODULE)
    ended(folder, "captured")
    with open_log(folder / "captured.h5") as log:
        assert set(log.sensors) == {"Gyro", "Mag"}
        check_log(log, register_rows, wire, least=5)
        assert {log[name].attributes["time_source"] for name in log.sensors} == {KERNEL_TIME}


def test_queues_of_chips_are_logged(results: tuple[Path, WireTap]) -> None:
    """Samples that the kernel's drivers read from the queues of two six-axis chips, and push into their buffers."""
    folder, wire = results
    needs(folder, INTERRUPT_MODULE)
    ended(folder, "queued")
    with open_log(folder / "queued.h5") as log:
        assert set(log.sensors) == {"A1", "G1", "A2", "G2"}
        check_log(log, queue_rows, wire, least=50)
        assert {log[name].attributes["time_source"] for name in log.sensors} == {KERNEL_TIME}
