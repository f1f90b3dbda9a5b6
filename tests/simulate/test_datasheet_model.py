"""configs/models/datasheet.toml against the figures of the fact sheet, copied here independently."""

from __future__ import annotations

from collections.abc import Callable, Collection
from math import atan, degrees, isnan, sqrt
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import pytest
from scipy.stats import truncnorm

from imuarray.log.format import SensorHeader
from imuarray.simulate.effects import EFFECTS
from imuarray.simulate.effects.timing import OwnClock
from imuarray.simulate.model import TRIADS, load_model
from imuarray.simulate.population import Spread
from imuarray.simulate.streams import Streams
from tests.selection import some

MakeSensor = Callable[..., SensorHeader]
Floats = npt.NDArray[np.float64]

MODEL = load_model(Path(__file__).parents[2] / "configs" / "models" / "datasheet.toml")
UNITS = 1000

MG = 1e-3
PERCENT = 0.01


class Printed(NamedTuple):
    """One tolerance of a data sheet: sigma and limit about the mean, in the unit of the effect's parameter."""

    effect: str
    parameter: str
    sigma: float
    limit: float
    mean: float = 0.0
    axes: tuple[int, ...] = (0, 1, 2)


def typical(effect: str, parameter: str, value: float) -> Printed:
    """Of Bosch, ST, Honeywell: two sigma and the limit (DEC-51)."""
    return Printed(effect, parameter, value / 2, value)


def deviation(effect: str, parameter: str, sigma: float, limit: float, *axes: int) -> Printed:
    """Of Analog Devices: one sigma (DEC-51)."""
    return Printed(effect, parameter, sigma, limit, axes=axes or (0, 1, 2))


