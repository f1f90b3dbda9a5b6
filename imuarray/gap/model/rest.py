"""Parameters of one sensor from its phases at rest: noise, offset, slope over temperature, response to specific force.

Offset, slope and response are nuisance parameters, which differ from part to part. Offset and slope are unbounded. The
response (scale error and misalignment of an accelerometer, g-sensitivity of a gyroscope) is fitted within the chip's
tolerance: a response within the tolerance is not a difference between simulator and recording, and the excess over the
tolerance remains in the residuals.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from imuarray.arrays import Booleans, Floats, Integers
from imuarray.gap.model.element_temperature import LEAST_HEATING_DEGC
from imuarray.gap.model.signal_delay import NO_DELAY, SignalDelay
from imuarray.gap.statistics.segments import Segments
from imuarray.gap.statistics.summary import Summary
from imuarray.log.format import SensorHeader
from imuarray.simulate.converters import code_span
from imuarray.simulate.effect import Effect
from imuarray.simulate.effects.bandwidth import Bandwidth, two_pole_cutoff_hz
from imuarray.simulate.effects.bias import Bias
from imuarray.simulate.effects.noise import WhiteNoise
from imuarray.simulate.effects.temperature import ThermalBias, ThermalLag
from imuarray.simulate.effects.timing import Skew
from imuarray.simulate.motion.stimulus import Motion
from imuarray.simulate.signal import Triple
from imuarray.units import SI_PER_UNIT, STANDARD_GRAVITY

Matrix = tuple[Triple, Triple, Triple]

REFERENCE_DEGC = 25.0
"""Temperature, in degC, at which biases are given, as in data sheets."""

_LEAST_ROWS = 4
"""Least number of rows of a segment whose variance is used."""

WHITE = np.zeros(0)
"""Correlations of white noise."""

_LEAST_SHARE = 0.2
"""Lower limit of the share of the variance of correlated noise that is measured within a segment, when the total
variance is computed from it.
"""

_ADDED, _LARGEST = 0.3, 64.0
"""Least ratio of a corrected noise variance to the previous one for which the difference is added; below it the noise
is scaled. Largest factor by which a variance is scaled.
"""

_PASSES = 4
"""Largest number of passes of the active-set method, in which components of the response that reach their tolerance are
fixed and the others are fitted again.
"""

STEEP_SPAN_DEGC = 5.0
"""Least change of temperature with which a slope can be too steep for a part."""

NO_RESPONSE = ((0.0, 0.0, 0.0),) * 3
"""The response of a part that follows its nominal axes and scale exactly."""

_DISTINCT = 0.02
"""Least relative difference between two noise variances for which their simulations determine a slope."""

_COLUMN = {"specific_force": "force_box", "angular_rate": "rate_box", "magnetic_field": "field_box"}


class FilterDraw(NamedTuple):
    """The filter of a unit that is drawn: the deviation of the log of its cutoff from the fitted one, in standard
    deviations, and whether its noise has the measured correlations, since no fitted filter has exactly the form of the
    chip's.
    """

    deviate: float = 0.0
    is_measured: bool = False


FITTED_FILTER = FilterDraw()
"""The filter as fitted."""


@dataclass(frozen=True)
class FittedParameters:
    """Parameters of one sensor in its unit along its own axes; noise, offset, slope and response are zero if it was
    never at rest.

    `rms`: noise without rounding. `offset`: bias at 25 degC. `slope`: change of the bias per degC of the element's
    temperature, 0 on an axis on which it is too steep for a part; `raw_slope`: the same without that bound.
    `response`: change of the reading of each axis (row) per unit of specific force along each axis (column),
    dimensionless for an accelerometer and in the sensor's unit per g for others, within the chip's tolerance;
    `raw_response`: the same without that bound. `is_slope_known`: whether temperatures differed enough. `low_pass`: the
    chip's own low-pass filter (None: white noise); `low_pass_sd`: standard deviation of the log of its cutoff;
    `measured_low_pass`: the same filter with the measured correlations, if they are known.
    `clock_error`: relative error of the rate of the chip's data clock, nan if the rows do not determine it. `lag_s`:
    time constant, in s, with which the element follows the temperature of the box. `delay`: delay of the signal.
    """

    rms: Triple
    offset: Triple
    slope: Triple
    raw_slope: Triple = (0.0, 0.0, 0.0)
    response: Matrix = NO_RESPONSE
    raw_response: Matrix = NO_RESPONSE
    is_slope_known: bool = False
    low_pass: Bandwidth | None = None
    low_pass_sd: float = 0.0
    measured_low_pass: Bandwidth | None = None
    clock_error: float = math.nan
    lag_s: float = 0.0
    delay: SignalDelay = NO_DELAY

    def effects(self, draw: FilterDraw = FITTED_FILTER) -> tuple[Effect, ...]:
        """Return the parameters as effects of the simulator, with the filter that was drawn."""
        noise: tuple[Effect, ...] = (WhiteNoise(self.rms),)
        if draw.is_measured and self.measured_low_pass is not None:
            noise = (*noise, self.measured_low_pass)
        elif self.low_pass is not None:
            cutoff_hz = self.low_pass.cutoff_hz * math.exp(draw.deviate * self.low_pass_sd)
            noise = (*noise, replace(self.low_pass, cutoff_hz=cutoff_hz))
        if self.delay.filter_s:
            noise = (*noise, Bandwidth(two_pole_cutoff_hz(self.delay.filter_s), share=1.0, poles=2.0, signal_only=1.0))
        if self.delay.stamp_s:
            noise = (*noise, Skew(self.delay.stamp_s))
        lag = (ThermalLag(self.lag_s),) if self.lag_s else ()
        return *noise, *lag, Bias(self.offset), ThermalBias(self.slope, reference_degc=REFERENCE_DEGC)

    def moved(self, target: FittedParameters, simulated: Sequence[FittedParameters]) -> FittedParameters:
        """Return these parameters corrected by the mean difference between the `target` and the fits to their
        simulations (`simulated`).

        The difference of the noise variances is added. If less than `_ADDED` of the variance would remain, the
        simulation is assumed to scale the noise, and the noise is scaled back; differences of offsets and slopes are
        then divided by the same scale factor.
        """
        variance, mean = np.square(self.rms), np.mean([np.square(parameters.rms) for parameters in simulated], axis=0)
        gain = np.clip(np.divide(mean, variance, out=np.ones(3), where=variance > 0), 1 / _LARGEST, _LARGEST)
        added = variance + np.square(target.rms) - mean
        ratio = np.divide(np.square(target.rms), mean, out=np.ones(3), where=mean > 0)
        is_added = added > _ADDED * variance
        squares = np.where(is_added, added, variance * np.clip(ratio, 1 / _LARGEST, _LARGEST))
        gain = np.where(is_added, 1.0, gain)
        offset = np.subtract(target.offset, np.mean([parameters.offset for parameters in simulated], axis=0)) / np.sqrt(
            gain
        )
        slope = np.subtract(target.slope, np.mean([parameters.slope for parameters in simulated], axis=0)) / np.sqrt(
            gain
        )
        return replace(
            self,
            rms=_triple(np.sqrt(np.maximum(squares, 0.0))),
            offset=_triple(np.add(self.offset, offset)),
            slope=_triple(np.add(self.slope, slope)),
        )

    def between(
        self,
        target: FittedParameters,
        simulated: Sequence[FittedParameters],
        before: FittedParameters,
        simulated_before: Sequence[FittedParameters],
    ) -> FittedParameters:
        """Return what `moved` returns, but with the noise from a secant through the simulations with these parameters
        and with those `before`, which is correct whether the simulation adds to the noise variance or scales it.
        """
        variance, last = np.square(self.rms), np.square(before.rms)
        mean, mean_before = (
            np.mean([np.square(parameters.rms) for parameters in some], axis=0)
            for some in (simulated, simulated_before)
        )
        is_distinct = np.abs(variance - last) > _DISTINCT * np.maximum(variance, last)
        gain = np.divide(mean - mean_before, variance - last, out=np.ones(3), where=is_distinct)
        gain = np.clip(gain, 1 / _LARGEST, _LARGEST)
        squares = np.maximum(variance + (np.square(target.rms) - mean) / gain, variance / _LARGEST**2)
        parameters_moved = self.moved(target, simulated)
        return replace(
            parameters_moved, rms=_triple(np.sqrt(np.where(is_distinct, squares, np.square(parameters_moved.rms))))
        )

    def noise(self, header: SensorHeader) -> Floats:
        """Return the standard deviation (3,) of readings including rounding, in the sensor's unit."""
        return np.asarray(np.sqrt(np.square(self.rms) + rounding_lsb2(header) / header.sensitivity**2))

    def predicted(self, summary: Summary, stimulus: SegmentStimulus) -> Floats:
        """Return the predicted reading (s, 3) of each segment, in the sensor's unit."""
        return np.asarray(stimulus.quantity + self._biases(summary) + stimulus.force @ np.array(self.response).T)

    def mean_force(self, summary: Summary) -> Floats:
        """Return the mean specific force (3,) along an accelerometer's axes, in its unit, from its readings corrected
        by these parameters.
        """
        return self.by_response(self.unbiased(summary))

    def unbiased(self, summary: Summary) -> Floats:
        """Return the mean (3,) of the readings less offset and slope, in the sensor's unit."""
        part = summary.segments
        has_rows = part.rows > 0
        levels = part.mean[has_rows] / summary.header.sensitivity - self._biases(summary)[has_rows]
        return np.asarray(np.average(levels, axis=0, weights=part.rows[has_rows]))

    def by_response(self, readings: Floats) -> Floats:
        """Return the specific force (3,) that gives these readings (3,) of an accelerometer without bias."""
        return np.asarray(np.linalg.solve(np.eye(3) + np.array(self.response), readings))

    def _biases(self, summary: Summary) -> Floats:
        """Return the bias (s, 3) of each segment from offset and slope, in the sensor's unit."""
        warm = (summary.segments.temperature_degc - REFERENCE_DEGC)[:, None]
        return np.asarray(np.array(self.offset) + warm * np.array(self.slope))


