"""Populations and tolerances of the nuisance quantities that differ from part to part within the data sheet.

They are the figures of the data sheets if these print any, and otherwise usual values for the kind of sensor. Every
replicate of the base model draws its parts from these populations; a fitted quantity is compared with its tolerance (a
pull). A repaired model has the same populations.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import replace
from functools import cache
from types import MappingProxyType

import numpy as np

from imuarray.arrays import Floats
from imuarray.log.format import SensorHeader
from imuarray.shipped import configs
from imuarray.simulate.effect import Effect
from imuarray.simulate.effects.bias import BiasInstability, TurnOnBias
from imuarray.simulate.effects.noise import WhiteNoise
from imuarray.simulate.effects.response import SizeEffect
from imuarray.simulate.effects.temperature import ThermalLag
from imuarray.simulate.model import TRIADS, Model, Part, load_model, noise_bandwidth_hz
from imuarray.simulate.population import Figure, Recipe, Spread
from imuarray.simulate.signal import Triple
from imuarray.simulate.streams import Streams

SCALE_SIGMA, ANGLE_SIGMA_DEG, G_SENSITIVITY_SIGMA = 0.01, 0.7, 0.01
"""Standard deviations over the sensors of an array: relative scale error, misalignment in degrees, and g-sensitivity of
a gyroscope in dps per g. Data sheets print the alignment of a die in its package (half a degree, BMA-119), but not that
of soldering and mounting. The paper's gyroscopes changed by up to 0.038 dps over 2 g (its Table 4).
"""

TURN_ON_SHARE = 0.01
"""Largest usual scatter of a bias from one power-on to the next, as a share of the bias that the data sheet allows at
the configured range. No data sheet prints it: the paper's parts scatter by up to 0.7 mg and 0.057 dps (the left half of
its Table 11), other parts by several times more.
"""

TURN_ON_RMS: Mapping[str, float] = MappingProxyType({"g": 1.2e-3, "dps": 0.15})
"""Least value, by unit, of this largest usual scatter, also for a chip whose data sheet allows little bias: the board
contributes to the scatter.
"""

FLICKER_FLOOR: Mapping[str, float] = MappingProxyType({"g": 1.2e-4, "dps": 8e-3, "gauss": 2e-4})
"""Largest usual flicker noise (1/f) by unit, as the flat part of the Allan deviation: every sensor of this kind has
flicker, and the data sheets of these chips do not print it. Allan deviations of such parts are flat at 0.03 to 0.15 mg
and at 0.002 to 0.01 dps.
"""

FLICKER_TIMES_S = 1024.0, 4.0
"""Slowest and fastest time constant of this flicker, in s: faster components are below the white noise."""

_OFFSET_TOLERANCE_G = 0.15
"""Tolerance of the bias, in g, of an accelerometer whose data sheet is not known (ADX-60)."""

THERMAL_SLOPE_SIGMA: Mapping[str, float] = MappingProxyType({"g": 5e-4, "dps": 0.02, "gauss": 2e-3})
"""Standard deviation of the change of a bias per degC, by unit, for chips whose data sheet is not known; BMA-115 and
L3G-71 print the same values. For a magnetometer at rest it is the change of its scale (0.3 % of half a gauss: HMC-57).
"""

STEEPEST_SLOPE = 2.0
"""Largest slope of a bias that is a property of a part, in its tolerances: data sheets print typical slopes, and those
of parts without a fault reach 1.9 tolerances. A steeper one is not fitted, and can be explained by an effect.
"""

SCALE_SLOPE_SIGMA = 1e-4
"""Standard deviation of the relative change of a scale per degC, for chips whose data sheet is not known (ADX-64,
BMA-116).
"""

THERMAL_GROWTH_SIGMA = 0.0015
"""Standard deviation of the quadratic coefficient of a bias over temperature, as a share of its slope per degC. Data
sheets print only a typical slope; over 20 degC that of a part changes by some percent, so its bias follows a curve.
"""

BOARD_STRESS_SIGMA, BOARD_LAGS_S = 0.08, (20.0, 200.0)
"""Standard deviation of the change of the bias with the temperature of a part of the board that warms up later than the
chip, as a share of the slope of the bias; and the shortest and the longest time constant of that part, in s. A board
that is not uniformly warm stresses the package, so that the bias over temperature is a loop. No data sheet prints it.
"""

LONGEST_LAG_S = 20.0
"""Longest usual time constant, in s, of a chip in a box if no chip thermometer shows a longer one; a longer lag is an
effect.
"""

CLOCK_SIGMA = 0.02
"""Standard deviation of the relative error of a chip's data clock if no tolerance is printed: RC oscillators are
accurate to a few percent.
"""

GRAVITY_TOLERANCE = 0.003
"""Relative tolerance of local gravity: at sea level it is 9.780 m/s^2 at the equator and 9.832 m/s^2 at the poles (WGS
84), compared with the standard 9.80665 m/s^2; a height of 300 m reduces it by 0.01 %.
"""

POSITION_SIGMA_MM = 1.5
"""Standard deviation, in mm along each axis, of an accelerometer's position in the box about the noted one: three
standard deviations are about the size of a package, and no data sheet prints the position of the element in it.
"""

CUTOFF_TOLERANCE = 0.5
"""Relative tolerance of the cutoff of a filter. Few data sheets print the order of a filter or the tolerance of its
cutoff; the paper's gyroscopes, set to 35 Hz, have the correlation of a first-order filter of 51 Hz.
"""

LEAST_CORRELATION = 0.02
"""Least correlation between rows that indicates a filter."""

TOLERANCE_SIGMAS = 3.0
"""Tolerance of a population without a printed limit, in standard deviations."""

USUAL: Mapping[str, Recipe] = MappingProxyType(
    {
        "own_clock": {"phase_deg": math.nan},
        "scale": {"error": Spread(sigma=SCALE_SIGMA)},
        "misalignment": {"angles_deg": Spread(sigma=ANGLE_SIGMA_DEG)},
    }
)
"""Populations of the quantities that are not fitted, for sensors without a model."""

_USUAL_AT: Mapping[str, Mapping[str, Recipe]] = MappingProxyType(
    {
        "g": {
            "thermal_bias": {"slope_g_per_degc": Spread(sigma=THERMAL_SLOPE_SIGMA["g"])},
        },
        "dps": {
            "thermal_bias": {"slope_dps_per_degc": Spread(sigma=THERMAL_SLOPE_SIGMA["dps"])},
            "g_sensitivity": {"response_dps_per_g": Spread(sigma=G_SENSITIVITY_SIGMA)},
        },
        "gauss": {
            "thermal_bias": {"slope_gauss_per_degc": Spread(sigma=THERMAL_SLOPE_SIGMA["gauss"])},
        },
    }
)
"""Further populations for sensors with these units."""

PRINTED = frozenset({"scale", "thermal_bias", "thermal_scale", "nonlinearity", "g_sensitivity"})
"""Kinds of effect for which the populations of the data sheets are used if they exist."""


def usual_model(headers: Iterable[SensorHeader]) -> Model:
    """Return the model of these sensors' chips with only the quantities that are not fitted."""
    parts: dict[tuple[str, str, float | None], Part] = {}
    for header in headers:
        for part in (part for part in _data_sheets().designs if part.fits(header)):
            # at rest the thermal slope of a magnetometer's scale acts as a slope of its bias, and is drawn as one
            printed = PRINTED - {"thermal_scale"} if header.unit == "gauss" else PRINTED
            if effects := {kind: _guaranteed(recipes) for kind, recipes in part.effects.items() if kind in printed}:
                parts[part.chip, "", part.range] = replace(part, noise_bandwidth_hz=None, effects=effects)
        known = Model("", "", tuple(parts.values()), ()).parts(header)
        if missing := {kind: (recipe,) for kind, recipe in _usual(header).items() if kind not in known}:
            unit = own_unit(header)
            before = parts.get((header.chip, unit, None), Part(header.chip, unit=unit))
            parts[header.chip, unit, None] = replace(before, effects={**before.effects, **missing})
        if turn_on := _turn_on(header):
            range_ = header.range if header.chip in TRIADS else None
            place = header.chip, own_unit(header), range_
            before = parts.get(place, Part(header.chip, range_, unit=own_unit(header)))
            parts[place] = replace(before, effects={**before.effects, TurnOnBias.name: (turn_on,)})
    return Model("data sheets", "", tuple(parts.values()), ())


