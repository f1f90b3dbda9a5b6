"""Imperfections: the paper's own for its array, tolerances of the data sheets for every other part."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace
from statistics import fmean, pstdev

import pytest

from firmware_emulator.chips.adxl345 import Adxl345Chip
from firmware_emulator.clock import VirtualClock
from firmware_emulator.element import IDENTITY, ZERO, Matrix, SensingElement, UnitDeviations
from firmware_emulator.units import TABLES, TOLERANCES, unit_of
from firmware_emulator.wire import Wire
from firmware_emulator.world import StillWorld, WorldStimulus

UPS = ("+X", "+Y", "+Z", "-X", "-Y", "-Z")
ORIENTATIONS: dict[str, Matrix] = {  # Table 1 with finding of Table 10: box = matrix @ sensor
    "ADXL1": ((-1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, 1.0)),
    "Gyro1": IDENTITY,
    "Gyro2": ((1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, -1.0)),
    "BMA1": ((0.0, 1.0, 0.0), (-1.0, 0.0, 0.0), (0.0, 0.0, 1.0)),
    "BMA2": ((0.0, 1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, -1.0)),
}


def noiseless(name: str, chip: str, full_scale: float, up: str, degc: float = 25.0) -> tuple[float, float, float]:
    """Converter input of a paper's unit, with its noise taken away."""
    unit = replace(unit_of("martin2013", name, chip, full_scale), noise=ZERO)
    element = SensingElement(StillWorld(up, degc), chip, name, ORIENTATIONS[name], unit)
    return element.sample(0, full_scale, 100.0)


def adxl1_readings(up: str, count: int) -> list[list[int]]:
    """Codes x, y, z of the paper's ADXL1 at 16 g, full resolution and 1600 Hz, every conversion read once."""
    unit = unit_of("martin2013", "ADXL1", "adxl345", 16)
    clock = VirtualClock()
    wire = Wire(clock)
    wire.connect(
        Adxl345Chip(0x53, SensingElement(StillWorld(up), "adxl345", "ADXL1", ORIENTATIONS["ADXL1"], unit, seed=7))
    )
    for pair in (b"\x31\x0b", b"\x2c\x0e", b"\x2d\x08"):
        wire.transfer(0x53, pair)
    codes: list[list[int]] = [[], [], []]
    clock.sleep_until(3_000_000)
    for index in range(count):
        clock.sleep_until(3_000_000 + index * 625_000)
        data = wire.transfer(0x53, b"\x32", 6)
        for axis in range(3):
            codes[axis].append(int.from_bytes(data[2 * axis : 2 * axis + 2], "little", signed=True))
    return codes


TABLE_10_ADXL1 = {  # mean with each face up, x y z
    "+Z": (12.33293, 22.35989, 247.2157),
    "+X": (-253.497, 13.01353, -3.95661),
    "+Y": (2.469027, -256.075, 4.159566),
    "-X": (269.075, 2.25853, -11.9417),
    "-Y": (13.12513, 271.2409, -22.4309),
    "-Z": (2.899611, -5.9701, -262.606),
}
ADXL1_STD = (5.811277, 6.560084, 12.28892)
TABLE_3_ADXL1 = ((7.734, 261.38), (7.805, 264.09), (-8.260, 255.29))  # bias, size of the scale factor


def test_the_papers_readings_of_adxl1_are_reproduced() -> None:
    """18 face means, 3 biases, 3 scales, 3 deviations, each at 4.4 sigma: one false alarm in 3500 seeds."""
    count = 3000
    readings = {up: adxl1_readings(up, count) for up in UPS}
    means = {up: [fmean(axis) for axis in codes] for up, codes in readings.items()}
    unevenness = (0.12, 0.39, 0.88)  # by how much the printed pairs of faces disagree about the bias
    for axis in range(3):
        error = ADXL1_STD[axis] / math.sqrt(count)
        for up in UPS:
            assert means[up][axis] == pytest.approx(TABLE_10_ADXL1[up][axis], abs=unevenness[axis] + 4.4 * error)
        bias, scale = TABLE_3_ADXL1[axis]
        assert fmean(means[up][axis] for up in UPS) == pytest.approx(bias, abs=4.4 * error / math.sqrt(6) + 0.001)
        halves = [(means[up][axis] - means[down][axis]) / 2 for up, down in zip(UPS[:3], UPS[3:], strict=True)]
        assert math.hypot(*halves) == pytest.approx(scale, abs=4.4 * error / math.sqrt(2) + 0.01)
        spread = math.sqrt(fmean(pstdev(readings[up][axis]) ** 2 for up in UPS))
        assert spread == pytest.approx(ADXL1_STD[axis], rel=4.4 / math.sqrt(2 * 6 * count))


