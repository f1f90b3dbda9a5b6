"""Imperfections of each unit: the paper's for its own array, drawn from the data sheets' tolerances for others.

Draws are keyed by (seed, name of the sensor). The tolerances of a six-axis chip are defined with its registers, in
`firmware_emulator.chips`.

x
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from firmware_emulator.chip import Triple
from firmware_emulator.chips import HALVES
from firmware_emulator.element import Matrix, UnitDeviations, product, stream, times
from firmware_emulator.tolerances import Sheet, Tolerances, TruncatedNormal, one_sigma, typical

PAPER_ARRAY = "martin2013"


@dataclass(frozen=True)
class PublishedUnit:
    """One triad of Tables 4, 8 and 10, rows x, y, z. `counts_per_unit` is the typical scale of the data sheet.

    An accelerometer's `faces` are the readings with +X, +Y, +Z, -X, -Y, -Z up; a gyroscope's `bias` and `differences`
    (Table 4) are the mean reading and its changes from +X, +Y, +Z to -X, -Y, -Z up. `step` is the step between codes
    that occur. With `thermometer_offset_degc` the thermometer has its mean of Table 10 in a room of 24 degC.
    """

    chip: str
    range: float
    counts_per_unit: float
    bandwidth_hz: float
    slope: Triple
    noise: Triple
    faces: tuple[tuple[float, ...], ...] = ()
    bias: Triple = (0.0, 0.0, 0.0)
    differences: Matrix | None = None
    step: float = 1.0
    thermometer_offset_degc: float = 0.0


ADXL345 = ("adxl345", 16.0, 256.0, 800.0)  # ADX-40; 1600 Hz, of which only even codes come (ADX-47)
BMA180_HIGH = ("bma180", 16.0, 512.0, 150.0)  # BMA-76
BMA180_LOW = ("bma180", 1.5, 5460.0, 150.0)  # BMA-71
L3G4200D_HIGH = ("l3g4200d", 2000.0, 1000 / 70, 35.0)  # L3G-42; 0.18 dps is L3G-74 over 35 Hz
L3G4200D_LOW = ("l3g4200d", 250.0, 1000 / 8.75, 35.0)  # L3G-40

TABLES: dict[str, PublishedUnit] = {
    "ADXL1": PublishedUnit(
        *ADXL345,
        slope=(-0.024, 0.019, -0.352),
        noise=(5.811277, 6.560084, 12.28892),
        faces=(
            (-253.497, 2.469027, 12.33293, 269.075, 13.12513, 2.899611),
            (13.01353, -256.075, 22.35989, 2.25853, 271.2409, -5.9701),
            (-3.95661, 4.159566, 247.2157, -11.9417, -22.4309, -262.606),
        ),
        step=2.0,
    ),
    "ADXL2": PublishedUnit(
        *ADXL345,
        slope=(-0.011, -0.067, -0.194),
        noise=(5.481664, 6.40681, 12.03305),
        faces=(
            (-253.973, 5.220675, 7.175946, 272.7924, 13.62696, 11.40376),
            (17.24602, -251.402, 14.30768, 8.269124, 275.401, 10.37481),
            (-22.7733, -18.1663, 236.3945, -15.774, -20.7224, -273.978),
        ),
        step=2.0,
    ),
    "BMA1": PublishedUnit(
        *BMA180_HIGH,
        slope=(-0.034, -0.199, 0.192),
        noise=(8.14338, 9.199038, 8.723506),
        faces=(
            (-81.7408, -604.112, -100.816, -102.087, 418.4423, -84.4824),
            (391.6477, -115.322, -134.907, -648.648, -139.155, -120.145),
            (13.09122, 7.244381, 537.0402, 10.84351, 16.37739, -515.345),
        ),
        thermometer_offset_degc=-0.47,
    ),
    "BMA2": PublishedUnit(
        *BMA180_HIGH,
        slope=(0.205, -0.258, 0.496),
        noise=(7.901824, 10.07948, 8.315939),
        faces=(
            (21.47985, 549.6836, 52.25275, 31.50906, -492.828, 3.071563),
            (425.7175, -91.8819, -86.6883, -615.501, -97.1331, -102.099),
            (69.95953, 90.44258, -451.826, 64.45256, 44.14392, 591.1872),
        ),
        thermometer_offset_degc=3.00,
    ),
    "BMA3": PublishedUnit(
        *BMA180_LOW,
        slope=(-0.548, -0.121, 4.516),
        noise=(40.04875, 51.06081, 49.97539),
        faces=(
            (144.0243, -5351.68, 515.6351, -24.0278, 5461.916, -415.383),
            (-5422.59, -77.3823, -9.89211, 5405.179, 57.58821, -21.7895),
            (20.71929, -451.205, -5522.18, -138.035, 329.0204, 5444.336),
        ),
        thermometer_offset_degc=1.76,
    ),
    "BMA4": PublishedUnit(
        *BMA180_LOW,
        slope=(0.946, -1.714, -2.235),
        noise=(46.12221, 68.80461, 56.33199),
        faces=(
            (-39.5078, 5419.983, 312.1222, 136.5785, -5306.03, -197.77),
            (-5438.93, -120.47, -66.5468, 5361.847, 47.06203, -35.0201),
            (183.5848, -161.923, 5603.323, 129.4264, 477.9277, -5340.18),
        ),
        thermometer_offset_degc=2.44,
    ),
    "Gyro1": PublishedUnit(
        *L3G4200D_HIGH,
        slope=(0.235, 0.265, 0.221),
        noise=(2.626539, 2.517964, 2.72343),
        bias=(8.389, -7.026, 12.888),
        differences=((0.006, -0.545, -0.073), (-0.160, -0.146, -0.023), (-0.094, -0.009, -0.202)),
        thermometer_offset_degc=2.15,
    ),
    "Gyro2": PublishedUnit(
        *L3G4200D_HIGH,
        slope=(0.521, 0.261, 0.187),
        noise=(2.456826, 2.432673, 3.008718),
        bias=(18.930, -4.050, 7.526),
        differences=((0.007, 0.385, -0.501), (0.236, 0.209, -0.260), (-0.221, 0.097, 0.007)),
        thermometer_offset_degc=-3.07,
    ),
    "Gyro3": PublishedUnit(
        *L3G4200D_LOW,
        slope=(0.904, 2.133, -2.782),
        noise=(19.90578, 20.25934, 19.69882),
        bias=(-10.822, 80.196, -6.116),
        differences=((-0.508, -3.315, 0.133), (1.109, 0.701, 0.694), (-0.674, -1.410, -0.206)),
        thermometer_offset_degc=3.98,
    ),
}

MOUNTED: dict[str, Matrix] = {
    "Gyro1": ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),
    "Gyro2": ((1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, -1.0)),
    "Gyro3": ((-1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, 1.0)),
}
"""Orientations of the gyroscopes by Table 1, box = matrix @ sensor; those of accelerometers follow from Table 10."""


def bias_of(published: PublishedUnit) -> Triple:
    """Return the mean of the six faces, or the bias of Table 4, in the data sheet's unit."""
    counts = [sum(row) / 6 for row in published.faces] if published.faces else published.bias
    x, y, z = (count / published.counts_per_unit for count in counts)
    return x, y, z


