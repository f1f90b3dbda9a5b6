"""Imperfections of each unit: the paper's for its own array, drawn from the data sheets' tolerances for others.

Draws are keyed by (seed, name of the sensor). The tolerances of a six-axis chip stand beside its registers, in
`firmware_emulator.chips`.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from firmware_emulator import martin2013
from firmware_emulator.chip import Triple
from firmware_emulator.chips import HALVES
from firmware_emulator.element import Matrix, Unit, stream
from firmware_emulator.tolerances import Sheet, Spread, Tolerances, one_sigma, typical


def adxl345(range_g: float) -> Tolerances:
    """ADX-60 ... ADX-70, noise at 100 Hz; the same in every range."""
    return Tolerances(
        bias=(one_sigma(0.035, 0.150), one_sigma(0.035, 0.150), one_sigma(0.040, 0.250)),
        slope_per_degc=(one_sigma(0.4e-3), one_sigma(0.4e-3), one_sigma(1.2e-3)),
        scale=one_sigma(0.01, 0.10),
        cross_axis=one_sigma(0.01),
        alignment_deg=one_sigma(0.1),
        noise=(0.75 / 256, 0.75 / 256, 1.1 / 256),
        noise_full_scale=16.0,
        noise_bandwidth_hz=50.0,
        scale_slope_per_degc=one_sigma(1e-4),
    )


BMA180_NOISE_EXPONENT = math.log(17.05 / 9.53) / math.log(16 / 1.5)
"""Mean noise of the paper's six axes in mg at 16 g and at 1.5 g (Table 10); the data sheet gives 2 g alone (PAP-05)."""
BMA180_SCALE: dict[float, float] = {1: 0.02, 1.5: 0.02, 2: 0.015, 3: 0.02, 4: 0.02, 8: 0.025, 16: 0.03}
"""BMA-70 ... BMA-76."""


def bma180(range_g: float) -> Tolerances:
    """BMA-110 ... BMA-119 after soldering, and the offset shift of the 8 and 16 g ranges (BMA-79)."""
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
"""L3G-70."""


def l3g4200d(range_dps: float) -> Tolerances:
    """L3G-70 ... L3G-76; scale and alignment are not specified: within 1 % and 1 degree."""
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


def hmc5883l(range_gauss: float) -> Tolerances:
    """HMC-52 ... HMC-57; noise from 2.1 to 2.8 mG between the smallest and the largest field, unaveraged (HMC-53)."""
    return Tolerances(
        scale=typical(0.05),
        cross_axis=typical(0.002),
        alignment_deg=typical(1.0),
        noise=(2.1e-3,) * 3,
        noise_full_scale=0.88,
        noise_bandwidth_hz=80.0,
        noise_exponent=math.log(2.8 / 2.1) / math.log(8.1 / 0.88),
        scale_slope_per_degc=Spread(0.0, 0.0, mean=-0.003),
    )


def hmc5883(range_gauss: float) -> Tolerances:
    """Return the tolerances of the L, but 10 mG at 1.9 G (HMC-53) and -1.2 counts of 1024 per degC (HMC-57)."""
    return replace(
        hmc5883l(range_gauss),
        noise=(10e-3,) * 3,
        noise_full_scale=1.9,
        scale_slope_per_degc=Spread(0.0, 0.0, mean=-1.2 / 1024),
    )


def lis3mdl(_: float) -> Tolerances:
    """LIS-21; scale and alignment are not specified, and ideal."""
    return Tolerances(
        bias=(typical(1.0),) * 3,
        noise=(3.2e-3, 3.2e-3, 4.1e-3),
        noise_full_scale=12.0,
        noise_bandwidth_hz=77.5,
    )


def mmc5983(_: float) -> Tolerances:
    """MMC-20; where the bridges stand is the chip's own, alignment is left out."""
    return Tolerances(
        scale=typical(0.05),
        noise=(0.4e-3,) * 3,
        noise_full_scale=8.0,
        noise_bandwidth_hz=100.0,
    )


def ak8963(_: float) -> Tolerances:
    """AKM-17; noise of two counts is ours (DEC-233), alignment is left out."""
    return Tolerances(
        bias=(typical(0.75),) * 3,
        scale=typical(0.05),
        noise=(3e-3,) * 3,
        noise_full_scale=49.12,
        noise_bandwidth_hz=50.0,
    )


def ak8975(_: float) -> Tolerances:
    """AKM-28; noise of a count is ours (DEC-233), alignment is left out."""
    return Tolerances(
        bias=(typical(3.0),) * 3,
        scale=typical(0.05),
        noise=(3e-3,) * 3,
        noise_full_scale=12.29,
        noise_bandwidth_hz=50.0,
    )