@dataclass(frozen=True)
class Rest:
    """One phase at rest: its `segments`, and for those with rows `deviation` (s, 3), the mean reading less the stimulus
    in the sensor's unit, and `variance` (s, 3) in squared counts.

    `force` (3,) is the mean specific force along the axes, as in `SegmentStimulus`. Phases on one `face` are averaged.
    Phases of one `group` are in the same log and attitude, so that only temperature changes their levels.
    """

    face: str
    group: tuple[int, str]
    segments: Segments
    deviation: Floats
    variance: Floats
    force: Floats

    @property
    def rows(self) -> Integers:
        """Number of rows (s,) of the segments with rows."""
        return self.segments.rows[self.segments.rows > 0]

    @property
    def degc(self) -> Floats:
        """Temperatures (s,) of these segments."""
        return self.segments.temperature_degc[self.segments.rows > 0]


class SegmentStimulus(NamedTuple):
    """Stimulus (s, 3) along a sensor's nominal axes in each segment: the measured quantity (`quantity`) in the sensor's
    unit, and the specific `force`, in the sensor's unit for an accelerometer and in g for others.
    """

    quantity: Floats
    force: Floats


def segment_stimulus(summary: Summary, motion: Motion, force_box: Floats | None) -> SegmentStimulus:
    """Return the stimulus along the nominal axes at the segments' mean times; with the force `force_box` (3,) in m/s^2
    instead of that of the motion, if given.
    """
    cache: dict[str, tuple[Motion, SegmentStimulus]] = vars(summary)  # used by the fit, and again by its residual
    if "stimulus" not in cache or cache["stimulus"][0] is not motion:
        cache["stimulus"] = (motion, _stimulus(summary, motion))
    known = cache["stimulus"][1]
    if force_box is None:
        return known
    along = np.broadcast_to(force_box @ np.array(summary.header.orientation), known.force.shape)
    if summary.header.quantity == "specific_force":
        force = along / SI_PER_UNIT[summary.header.unit]
        return SegmentStimulus(force, force)
    return known._replace(force=along / STANDARD_GRAVITY)


