"""The drivers of a real Linux kernel bind to the emulated BMP280, BMP388, LIS3MDL, AK8963 and MPU-9250 and read what
ours read.

The guest attaches the array as a USB/IP device, as in `test_kernel_usbip`. The script opens the bypass of the MPU-9250
for the driver ak8975, and closes it again for inv_mpu6050, which reads the same magnetometer by the master of the
auxiliary bus.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from imuarray.acquire import connect
from imuarray.array import load_array
from imuarray.bus import open_bus
from tests.system.bench import SEED, serve_array
from tests.system.guest_readings import addresses, numbers, own_readings, sections

MODULES = ("vhci-hcd", "i2c-tiny-usb", "i2c-dev", "bmp280-i2c", "st_magn_i2c", "ak8975", "inv-mpu6050-i2c")
CONFIG = """
[array]
name = "shelf"

[[sensor]]
name = "Baro280"
chip = "bmp280"
address = 0x76

[[sensor]]
name = "Baro388"
chip = "bmp388"
address = 0x77

[[sensor]]
name = "Field"
chip = "lis3mdl"
address = 0x1C
range = 4

[[sensor]]
name = "Force"
chip = "mpu9250"
address = 0x68
range = 4

[[sensor]]
name = "Compass"
chip = "ak8963"
address = 0x0C
range = 49.12
"""
READINGS = 8
TIMEOUT_S = 1200.0
"""It takes a minute on a quiet machine."""
SCRIPT = """
section() {{ echo "## $1"; }}
usbip --tcp-port {port} attach -r 10.0.2.2 -b 1-1
sleep 1
n=$(basename $(grep -l i2c-tiny-usb /sys/class/i2c-dev/i2c-*/name | xargs dirname) | cut -c5-)
section closed; i2cdetect -y -r $n
i2cset -y $n 0x68 0x37 0x02
section open; i2cdetect -y -r $n
bus=/sys/bus/i2c/devices/i2c-$n
echo bmp280 0x76 > $bus/new_device
echo bmp380 0x77 > $bus/new_device
echo lis3mdl 0x1c > $bus/new_device
echo ak8963 0x0c > $bus/new_device
section drivers; for a in 0076 0077 001c 000c; do basename $(readlink /sys/bus/i2c/devices/$n-$a/driver); done
iio() {{ dirname $(grep -l "^$1$" /sys/bus/iio/devices/iio:device*/name); }}
repeat() {{ section $1/$2; for i in $(seq {readings}); do cat $(iio $1)/$2; done; }}
for chip in bmp280 bmp380; do
  repeat $chip in_pressure_input
  repeat $chip in_temp_input
done
for chip in lis3mdl ak8963; do
  for axis in x y z; do
    repeat $chip in_magn_${{axis}}_raw
    section $chip/in_magn_${{axis}}_scale; cat $(iio $chip)/in_magn_${{axis}}_scale
  done
done
echo 0x0c > $bus/delete_device
i2cset -y $n 0x68 0x37 0x00
echo mpu9250 0x68 > $bus/new_device
section master; basename $(readlink /sys/bus/i2c/devices/$n-0068/driver)
for axis in x y z; do
  for kind in magn accel; do repeat mpu9250 in_${{kind}}_${{axis}}_raw; done
  section mpu9250/in_magn_${{axis}}_scale; cat $(iio mpu9250)/in_magn_${{axis}}_scale