def bmp180(_: float) -> Tolerances:
    """BMP-70, BMP-73: pressure 1 hPa low, give or take 1 hPa; temperature within 0.5 degC of the truth, 1.5 at most."""
    return replace(
        l3g4200d(0.0),
        pressure_pa=Spread(100.0, 300.0, mean=-100.0),
        thermometer_degc=Spread(0.5, 1.5),
    )


def bmp280(_: float) -> Tolerances:
    """BMP-124: pressure within 1 hPa, temperature within 0.5 degC, both typical; noise is the chip's (BMP-125)."""
    return replace(l3g4200d(0.0), pressure_pa=typical(100.0), thermometer_degc=typical(0.5))


def bmp388(_: float) -> Tolerances:
    """BMP-222: pressure within 0.5 hPa, temperature within 0.5 degC, both typical; noise is the chip's (DEC-221)."""
    return replace(l3g4200d(0.0), pressure_pa=typical(50.0), thermometer_degc=typical(0.5))


TOLERANCES: dict[str, Sheet] = {
    "adxl345": adxl345,
    "bma180": bma180,
    "l3g4200d": l3g4200d,
    "bmp180": bmp180,
    "bmp280": bmp280,
    "bmp388": bmp388,
    "hmc5883": hmc5883,
    "hmc5883l": hmc5883l,
    "lis3mdl": lis3mdl,
    "mmc5983": mmc5983,
    "ak8963": ak8963,
    "ak8975": ak8975,
} | {chip: half.sheet for chip, half in HALVES.items()}


def drawn_response(tolerances: Tolerances, random: np.random.Generator) -> Matrix:
    """Scale of each axis, a small rotation of the triad, and cross-axis sensitivity of every pair."""
    a, b, c = (math.radians(tolerances.alignment_deg.draw(random)) for _ in range(3))
    rotated = ((1.0, -c, b), (c, 1.0, -a), (-b, a, 1.0))
    rows = []
    for row in range(3):
        scale = 1.0 + tolerances.scale.draw(random)
        crossed = [0.0 if row == column else tolerances.cross_axis.draw(random) for column in range(3)]
        rows.append(tuple(scale * (rotated[row][column] + crossed[column]) for column in range(3)))
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = rows
    return (xx, xy, xz), (yx, yy, yz), (zx, zy, zz)


def drawn_triple(spread: Spread, random: np.random.Generator) -> Triple:
    """Three independent draws."""
    return spread.draw(random), spread.draw(random), spread.draw(random)


def drawn_unit(chip: str, name: str, full_scale: float, seed: int) -> Unit:
    """A part bought somewhere: drawn from the tolerances of its data sheet."""
    random = stream(seed, f"unit {name}")
    tolerances = TOLERANCES[chip](full_scale)
    bias_x, bias_y, bias_z = (spread.draw(random) for spread in tolerances.bias)
    slope_x, slope_y, slope_z = (spread.draw(random) for spread in tolerances.slope_per_degc)
    return Unit(
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


def paper_unit(name: str, seed: int) -> Unit:
    """A unit of the paper's array. What its tables don't tell (a gyroscope's scale and alignment) is drawn."""
    published = martin2013.TABLES[name]
    drawn = drawn_unit(published.chip, name, published.range, seed)
    x, y, z = (count / published.counts_per_unit for count in published.slope)
    bias = martin2013.bias_of(published)
    unit = replace(
        drawn,
        bias=bias,
        slope_per_degc=(x, y, z),
        scale_slope_per_degc=0.0,
        noise=martin2013.noise_of(published),
        noise_full_scale=published.range,
        noise_bandwidth_hz=published.bandwidth_hz,
        thermometer_offset_degc=published.thermometer_offset_degc,
    )
    if published.differences is not None:
        return replace(unit, g_sensitivity=martin2013.force_response(published, martin2013.MOUNTED[name]))
    unit = replace(unit, response=martin2013.force_response(published))
    return with_low_range_bias(unit, drawn.bias) if published.range >= unit.shift_from else unit


def with_low_range_bias(unit: Unit, low_range_bias: Triple) -> Unit:
    """The same bias at high ranges, but `low_range_bias` at low ones: the paper tells only the sum of both."""
    x, y, z = (bias - low for bias, low in zip(unit.bias, low_range_bias, strict=True))
    return replace(unit, bias=low_range_bias, shift=(x, y, z))


def unit_of(array: str, name: str, chip: str, full_scale: float, seed: int = 0) -> Unit:
    """The unit called `name` in an array of that name; a paper's unit only with the paper's chip and range."""
    published = martin2013.TABLES.get(name) if array == martin2013.NAME else None
    if published is not None and (published.chip, published.range) == (chip, float(full_scale)):
        return paper_unit(name, seed)
    return drawn_unit(chip, name, full_scale, seed)