def force_response(published: PublishedUnit, mounted: Matrix | None = None) -> Matrix:
    """Return half the differences of opposite faces, in data-sheet units per g; rows are the measured axes, columns the
    axes of the ideal orientation.

    `mounted` is the ideal orientation, box = `mounted` @ sensor; by default the nearest one to the response, for an
    accelerometer.
    """
    rows = published.differences
    if rows is None:
        x, y, z = (tuple(up - down for up, down in zip(row[:3], row[3:], strict=True)) for row in published.faces)
        rows = (x[0], x[1], x[2]), (y[0], y[1], y[2]), (z[0], z[1], z[2])
    by_box_axis = times(rows, 0.5 / published.counts_per_unit)
    return product(by_box_axis, mounted or nearest_orientation(by_box_axis))


def nearest_orientation(by_box_axis: Matrix) -> Matrix:
    """Return the orientation along box axes, box = matrix @ sensor, that is nearest to a response."""
    columns = []
    for row in by_box_axis:
        largest = max(abs(element) for element in row)
        columns.append([math.copysign(1.0, element) if abs(element) == largest else 0.0 for element in row])
    x, y, z = zip(*columns, strict=True)
    return x, y, z


def noise_of(published: PublishedUnit) -> Triple:
    """Return the noise before the converter's rounding, in the data sheet's unit; rounding adds step**2 / 12 to the
    variance.
    """
    rounding = published.step**2 / 12
    x, y, z = (math.sqrt(rms**2 - rounding) / published.counts_per_unit for rms in published.noise)
    return x, y, z


