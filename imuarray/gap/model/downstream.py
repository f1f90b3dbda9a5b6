"""The effect of a gap on users of the sensors: errors of heading and velocity after coasting, of the fused array at
rest, of force over faces, and drift during heating.

All figures are computed from summaries, so that a campaign's rows are read once; simulations have the same figures
under the same names.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from imuarray.arrays import Floats
from imuarray.axes import UP_AXES
from imuarray.gap.model.base_model import headers_in
from imuarray.gap.model.use import IntervalEstimate, Use
from imuarray.gap.statistics.campaign import Campaign
from imuarray.gap.statistics.cross import Cross
from imuarray.gap.statistics.probes.level import mean
from imuarray.gap.statistics.summary import Summary
from imuarray.log.format import Phase
from imuarray.units import INERTIAL, READABLE_SI, SI_PER_UNIT

Uses = Mapping[tuple[str, str], tuple[float, str]]
"""Value and unit of each figure, by the name of the figure and the sensor ("" for the array)."""

TAUS_S = (60.0, 50.0, 40.0, 30.0, 20.0, 15.0, 10.0, 5.0, 2.0, 1.0)
"""Coasting times that are tried, in s; the longest one that the phases at rest determine is used."""

_TERMS = 12
"""Least number of terms of the Allan variance at the coasting time, summed over the phases."""

_LEAST_RATIO = 4.25
"""Least length of a phase in coasting times: it then has Allan variances up to twice the coasting time, between which
the variance is interpolated.
"""

_LEAST_REPLICATES = 8
"""Least number of replicates that give the interval of a recorded figure."""

_TINY = np.finfo(float).tiny

_COASTING = {"angular_rate": ("heading", "deg", 180 / np.pi), "specific_force": ("velocity", "m/s", 1.0)}
_FUSED = {"angular_rate": "rate", "specific_force": "force"}
_UNITS = {"mg": "mg", "dps": "deg/s"}


class CoastingError(NamedTuple):
    """Root mean square `error` (3,) of the integral of each axis over `tau_s`, in `unit` (deg for a gyroscope, m/s for
    an accelerometer), with a bias that was calibrated at rest during the `tau_s` before.
    """

    tau_s: float
    error: Floats
    unit: str


def uses_of(campaign: Campaign, residual_campaign: Campaign) -> Uses:
    """Return all figures of use that the campaign determines; `residual_campaign` is its residual after its own fit
    (`imuarray.gap.model.base_model.residual`).

    For each inertial sensor, as the root mean square over its axes: error after coasting, residual over faces or poses
    (two or more, accelerometers only), peak to peak over a heating log. For the array: fused rate and force at rest.
    """
    figures: dict[tuple[str, str], tuple[float, str]] = {}
    for sensor, header in headers_in(campaign).items():
        if header.quantity not in INERTIAL:
            continue
        coasted = coasting(campaign, sensor)
        if coasted is not None:
            what = _COASTING[header.quantity][0]
            figures[f"{what} error after coasting {coasted.tau_s:g} s", sensor] = (_rms(coasted.error), coasted.unit)
        factor, unit = READABLE_SI[header.quantity]
        for name, value in _residuals(residual_campaign, sensor, header.quantity):
            figures[name, sensor] = (value * factor * SI_PER_UNIT[header.unit], _UNITS[unit])
    for quantity in INERTIAL:
        error = fused(campaign, quantity)
        if error is not None:
            figures[f"fused {_FUSED[quantity]} error at rest", ""] = (error, _UNITS[READABLE_SI[quantity][1]])
    return {place: figure for place, figure in figures.items() if np.isfinite(figure[0])}


def coasting(campaign: Campaign, sensor: str) -> CoastingError | None:
    """Return the error of an inertial sensor after coasting, which is exactly sqrt(2) tau sigma_A(tau).

    The integral of the readings less the calibrated bias is the second difference of their running integral, whose mean
    square is 2 tau^2 sigma_A^2. Allan variances at octaves of rows are pooled over the phases at rest by their terms
    and interpolated in log-log. None if no phase is long enough for the least of `TAUS_S`.
    """
    phases = [phase for log in campaign.logs for phase in log.still(sensor) if phase.intervals.count]
    tau_s = _longest_s(phases)
    known = [allan for phase in phases if tau_s and (allan := _allan_at(phase, tau_s)) is not None]
    if not known:
        return None
    header = phases[0].header
    variance = np.average(
        [variance_of_phase for variance_of_phase, _ in known], axis=0, weights=[terms for _, terms in known]
    )
    _, unit, factor = _COASTING[header.quantity]
    error = np.sqrt(2 * variance) * tau_s * SI_PER_UNIT[header.unit] * factor
    return CoastingError(tau_s, np.asarray(error), unit)


def fused(campaign: Campaign, quantity: str) -> float | None:
    """Return the root mean square over the box's axes, in deg/s or mg, of the mean of all sensors of a quantity about
    its mean in each phase at rest, from the windows of `imuarray.gap.statistics.cross`. None if no phase at rest with
    joint moments has such a sensor.
    """
    parts = [
        (_mean_square(phase.cross, quantity), phase.cross.windows)
        for log in campaign.logs
        for phase in log.phases
        if phase.is_still and phase.cross is not None and phase.cross.windows
    ]
    known = [(square, windows) for square, windows in parts if np.isfinite(square)]
    if not known:
        return None
    return float(np.sqrt(np.average([value for value, _ in known], weights=[windows for _, windows in known])))


def uses(real: Uses, before: Sequence[Uses], after: Sequence[Uses]) -> tuple[Use, ...]:
    """Return the figures of a recording with those of its simulations before and after the causes were added.

    A simulated figure is the median of the replicates with their 95 % interval. The interval of the recorded figure is
    the scatter of the replicates about their median: of those `after` if there are at least 8, otherwise of those
    `before`; nan if there are fewer than 8 of these.
    """
    table = []
    for (name, sensor), (value, unit) in real.items():
        first, second = (_values(replicates, (name, sensor)) for replicates in (before, after))
        scatter = second if len(second) >= _LEAST_REPLICATES else first
        table.append(Use(name, sensor, unit, _recorded(value, scatter), _interval_of(first), _interval_of(second)))
    return tuple(table)


def attitude_of(phase: Phase) -> str:
    """Return the attitude of a phase at rest: the axis that points up, or the name of a hand-held pose; "" if it is
    unknown.
    """
    return phase.up or (phase.name if phase.name.startswith("pose ") else "")


def _rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def _longest_s(phases: Sequence[Summary]) -> float:
    """Return the longest coasting time, in s, that the phases determine; 0 if all are too short. It depends on the
    lengths of the phases, which simulations have too, and not on the number of rows.
    """
    if not phases:
        return 0.0
    lasting_s = np.array([(phase.phase.end_ns - phase.phase.start_ns) * 1e-9 for phase in phases])
    interval_s = float(np.median([phase.intervals.mean_s for phase in phases]))
    for tau_s in TAUS_S:
        ratios = lasting_s[lasting_s >= _LEAST_RATIO * tau_s] / tau_s
        octaves = len(phases[0].allan.terms)
        if (4 * ratios - 7).sum() >= _TERMS and interval_s <= tau_s <= interval_s * 2 ** (octaves - 1):
            return tau_s
    return 0.0


def _allan_at(phase: Summary, tau_s: float) -> tuple[Floats, float] | None:
    """Return the Allan variance (3,) in the squared unit of the sensor and its number of terms; None outside the
    octaves of the phase.
    """
    variance, terms, _ = phase.allan
    known = np.flatnonzero(terms)
    octave = float(np.log2(tau_s / phase.intervals.mean_s))
    if len(known) == 0 or not known[0] <= octave <= known[-1]:
        return None
    logs = np.log(np.maximum(variance[known], _TINY))
    variance_lsb2 = np.exp([np.interp(octave, known, column) for column in logs.T])
    return variance_lsb2 / phase.header.sensitivity**2, float(np.interp(octave, known, terms[known]))


def _mean_square(cross: Cross, quantity: str) -> float:
    """Return the mean square, in deg^2/s^2 or mg^2, over the box's axes of the mean of all sensors of the quantity; nan
    without one.
    """
    members = [sensor for sensor in cross.sensors if sensor.quantity == quantity]
    weights = np.zeros((3, cross.fast.shape[0]))
    for sensor in members:
        factor = SI_PER_UNIT[sensor.unit] * READABLE_SI[quantity][0]
        weights[:, cross.columns(sensor.name)] = np.array(sensor.orientation) * factor / len(members)
    slow = cross.slow[np.isfinite(cross.slow).all(axis=1)] @ weights.T
    fast = np.diag(weights @ cross.fast @ weights.T)
    return float(np.mean(fast + slow.var(axis=0))) if members and len(slow) else float("nan")


def _residuals(campaign: Campaign, sensor: str, quantity: str) -> Iterator[tuple[str, float]]:
    """Yield the names and the values, in the sensor's unit, of the residual levels and of the drift over heating."""
    faces: dict[str, list[Floats]] = {}
    for log in campaign.logs:
        for phase in log.still(sensor):
            attitude = attitude_of(phase.phase)
            if phase.rows and attitude:
                faces.setdefault(attitude, []).append(mean(phase))
    if quantity == "specific_force" and len(faces) > 1:
        name = "six-face residual" if faces.keys() == set(UP_AXES) else f"residual over {len(faces)} attitudes"
        yield name, _rms(np.array([np.mean(means, axis=0) for means in faces.values()]))
    drifts = [_peak_to_peak(log.still(sensor)) for log in campaign.logs if log.kind == "heating" and log.still(sensor)]
    if drifts:
        yield "drift over heating", _rms(np.array(drifts))