def printed_noise(header: SensorHeader) -> Triple | None:
    """Return the standard deviation of readings along a sensor's axes from its data sheet, in its unit, at the
    configured bandwidth; None if the data sheet prints none or the bandwidth is not known.
    """
    if noise_bandwidth_hz(header) <= 0:
        return None
    effects = _data_sheets().effects(header, Streams(0))
    return next((effect.rms for effect in effects if isinstance(effect, WhiteNoise)), None)


def own_unit(header: SensorHeader) -> str:
    """Return the unit that identifies the part of a chip without a driver; "" for the others."""
    return "" if header.chip in TRIADS else header.unit


def response_tolerance(header: SensorHeader, accelerometers: int = 1) -> Floats:
    """Return the largest response (3, 3) of each axis (row) of a part to specific force along each axis (column).

    The response is relative to the attitude that `accelerometers` accelerometers measure. The median of several is
    misaligned itself, with pi / 2 times the variance of a mean; half of the difference of two is within the tolerance
    of one.

    In the units of `FittedParameters.response`: for an accelerometer the scale error on the diagonal (ADX-63, BMA-70 to
    BMA-76, plus the deviation of local gravity, which a log at rest cannot separate from it) and the sine of the
    misalignment elsewhere, for a gyroscope the g-sensitivity (INV-66, else the usual one); 0 for other sensors.
    """
    if header.unit == "dps":
        usual = TOLERANCE_SIGMAS * G_SENSITIVITY_SIGMA
        return np.full((3, 3), _reach(header, "g_sensitivity", "response_dps_per_g", usual))
    if header.quantity != "specific_force":
        return np.zeros((3, 3))
    of_median = math.pi / 2 / accelerometers if accelerometers > 2 else 0.0
    angle = math.sin(math.radians(TOLERANCE_SIGMAS * ANGLE_SIGMA_DEG * math.sqrt(1 + of_median)))
    return np.asarray(np.where(np.eye(3) > 0, scale_tolerance(header) + GRAVITY_TOLERANCE, angle))


