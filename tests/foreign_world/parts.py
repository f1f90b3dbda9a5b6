"""Facts of the chips and the draw of a part within its data sheet's tolerance.

All numbers are from the data sheets' tables (identifiers such as BMA-64 in comments). Where a data sheet gives a
typical value only, a part is drawn from a normal distribution whose sigma is half of it, truncated at it (DEC-51).
Inside, specific force is in m/s2, angular rate in rad/s, magnetic flux density in gauss.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Generator = np.random.Generator

G = 9.80665
DPS = np.pi / 180
SI = {"g": G, "dps": DPS, "gauss": 1.0}
"""SI value of the unit in which a range is given."""


@dataclass(frozen=True)
class Chip:
    """What all parts of one design share. `sensitivity` maps a range to counts per unit."""

    quantity: str
    unit: str
    sensitivity: dict[float, float]
    code_low: int
    code_high: int
    rates_hz: tuple[float, ...]
    bandwidths_hz: tuple[float, ...]
    addresses: tuple[int, ...]
    clock_tolerance: float
    thermometer: str = ""


CHIPS = {
    "bma180": Chip(
        "specific_force",
        "g",
        {1: 8192, 1.5: 5460, 2: 4096, 3: 2730, 4: 2048, 8: 1024, 16: 512},  # BMA-70 to BMA-76
        -8192,  # BMA-60
        8191,
        (2400,),  # BMA-93
        (10, 20, 40, 75, 150, 300, 600, 1200),
        (0x40, 0x41),
        0.10,  # BMA-107
        "bma180",
    ),
    "adxl345": Chip(
        "specific_force",
        "g",
        {2: 256, 4: 256, 8: 256, 16: 256},  # ADX-40, full resolution
        -4096,
        4095,
        (25, 50, 100, 200, 400, 800),  # ADX-34, ADX-35; above 800 Hz is not for I2C (ADX-06)
        (),
        (0x53, 0x1D),
        0.02,  # none is given; a trimmed RC oscillator
    ),
    "l3g4200d": Chip(
        "angular_rate",
        "dps",
        {250: 1 / 0.00875, 500: 1 / 0.0175, 2000: 1 / 0.07},  # L3G-40 to L3G-42
        -32768,
        32767,
        (100, 200, 400, 800),
        (12.5, 20, 25, 30, 35, 50, 70, 110),
        (0x68, 0x69),
        0.03,  # none is given
        "l3g4200d",
    ),
    "hmc5883l": Chip(
        "magnetic_field",
        "gauss",
        {0.88: 1370, 1.3: 1090, 1.9: 820, 2.5: 660, 4.0: 440},  # HMC-20 to HMC-24
        -2048,
        2047,
        (15, 30, 75),
        (),
        (0x1E,),
        0.02,
    ),
}

L3G_BANDWIDTHS = {100: (12.5, 25), 200: (12.5, 25, 50, 70), 400: (20, 25, 50, 110), 800: (30, 35, 50, 110)}
"""L3G-30 to L3G-33."""
BMA_SCALE_TOLERANCE: dict[float, float] = {1: 0.02, 1.5: 0.02, 2: 0.015, 3: 0.02, 4: 0.02, 8: 0.025, 16: 0.03}
"""BMA-70 to BMA-76."""
BMA_NONLINEARITY: dict[float, float] = {1: 0.0015, 1.5: 0.0015, 2: 0.0015, 3: 0.0025, 4: 0.0025, 8: 0.0075, 16: 0.0075}
"""Share of full scale (BMA-117)."""
BMA_WIDE_NOISE = {3.0: 1.15, 4.0: 1.3, 8.0: 1.9, 16.0: 2.7}
"""Noise above that at 2 g: from 15.7 to 19.3 mg rms at 16 g in the paper (PAP-05); between them interpolated."""
L3G_ZERO_DPS = {250.0: 10.0, 500.0: 15.0, 2000.0: 75.0}
"""L3G-70."""
HMC_NOISE_GAUSS = 0.002
"""HMC-53, one average."""


@dataclass(frozen=True)
class Sensor:
    """One chip at one place, as the array's configuration tells it. `divider`: it is read in every n-th frame."""

    name: str
    chip: str
    channel: int
    address: int
    range: float
    rate_hz: float
    bandwidth_hz: float
    axes: str
    position_mm: tuple[float, float, float]
    divider: int = 1

    @property
    def facts(self) -> Chip:
        return CHIPS[self.chip]

    @property
    def sensitivity(self) -> float:
        """Counts per unit, typical."""
        return self.facts.sensitivity[self.range]

    @property
    def counts_per_si(self) -> float:
        return self.sensitivity / SI[self.facts.unit]

    @property
    def orientation(self) -> Array:
        """3x3, box = orientation @ sensor: column j is the box axis along which the sensor's axis j points."""
        matrix = np.zeros((3, 3))
        for j in range(3):
            matrix["XYZ".index(self.axes[2 * j + 1]), j] = 1 if self.axes[2 * j] == "+" else -1
        return matrix

    @property
    def is_filtered(self) -> bool:
        """Whether a low-pass filter within the band of the chip's own samples acts on the output."""
        return self.chip in ("bma180", "l3g4200d") and self.bandwidth_hz < 0.4 * self.rate_hz