def _peak_to_peak(phases: Sequence[Summary]) -> Floats:
    """Return the largest peak-to-peak value (3,) over the attitudes of the means of segments, in the sensor's unit.
    Segments with fewer than half of the median number of rows are left out.
    """
    faces: dict[str, list[Floats]] = {}
    for phase in phases:
        part = phase.segments
        full = part.rows >= max(1.0, float(np.median(part.rows)) / 2)
        faces.setdefault(attitude_of(phase.phase), []).append(part.mean[full] / phase.header.sensitivity)
    joined = [np.concatenate(means) for means in faces.values()]
    sizes = [np.ptp(means, axis=0) for means in joined if len(means)]
    return np.asarray(np.max(sizes, axis=0)) if sizes else np.full(3, np.nan)


def _values(replicates: Sequence[Uses], place: tuple[str, str]) -> Floats:
    return np.array([replicate[place][0] for replicate in replicates if place in replicate])


def _interval_of(values: Floats) -> IntervalEstimate:
    low, middle, high = np.quantile(values, (0.025, 0.5, 0.975)) if len(values) else np.full(3, np.nan)
    return IntervalEstimate(float(middle), float(low), float(high))


def _recorded(value: float, scatter: Floats) -> IntervalEstimate:
    positive = scatter[scatter > 0]
    if len(positive) < _LEAST_REPLICATES:
        return IntervalEstimate(value, float("nan"), float("nan"))
    logs = np.log(positive)
    low, high = np.quantile(logs - np.median(logs), (0.025, 0.975))
    return IntervalEstimate(value, float(value * np.exp(-high)), float(value * np.exp(-low)))