def _stimulus(summary: Summary, motion: Motion) -> SegmentStimulus:
    part, header = summary.segments, summary.header
    at_ns = np.rint(np.where(part.rows > 0, part.time_s, 0.0) * 1e9).astype(np.int64)
    moment = motion.stimulus(at_ns)
    measured = _along(np.asarray(getattr(moment, _COLUMN[header.quantity]), float), header)
    if header.quantity == "specific_force":
        return SegmentStimulus(measured, measured)
    force = np.asarray(moment.force_box, float) @ np.array(header.orientation) / STANDARD_GRAVITY
    return SegmentStimulus(measured, force)


def _along(vectors_box: Floats, header: SensorHeader) -> Floats:
    unit = 1.0 if header.quantity == "magnetic_field" else 1 / SI_PER_UNIT[header.unit]  # fields are in gauss
    return np.asarray(vectors_box @ np.array(header.orientation) * unit * header.adjustment)


def fit_sensor(
    header: SensorHeader, phases: Sequence[Rest], tolerance: Floats, steepest: Sequence[float] = (math.inf,) * 3
) -> FittedParameters:
    """Fit the parameters of one sensor to its phases; all zero without phases.

    The noise is the median of the segments' variances; the slope is that of the readings less the stimulus over
    temperature; offset and response are fitted to the remaining levels, with equal weights of the faces. `tolerance`
    (3, 3) bounds the response. On an axis whose slope exceeds the `steepest` (3,) of a part no slope is fitted, if the
    temperature changes by `STEEP_SPAN_DEGC`: a smaller change does not distinguish a slope from a wander.
    """
    if not phases:
        return FittedParameters(*((0.0, 0.0, 0.0),) * 3)
    raw_slope = slope_of(phases)
    slope = raw_slope and _triple(np.where(_is_steep(phases, raw_slope, steepest), 0.0, raw_slope))
    faces: dict[str, list[tuple[Floats, Floats]]] = {}
    for phase in phases:
        level = phase.deviation - (phase.degc - REFERENCE_DEGC)[:, None] * (slope or (0.0, 0.0, 0.0))
        faces.setdefault(phase.face, []).append((np.average(level, axis=0, weights=phase.rows), phase.force))
    levels, forces = (
        np.array([np.mean([pair[at] for pair in pairs], axis=0) for pairs in faces.values()]) for at in (0, 1)
    )
    rms = _rms_lsb(header, phases)
    noise = np.sqrt(np.square(rms) + rounding_lsb2(header)) / header.sensitivity
    raw, response = response_of(levels, forces, noise, tolerance)
    offset = np.mean(levels - forces @ response.T, axis=0)
    return FittedParameters(
        _triple(rms / header.sensitivity),
        _triple(offset),
        slope or (0.0, 0.0, 0.0),
        raw_slope or (0.0, 0.0, 0.0),
        _matrix(response),
        _matrix(raw),
        slope is not None,
    )