done
section mpu9250/in_accel_scale; cat $(iio mpu9250)/in_accel_scale
section end
"""


@pytest.mark.campaign
def test_the_kernel_reads_the_barometers_and_magnetometers(
    guest: Callable[[str, Iterable[str], float], str], tmp_path: Path
) -> None:
    config = tmp_path / "shelf.toml"
    config.write_text(CONFIG)
    with serve_array(config) as port:
        outputs = sections(guest(SCRIPT.format(port=port, readings=READINGS), MODULES, TIMEOUT_S))
    assert "end" in outputs, outputs
    assert addresses(outputs["closed"]) == {0x1C, 0x68, 0x76, 0x77}
    assert addresses(outputs["open"]) == {0x0C, 0x1C, 0x68, 0x76, 0x77}  # INV-97
    assert outputs["drivers"].split() == ["bmp280", "bmp280", "st-magn-i2c", "ak8975"]

    ours = own_readings(config)
    check_barometer(outputs, "bmp280", ours["Baro280"], noise_pa=1.3)  # BMP-125
    check_barometer(outputs, "bmp380", ours["Baro388"], noise_pa=1.3)  # DEC-221
    check_lis3mdl(outputs, ours["Field"])
    check_ak8963(outputs, ours["Compass"], own_adjustment(config))
    assert outputs["master"].split() == ["inv-mpu6050-i2c"]
    check_mpu9250(outputs, ours["Compass"], ours["Force"], own_adjustment(config))


def own_adjustment(config: Path) -> list[int]:
    """Return the fuse ROM's adjustment of the AK8963 as this project's driver reads it."""
    array = load_array(config)
    with open_bus(f"emulated:?seed={SEED}", array) as bus:
        (header,) = [station.driver.header() for station in connect(array, bus) if station.sensor.name == "Compass"]
    return [int(header[f"asa_{axis}"]) for axis in "xyz"]


def check_barometer(outputs: dict[str, str], chip: str, ours: npt.NDArray[np.float64], noise_pa: float) -> None:
    """Compare means: the kernel and ours compute with the same words, so that only the pressure's noise is left, 5
    standard errors, and 0.01 Pa of rounding. The emulated temperature has no noise; it is printed to 0.01 degC.
    """
    pressure, temperature = numbers(outputs[f"{chip}/in_pressure_input"]), numbers(outputs[f"{chip}/in_temp_input"])
    assert len(pressure) == len(temperature) == READINGS
    error = noise_pa / 1e3 * np.sqrt(1 / READINGS + 1 / len(ours))
    assert pressure.mean() == pytest.approx(ours[:, 0].mean(), abs=1e-5 + 5 * error)
    assert temperature / 1e3 == pytest.approx(ours[:, 1].mean(), abs=0.005)


def check_lis3mdl(outputs: dict[str, str], ours: npt.NDArray[np.float64]) -> None:
    """The kernel leaves the part in low-power performance, ours is ultra-high: sqrt(1000 / 155) more noise (LIS-11,
    DEC-103). Bound of 5 standard errors.
    """
    error = 5 * np.sqrt(1000 / 155 / READINGS) * ours.std(axis=0)
    for axis, mean, bound in zip("xyz", ours.mean(axis=0), error, strict=True):
        theirs = numbers(outputs[f"lis3mdl/in_magn_{axis}_raw"])
        assert len(theirs) == READINGS
        assert theirs.mean() == pytest.approx(mean, abs=bound)
    x, y, z = ours.mean(axis=0)
    assert min(abs(x - y), abs(y - z), abs(z - x)) > 2 * error.max()  # or swapped axes would pass


def check_ak8963(outputs: dict[str, str], ours: npt.NDArray[np.float64], adjustment: list[int]) -> None:
    """The kernel reads 14 bits of 6 mG, ours are 16 bits of 1.5 mG; its scale, in gauss, contains the adjustment
    (asa + 128) / 256 (AKM-11, AKM-16). Bound of 5 standard errors and half a count of 14 bits.
    """
    for index, axis in enumerate("xyz"):
        theirs = numbers(outputs[f"ak8963/in_magn_{axis}_raw"])
        assert len(theirs) == READINGS
        bound = 2 + 5 * ours[:, index].std() / np.sqrt(READINGS)
        assert 4 * theirs.mean() == pytest.approx(ours[:, index].mean(), abs=bound)
        (scale,) = numbers(outputs[f"ak8963/in_magn_{axis}_scale"])
        assert scale == pytest.approx(0.006 * (adjustment[index] + 128) / 256, abs=1e-6)
    x, y, z = ours.mean(axis=0)
    assert min(abs(x - y), abs(y - z), abs(z - x)) > 20  # or swapped axes would pass


def check_mpu9250(
    outputs: dict[str, str], ours: npt.NDArray[np.float64], force: npt.NDArray[np.float64], adjustment: list[int]
) -> None:
    """The kernel asks for single measurements of 16 bits, whose bytes the master swaps (INV-111), and scales them by
    1.5 mG and the adjustment of x, for its channels lack an address. Bound of 5 standard errors and a count. Its
    accelerometer has another range; ours is at 4 g.
    """
    for index, axis in enumerate("xyz"):
        theirs = numbers(outputs[f"mpu9250/in_magn_{axis}_raw"])
        assert len(theirs) == READINGS
        bound = 1 + 5 * ours[:, index].std() * np.sqrt(1 / READINGS + 1 / len(ours))
        assert theirs.mean() == pytest.approx(ours[:, index].mean(), abs=bound)
        (scale,) = numbers(outputs[f"mpu9250/in_magn_{axis}_scale"])
        assert scale == pytest.approx(0.0015 * (adjustment[0] + 128) / 256, abs=1e-6)  # of x for every axis
        accelerations = numbers(outputs[f"mpu9250/in_accel_{axis}_raw"])
        (unit,) = numbers(outputs["mpu9250/in_accel_scale"])
        bound = 5 * force[:, index].std() / np.sqrt(READINGS) + 20
        assert accelerations.mean() * unit / 9.80665 * 8192 == pytest.approx(force[:, index].mean(), abs=bound)