BMA180_NOISE_EXPONENT = math.log(17.05 / 9.53) / math.log(16 / 1.5)
"""Exponent of the noise over the full scale, from the mean noise in mg of the paper's six axes at 16 g and at 1.5 g
(Table 10); the data sheet states only that at 2 g (PAP-05).
"""
BMA180_SCALE: dict[float, float] = {1: 0.02, 1.5: 0.02, 2: 0.015, 3: 0.02, 4: 0.02, 8: 0.025, 16: 0.03}
"""Relative tolerance of the scale by range in g: BMA-70 ... BMA-76."""


def bma180(range_g: float) -> Tolerances:
    """Return the tolerances BMA-110 ... BMA-119 after soldering; the 8 and 16 g ranges shift the offset (BMA-79)."""
    return Tolerances(
        bias=(typical(0.060),) * 3,
        slope_per_degc=(typical(0.5e-3),) * 3,
        scale=typical(BMA180_SCALE.get(range_g, 0.03)),
        cross_axis=typical(0.0175),
        alignment_deg=typical(1.0),
        noise=(150e-6 * math.sqrt(1200.0),) * 3,
        noise_full_scale=2.0,
        noise_bandwidth_hz=1200.0,
        noise_exponent=BMA180_NOISE_EXPONENT,
        scale_slope_per_degc=typical(1e-4),
        shift=typical(0.4),
        shift_from=8.0,
        thermometer_degc=typical(5.0),
    )


L3G4200D_BIAS_DPS: dict[float, float] = {250: 10.0, 500: 15.0, 2000: 75.0}
"""Tolerance of the bias in dps by range in dps: L3G-70."""


def l3g4200d(range_dps: float) -> Tolerances:
    """Return the tolerances L3G-70 ... L3G-76; scale and alignment are not specified and are assumed to be within 1 %
    and 1 degree.
    """
    return Tolerances(
        bias=(typical(L3G4200D_BIAS_DPS.get(range_dps, 75.0)),) * 3,
        slope_per_degc=(typical(0.03 if range_dps <= 250 else 0.04),) * 3,
        scale=typical(0.01),
        alignment_deg=typical(1.0),
        noise=(0.03 * math.sqrt(50.0),) * 3,
        noise_full_scale=range_dps,
        noise_bandwidth_hz=50.0,
        g_sensitivity=typical(0.02),
    )


_HMC5883L = Tolerances(
    scale=typical(0.05),
    cross_axis=typical(0.002),
    alignment_deg=typical(1.0),
    noise=(2.1e-3,) * 3,
    noise_full_scale=0.88,
    noise_bandwidth_hz=80.0,
    noise_exponent=math.log(2.8 / 2.1) / math.log(8.1 / 0.88),
    scale_slope_per_degc=TruncatedNormal(0.0, 0.0, mean=-0.003),
)
"""Tolerances HMC-52 ... HMC-57; the noise without averaging is 2.1 mG in the smallest and 2.8 mG in the largest range
(HMC-53).
"""

