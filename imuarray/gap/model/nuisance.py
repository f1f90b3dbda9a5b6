"""Estimates of the nuisance quantities of a recording, with the tolerance that the data sheet allows each part.

They do not cause a gap, since the fit removes them or the replicates draw them. A value beyond its tolerance means that
the part is out of specification, which is a different finding from an effect that the simulator lacks.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from imuarray.gap.model.base_model import Base
from imuarray.gap.model.populations import (
    CUTOFF_TOLERANCE,
    clock_tolerance,
    offset_tolerance,
    printed_noise,
    response_tolerance,
    slope_tolerance,
    thermometer_tolerance_degc,
)
from imuarray.gap.model.rest import FittedParameters
from imuarray.gap.statistics.campaign import Campaign
from imuarray.gap.statistics.catalogue import AXES
from imuarray.gap.statistics.summary import Summary
from imuarray.log.format import SensorHeader
from imuarray.simulate.converters import thermometer_of
from imuarray.simulate.model import noise_bandwidth_hz


class NuisanceEstimate(NamedTuple):
    """Estimate of one quantity of one sensor, on one `axis` ("" for the whole sensor, "xy" for axis x tilted towards
    y).

    `value` and `tolerance` are in `unit`; the tolerance is nan if the data sheet prints none; `source` is that of the
    tolerance.
    """

    quantity: str
    sensor: str
    axis: str
    value: float
    unit: str
    tolerance: float
    source: str

    @property
    def pull(self) -> float:
        """The value divided by the tolerance; nan without a tolerance."""
        return self.value / self.tolerance if self.tolerance > 0 else math.nan


def nuisance_estimates(campaign: Campaign, base: Base, *, has_reference: bool) -> tuple[NuisanceEstimate, ...]:
    """Return the nuisance quantities of all sensors of a campaign to which `base` was fitted. The zeros of chip
    thermometers are included only if `has_reference`: the campaign has a reference temperature.
    """
    return tuple(
        estimate
        for name, header in base.headers.items()
        for estimate in (
            *_of_part(header, base.fitted[name]),
            *(_of_thermometer(campaign, header) if has_reference else ()),
        )
    )


def _of_part(header: SensorHeader, fitted: FittedParameters) -> Iterator[NuisanceEstimate]:
    for axis, value, tolerance in zip(AXES, fitted.offset, offset_tolerance(header), strict=True):
        if math.isfinite(tolerance):
            yield NuisanceEstimate("bias", header.name, axis, value, header.unit, tolerance, _SHEET)
    if fitted.is_slope_known:
        unit = f"{header.unit}/degC"
        for axis, value, tolerance in zip(AXES, fitted.raw_slope, slope_tolerance(header), strict=True):
            yield NuisanceEstimate("thermal slope of the bias", header.name, axis, value, unit, tolerance, _SHEET)
    yield from _of_noise(header, fitted)
    if fitted.low_pass is not None:
        off = fitted.low_pass.cutoff_hz / noise_bandwidth_hz(header) - 1
        yield NuisanceEstimate("cutoff of the filter", header.name, "", off, "", CUTOFF_TOLERANCE, _USUAL)
    if math.isfinite(fitted.clock_error):
        tolerance = clock_tolerance(header)
        yield NuisanceEstimate("rate of the data clock", header.name, "", fitted.clock_error, "", tolerance, _SHEET)
    tolerances = response_tolerance(header)
    for row, (axis, values) in enumerate(zip(AXES, fitted.raw_response, strict=True)):
        for column, value in enumerate(values):
            if value:
                yield _response(header, axis, AXES[column], value, float(tolerances[row, column]))


def _of_noise(header: SensorHeader, fitted: FittedParameters) -> Iterator[NuisanceEstimate]:
    """Yield the ratio of the noise at rest to that of the data sheet, in dB, with rounding included in both. It has no
    tolerance: data sheets print a typical figure, often for one range or mode only; that of a BMA180 grows with the
    range (PAP-05).
    """
    printed = printed_noise(header)
    if printed is None:
        return
    expected = replace(fitted, rms=printed).noise(header)
    for axis, ratio in zip(AXES, (fitted.noise(header) / expected).tolist(), strict=True):
        if ratio > 0:
            value_db = 20 * math.log10(ratio)
            yield NuisanceEstimate("noise", header.name, axis, value_db, "dB", math.nan, _SHEET)


def _response(header: SensorHeader, axis: str, along: str, value: float, tolerance: float) -> NuisanceEstimate:
    """Return one component of the response to specific force as a nuisance quantity."""
    if header.quantity != "specific_force":
        unit = f"{header.unit}/g"
        return NuisanceEstimate("g-sensitivity", header.name, axis + along, value, unit, tolerance, _USUAL)
    if axis == along:
        return NuisanceEstimate("scale factor error", header.name, axis, value, "", tolerance, _SHEET)
    angle_deg, limit_deg = (math.degrees(math.asin(min(max(sine, -1.0), 1.0))) for sine in (value, tolerance))
    return NuisanceEstimate("misalignment", header.name, axis + along, angle_deg, "deg", limit_deg, _USUAL)


def _of_thermometer(campaign: Campaign, header: SensorHeader) -> Iterator[NuisanceEstimate]:
    """Yield the offset of the chip's own thermometer from the reference."""
    converter, zero = thermometer_of(header), thermometer_zero_degc(_rests(campaign, header.name))
    if converter is not None and math.isfinite(zero):
        tolerance = thermometer_tolerance_degc(header)
        yield NuisanceEstimate("zero of the chip's thermometer", header.name, "", zero, "degC", tolerance, _SHEET)


def thermometer_zero_degc(phases: Sequence[Summary]) -> float:
    """Return the mean temperature that a chip's thermometer measures, by its data sheet (BMA-64, L3G-60), less the
    reference; nan without a thermometer or a reference.
    """
    converter = thermometer_of(phases[0].header) if phases else None
    if converter is None:
        return math.nan
    counts, rows, degc = (
        np.concatenate([np.asarray(getattr(phase.segments, name), float) for phase in phases])
        for name in ("thermometer", "rows", "temperature_degc")
    )
    is_usable = np.isfinite(counts) & np.isfinite(degc) & (rows > 0)
    if not is_usable.any():
        return math.nan
    thermometer_degc = counts[is_usable] / converter.lsb_per_degc + converter.zero_degc
    return float(np.average(thermometer_degc - degc[is_usable], weights=rows[is_usable]))


def _rests(campaign: Campaign, sensor: str) -> list[Summary]:
    return [phase for log in campaign.logs for phase in log.still(sensor)]


_SHEET = "data sheet"
_USUAL = "usual for such parts"