def is_usual(effect: Effect, header: SensorHeader) -> bool:
    """Return whether an effect is a nuisance quantity that is usual for the sensor: flicker, a turn-on bias, a lag of
    the element or the stress of a board of at most the usual size.
    """
    if isinstance(effect, ThermalLag):
        largest_stress = (TOLERANCE_SIGMAS + 1) * BOARD_STRESS_SIGMA * np.array(slope_tolerance(header))
        is_short = any(effect.slope) or effect.time_constant_s <= LONGEST_LAG_S
        return is_short and bool((np.abs(effect.slope) <= largest_stress).all())
    if isinstance(effect, BiasInstability):
        largest = usual_flicker((FLICKER_FLOOR.get(header.unit, 0.0),) * 3)
        return replace(effect, rms=largest.rms) == largest and max(effect.rms) <= max(largest.rms)
    return isinstance(effect, TurnOnBias) and max(effect.rms) <= turn_on_rms(header)


def usual_flicker(floor: Triple) -> BiasInstability:
    """Return the flicker whose Allan deviation is flat at `floor` (3 axes, in the sensor's unit)."""
    slowest_s, fastest_s = FLICKER_TIMES_S
    flicker = BiasInstability((0.0, 0.0, 0.0), slowest_s, fastest_s)
    x, y, z = (level * math.sqrt(len(flicker.time_constants_s)) for level in floor)
    return replace(flicker, rms=(x, y, z))


def is_near_noted_position(effect: Effect, header: SensorHeader) -> bool:
    """Return whether an effect is a position that agrees with the one noted in the header, within the tolerance."""
    if not isinstance(effect, SizeEffect):
        return False
    deviation_mm = np.subtract(effect.position_mm, header.position_mm)
    return bool(np.abs(deviation_mm).max() <= (TOLERANCE_SIGMAS + 1) * POSITION_SIGMA_MM)


def turn_on_rms(header: SensorHeader) -> float:
    """Return the largest usual scatter of a bias from one power-on to the next, in the sensor's unit; 0 if it is not
    known.
    """
    allowed = min(offset_tolerance(header))
    usual = TURN_ON_RMS.get(header.unit, 0.0)
    return max(TURN_ON_SHARE * allowed, usual) if math.isfinite(allowed) else usual


def clock_tolerance(header: SensorHeader) -> float:
    """Return the relative error of the data clock that the data sheet allows a part (BMA-107), or the usual one."""
    return _reach(header, "own_clock", "rate_error", TOLERANCE_SIGMAS * CLOCK_SIGMA)


def scale_tolerance(header: SensorHeader) -> float:
    """Return the relative scale error that the data sheet allows a part, or the usual one."""
    return _reach(header, "scale", "error", TOLERANCE_SIGMAS * SCALE_SIGMA)