def _is_steep(phases: Sequence[Rest], slope: Triple, steepest: Sequence[float]) -> Booleans:
    """Return on which axes (3,) a slope is steeper than that of a part, over a sufficient change of temperature."""
    degc = np.concatenate([phase.degc for phase in phases])
    return np.abs(slope) > (steepest if np.ptp(degc) >= STEEP_SPAN_DEGC else math.inf)


def response_of(levels: Floats, forces: Floats, noise: Floats, tolerance: Floats) -> tuple[Floats, Floats]:
    """Return the response (3, 3) to specific force without bounds, and within `tolerance` (3, 3), from levels (f, 3) on
    f faces with the forces (f, 3).

    Least squares about the mean over faces, with the `noise` (3,) of single readings as the error of a level and a
    normal prior whose standard deviation is the tolerance: the response is 0 in directions along which the faces do not
    differ. Components that exceed their tolerance are fixed to it and the others are fitted again (active set).
    """
    nothing = np.zeros((3, 3))
    if len(levels) < 2 or not tolerance.any():
        return nothing, nothing
    force, level = forces - forces.mean(axis=0), levels - levels.mean(axis=0)
    raw, bounded = np.zeros((3, 3)), np.zeros((3, 3))
    for axis in range(3):
        bound = tolerance[axis]
        normal = force.T @ force / noise[axis] ** 2
        target = force.T @ level[:, axis] / noise[axis] ** 2
        free = bound > 0
        for number in range(_PASSES):
            fixed = np.where(free, 0.0, bounded[axis])
            prior = np.diag(1 / bound[free] ** 2)
            solved = np.linalg.solve(normal[np.ix_(free, free)] + prior, (target - normal @ fixed)[free])
            bounded[axis, free] = solved
            if number == 0:
                raw[axis] = bounded[axis]
            beyond = free & (np.abs(bounded[axis]) > bound)
            bounded[axis] = np.clip(bounded[axis], -bound, bound)
            free &= ~beyond
            if not beyond.any() or not free.any():
                break
    return raw, bounded