TABLE_3_SCALES = {
    "ADXL1": (261.38, 264.09, 255.29),
    "ADXL2": (263.42, 263.45, 255.21),
    "BMA1": (511.44, 520.34, 526.21),
    "BMA2": (521.86, 520.67, 522.03),
    "BMA3": (5427.45, 5414.31, 5497.69),
    "BMA4": (5369.79, 5401.06, 5481.16),
}
TABLE_3_BIASES_MG = {
    "ADXL1": (30.2, 30.5, -32.3),
    "ADXL2": (36.6, 48.3, -74.9),
    "BMA1": (-180.6, -249.5, 22.5),
    "BMA2": (53.8, -184.8, 132.9),
    "BMA3": (10.1, -2.1, -9.7),
    "BMA4": (9.9, -7.7, 27.2),
}


@pytest.mark.parametrize("name", TABLE_3_SCALES)
def test_accelerometers_have_table_3s_scale_and_bias(name: str) -> None:
    published = TABLES[name]
    unit = unit_of("martin2013", name, published.chip, published.range)
    lengths = [math.hypot(*row) * published.counts_per_unit for row in unit.response]
    assert lengths == pytest.approx(TABLE_3_SCALES[name], abs=0.006)
    total = [1000 * (a + b) for a, b in zip(unit.bias, unit.shift, strict=True)]
    bias_mg = total if published.range >= unit.shift_from else [1000 * a for a in unit.bias]
    assert bias_mg == pytest.approx(TABLE_3_BIASES_MG[name], abs=0.06)
    for axis in range(3):  # mounted right: within 6 degrees of its own axis
        assert unit.response[axis][axis] * published.counts_per_unit > 0.99 * lengths[axis]


def test_bma2_has_the_readings_of_table_10() -> None:
    """Table 10: x is largest with +Y up, y with +X up, z smallest with +Z up."""
    up = {face: noiseless("BMA2", "bma180", 16, face) for face in UPS}
    halves = [
        [512 * (up[a][axis] - up[b][axis]) / 2 for a, b in zip(UPS[:3], UPS[3:], strict=True)] for axis in range(3)
    ]
    assert halves[0] == pytest.approx([(21.47985 - 31.50906) / 2, (549.6836 + 492.828) / 2, (52.25275 - 3.071563) / 2])
    assert halves[1] == pytest.approx([(425.7175 + 615.501) / 2, (97.1331 - 91.8819) / 2, (102.099 - 86.6883) / 2])
    assert halves[2] == pytest.approx([(69.95953 - 64.45256) / 2, (90.44258 - 44.14392) / 2, (-451.826 - 591.1872) / 2])


def test_bma1_has_the_readings_of_table_10() -> None:
    """Its matrix is not its own inverse: x points along -Y, y along +X (Table 10)."""
    x_up, x_down, y_up, y_down = (noiseless("BMA1", "bma180", 16, face) for face in ("+X", "-X", "+Y", "-Y"))
    assert 512 * (y_up[0] - y_down[0]) == pytest.approx(-604.112 - 418.4423)
    assert 512 * (x_up[1] - x_down[1]) == pytest.approx(391.6477 + 648.648)


def test_gyros_have_table_4s_bias_and_g_sensitivity() -> None:
    for name, bias, differences in (
        ("Gyro1", (8.389, -7.026, 12.888), {"X": (0.006, -0.160, -0.094), "Y": (-0.545, -0.146, -0.009)}),
        ("Gyro2", (18.930, -4.050, 7.526), {"X": (0.007, 0.236, -0.221), "Z": (-0.501, -0.260, 0.007)}),
    ):
        for axis, expected in differences.items():
            up, down = (noiseless(name, "l3g4200d", 2000, sign + axis) for sign in "+-")
            assert [(a - b) / 0.070 for a, b in zip(up, down, strict=True)] == pytest.approx(expected, abs=1e-9)
            assert [(a + b) / 0.140 for a, b in zip(up, down, strict=True)] == pytest.approx(bias, abs=1e-9)


