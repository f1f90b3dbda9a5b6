"""Parameters of one sensor from its phases at rest: noise, offset, slope over temperature, response to specific force.

Offset, slope and response are nuisance parameters: a data sheet leaves them to the part. Offset and slope are free. The
response (scale error and misalignment of an accelerometer, g-sensitivity of a gyroscope) is profiled within the chip's
tolerance: the part within it is no difference between simulator and recording, the part beyond it stays in the
residuals.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from imuarray.arrays import Floats, Integers
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
from imuarray.simulate.motion.felt import Motion
from imuarray.simulate.signal import Triple
from imuarray.units import SI_PER_UNIT, STANDARD_GRAVITY

Matrix = tuple[Triple, Triple, Triple]

REFERENCE_DEGC = 25.0
"""Temperature at which biases are given, as in data sheets."""

_LEAST_ROWS = 4
"""Fewest rows of a segment whose variance is used."""

WHITE = np.zeros(0)
"""The correlations of noise without a memory."""

_LEAST_SHARE = 0.2
"""Least share of the variance of noise with a memory that shows within a segment, if it is to tell the rest."""

_ADDED, _LARGEST = 0.3, 64.0
"""Least share of a variance that remains if something was added to it; largest factor by which one is scaled."""

_PASSES = 4
"""Passes of the active set, in which components of the response that reach their tolerance are fixed and the others
fitted again.
"""

NO_RESPONSE = ((0.0, 0.0, 0.0),) * 3
"""The response of a part that follows its nominal axes and scale exactly."""

_DISTINCT = 0.02
"""Relative difference of two variances from which on their simulations determine a slope."""

_COLUMN = {"specific_force": "force_box", "angular_rate": "rate_box", "magnetic_field": "field_box"}


@dataclass(frozen=True)
class FittedParameters:
    """Parameters of one sensor in its unit along its own axes; all zero for one that never was at rest.

    `rms` without that of rounding, `offset` at 25 degC, `slope` per degC. `response`: the reading of each axis (row)
    for each unit of specific force along each axis (column), per unit for an accelerometer and in the sensor's unit per
    g for others, within the chip's tolerance; `raw_response` as fitted without that bound. `is_slope_known`: whether
    temperatures differed enough. `low_pass`: the chip's own low-pass filter (None: white noise), the log of whose
    cutoff is known to `low_pass_sd`. `clock_error`: relative error of the rate of the chip's data clock, if repeated
    rows determine it (otherwise nan). `lag_s`: time constant with which the element follows the temperature of the box;
    offset and slope are over the element's temperature. `delay` of the signal.
    """

    rms: Triple
    offset: Triple
    slope: Triple
    response: Matrix = NO_RESPONSE
    raw_response: Matrix = NO_RESPONSE
    is_slope_known: bool = False
    low_pass: Bandwidth | None = None
    low_pass_sd: float = 0.0
    clock_error: float = math.nan
    lag_s: float = 0.0
    delay: SignalDelay = NO_DELAY

    def effects(self, deviate: float = 0.0) -> tuple[Effect, ...]:
        """Return the parameters as effects of the simulator; the cutoff differs by so many standard deviations."""
        noise: tuple[Effect, ...] = (WhiteNoise(self.rms),)
        if self.low_pass is not None:
            cutoff_hz = self.low_pass.cutoff_hz * math.exp(deviate * self.low_pass_sd)
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

        The difference of the noise variances is added, unless little or nothing would remain: then the simulation
        scales the noise, which is scaled back. Offsets are assumed to scale with the noise.
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
        """`moved` once more, with the noise by a secant through the simulations of these parameters and of those
        `before`, whatever the simulation adds to the noise's variance or scales it by.
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
        """Standard deviation (3,) of readings, rounding included."""
        return np.asarray(np.sqrt(np.square(self.rms) + rounding_lsb2(header) / header.sensitivity**2))

    def predicted(self, summary: Summary, stimulus: SegmentStimulus) -> Floats:
        """Predicted reading (s, 3) of each segment, in the sensor's unit."""
        return np.asarray(stimulus.felt + self._biases(summary) + stimulus.force @ np.array(self.response).T)

    def force_felt(self, summary: Summary) -> Floats:
        """Return the mean specific force (3,) along an accelerometer's axes by these parameters, in its unit."""
        return self.by_response(self.unbiased(summary))

    def unbiased(self, summary: Summary) -> Floats:
        """Return the mean (3,) of the readings without offset and slope."""
        part = summary.segments
        has_rows = part.rows > 0
        levels = part.mean[has_rows] / summary.header.sensitivity - self._biases(summary)[has_rows]
        return np.asarray(np.average(levels, axis=0, weights=part.rows[has_rows]))

    def by_response(self, readings: Floats) -> Floats:
        """Specific force (3,) for which an accelerometer without bias has these readings."""
        return np.asarray(np.linalg.solve(np.eye(3) + np.array(self.response), readings))

    def _biases(self, summary: Summary) -> Floats:
        """Return the bias (s, 3) of each segment by offset and slope, in the sensor's unit."""
        warm = (summary.segments.temperature_degc - REFERENCE_DEGC)[:, None]
        return np.asarray(np.array(self.offset) + warm * np.array(self.slope))