SHEETS: dict[str, tuple[float, tuple[Printed, ...]]] = {
    "adxl345": (
        16.0,
        (
            deviation("bias", "offset", 35 * MG, 150 * MG, 0, 1),  # ADX-60
            deviation("bias", "offset", 40 * MG, 250 * MG, 2),  # ADX-61
            deviation("thermal_bias", "slope", 0.4 * MG, 1.2 * MG, 0, 1),  # ADX-62, three sigma
            deviation("thermal_bias", "slope", 1.2 * MG, 3.6 * MG, 2),
            deviation("scale", "error", 1.0 * PERCENT, 10 * PERCENT),  # ADX-63
            deviation("thermal_scale", "slope", 0.01 * PERCENT, 0.03 * PERCENT),  # ADX-64
            deviation("nonlinearity", "quadratic", 2 * 0.5 * PERCENT / 16, 6 * 0.5 * PERCENT / 16),  # ADX-65
            deviation("misalignment", "angles_deg", degrees(atan(0.01)), 3 * degrees(atan(0.01)), *range(6)),  # ADX-66
        ),
    ),
    "bma180": (
        2.0,
        (
            typical("own_clock", "rate_error", 10 * PERCENT)._replace(axes=(0,)),  # BMA-107
            typical("scale", "error", 1.5 * PERCENT),  # BMA-72
            Printed("thermometer", "offset_degc", 5 / 3, 5.0, axes=(0,)),  # BMA-64: a minimum and a maximum
            typical("bias", "offset", 60 * MG),  # BMA-113
            typical("thermal_bias", "slope", 0.5 * MG),  # BMA-115
            typical("thermal_scale", "slope", 0.01 * PERCENT),  # BMA-116
            typical("nonlinearity", "quadratic", 2 * 0.15 * PERCENT / 2),  # BMA-117
            typical("misalignment", "angles_deg", 1.0)._replace(axes=tuple(range(6))),  # BMA-118, BMA-119
        ),
    ),
    "l3g4200d": (
        250.0,
        (
            typical("bias", "offset", 10.0),  # L3G-70
            typical("thermal_bias", "slope", 0.03),  # L3G-71
            typical("thermal_scale", "slope", 2 * PERCENT / (25 + 40)),  # L3G-72
            typical("nonlinearity", "quadratic", 2 * 0.2 * PERCENT / 250),  # L3G-73
        ),
    ),
    "mpu6050_acc": (
        4.0,
        (
            typical("bias", "offset", 50 * MG)._replace(axes=(0, 1)),  # INV-51
            typical("bias", "offset", 80 * MG)._replace(axes=(2,)),
            typical("thermal_bias", "slope", 35 * MG / 45)._replace(axes=(0, 1)),  # INV-52
            typical("thermal_bias", "slope", 60 * MG / 45)._replace(axes=(2,)),
            typical("scale", "error", 3 * PERCENT),  # INV-53
            typical("thermal_scale", "slope", 0.02 * PERCENT),
            typical("nonlinearity", "quadratic", 2 * 0.5 * PERCENT / 4),  # INV-54
            typical("misalignment", "angles_deg", degrees(atan(0.02)))._replace(axes=tuple(range(6))),  # INV-55
            typical("thermometer", "offset_degc", 1.0)._replace(axes=(0,)),  # INV-42
        ),
    ),
    "mpu6050_gyro": (
        500.0,
        (
            typical("bias", "offset", 20.0),  # INV-61
            typical("thermal_bias", "slope", 20.0 / (25 + 40)),  # INV-62
            typical("scale", "error", 3 * PERCENT),  # INV-63
            typical("thermal_scale", "slope", 2 * PERCENT / (25 + 40)),
            typical("nonlinearity", "quadratic", 2 * 0.2 * PERCENT / 500),  # INV-64
            typical("misalignment", "angles_deg", degrees(atan(0.02)))._replace(axes=tuple(range(6))),  # INV-65
            typical("g_sensitivity", "response", 0.1)._replace(axes=tuple(range(9))),  # INV-66
            typical("thermometer", "offset_degc", 1.0)._replace(axes=(0,)),
        ),
    ),
    "mpu6500_acc": (
        4.0,
        (
            typical("bias", "offset", 60 * MG)._replace(axes=(0, 1)),  # INV-81
            typical("bias", "offset", 80 * MG)._replace(axes=(2,)),
            typical("thermal_bias", "slope", 1.5 * MG),  # INV-82
            typical("scale", "error", 3 * PERCENT),  # INV-83
            typical("thermal_scale", "slope", 0.026 * PERCENT),
            typical("nonlinearity", "quadratic", 2 * 0.5 * PERCENT / 4),  # INV-84
            typical("misalignment", "angles_deg", degrees(atan(0.02)))._replace(axes=tuple(range(6))),
        ),
    ),
    "mpu6500_gyro": (
        500.0,
        (
            typical("bias", "offset", 5.0),  # INV-91
            typical("thermal_bias", "slope", 30.0 / (25 + 40)),  # INV-92
            typical("scale", "error", 3 * PERCENT),  # INV-93
            typical("thermal_scale", "slope", 4 * PERCENT / (25 + 40)),
            typical("nonlinearity", "quadratic", 2 * 0.1 * PERCENT / 500),  # INV-94
            typical("misalignment", "angles_deg", degrees(atan(0.02)))._replace(axes=tuple(range(6))),
        ),
    ),
    "icm42688_acc": (
        4.0,
        (
            typical("bias", "offset", 20 * MG),  # TDK-51
            typical("thermal_bias", "slope", 0.15 * MG),  # TDK-52
            typical("scale", "error", 0.5 * PERCENT),  # TDK-53
            typical("thermal_scale", "slope", 0.005 * PERCENT),
            typical("nonlinearity", "quadratic", 2 * 0.1 * PERCENT / 4),  # TDK-54
            typical("misalignment", "angles_deg", degrees(atan(0.01)))._replace(axes=tuple(range(6))),
            typical("thermometer", "offset_degc", 5.0)._replace(axes=(0,)),  # TDK-64
        ),
    ),
    "icm42688_gyro": (
        500.0,
        (
            typical("bias", "offset", 0.5),  # TDK-61
            typical("thermal_bias", "slope", 0.005),  # TDK-62
            typical("scale", "error", 0.5 * PERCENT),  # TDK-63
            typical("thermal_scale", "slope", 0.005 * PERCENT),
            typical("nonlinearity", "quadratic", 2 * 0.1 * PERCENT / 500),  # TDK-64
            typical("misalignment", "angles_deg", degrees(atan(0.0125)))._replace(axes=tuple(range(6))),
            typical("thermometer", "offset_degc", 5.0)._replace(axes=(0,)),
        ),
    ),
    "lsm6dso_acc": (
        4.0,
        (
            typical("bias", "offset", 20 * MG),  # LSM-50
            typical("thermal_bias", "slope", 0.1 * MG),  # LSM-51
            typical("scale", "error", 1 * PERCENT),
            typical("thermal_scale", "slope", 0.01 * PERCENT),
            typical("thermometer", "offset_degc", 15.0)._replace(axes=(0,)),  # LSM-33
        ),
    ),
    "lsm6dso_gyro": (
        500.0,
        (
            typical("bias", "offset", 1.0),  # LSM-60
            typical("thermal_bias", "slope", 0.01),  # LSM-61
            typical("scale", "error", 1 * PERCENT),
            typical("thermal_scale", "slope", 0.007 * PERCENT),
            typical("thermometer", "offset_degc", 15.0)._replace(axes=(0,)),
        ),
    ),
    "hmc5883l": (
        4.0,
        (
            typical("scale", "error", 5 * PERCENT),  # HMC-52
            Printed("nonlinearity", "quadratic", 0.002 / 3, 2 * 0.1 * PERCENT * 4 / 2**2),  # HMC-54: a maximum
            typical("misalignment", "angles_deg", degrees(atan(0.2 * PERCENT * 4)))._replace(
                axes=tuple(range(6))
            ),  # HMC-56
            Printed("thermal_scale", "slope", 0.0, 0.0, mean=-0.3 * PERCENT),  # HMC-57
        ),
    ),
    "hmc5883": (
        1.2,
        (
            typical("scale", "error", 5 * PERCENT),  # HMC-52
            Printed("nonlinearity", "quadratic", 0.002 / 1.2 / 3, 2 * 0.1 * PERCENT / 1.2),  # HMC-54
            Printed("thermal_scale", "slope", 0.0, 0.0, mean=-1.2 / 1024),  # HMC-57
        ),
    ),
    "lis3mdl": (
        4.0,
        (
            typical("bias", "offset", 1.0),  # LIS-21
            typical("nonlinearity", "quadratic", 2 * 0.12 * PERCENT * 12 / 6**2),
        ),
    ),
    "ak8963": (
        49.12,
        (
            typical("bias", "offset", 0.75),  # AKM-17
            typical("scale", "error", 5 * PERCENT),
        ),
    ),
    "ak8975": (
        12.29,
        (
            typical("bias", "offset", 3.0),  # AKM-28
            typical("scale", "error", 5 * PERCENT),
        ),
    ),
    "mmc5983": (
        8.0,
        (
            typical("bias", "offset", 0.5),  # MMC-20
            typical("scale", "error", 5 * PERCENT),
            typical("nonlinearity", "quadratic", 2 * 0.1 * PERCENT / 8),
        ),
    ),
}
SHEETS |= {f"mpu9250_{half}": SHEETS[f"mpu6500_{half}"] for half in ("acc", "gyro")}  # INV-81 ... INV-94 hold for both