TOLERANCES: dict[str, Sheet] = {
    # ADX-60 ... ADX-70, noise at 100 Hz; the same in every range
    "adxl345": Tolerances(
        bias=(one_sigma(0.035, 0.150), one_sigma(0.035, 0.150), one_sigma(0.040, 0.250)),
        slope_per_degc=(one_sigma(0.4e-3), one_sigma(0.4e-3), one_sigma(1.2e-3)),
        scale=one_sigma(0.01, 0.10),
        cross_axis=one_sigma(0.01),
        alignment_deg=one_sigma(0.1),
        noise=(0.75 / 256, 0.75 / 256, 1.1 / 256),
        noise_full_scale=16.0,
        noise_bandwidth_hz=50.0,
        scale_slope_per_degc=one_sigma(1e-4),
    ),
    "bma180": bma180,
    "l3g4200d": l3g4200d,
    # BMP-70, BMP-73: pressure 1 hPa low, +-1 hPa; temperature within 0.5 degC, 1.5 at most
    "bmp180": replace(
        l3g4200d(0.0),
        pressure_pa=TruncatedNormal(100.0, 300.0, mean=-100.0),
        thermometer_degc=TruncatedNormal(0.5, 1.5),
    ),
    # BMP-124: pressure within 1 hPa, temperature within 0.5 degC, both typical; noise is the chip's (BMP-125)
    "bmp280": replace(l3g4200d(0.0), pressure_pa=typical(100.0), thermometer_degc=typical(0.5)),
    # BMP-222: pressure within 0.5 hPa, temperature within 0.5 degC, both typical; noise is the chip's (DEC-221)
    "bmp388": replace(l3g4200d(0.0), pressure_pa=typical(50.0), thermometer_degc=typical(0.5)),
    # those of the L, but 10 mG at 1.9 G (HMC-53) and -1.2 counts of 1024 per degC (HMC-57)
    "hmc5883": replace(
        _HMC5883L,
        noise=(10e-3,) * 3,
        noise_full_scale=1.9,
        scale_slope_per_degc=TruncatedNormal(0.0, 0.0, mean=-1.2 / 1024),
    ),
    "hmc5883l": _HMC5883L,
    # LIS-21; scale and alignment are not specified, and ideal
    "lis3mdl": Tolerances(
        bias=(typical(1.0),) * 3,
        noise=(3.2e-3, 3.2e-3, 4.1e-3),
        noise_full_scale=12.0,
        noise_bandwidth_hz=77.5,
    ),
    # MMC-20; the offset of the bridges is the chip's own, alignment is not modelled
    "mmc5983": Tolerances(
        scale=typical(0.05),
        noise=(0.4e-3,) * 3,
        noise_full_scale=8.0,
        noise_bandwidth_hz=100.0,
    ),
    # AKM-17; noise of two counts is our assumption (DEC-233), alignment is not modelled
    "ak8963": Tolerances(
        bias=(typical(0.75),) * 3,
        scale=typical(0.05),
        noise=(3e-3,) * 3,
        noise_full_scale=49.12,
        noise_bandwidth_hz=50.0,
    ),
    # AKM-28; noise of a count is our assumption (DEC-233), alignment is not modelled
    "ak8975": Tolerances(
        bias=(typical(3.0),) * 3,
        scale=typical(0.05),
        noise=(3e-3,) * 3,
        noise_full_scale=12.29,
        noise_bandwidth_hz=50.0,
    ),
    **{chip: half.sheet for chip, half in HALVES.items()},
}


def tolerances_of(chip: str, full_scale: float) -> Tolerances:
    """Return the tolerances of a chip at a measuring range. ValueError for a chip without an entry in `TOLERANCES`."""
    if chip not in TOLERANCES:
        known = ", ".join(TOLERANCES)
        raise ValueError(f"chip {chip!r} has no entry in firmware_emulator.units.TOLERANCES, which has {known}")
    sheet = TOLERANCES[chip]
    return sheet if isinstance(sheet, Tolerances) else sheet(full_scale)