@dataclass(frozen=True)
class Part:
    """The true parameters of one part, in SI and in the sensor's axes.

    `scale` and `clock_error` are relative; `matrix` holds the directions of the element's axes (identity where all is
    right); `quadratic` and `cubic` are deviations at full scale as shares of it; `noise_density` is one-sided, per
    square root of hertz; `turn_on_sigma` is the scatter of the bias between turn-ons, which no data sheet states.
    """

    scale: Array
    matrix: Array
    bias: Array
    bias_slope: Array
    scale_slope: Array
    quadratic: Array
    cubic: Array
    noise_density: Array
    turn_on_sigma: float
    clock_error: float
    filter_order: int
    thermometer_zero_k: float
    thermometer_slope: float
    thermometer_noise_k: float
    lag_s: float
    self_heating_k: float
    extra: dict[str, Any] = field(default_factory=dict)


def stream(*keys: object) -> Generator:
    """A random stream of its own for these keys, the same on every machine."""
    digest = hashlib.sha256("/".join(map(str, keys)).encode()).digest()
    return np.random.default_rng(int.from_bytes(digest, "little"))


def truncated(rng: Generator, sigma: float, limit: float, size: int | None = None) -> Any:
    """Normal draws of which none is beyond the limit."""
    draws = np.atleast_1d(rng.normal(0, sigma, size or 1))
    while (beyond := np.abs(draws) > limit).any():
        draws[beyond] = rng.normal(0, sigma, int(beyond.sum()))
    return draws if size else float(draws[0])


def typical(rng: Generator, limit: float, size: int | None = None) -> Any:
    """Draws of a quantity of which the data sheet gives a typical value only."""
    return truncated(rng, limit / 2, limit, size)


def small_rotation(rng: Generator, limit_rad: float) -> Array:
    """Rotation about a random axis by at most this angle."""
    axis = rng.normal(size=3)
    return rotation(axis / np.linalg.norm(axis), abs(typical(rng, limit_rad)))


def rotation(axis: Array, angle: Any) -> Array:
    """Rotation matrices (..., 3, 3) about a unit axis by angles (...)."""
    x, y, z = axis
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    angle = np.asarray(angle, float)[..., None, None]
    matrix: Array = np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * (cross @ cross)
    return matrix


def white_rms(sensor: Sensor) -> Array:
    """Typical rms noise of the chip's output (3,), SI, from the data sheet's density and the filter's bandwidth."""
    rms: Array = typical_density(sensor) * np.sqrt(noise_bandwidth(sensor, 2))
    return rms


def noise_bandwidth(sensor: Sensor, order: int) -> float:
    """Bandwidth in Hz of the rectangular filter that passes as much white noise."""
    if not sensor.is_filtered:
        return sensor.rate_hz / 2
    return sensor.bandwidth_hz * (np.pi / 2 if order == 1 else np.pi / (2 * np.sqrt(2)))


def typical_density(sensor: Sensor) -> Array:
    """Typical one-sided noise density (3,), SI per square root of hertz."""
    if sensor.chip == "bma180":  # BMA-110; above 2 g nothing is given and the paper measured more (PAP-05)
        return np.full(3, 150e-6 * G * BMA_WIDE_NOISE.get(sensor.range, 1.0))
    if sensor.chip == "adxl345":  # ADX-67, ADX-68: rms in codes, quantisation taken out
        rms = np.sqrt(np.array([0.75, 0.75, 1.1]) ** 2 - 1 / 12) * np.sqrt(max(sensor.rate_hz, 100) / 100)
        density: Array = rms / sensor.counts_per_si / np.sqrt(sensor.rate_hz / 2)
        return density
    if sensor.chip == "l3g4200d":  # L3G-74
        return np.full(3, 0.03 * DPS)
    return np.full(3, HMC_NOISE_GAUSS / np.sqrt(sensor.rate_hz / 2))