def rms_of(header: SensorHeader, phases: Sequence[Rest], correlations: Floats) -> Triple:
    """Return the rms of the noise in the sensor's unit, without rounding, for noise with the `correlations` (k,) at
    lags of 1 ... k rows.
    """
    return _triple(_rms_lsb(header, phases, correlations) / header.sensitivity)


def _rms_lsb(header: SensorHeader, phases: Sequence[Rest], correlations: Floats = WHITE) -> Floats:
    """Return the rms (3,) of the noise in counts: the root of the median over segments of the variance, less step^2 /
    12 for rounding (Sheppard's correction).

    The median of a variance with nu degrees of freedom is (1 - 2 / (9 nu))^3 times its mean (Wilson and Hilferty, PNAS
    17, 1931); it is not affected by a few glitches or jumps. The variance of n rows with correlations r_k at lag k
    about their own mean is 1 - (1 + 2 sum (1 - k / n) r_k) / n times the total variance, with (n - 1) / (1 + 2 sum
    r_k^2) degrees of freedom (Bartlett).
    """
    rows = np.concatenate([phase.rows for phase in phases])
    variance = np.concatenate([phase.variance for phase in phases])
    has_rows = rows >= _LEAST_ROWS
    if not has_rows.any():
        return np.zeros(3)
    count = rows[has_rows, None].astype(float)
    pairs = np.maximum(1 - np.arange(1, len(correlations) + 1) / count, 0.0)
    share = np.maximum(1 - (1 + 2 * pairs @ correlations) / count[:, 0], _LEAST_SHARE)[:, None]
    freedom = np.maximum((count - 1) / (1 + 2 * np.square(correlations).sum()), 1.0)
    unbiased = variance[has_rows] / share / (1 - 2 / (9 * freedom)) ** 3
    return np.asarray(np.sqrt(np.maximum(np.median(unbiased, axis=0) - rounding_lsb2(header), 0.0)))


def slope_of(phases: Sequence[Rest]) -> Triple | None:
    """Return the slope of the bias per degC, in the sensor's unit; None if the temperatures do not differ by
    `LEAST_HEATING_DEGC` in any attitude of a log.
    """
    products, squares = np.zeros(3), 0.0
    for group in dict.fromkeys(phase.group for phase in phases):
        members = [phase for phase in phases if phase.group == group]
        rows, degc, deviation = (
            np.concatenate([getattr(phase, name) for phase in members]) for name in ("rows", "degc", "deviation")
        )
        if np.ptp(degc) >= LEAST_HEATING_DEGC:
            warm = degc - np.average(degc, weights=rows)
            products += (rows * warm) @ deviation
            squares += float(rows @ warm**2)
    return _triple(products / squares) if squares > 0 else None


def rounding_lsb2(header: SensorHeader) -> float:
    """Return the variance of rounding to the codes that occur, step^2 / 12, in squared counts."""
    return code_span(header).step ** 2 / 12


def _triple(values: Floats) -> Triple:
    x, y, z = values.tolist()
    return x, y, z


def _matrix(values: Floats) -> Matrix:
    x, y, z = values
    return _triple(x), _triple(y), _triple(z)
