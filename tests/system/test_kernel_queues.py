"""The kernel's drivers take the queues of emulated six-axis chips: the content of its buffers is that of the queues.

The guest attaches two adapters over USB/IP, served by this process, which notes every byte. inv_mpu6050, st_lsm6dsx and
inv_icm42600 of a mainline kernel bind to the chips with an interrupt that a module of this project raises
(`build_kernel_modules`; an adapter on USB has no wire for one), and fill their buffers. The driver of Linux 6.1 does
not support the ICM-42688-P; the chip answers as its relative ICM-42605, whose registers are the same where the driver
uses them, and is bound by a front of this project, because a PC has no device tree. No adapter for SPI can be had this
way.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable

import numpy as np
import pytest

from firmware_emulator.array import open_array
from imuarray.array import parse_array
from tests.system.guest_readings import sections
from tests.system.usbip_tap import Rows, WireTap, icm_rows, lsm6dso_rows, mpu_rows, serve_array

pytestmark = pytest.mark.slow

MODULES = (
    *("vhci-hcd", "i2c-tiny-usb", "i2c-dev", "i2c_interrupt"),
    *("inv-mpu6050-i2c", "st_lsm6dsx_i2c", "icm42605_by_name"),
)
OTHER = "/dev/i2c-9"
"""The bus of the second adapter."""
ICM42605 = 0x42  # TDK-03
BOARD = '[array]\nname = "kernel queues"\n' + "".join(
    f'[[sensor]]\nname = "{name}"\nchip = "{chip}"\naddress = {address:#x}\nrange = {range_}\n{keys}\n'
    for name, chip, address, range_, keys in (
        ("A1", "mpu6050", 0x68, 2, ""),
        ("G1", "mpu6050", 0x68, 500, ""),
        ("A2", "lsm6dso", 0x6A, 4, ""),
        ("G2", "lsm6dso", 0x6A, 500, ""),
        ("A3", "icm42688", 0x68, 4, f'bus = "{OTHER}"'),
        ("G3", "icm42688", 0x68, 500, f'bus = "{OTHER}"'),
    )
)
DEVICES = {"mpu6050": 20, "lsm6dso_accel": 26, "lsm6dso_gyro": 26, "icm42605-accel": 25, "icm42605-gyro": 25}
"""Names that the drivers give their devices, and rates (Hz) at which a slow guest keeps up with them."""
LIMIT_S = 1200.0
"""It takes half a minute on a quiet machine."""
SCRIPT = """
section() {{ echo "## $1"; }}
attach() {{ for second in $(seq 20); do usbip --tcp-port {port} attach -r 10.0.2.2 -b $1 && return; sleep 1; done; }}
attach 1-1
attach 1-2
sleep 2
set -- $(for d in /sys/class/i2c-dev/i2c-*; do grep -q tiny $d/name && basename $d | cut -c5-; done)
i2cdetect -y -r $1 | grep -q 6a || set -- $2 $1
add=/sys/module/i2c_interrupt/parameters/device
echo "$1 mpu6050 0x68" > $add
echo "$1 lsm6dso 0x6a" > $add
echo "$2 icm42605-by-name 0x68" > $add
sleep 1
section names; cat /sys/bus/iio/devices/iio:device*/name
iio() {{ dirname $(grep -l "^$1$" /sys/bus/iio/devices/iio:device*/name); }}
start() {{
  name=$1
  cd $(iio $name)
  for element in scan_elements/*_en; do echo 1 > $element; done
  echo $2 > sampling_frequency
  echo 512 > buffer/length
  echo 10 > buffer/watermark
  echo 1 > buffer/enable
  section $name/elements
  for element in scan_elements/*_en; do
    element=${{element%_en}}; echo $(basename $element) $(cat ${{element}}_index) $(cat ${{element}}_type)
  done
}}
{starts}
sleep 5
for name in {devices}; do echo 0 > $(iio $name)/buffer/enable; done
for name in {devices}; do
  timeout 1 cat /dev/$(basename $(iio $name)) > /run/scans 2> /dev/null
  section $name/scans; hexdump -v -e '1/1 "%02x"' /run/scans; echo
done
section messages; dmesg | tail -20
section end
"""


@pytest.fixture(scope="module")
def wires() -> dict[str, WireTap]:
    """The wires of the array; their bytes once the guest has ended."""
    array = parse_array(BOARD)
    bus = open_array(array, clock="real", seed=7, switches={"A3": {"identity": ICM42605}})
    return {name: WireTap(wire) for name, wire in bus.wires.items()}


def scans(outputs: dict[str, str], name: str) -> bytes:
    """The bytes that were read from a device's file."""
    (text,) = re.findall("^[0-9a-f]+$", outputs[f"{name}/scans"], re.MULTILINE)
    return bytes.fromhex(text)


def triads(outputs: dict[str, str], name: str) -> Rows:
    """The scans of a device without their times: words of 16 bits in the order and byte order of their elements."""
    elements = sorted(
        (int(index), kind[:2] == "be", element)
        for element, index, kind in (line.split() for line in outputs[f"{name}/elements"].splitlines())
    )
    data = scans(outputs, name)
    channels = [(big, element) for _, big, element in elements if element != "in_timestamp"]
    size = (2 * len(channels) + 7) // 8 * 8 + 8
    assert len(data) % size == 0
    rows = []
    for at in range(0, len(data), size):
        texts = [data[at + 2 * place : at + 2 * place + 2] for place in range(len(channels))]
        rows.append(
            [
                int.from_bytes(text, "big" if big else "little", signed=True)
                for text, (big, element) in zip(texts, channels, strict=True)
                if not element.startswith("in_temp")
            ]
        )
    return rows


def times_ns(outputs: dict[str, str], name: str) -> list[int]:
    """The last eight bytes of every scan."""
    words = 0
    for line in outputs[f"{name}/elements"].splitlines():
        words += not line.startswith("in_timestamp")
    size = (2 * words + 7) // 8 * 8 + 8
    data = scans(outputs, name)
    return [int.from_bytes(data[at + size - 8 : at + size], "little") for at in range(0, len(data), size)]


def check_rows(taken: Rows, given: Rows) -> None:
    """The rows of the kernel are a contiguous part of those of the chip."""
    assert len(taken) >= 20
    assert len({tuple(row) for row in taken}) >= 5, "or a constant would pass"
    starts = [start for start in range(len(given)) if given[start : start + len(taken)] == taken]
    assert len(starts) == 1, (taken[:3], given[:8])


def test_the_kernels_buffers_contain_the_bytes_of_the_queues(
    guest: Callable[[str, Iterable[str], float], str], wires: dict[str, WireTap]
) -> None:
    with serve_array(wires, "kernel queues") as port:
        starts = "\n".join(f"start {name} {rate_hz}" for name, rate_hz in DEVICES.items())
        script = SCRIPT.format(port=port, devices=" ".join(DEVICES), starts=starts)
        outputs = sections(guest(script, MODULES, LIMIT_S))
    assert "end" in outputs, outputs
    assert set(outputs["names"].split()) >= set(DEVICES), outputs
    trunk, other = wires[""], wires[OTHER]
    check_rows(triads(outputs, "mpu6050"), mpu_rows(trunk, 0x68))
    check_rows(triads(outputs, "lsm6dso_accel"), lsm6dso_rows(trunk, 0x6A, 2))
    check_rows(triads(outputs, "lsm6dso_gyro"), lsm6dso_rows(trunk, 0x6A, 1))
    check_rows(triads(outputs, "icm42605-accel"), icm_rows(other, 0x68, 0))
    check_rows(triads(outputs, "icm42605-gyro"), icm_rows(other, 0x68, 1))
    for name in DEVICES:  # one step back where the other half is switched on: a slow guest's clock is behind the chip's
        assert np.count_nonzero(np.diff(times_ns(outputs, name)) <= 0) <= 1, name
    for name in (
        "lsm6dso_accel",
        "lsm6dso_gyro",
    ):  # 26 Hz in counts of 25 us, from the time stamps in the queue: LSM-46
        assert np.mean(np.isin(np.diff(times_ns(outputs, name)), (38_450_000, 38_475_000))) > 0.95