def drawn(header: SensorHeader, effect: str, parameter: str, unit: int) -> Floats:
    """The parameter of one virtual unit; tables of one kind added up."""
    return drawn_together(header, effect, (parameter,), unit)[parameter]


def drawn_together(header: SensorHeader, effect: str, parameters: Collection[str], unit: int) -> dict[str, Floats]:
    """Parameters of one effect of one virtual unit; tables of one kind added up."""
    without = frozenset(EFFECTS) - {effect}
    effects = MODEL.effects(_named(header, f"U{unit}"), Streams(11), without=without)
    return {
        parameter: np.sum([np.atleast_1d(getattr(result, parameter)) for result in effects], axis=0, dtype=float)
        for parameter in parameters
    }


def _named(header: SensorHeader, name: str) -> SensorHeader:
    return SensorHeader(**{**vars(header), "name": name})


@pytest.mark.slow
@pytest.mark.parametrize(
    ("chip", "effect"),
    some(
        [
            (chip, effect)
            for chip, (_, sheet) in SHEETS.items()
            for effect in sorted({printed.effect for printed in sheet})
        ],
        40,
        0,
    ),
)
def test_a_thousand_units_have_the_tolerances_of_the_data_sheet(sensor: MakeSensor, chip: str, effect: str) -> None:
    """Mean and deviation at 4.4 sigma each (24 populations: one false alarm in 1900 seeds), none beyond the limit.

    Rounding in the file: four digits.
    """
    range_, sheet = SHEETS[chip]
    tolerances = [printed for printed in sheet if printed.effect == effect]
    parameters = {printed.parameter for printed in tolerances}
    units = [drawn_together(sensor(chip, range_=range_), effect, parameters, unit) for unit in range(UNITS)]
    for printed in tolerances:
        result = np.array([unit[printed.parameter] for unit in units])[:, printed.axes].ravel() - printed.mean
        rounding = 1e-4 * (printed.limit + abs(printed.mean))
        assert np.abs(result).max() <= printed.limit + rounding, printed
        if printed.sigma:
            cut = printed.limit / printed.sigma
            sigma = printed.sigma * truncnorm(-cut, cut).std()
            assert result.mean() == pytest.approx(0.0, abs=4.4 * sigma / sqrt(len(result)) + rounding), printed
            assert result.std() == pytest.approx(sigma, rel=4.4 / sqrt(2 * len(result)) + 1e-4), printed