@dataclass(frozen=True)
class Rest:
    """One phase at rest: its `segments`, and of those that have rows the readings less the stimulus, `deviation` (s, 3)
    in the sensor's unit, and their variances in counts.

    `force` (3,) is the mean specific force along the axes, as in `SegmentStimulus`. Phases of one `face` are averaged;
    phases of one `group` are of one log and one attitude: only temperature changes their levels.
    """

    face: str
    group: tuple[int, str]
    segments: Segments
    deviation: Floats
    variance: Floats
    force: Floats

    @property
    def rows(self) -> Integers:
        """Rows (s,) of the segments that have any."""
        return self.segments.rows[self.segments.rows > 0]

    @property
    def degc(self) -> Floats:
        """Temperatures (s,) of these segments."""
        return self.segments.temperature_degc[self.segments.rows > 0]


class SegmentStimulus(NamedTuple):
    """Stimulus (s, 3) along a sensor's nominal axes in each segment: the measured quantity (`felt`) in its unit, and
    the specific `force`, in the unit of an accelerometer, in g for others.
    """

    felt: Floats
    force: Floats


def felt(summary: Summary, motion: Motion, force_box: Floats | None) -> SegmentStimulus:
    """Return the stimulus along the nominal axes at the segments' mean times; the force is `force_box` (3,) in m/s^2,
    if given.
    """
    cache: dict[str, tuple[Motion, SegmentStimulus]] = vars(summary)  # a fit asks, and the residual of the same summary
    if "felt" not in cache or cache["felt"][0] is not motion:
        cache["felt"] = (motion, _stimulus(summary, motion))
    known = cache["felt"][1]
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
    moment = motion.felt(at_ns)
    measured = _along(np.asarray(getattr(moment, _COLUMN[header.quantity]), float), header)
    if header.quantity == "specific_force":
        return SegmentStimulus(measured, measured)
    force = np.asarray(moment.force_box, float) @ np.array(header.orientation) / STANDARD_GRAVITY
    return SegmentStimulus(measured, force)


def _along(vectors_box: Floats, header: SensorHeader) -> Floats:
    unit = 1.0 if header.quantity == "magnetic_field" else 1 / SI_PER_UNIT[header.unit]  # a field comes in gauss
    return np.asarray(vectors_box @ np.array(header.orientation) * unit * header.adjustment)


def fit_sensor(header: SensorHeader, phases: Sequence[Rest], tolerance: Floats) -> FittedParameters:
    """Fit the parameters of one sensor to its phases; all zero without phases.

    Noise is the median of the segments' variances; the slope that of the readings less the stimulus over temperature;
    offset and response explain the rest, faces weighted equally. `tolerance` (3, 3) bounds the response.
    """
    if not phases:
        return FittedParameters(*((0.0, 0.0, 0.0),) * 3)
    slope = slope_of(phases)
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
        _matrix(response),
        _matrix(raw),
        slope is not None,
    )


def response_of(levels: Floats, forces: Floats, noise: Floats, tolerance: Floats) -> tuple[Floats, Floats]:
    """Response (3, 3) to specific force without bounds, and within `tolerance` (3, 3), from levels (f, 3) on f faces
    whose forces are (f, 3).

    Least squares about the faces' mean with a normal prior of the tolerance, by the `noise` (3,) of single readings:
    the response is 0 in directions in which no two faces differ. A component that reaches its tolerance is fixed there
    while the others are fitted again (an active set).
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
    """RMS of the noise in the sensor's unit, without rounding, whose `correlations` (k,) at lags of 1 ... k rows are
    known.
    """
    return _triple(_rms_lsb(header, phases, correlations) / header.sensitivity)


def _rms_lsb(header: SensorHeader, phases: Sequence[Rest], correlations: Floats = WHITE) -> Floats:
    """Root of the median over segments of the variance, less step^2 / 12 of rounding (Sheppard's correction).

    The median of a variance of nu degrees of freedom is (1 - 2 / (9 nu))^3 of its mean (Wilson and Hilferty, PNAS 17,
    1931); it is not affected by a few glitches or jumps. About their own mean, n rows that correlate by r_k at lag k
    have the variance 1 - (1 + 2 sum (1 - k / n) r_k) / n, of (n - 1) / (1 + 2 sum r_k^2) degrees of freedom (Bartlett).
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
    """Slope of the bias per degC; None if the temperatures of no attitude in a log differ enough."""
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
    """Return the variance of rounding to the codes that occur, step^2 / 12."""
    return code_span(header).step ** 2 / 12


def _triple(values: Floats) -> Triple:
    x, y, z = values.tolist()
    return x, y, z


def _matrix(values: Floats) -> Matrix:
    x, y, z = values
    return _triple(x), _triple(y), _triple(z)
