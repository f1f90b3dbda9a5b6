"""A real Linux kernel on the emulated array: i2c-tools find the chips, the kernel's own drivers read what ours read.

The guest attaches the array as a USB/IP device; from there on nothing of this project is involved in it. Debian's
kernel has no driver of the multiplexer, so that the script selects channel 0 by hand.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from tests.system.bench import CONFIG, serve_array
from tests.system.guest_readings import addresses, numbers, own_readings, sections

MODULES = ("vhci-hcd", "i2c-tiny-usb", "i2c-dev", "st_gyro_i2c", "bmp280-i2c", "hmc5843_i2c")
TIMEOUT_S = 120.0
READINGS = 12
GYRO_READINGS = 6
SCRIPT = """
section() {{ echo "## $1"; }}
usbip --tcp-port {port} attach -r 10.0.2.2 -b 1-1
sleep 1
section name; cat /sys/class/i2c-dev/i2c-*/name
n=$(basename $(grep -l i2c-tiny-usb /sys/class/i2c-dev/i2c-*/name | xargs dirname) | cut -c5-)
section functionality; i2cdetect -F $n
section trunk; i2cdetect -y -r $n
i2cset -y $n 0x70 0x04 c
section channel0; i2cdetect -y -r $n
section quick; i2cdetect -y -q $n
section devid; i2cget -y $n 0x53 0x00
section joined; i2ctransfer -y $n w1@0x53 0x00 r1 w1@0x68 0x0f r1
section misrouted; i2ctransfer -y $n w1@0x70 0x05 w1@0x69 0x0f r1 2>&1
i2cset -y $n 0x70 0x05 c
section channel1; i2cdetect -y -r $n
i2cset -y $n 0x70 0x04 c
bus=/sys/bus/i2c/devices/i2c-$n
echo l3g4200d 0x68 > $bus/new_device
echo bmp180 0x77 > $bus/new_device
echo hmc5883l 0x1e > $bus/new_device
section drivers; for a in 0068 0077 001e; do basename $(readlink /sys/bus/i2c/devices/$n-$a/driver); done
section owned; i2cget -y $n 0x68 0x0f 2>&1
iio() {{ dirname $(grep -l "^$1$" /sys/bus/iio/devices/iio:device*/name); }}
repeat() {{ section $1/$2; for i in $(seq {readings}); do cat $(iio $1)/$2; done; }}
repeat bmp180 in_pressure_input
repeat bmp180 in_temp_input
repeat hmc5883l in_magn_x_raw
repeat hmc5883l in_magn_y_raw
repeat hmc5883l in_magn_z_raw
section l3g4200d/in_anglvel_x_scale; cat $(iio l3g4200d)/in_anglvel_x_scale
for axis in x y z; do
  section l3g4200d/in_anglvel_${{axis}}_raw
  for i in $(seq {gyro_readings}); do
    cat $(iio l3g4200d)/in_anglvel_${{axis}}_raw
  done
done
section end
"""


@pytest.mark.slow
def test_the_kernel_reads_the_emulated_array(guest: Callable[[str, Iterable[str], float], str], tmp_path: Path) -> None:
    config = tmp_path / "bench.toml"
    config.write_text(CONFIG)
    with serve_array(config) as port:
        script = SCRIPT.format(port=port, readings=READINGS, gyro_readings=GYRO_READINGS)
        outputs = sections(guest(script, MODULES, TIMEOUT_S))
    assert "end" in outputs, outputs

    assert outputs["name"].startswith("i2c-tiny-usb at bus ")
    assert addresses(outputs["trunk"]) == {0x70}
    assert addresses(outputs["channel0"]) == addresses(outputs["quick"]) == {0x1E, 0x40, 0x53, 0x68, 0x70, 0x77}
    assert addresses(outputs["channel1"]) == {0x69, 0x70}
    assert outputs["devid"].split() == ["0xe5"]  # ADX-10
    assert outputs["joined"].split() == ["0xe5", "0xd3"]  # L3G-10; both in one transaction
    assert "No such device or address" in outputs["misrouted"]  # the mux switches at STOP, ENXIO: LNX-07, LNX-40
    assert outputs["drivers"].split() == ["st-gyro-i2c", "bmp280", "hmc5843"]
    assert "busy" in outputs["owned"]  # LNX-12

    ours = own_readings(config)
    check_gyroscope(outputs, ours["Gyro"])
    check_magnetometer(outputs, ours["Compass"])
    check_barometer(outputs, ours["Baro"])


def check_gyroscope(outputs: dict[str, str], ours: npt.NDArray[np.float64]) -> None:
    """The kernel leaves the bandwidth at LPF1's 32 Hz, ours is LPF2's 12.5 Hz (L3G-30, L3G-38): sqrt(2.6) more noise.

    Its driver waits 20 ms from power-down to the first reading where the part takes 300 ms (L3G-65): the script has
    switched the part on before. Bound of 5 standard errors: wrong by chance once in half a million runs.
    """
    assert numbers(outputs["l3g4200d/in_anglvel_x_scale"])[0] == pytest.approx(np.radians(0.00875), abs=1e-6)  # L3G-40
    error = 5 * np.sqrt(32 / 12.5 / GYRO_READINGS) * ours.std(axis=0)
    for axis, mean, bound in zip("xyz", ours.mean(axis=0), error, strict=True):
        theirs = numbers(outputs[f"l3g4200d/in_anglvel_{axis}_raw"])
        assert len(theirs) == GYRO_READINGS
        assert theirs.mean() == pytest.approx(mean, abs=bound)
    assert np.abs(ours.mean(axis=0)).max() > error.max()  # or zeros would pass


def check_magnetometer(outputs: dict[str, str], ours: npt.NDArray[np.float64]) -> None:
    """X, Y, Z although the chip sends X, Z, Y (HMC-13 ... HMC-15); at 15 Hz some samples are read several times."""
    for axis, mean, deviation in zip("xyz", ours.mean(axis=0), ours.std(axis=0), strict=True):
        theirs = numbers(outputs[f"hmc5883l/in_magn_{axis}_raw"])
        assert len(theirs) == READINGS
        assert theirs.mean() == pytest.approx(mean, abs=5 * deviation)
    x, y, z = ours.mean(axis=0)
    assert min(abs(x - y), abs(y - z), abs(z - x)) > 50  # or swapped axes would pass


def check_barometer(outputs: dict[str, str], ours: npt.NDArray[np.float64]) -> None:
    """kPa and millidegrees. The kernel's one division rounds towards zero, ours down: 3 Pa with these calibration words
    (BMP-64), the rest is noise of 3 Pa rms (BMP-44).
    """
    pressure, temperature = numbers(outputs["bmp180/in_pressure_input"]), numbers(outputs["bmp180/in_temp_input"])
    assert len(pressure) == len(temperature) == READINGS
    error = 0.003 * np.sqrt(1 / READINGS + 1 / len(ours))
    assert pressure.mean() == pytest.approx(ours[:, 0].mean(), abs=0.003 + 5 * error)
    assert temperature.mean() / 1e3 == pytest.approx(ours[:, 1].mean(), abs=0.1)
