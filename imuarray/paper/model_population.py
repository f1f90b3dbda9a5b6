"""What other units of the three designs may be like, as far as nine sensors on one board can tell.

k units with values of mean m and standard deviation s (over units and axes) foretell a further one as m +- s sqrt(1 +
1/k): it differs from its design's mean by s, and that mean is known to s / sqrt(k) only. The second part is the same
for all units that anybody draws, so a share 1 / (k + 1) of the variance is common to them (`shared`). What the paper
calls common to a design (gyroscope drifts positive in eight of nine, ADXL345 z axes noisier and drifting down) stands
in the means. Parameters that can't be negative are cut off at 0 and as far above the mean.

A fault that one unit of several showed (two bias states, a range lost at power-on) is no spread and left out.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from math import floor, sqrt

import numpy as np
import numpy.typing as npt

from imuarray.paper.model_units import CHIP, CUTOFF_HZ, RANGE, TONE_HZ, Unit, tone_dps, units
from imuarray.paper.wander import TIME_CONSTANT_S

Floats = npt.NDArray[np.float64]
Table = dict[str, object]

NOISE_BANDWIDTH_HZ = {"adxl345": 800.0, "l3g4200d": 35.0}
"""Bandwidths of `configs/martin2013.toml` at which the noise of Tables 10 and 11 holds: half of 1600 Hz (ADX-32) and
35 Hz (finding: 0.03 dps/sqrt(Hz), L3G-74). The paper says nothing of the BMA180's; its noise stands as it is.
"""


@dataclass(frozen=True)
class Spread:
    """A normal population, in a parameter's unit."""

    mean: float
    sigma: float
    shared: float
    limit: float | None = None


def spread(values: Floats, known: int, *, positive: bool = False) -> Spread:
    """The population that `values` (any shape) of `known` units foretell."""
    mean, sigma = float(values.mean()), float(values.std(ddof=1)) * sqrt(1 + 1 / known)
    return _limited(mean, sigma, 1 / (known + 1), positive)


def about_zero(values: Floats, known: int) -> Spread:
    """The same where no direction is preferred: mean 0."""
    return Spread(0.0, float(np.sqrt(np.mean(values**2))) * sqrt(1 + 1 / known), 1 / (known + 1))


def designs() -> Iterator[tuple[Table, dict[str, Table]]]:
    """(head, effects) of every [[design]] table: each chip at any range, then what depends on the range."""
    for design, chip in CHIP.items():
        group = [unit for unit in units() if unit.design == design]
        head: Table = {"chip": chip}
        if chip in NOISE_BANDWIDTH_HZ:
            head["noise_bandwidth_hz"] = NOISE_BANDWIDTH_HZ[chip]
        yield head, {**_scale(group), **_any_range(group), **_by_range(group), **_line(design)}
        ranges = dict.fromkeys(unit.range for unit in group)
        for name in ranges if len(ranges) > 1 else ():
            members = [unit for unit in group if unit.range == name]
            yield {**head, "range": RANGE[name]}, _by_range(members) if design == "BMA" else _bias(members)


def _scale(group: Sequence[Unit]) -> dict[str, Table]:
    """How accelerometers' axes answer; for gyroscopes nothing was measured but their answer to force."""
    unit, known = group[0].unit, len(group)
    if unit == "dps":
        response = np.array([member.response for member in group])
        return {"g_sensitivity": {"response_dps_per_g": about_zero(response, known)}}
    angles = np.array([member.angles_deg for member in group])
    return {
        "misalignment": {"angles_deg": about_zero(angles, known)},
        "scale": {"error": _planes(group, lambda member: member.scale_error)},
    }


def _any_range(group: Sequence[Unit]) -> dict[str, Table]:
    slope = _planes(group, lambda member: member.slope)
    thermal: dict[str, Table] = {"thermal_bias": {f"slope_{group[0].unit}_per_degc": slope}}
    return thermal | ({} if group[0].thermometer is None else {"thermometer": _thermometer(group)})


def _bias(group: Sequence[Unit]) -> dict[str, Table]:
    """Gyroscopes: all else is the same at both ranges, in dps (section 5.1)."""
    return {"bias": {f"offset_{group[0].unit}": _planes(group, lambda member: member.bias)}}


def _by_range(group: Sequence[Unit]) -> dict[str, Table]:
    unit = group[0].unit
    return {
        **_bias(group),
        "turn_on_bias": {f"rms_{unit}": _planes(group, lambda member: member.turn_on, positive=True)},
        "bias_instability": {
            f"rms_{unit}": _planes(group, lambda member: member.in_run, positive=True),
            "time_constant_s": TIME_CONSTANT_S,
        },
        "white_noise": {f"rms_{unit}": _planes(group, lambda member: member.noise, positive=True)},
    }


def _line(design: str) -> dict[str, Table]:
    if design != "Gyro":
        return {}
    return {
        "tone": {"amplitude_dps": [0.0, tone_dps(), 0.0], "frequency_hz": TONE_HZ},
        "bandwidth": {"cutoff_hz": CUTOFF_HZ},
    }


def _thermometer(group: Sequence[Unit]) -> Table:
    told = np.array([member.thermometer for member in group])
    known = len(group)
    return {"offset_degc": spread(told[:, 0], known), "rms_degc": spread(told[:, 1], known, positive=True)}


def _planes(group: Sequence[Unit], value: Callable[[Unit], Floats], *, positive: bool = False) -> Spread | list[Spread]:
    """One population for all axes, or, where x and y are one design and z another (ADXL345, section 2.2), two."""
    values = np.array([value(unit) for unit in group])
    if group[0].design != "ADXL":
        return spread(values, len(group), positive=positive)
    plane, across = (spread(part, len(group), positive=positive) for part in (values[:, :2], values[:, 2]))
    return [plane, plane, across]


def _limited(mean: float, sigma: float, shared: float, positive: bool) -> Spread:
    if not positive or mean >= 3 * sigma:
        return Spread(mean, sigma, shared)
    return Spread(mean, sigma, shared, limit=floor(mean * 1e6) / 1e6)