@pytest.mark.parametrize("chip", SHEETS)
def test_the_file_has_the_printed_figures(sensor: MakeSensor, chip: str) -> None:
    """More exact than by a thousand units: sigma and limit to four digits."""
    range_, sheet = SHEETS[chip]
    parts = MODEL.parts(sensor(chip, range_=range_))
    for printed in sheet:
        if not printed.sigma:
            continue
        recipe = parts[printed.effect].effects[printed.effect][0]
        figure = next(figure for key, figure in recipe.items() if key.startswith(printed.parameter))
        for axis in printed.axes:
            spread = figure[axis] if isinstance(figure, tuple) else figure
            assert isinstance(spread, Spread), printed
            stated = spread.mean, spread.sigma, spread.reach
            assert stated == pytest.approx((0, printed.sigma, printed.limit), rel=1e-4), printed
            assert spread.shared == 0, printed


GAUSS_L = (0.88, 1.3, 1.9, 2.5, 4.0, 4.7, 5.6, 8.1)
GAUSS = (0.9, 1.2, 1.9, 2.5, 4.0, 4.6, 5.5, 7.9)
BMA117 = {1: 0.15, 1.5: 0.15, 2: 0.15, 3: 0.25, 4: 0.25, 8: 0.75, 16: 0.75}

RATIOS = {
    ("adxl345", "nonlinearity", "quadratic"): {2: 1 / 2, 4: 1 / 4, 8: 1 / 8, 16: 1 / 16},  # ADX-65
    ("adxl345", "bias", "offset"): dict.fromkeys((2, 4, 8, 16), 1.0),
    ("bma180", "scale", "error"): {1: 2, 1.5: 2, 2: 1.5, 3: 2, 4: 2, 8: 2.5, 16: 3},  # BMA-70 ... BMA-76
    ("bma180", "nonlinearity", "quadratic"): {range_: share / range_ for range_, share in BMA117.items()},
    ("bma180", "bias", "offset"): dict.fromkeys((1, 1.5, 2, 3, 4), 1.0),  # BMA-113
    ("l3g4200d", "bias", "offset"): {250: 10, 500: 15, 2000: 75},  # L3G-70
    ("l3g4200d", "thermal_bias", "slope"): {250: 0.03, 500: 0.04, 2000: 0.04},  # L3G-71
    ("l3g4200d", "nonlinearity", "quadratic"): {250: 1 / 250, 500: 1 / 500, 2000: 1 / 2000},  # L3G-73
    # HMC-54: over +-2 gauss, or over the range where that is less; HMC-56
    ("hmc5883l", "nonlinearity", "quadratic"): {r: r / min(r, 2) ** 2 for r in GAUSS_L},
    ("hmc5883", "nonlinearity", "quadratic"): {r: r / min(r, 2) ** 2 for r in GAUSS},
    ("hmc5883l", "misalignment", "angles_deg"): {r: degrees(atan(0.002 * r)) for r in GAUSS_L},
    ("hmc5883", "misalignment", "angles_deg"): {r: degrees(atan(0.002 * r)) for r in GAUSS},
}