def scale_slope_tolerance(header: SensorHeader) -> float:
    """Return the relative change of the scale per degC that the data sheet allows a part (ADX-64, BMA-116, L3G-72), or
    the usual one.
    """
    return _reach(header, "thermal_scale", "slope_per_degc", TOLERANCE_SIGMAS * SCALE_SLOPE_SIGMA)


def slope_tolerance(header: SensorHeader) -> tuple[float, float, float]:
    """Return the change of a bias per degC that the data sheet allows each axis of a part (ADX-62, BMA-115, L3G-71), in
    the sensor's unit, or the usual one; nan for a unit without a usual value.
    """
    usual = TOLERANCE_SIGMAS * THERMAL_SLOPE_SIGMA.get(header.unit, math.nan)
    key = f"slope_{header.unit}_per_degc"
    x, y, z = (_reach(header, "thermal_bias", key, usual, axis) for axis in range(3))
    return x, y, z


def steepest_slope(header: SensorHeader) -> tuple[float, float, float]:
    """Return the largest change of a bias per degC of each axis, in the sensor's unit, that is a property of a part;
    infinite for a unit without a usual value.
    """
    x, y, z = (STEEPEST_SLOPE * bound if bound == bound else math.inf for bound in slope_tolerance(header))
    return x, y, z


def offset_tolerance(header: SensorHeader) -> tuple[float, float, float]:
    """Return the bias that the data sheet allows each axis of a part (ADX-61, BMA-113, L3G-70), in the sensor's unit;
    nan if it prints none.
    """
    x, y, z = (_reach(header, "bias", f"offset_{header.unit}", math.nan, axis) for axis in range(3))
    return x, y, z


def common_bias_sigma_g(headers: Iterable[SensorHeader]) -> float:
    """Return the standard deviation of the mean bias of these accelerometers along an axis of the box, in g."""
    tolerances = [offset_tolerance(header) for header in headers if header.quantity == "specific_force"]
    known = [np.nan_to_num(tolerance, nan=_OFFSET_TOLERANCE_G) for tolerance in tolerances]
    return float(np.sqrt(np.mean(np.square(known)) / len(known))) / TOLERANCE_SIGMAS if known else 0.0


def thermometer_tolerance_degc(header: SensorHeader) -> float:
    """Return the tolerance of the offset of a chip's thermometer, in degC (BMA-64); nan if the data sheet prints no
    absolute reference (L3G-60).
    """
    return _reach(header, "thermometer", "offset_degc", math.nan)


def _reach(header: SensorHeader, kind: str, key: str, usual: float, axis: int = 0) -> float:
    """Return the largest value of a quantity that the population of the data sheet allows, or the `usual` one."""
    parts = _data_sheets().parts(header)
    if kind not in parts:
        return usual
    figures = [recipe[key] for recipe in parts[kind].effects[kind] if key in recipe]
    spreads = [figure[axis] if isinstance(figure, tuple) else figure for figure in figures]
    reaches = [spread.reach for spread in spreads if isinstance(spread, Spread)]
    return max(reaches) if reaches else usual


def _guaranteed(recipes: tuple[Recipe, ...]) -> tuple[Recipe, ...]:
    """Return the populations widened to their printed limits: real parts use the guaranteed range and not the typical
    figure (those of the paper are off by 2.4 to 3.3 %, where 1 % is typical and 10 % guaranteed).
    """
    return tuple({key: _wide(figure) for key, figure in recipe.items()} for recipe in recipes)


def _wide(figure: Figure) -> Figure:
    if isinstance(figure, tuple):
        return tuple(_widest(part) if isinstance(part, Spread) else part for part in figure)
    return _widest(figure) if isinstance(figure, Spread) else figure


def _widest(spread: Spread) -> Spread:
    return spread.model_copy(update={"sigma": max(spread.sigma, spread.reach / TOLERANCE_SIGMAS)})


def _usual(header: SensorHeader) -> dict[str, Recipe]:
    return {**USUAL, **_USUAL_AT.get(header.unit, {})}


def _turn_on(header: SensorHeader) -> Recipe:
    """Return a nearly uniform population of turn-on scatters between 0 and the largest usual one; empty if that is not
    known.
    """
    half = turn_on_rms(header) / 2
    return {f"rms_{header.unit}": Spread(mean=half, sigma=half, limit=half)} if half else {}


@cache
def _data_sheets() -> Model:
    """Return the shipped model of units as the data sheets describe them."""
    return load_model(configs() / "models" / "datasheet.toml")