def test_temperature_slopes_are_table_8s() -> None:
    warm, cold = (noiseless("Gyro1", "l3g4200d", 2000, "+Z", degc) for degc in (45.0, 25.0))
    assert [(a - b) / 20 / 0.070 for a, b in zip(warm, cold, strict=True)] == pytest.approx((0.235, 0.265, 0.221))


def test_noise_of_the_papers_gyro_at_110_hz_is_table_9s() -> None:
    unit = unit_of("martin2013", "Gyro1", "l3g4200d", 2000)
    element = SensingElement(StillWorld(), "l3g4200d", "Gyro1", IDENTITY, unit, seed=3)
    draws = list(zip(*(element.sample(0, 2000.0, 110.0) for _ in range(20_000)), strict=True))
    assert [pstdev(axis) for axis in draws] == pytest.approx((0.3258, 0.3171, 0.3278), rel=0.05)


def test_noise_of_the_bma180_grows_with_the_range() -> None:
    unit = unit_of("other", "A", "bma180", 2)
    element = SensingElement(StillWorld(), "bma180", "A", IDENTITY, unit)
    rms = {}
    for full_scale, bandwidth in ((2.0, 1200.0), (16.0, 1200.0), (2.0, 300.0), (1.5, 1200.0)):
        x = [element.sample(0, full_scale, bandwidth)[0] for _ in range(20_000)]
        rms[full_scale, bandwidth] = 1000 * pstdev(x)
    assert rms[2.0, 1200.0] == pytest.approx(5.196, rel=0.025)  # BMA-110, in mg
    assert rms[2.0, 300.0] == pytest.approx(2.598, rel=0.025)
    assert rms[16.0, 1200.0] / rms[1.5, 1200.0] == pytest.approx(17.05 / 9.53, rel=0.05)


def test_a_bma180_outside_the_papers_range_has_no_shift() -> None:
    at_16_g = noiseless("BMA2", "bma180", 16, "+Z")
    unit = replace(unit_of("martin2013", "BMA2", "bma180", 16), noise=ZERO)
    at_2_g = SensingElement(StillWorld(), "bma180", "BMA2", ORIENTATIONS["BMA2"], unit).sample(0, 2.0, 100.0)
    assert max(abs(a - b) for a, b in zip(at_16_g, at_2_g, strict=True)) > 0.05
    assert all(abs(bias) <= 0.060 for bias in unit.bias)  # BMA-113


LIMITS = {  # bias, and scale error of the diagonal
    ("adxl345", 16.0): ((0.150, 0.150, 0.250), 0.10),
    ("bma180", 1.5): ((0.060,) * 3, 0.02),
    ("bma180", 16.0): ((0.060,) * 3, 0.03),
    ("l3g4200d", 250.0): ((10.0,) * 3, 0.01),
    ("l3g4200d", 2000.0): ((75.0,) * 3, 0.01),
    ("hmc5883l", 1.3): ((0.0,) * 3, 0.05),
}


@pytest.mark.parametrize(("chip", "full_scale"), LIMITS)
def test_drawn_units_keep_the_tolerances(chip: str, full_scale: float) -> None:
    units = [unit_of("mine", f"S{index}", chip, full_scale, seed=1) for index in range(400)]
    biases, scale = LIMITS[chip, full_scale]
    for axis, limit in enumerate(biases):
        drawn = [unit.bias[axis] for unit in units]
        assert max(map(abs, drawn)) <= limit
        assert len(set(drawn)) == (400 if limit else 1)
    errors = [unit.response[axis][axis] - 1 for unit in units for axis in range(3)]
    assert max(map(abs, errors)) <= scale
    assert max(map(abs, errors)) > 0.25 * scale