@pytest.mark.parametrize(("key", "figures"), RATIOS.items(), ids=["-".join(key[:2]) for key in RATIOS])
def test_ranges_differ_as_in_the_data_sheet(
    sensor: MakeSensor, key: tuple[str, str, str], figures: dict[float, float]
) -> None:
    """A unit draws the same deviate at every range, so that its values are in the ratio of the printed figures."""
    chip, effect, parameter = key
    at = {range_: drawn(sensor(chip, range_=float(range_)), effect, parameter, 1) for range_ in figures}
    base_range, base = next(iter(figures.items()))
    for range_, figure in figures.items():
        assert at[range_] == pytest.approx(at[base_range] * figure / base, rel=2e-4)


@pytest.mark.slow
def test_the_bma180s_offset_shifts_at_8_and_16_g(sensor: MakeSensor) -> None:
    """BMA-79: by up to 400 mg from that at 2 g, where the chip was trimmed; two sigma again, at 4.4 sigma."""
    shifts = []
    for unit in range(UNITS):
        low, mid, high = (drawn(sensor("bma180", range_=range_), "bias", "offset", unit) for range_ in (2.0, 8.0, 16.0))
        assert mid.tolist() == high.tolist()
        shifts.append(high - low)
    assert np.abs(shifts).max() <= 0.4
    assert np.std(shifts) == pytest.approx(0.2 * truncnorm(-2, 2).std(), rel=4.4 / sqrt(6 * UNITS))


@pytest.mark.parametrize(
    ("chip", "settings", "expected"),
    [
        ("adxl345", {"rate_hz": 100.0}, (0.75 / 256, 0.75 / 256, 1.1 / 256)),  # ADX-67
        ("adxl345", {"rate_hz": 400.0}, (1.5 / 256, 1.5 / 256, 2.2 / 256)),  # ADX-68
        ("bma180", {"bandwidth_hz": 150.0}, (150e-6 * sqrt(150),) * 3),  # BMA-110
        ("bma180", {"bandwidth_hz": 1200.0}, (150e-6 * sqrt(1200),) * 3),
        ("mpu9250_acc", {"bandwidth_hz": 20.0}, (300e-6 * sqrt(20),) * 3),  # INV-80
        ("mpu9250_gyro", {"bandwidth_hz": 92.0}, (0.01 * sqrt(92),) * 3),  # INV-90
        ("icm42688_acc", {"bandwidth_hz": 100.0}, (70e-6 * sqrt(100),) * 3),  # TDK-50
        ("icm42688_gyro", {"bandwidth_hz": 25.0}, (2.8e-3 * sqrt(25),) * 3),  # TDK-60
        ("lsm6dso_acc", {"range_": 16.0, "bandwidth_hz": 208.0}, (110e-6 * sqrt(208),) * 3),  # LSM-52
        ("lsm6dso_gyro", {"bandwidth_hz": 33.0}, (3.8e-3 * sqrt(33),) * 3),  # LSM-62
        ("l3g4200d", {"bandwidth_hz": 50.0}, (0.03 * sqrt(50),) * 3),  # L3G-74
        ("l3g4200d", {"bandwidth_hz": 110.0}, (0.315,) * 3),
        ("hmc5883l", {"range_": 0.88}, (2.1e-3,) * 3),  # HMC-53
        ("hmc5883l", {"range_": 8.1}, (2.8e-3,) * 3),
        ("hmc5883", {"range_": 1.9}, (10e-3,) * 3),
        ("lis3mdl", {"range_": 16.0}, (3.2e-3, 3.2e-3, 4.1e-3)),  # LIS-21
        ("mmc5983", {"bandwidth_hz": 100.0}, (0.4e-3,) * 3),  # MMC-20
        ("mmc5983", {"bandwidth_hz": 400.0}, (0.8e-3,) * 3),
    ],
)
def test_noise_is_that_of_the_data_sheet(
    sensor: MakeSensor, chip: str, settings: dict[str, float], expected: tuple[float, ...]
) -> None:
    assert drawn(sensor(chip, **settings), "white_noise", "rms", 1) == pytest.approx(expected, rel=2e-3)


