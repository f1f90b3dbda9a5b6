"""Every range, rate and filter of the six-axis chips: the register that is written, and the meaning of a reading.

Register values and counts are written out from the sources of `imuarray/facts/SOURCES.md`, not taken from the drivers.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import chain
from typing import Any, NamedTuple

import pytest

from firmware_emulator.chips import CHIPS
from imuarray.array import SensorConfig
from imuarray.errors import SensorError

Build = Callable[..., Any]


class Case(NamedTuple):
    """A setting of one chip, the register that has it, its value, and counts a unit where the range is what is set."""

    chip: str
    settings: dict[str, float]
    register: int
    value: int
    per_unit: float = 0.0


def ranges(chip: str, register: int, codes: dict[float, tuple[int, float]], **settings: float) -> list[Case]:
    return [
        Case(chip, {"range": range_, **settings}, register, value, per_unit)
        for range_, (value, per_unit) in codes.items()
    ]


def rates(chip: str, register: int, codes: dict[float, int], **settings: float) -> list[Case]:
    return [Case(chip, {"rate_hz": rate_hz, **settings}, register, value) for rate_hz, value in codes.items()]


def filters(chip: str, register: int, codes: dict[float, int], **settings: float) -> list[Case]:
    return [Case(chip, {"bandwidth_hz": hz, **settings}, register, value) for hz, value in codes.items()]


ICM_G = {2.0: (0x66, 16384.0), 4.0: (0x46, 8192.0), 8.0: (0x26, 4096.0), 16.0: (0x06, 2048.0)}  # TDK-14, TDK-30
ICM_DPS = {  # TDK-14, TDK-31
    2000.0: (0x06, 16.4),
    1000.0: (0x26, 32.8),
    500.0: (0x46, 65.5),
    250.0: (0x66, 131.0),
    125.0: (0x86, 262.0),
    62.5: (0xA6, 524.3),
    31.25: (0xC6, 1048.6),
    15.625: (0xE6, 2097.2),
}
ICM_RATES = {4000.0: 4, 2000.0: 5, 1000.0: 6, 500.0: 15, 200.0: 7, 100.0: 8, 50.0: 9, 25.0: 10, 12.5: 11}  # TDK-15
ICM_FILTERS = {250.0: 0x11, 200.0: 0x22, 125.0: 0x33, 100.0: 0x44, 62.5: 0x55, 50.0: 0x66, 25.0: 0x77}  # TDK-16
ICM_SLOW_FILTERS = {100.0: 0x11, 80.0: 0x22, 50.0: 0x33, 40.0: 0x44, 25.0: 0x55, 20.0: 0x66, 10.0: 0x77}  # of 400 Hz
LSM_G = {2.0: (0x50, 16393.4), 4.0: (0x58, 8196.7), 8.0: (0x5C, 4098.4), 16.0: (0x54, 2049.2)}  # LSM-14, LSM-30
LSM_DPS = {  # LSM-14, LSM-31
    125.0: (0x52, 228.571),
    250.0: (0x50, 114.286),
    500.0: (0x54, 57.143),
    1000.0: (0x58, 28.571),
    2000.0: (0x5C, 14.286),
}
LSM_RATES = {104.0: 0x40, 208.0: 0x50, 416.0: 0x60, 833.0: 0x70, 1666.0: 0x80}  # LSM-15
MPU_G = {2.0: (0x00, 16384.0), 4.0: (0x08, 8192.0), 8.0: (0x10, 4096.0), 16.0: (0x18, 2048.0)}  # INV-75, INV-77
MPU_DPS = {250.0: (0x00, 131.0), 500.0: (0x08, 65.5), 1000.0: (0x10, 32.8), 2000.0: (0x18, 16.4)}
MPU_RATES = {1000.0: 0, 500.0: 1, 250.0: 3, 200.0: 4, 125.0: 7, 100.0: 9, 50.0: 19, 40.0: 24, 10.0: 99, 4.0: 249}
MPU_FILTERS = {184.0: 1, 92.0: 2, 41.0: 3, 20.0: 4, 10.0: 5, 5.0: 6}  # INV-73, INV-74
CASES = [
    *ranges("icm42688_acc", 0x50, ICM_G),
    *ranges("icm42688_gyro", 0x4F, ICM_DPS),
    *rates("icm42688_acc", 0x50, ICM_RATES, range=16.0),
    *rates("icm42688_gyro", 0x4F, ICM_RATES, range=2000.0),
    *filters("icm42688_acc", 0x52, ICM_FILTERS, range=16.0),
    *filters("icm42688_gyro", 0x52, ICM_SLOW_FILTERS, range=2000.0, rate_hz=50.0),
    *ranges("lsm6dso_acc", 0x10, LSM_G),
    *ranges("lsm6dso_gyro", 0x11, LSM_DPS),
    *rates("lsm6dso_acc", 0x10, LSM_RATES, range=2.0),
    *rates("lsm6dso_gyro", 0x11, LSM_RATES, range=250.0),
    *chain.from_iterable(
        (
            *ranges(f"{die}_acc", 0x1C, MPU_G),
            *ranges(f"{die}_gyro", 0x1B, MPU_DPS),
            *rates(f"{die}_acc", 0x19, MPU_RATES, range=2.0),
            *filters(f"{die}_acc", 0x1D, MPU_FILTERS, range=2.0),
            *filters(f"{die}_gyro", 0x1A, MPU_FILTERS, range=250.0),
        )
        for die in ("mpu6500", "mpu9250")
    ),
]


def built(bench: Build, chip: str, settings: dict[str, float], unit: float) -> Any:
    """The bench of a chip whose input is `unit` along x."""
    address = 0x6A if chip.startswith("lsm") else 0x68
    sensor = SensorConfig(name="S", chip=chip, address=address, **settings)  # type: ignore[arg-type]
    return bench(CHIPS[chip], sensor, (unit, 0.0, 0.0))


@pytest.mark.parametrize("case", CASES, ids=lambda case: "-".join(map(str, (case.chip, *case.settings.values()))))
def test_a_setting_is_in_its_register(bench: Build, case: Case) -> None:
    unit = 0.5 * case.settings["range"]
    made = built(bench, case.chip, case.settings, unit)
    made.driver.identify()
    made.driver.configure()
    assert made.register(case.register) == case.value
    decoded = made.read()
    assert decoded.status.tolist() == [0]
    if case.per_unit:
        assert decoded.counts[0, 0] == pytest.approx(unit * case.per_unit, abs=1.0)
        assert decoded.counts[0, 1:].tolist() == [0, 0]


@pytest.mark.parametrize(
    ("chip", "range_", "registers"),
    [
        ("icm42688_acc", 4.0, (0x4D, 0x4E, 0x50, 0x52, 0x03, 0x04)),
        ("icm42688_gyro", 500.0, (0x4D, 0x4E, 0x4F, 0x52, 0x03, 0x04)),
        ("lsm6dso_acc", 4.0, (0x10, 0x12)),
        ("lsm6dso_gyro", 500.0, (0x11, 0x12)),
        ("mpu6500_acc", 4.0, (0x19, 0x1A, 0x1C, 0x1D)),
        ("mpu9250_gyro", 500.0, (0x19, 0x1A, 0x1B, 0x1D)),
    ],
)
def test_a_register_that_drops_a_write_is_reported(
    bench: Build, chip: str, range_: float, registers: tuple[int, ...]
) -> None:
    """Each of those whose value is not that of power-on."""
    for register in registers:
        made = built(bench, chip, {"range": range_}, 0.0)
        made.tap.drops = register.__eq__
        with pytest.raises(SensorError, match=f"register {register:#04x} reads .* the chip refuses its configuration"):
            made.driver.configure()