def draw_part(rng: Generator, sensor: Sensor, *, second_order: bool, supply_3v3: bool, l3g_order: int) -> Part:
    """A part within its data sheet's tolerance. `second_order`: nonlinearity and thermal slope of the scale factor are
    drawn as the data sheet allows, else they are zero. `supply_3v3` shifts an ADXL345 as ADX-71 says.
    """
    full_scale = sensor.range * SI[sensor.facts.unit]
    zero3 = np.zeros(3)
    cross = 0.0
    if sensor.chip == "bma180":
        scale = typical(rng, BMA_SCALE_TOLERANCE[sensor.range], 3)
        bias = typical(rng, 0.060 * G, 3)  # BMA-113
        if sensor.range >= 8:
            bias = bias + truncated(rng, 0.1 * G, 0.4 * G, 3)  # BMA-79
        bias_slope = typical(rng, 0.0005 * G, 3)  # BMA-115
        nonlinearity = BMA_NONLINEARITY[sensor.range]
        mounting, cross, turn_on = 1.0 * DPS, 0.0175, 0.0004 * G * max(1.0, sensor.range / 4)  # BMA-118, BMA-119
        thermal_scale = 1e-4  # BMA-116
    elif sensor.chip == "adxl345":
        scale = truncated(rng, 0.01, 0.10, 3)  # ADX-63
        bias = np.append(truncated(rng, 0.035 * G, 0.15 * G, 2), truncated(rng, 0.04 * G, 0.25 * G))  # ADX-60, -61
        bias_slope = np.append(typical(rng, 0.0004 * G, 2), typical(rng, 0.0012 * G))  # ADX-62
        if supply_3v3:
            scale = scale + np.array([265 / 256 - 1, 265 / 256 - 1, 0])
            bias = bias + np.array([0.025, 0.025, -0.02]) * G
        nonlinearity, mounting, cross, turn_on = 0.005, 0.6 * DPS, 0.01, 0.0008 * G  # ADX-65, ADX-66
        thermal_scale = 1e-4  # ADX-64
    elif sensor.chip == "l3g4200d":
        scale = truncated(rng, 0.01, 0.025, 3)  # L3G-75: nothing is given
        bias = typical(rng, L3G_ZERO_DPS[sensor.range] * DPS, 3)
        bias_slope = typical(rng, (0.04 if sensor.range == 2000 else 0.03) * DPS, 3)  # L3G-71
        nonlinearity, mounting, turn_on = 0.002, 1.0 * DPS, 0.05 * DPS * (2 if sensor.range == 2000 else 1)  # L3G-73
        thermal_scale = 0.02 / 60  # L3G-72: 2 % from 25 to 85 degC
    else:
        scale, bias, bias_slope = typical(rng, 0.05, 3), typical(rng, 0.02, 3), zero3
        nonlinearity, mounting, turn_on, thermal_scale = 0.0, 1.0 * DPS, 0.0, 0.0
    skew = rng.normal(0, cross / 4, (3, 3)).clip(-cross, cross) * (1 - np.eye(3))
    split = rng.uniform(-1, 1, 3)  # how much of the nonlinearity is even
    size = typical(rng, nonlinearity, 3) if second_order else zero3
    white_shift = 1.0 if sensor.chip == "hmc5883l" else float(np.exp(rng.normal(0, 0.07)))
    return Part(
        scale=scale,
        matrix=small_rotation(rng, mounting) + skew,
        bias=bias,
        bias_slope=bias_slope,
        scale_slope=typical(rng, thermal_scale, 3) if second_order and thermal_scale else zero3,
        quadratic=size * split,
        cubic=size * (1 - np.abs(split)),
        noise_density=typical_density(sensor) * white_shift * np.exp(rng.normal(0, 0.04, 3)),
        turn_on_sigma=turn_on,
        clock_error=typical(rng, sensor.facts.clock_tolerance),
        filter_order=2 if sensor.chip == "bma180" else l3g_order,  # BMA-92; the L3G4200D's order is not given
        thermometer_zero_k=typical(rng, 5.0) if sensor.chip == "bma180" else float(rng.uniform(35, 60)),  # BMA-64
        thermometer_slope=typical(rng, 0.04),
        thermometer_noise_k=float(rng.uniform(0.1, 0.35)),
        lag_s=float(rng.uniform(3, 20)),
        self_heating_k=float(rng.uniform(0.2, 1.0)),
        extra={"full_scale": full_scale},
    )