EVERYWHERE = {"own_clock", "thermal_scale", "nonlinearity", "white_noise"}
ALSO = {
    "adxl345": {"misalignment", "scale", "bias", "thermal_bias"},
    "bma180": {"misalignment", "scale", "bias", "thermal_bias", "thermometer"},
    "l3g4200d": {"bias", "thermal_bias"},  # scale, alignment, g-sensitivity: not specified (L3G-75, L3G-76)
    "mpu6050_acc": {"misalignment", "scale", "bias", "thermal_bias", "thermometer"},
    "mpu6050_gyro": {"misalignment", "scale", "bias", "thermal_bias", "thermometer", "g_sensitivity"},
    "mpu6500_acc": {"misalignment", "scale", "bias", "thermal_bias"},
    "mpu6500_gyro": {"misalignment", "scale", "bias", "thermal_bias"},
    "mpu9250_acc": {"misalignment", "scale", "bias", "thermal_bias"},
    "mpu9250_gyro": {"misalignment", "scale", "bias", "thermal_bias"},
    "icm42688_acc": {"misalignment", "scale", "bias", "thermal_bias", "thermometer"},
    "icm42688_gyro": {"misalignment", "scale", "bias", "thermal_bias", "thermometer"},
    "lsm6dso_acc": {"scale", "bias", "thermal_bias", "thermometer"},
    "lsm6dso_gyro": {"scale", "bias", "thermal_bias", "thermometer"},
    "hmc5883l": {"misalignment", "scale"},  # offset: removed by set and reset (HMC-58)
    "hmc5883": {"misalignment", "scale"},
    "lis3mdl": {"bias"},
    "mmc5983": {"bias", "scale"},
    "ak8963": {"bias", "scale"},
    "ak8975": {"bias", "scale"},
}


UNPRINTED = {
    "lsm6dso_acc": {"nonlinearity"},
    "lsm6dso_gyro": {"nonlinearity"},
    "lis3mdl": {"thermal_scale"},
    "mmc5983": {"thermal_scale"},
    "ak8963": {"thermal_scale", "nonlinearity", "white_noise"},
    "ak8975": {"thermal_scale", "nonlinearity", "white_noise"},
}
"""What the others print, and these do not."""


def test_every_clock_starts_anew_at_each_boot_and_only_that_of_bosch_has_a_tolerance(sensor: MakeSensor) -> None:
    """BMA-107; for the others none is printed. The clock of no chip waits for a poll."""
    for chip in TRIADS:
        effects = MODEL.effects(sensor(chip), Streams(3))
        clock = next((effect for effect in effects if isinstance(effect, OwnClock)), None)
        assert clock is not None, f"no own_clock in a [[design]] of {chip} in configs/models/datasheet.toml"
        assert isnan(clock.phase_deg)
        assert (clock.rate_error != 0) == (chip == "bma180")


def test_every_chip_and_range_has_exactly_the_printed_effects(sensor: MakeSensor) -> None:
    assert set(TRIADS) - set(ALSO) == set(), "no line in ALSO of this file"
    for chip, spec in TRIADS.items():
        for range_ in spec.sensitivity:
            effects = MODEL.effects(sensor(chip, range_=range_), Streams(0))
            assert {effect.name for effect in effects} == (EVERYWHERE | ALSO[chip]) - UNPRINTED.get(chip, set())
    assert not MODEL.sensors