def drawn_response(tolerances: Tolerances, random: np.random.Generator) -> Matrix:
    """Return the scale of each axis, a small rotation of the triad, and the cross-axis sensitivity of every pair."""
    a, b, c = (math.radians(tolerances.alignment_deg.draw(random)) for _ in range(3))
    rotated = ((1.0, -c, b), (c, 1.0, -a), (-b, a, 1.0))
    rows = []
    for row in range(3):
        scale = 1.0 + tolerances.scale.draw(random)
        crossed = [0.0 if row == column else tolerances.cross_axis.draw(random) for column in range(3)]
        rows.append(tuple(scale * (rotated[row][column] + crossed[column]) for column in range(3)))
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = rows
    return (xx, xy, xz), (yx, yy, yz), (zx, zy, zz)


def drawn_triple(tolerance: TruncatedNormal, random: np.random.Generator) -> Triple:
    """Draw three independent values."""
    return tolerance.draw(random), tolerance.draw(random), tolerance.draw(random)


def drawn_unit(chip: str, name: str, full_scale: float, seed: int) -> UnitDeviations:
    """Return a part like a purchased one: it is drawn from the tolerances of its data sheet."""
    random = stream(seed, f"unit {name}")
    tolerances = tolerances_of(chip, full_scale)
    bias_x, bias_y, bias_z = (tolerance.draw(random) for tolerance in tolerances.bias)
    slope_x, slope_y, slope_z = (tolerance.draw(random) for tolerance in tolerances.slope_per_degc)
    return UnitDeviations(
        bias=(bias_x, bias_y, bias_z),
        slope_per_degc=(slope_x, slope_y, slope_z),
        response=drawn_response(tolerances, random),
        scale_slope_per_degc=tolerances.scale_slope_per_degc.draw(random),
        noise=tolerances.noise,
        noise_full_scale=tolerances.noise_full_scale,
        noise_bandwidth_hz=tolerances.noise_bandwidth_hz,
        noise_exponent=tolerances.noise_exponent,
        shift=drawn_triple(tolerances.shift, random),
        shift_from=tolerances.shift_from,
        g_sensitivity=(
            drawn_triple(tolerances.g_sensitivity, random),
            drawn_triple(tolerances.g_sensitivity, random),
            drawn_triple(tolerances.g_sensitivity, random),
        ),
        thermometer_offset_degc=tolerances.thermometer_degc.draw(random),
        pressure_offset_pa=tolerances.pressure_pa.draw(random),
    )


def paper_unit(name: str, seed: int) -> UnitDeviations:
    """Return a unit of the paper's array. Properties that are not in its tables (a gyroscope's scale and alignment) are
    drawn.
    """
    published = TABLES[name]
    drawn_part = drawn_unit(published.chip, name, published.range, seed)
    x, y, z = (count / published.counts_per_unit for count in published.slope)
    bias = bias_of(published)
    unit = replace(
        drawn_part,
        bias=bias,
        slope_per_degc=(x, y, z),
        scale_slope_per_degc=0.0,
        noise=noise_of(published),
        noise_full_scale=published.range,
        noise_bandwidth_hz=published.bandwidth_hz,
        thermometer_offset_degc=published.thermometer_offset_degc,
    )
    if published.differences is not None:
        return replace(unit, g_sensitivity=force_response(published, MOUNTED[name]))
    unit = replace(unit, response=force_response(published))
    return with_low_range_bias(unit, drawn_part.bias) if published.range >= unit.shift_from else unit


def with_low_range_bias(unit: UnitDeviations, low_range_bias: Triple) -> UnitDeviations:
    """Return the unit with `low_range_bias` at low ranges and the same bias as before at high ones, because the paper
    states only the sum of bias and shift.
    """
    x, y, z = (bias - low for bias, low in zip(unit.bias, low_range_bias, strict=True))
    return replace(unit, bias=low_range_bias, shift=(x, y, z))


def unit_of(array: str, name: str, chip: str, full_scale: float, seed: int = 0) -> UnitDeviations:
    """Return the unit called `name` in an array of that name; it is a unit of the paper only if chip and range are also
    those of the paper.
    """
    published = TABLES.get(name) if array == PAPER_ARRAY else None
    if published is not None and (published.chip, published.range) == (chip, float(full_scale)):
        return paper_unit(name, seed)
    return drawn_unit(chip, name, full_scale, seed)