@pytest.mark.slow
def test_spread_of_drawn_biases() -> None:
    """sigma = typ / 2 cut off at 2 sigma has a standard deviation of 0.880 sigma (DEC-51); 3 % is 4.4 sigma of it."""
    biases = [bias for index in range(3600) for bias in unit_of("mine", f"S{index}", "bma180", 2.0).bias]
    assert pstdev(biases) == pytest.approx(0.030 * 0.8796, rel=0.03)
    assert fmean(biases) == pytest.approx(0.0, abs=4.4 * 0.0264 / math.sqrt(len(biases)))


def test_units_are_the_papers_only_where_array_name_and_range_match() -> None:
    paper = unit_of("martin2013", "BMA3", "bma180", 1.5)
    assert paper.response[2][2] == pytest.approx(1.0042, abs=0.001)  # 5483 counts of 5460
    for array, name, full_scale in (("mine", "BMA3", 1.5), ("martin2013", "BMA9", 1.5), ("martin2013", "BMA3", 2.0)):
        assert unit_of(array, name, "bma180", full_scale).bias != paper.bias


def test_draws_are_keyed_by_seed_and_name() -> None:
    first = unit_of("mine", "A", "bma180", 2.0, seed=5)
    assert unit_of("mine", "A", "bma180", 2.0, seed=5) == first
    assert unit_of("mine", "B", "bma180", 2.0, seed=5) != first
    assert unit_of("mine", "A", "bma180", 2.0, seed=6) != first


def test_every_chip_has_tolerances() -> None:
    for chip in TOLERANCES:
        assert unit_of("mine", "A", chip, 2.0) is not None
    barometers = [unit_of("mine", f"P{index}", "bmp180", 0.0) for index in range(300)]
    assert fmean(unit.pressure_offset_pa for unit in barometers) == pytest.approx(
        -100.0, abs=4.4 * 100 / math.sqrt(300)
    )
    assert all(-400.0 <= unit.pressure_offset_pa <= 200.0 for unit in barometers)  # BMP-70
    barometers = [unit_of("mine", f"P{index}", "bmp280", 0.0) for index in range(300)]
    assert fmean(unit.pressure_offset_pa for unit in barometers) == pytest.approx(0.0, abs=4.4 * 50 / math.sqrt(300))
    assert all(abs(unit.pressure_offset_pa) <= 100.0 for unit in barometers)  # BMP-124
    assert all(abs(unit.thermometer_offset_degc) <= 0.5 for unit in barometers)


def test_a_chip_without_tolerances_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delitem(TOLERANCES, "bmp280")
    with pytest.raises(
        ValueError, match=r"^chip 'bmp280' has no entry in firmware_emulator.units.TOLERANCES, which has adxl"
    ):
        unit_of("lab", "P", "bmp280", 0.0)


def test_noise_is_keyed_and_independent_of_the_input() -> None:
    unit = UnitDeviations(noise=(1.0, 1.0, 1.0))
    streams = [
        SensingElement(StillWorld(), "adxl345", name, IDENTITY, unit, seed)
        for name, seed in (("A", 1), ("A", 1), ("B", 1))
    ]
    first, same, other = ([element.sample(0, 1.0, 1.0) for _ in range(3000)] for element in streams)
    assert first == same
    assert first != other
    x = [sample[0] for sample in first]
    lag_one = fmean(a * b for a, b in itertools.pairwise(x))
    assert abs(lag_one) < 4.4 / math.sqrt(3000)  # white
    assert len(set(x)) == 3000


def test_temperature_scales_the_magnetometer() -> None:
    unit = UnitDeviations(scale_slope_per_degc=-0.003, slope_per_degc=(0.01, 0.0, 0.0), bias=(0.0, 0.1, 0.0))
    element = SensingElement(lambda at_ns: WorldStimulus(temperature_degc=35.0), "hmc5883l", "H", IDENTITY, unit)
    assert element.sample(0, 1.3, 80.0) == pytest.approx((0.2 * 0.97 + 0.1, 0.1, -0.43 * 0.97))


def test_thermometer_and_barometer_have_offsets() -> None:
    unit = UnitDeviations(thermometer_offset_degc=1.5, pressure_offset_pa=-100.0)
    element = SensingElement(StillWorld(temperature_degc=30.0), "bmp180", "P", IDENTITY, unit)
    assert element.temperature(0) == 31.5
    assert element.pressure(0) == 101225.0
