"""The base model: the simulation without any suspected effect, with a few parameters fitted to a campaign's summaries.

Every sensor has fitted `white_noise`, `bias`, a linear `thermal_bias` and a response to specific force that is fitted
within its tolerance. `scale`, `misalignment` and a gyroscope's `g_sensitivity` are drawn for every replicate from their
populations (`imuarray.gap.model.populations`), since they cannot be separated from a bias in a log with one attitude.
The phase of `own_clock` is drawn for every log, since it changes at every boot and is not determined by a log at rest.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property, lru_cache
from typing import Any, NamedTuple

import numpy as np

from imuarray.arrays import Floats
from imuarray.characterise.correlation import SEGMENT as CORRELATED_ROWS
from imuarray.gap.model.ambient_lines import MOST_FACTOR, AmbientLine
from imuarray.gap.model.data_clock import clock_errors, flags_repeats, repeated_share
from imuarray.gap.model.element_temperature import (
    LEAST_HEATING_DEGC,
    HeatedRest,
    fit_lag,
    longest_lags_s,
    usual_lag_s,
    with_element_temperatures,
)
from imuarray.gap.model.gravity import NO_CHANGE, Forces, estimated_forces, residual_forces
from imuarray.gap.model.populations import (
    BOARD_LAGS_S,
    BOARD_STRESS_SIGMA,
    CLOCK_SIGMA,
    CUTOFF_TOLERANCE,
    FLICKER_FLOOR,
    LEAST_CORRELATION,
    LONGEST_LAG_S,
    POSITION_SIGMA_MM,
    THERMAL_GROWTH_SIGMA,
    TOLERANCE_SIGMAS,
    response_tolerance,
    steepest_slope,
    usual_flicker,
    usual_model,
)
from imuarray.gap.model.rest import (
    REFERENCE_DEGC,
    FilterDraw,
    FittedParameters,
    Rest,
    fit_sensor,
    rms_of,
    segment_stimulus,
    slope_of,
)
from imuarray.gap.model.signal_delay import stated_delay
from imuarray.gap.recording.attitude import attitude_numbers
from imuarray.gap.recording.vibration import Vibration, vibration_along
from imuarray.gap.statistics.campaign import Campaign, LogSummary, PhaseSummary
from imuarray.gap.statistics.catalogue import (
    AXES,
    Key,
    ReplicateStatistics,
    Statistics,
    replicate_statistics,
    statistics,
)
from imuarray.gap.statistics.probes.level import halves, mean
from imuarray.gap.statistics.summary import Summary
from imuarray.log.format import SensorHeader
from imuarray.simulate.effect import FOREVER_S, Effect
from imuarray.simulate.effects.bandwidth import SEVERAL_SAMPLES, Bandwidth, has_correlations
from imuarray.simulate.effects.bias import Bias, BiasInstability
from imuarray.simulate.effects.noise import Tone
from imuarray.simulate.effects.response import SizeEffect, with_position
from imuarray.simulate.effects.temperature import ThermalBias, ThermalLag
from imuarray.simulate.effects.timing import AT_ITS_RATE, OwnClock
from imuarray.simulate.model import Model, noise_bandwidth_hz
from imuarray.simulate.motion.stimulus import Motion
from imuarray.simulate.signal import Triple
from imuarray.simulate.streams import Streams
from imuarray.units import INERTIAL, SI_PER_UNIT, STANDARD_GRAVITY

__all__ = ["Base", "FittedParameters", "fit", "headers_in", "replicate_seed", "residual", "select_fitted"]


_IN_STEP = OwnClock(phase_deg=math.nan)
"""Clock of a chip for which the model specifies none."""

_NOISE_POWERS = {"noise": 1, "motion_residual": 2, "run_spread": 1}
"""Probes whose values are logs of quantities in the sensor's unit to this power. These quantities are divided by the
fitted noise to the same power.
"""

_SAMPLES_A_ROW = 8
"""Number of samples per row from which on a digital filter cannot be distinguished from an analogue one."""

_LAGS, _CUTOFFS = 3, 101
"""Number of lags of the correlations to which a filter is fitted, and number of cutoffs that are tried for each number
of poles.
"""

_FORGOTTEN, _WANDERS, _FLAT = 0.1, 4.0, 0.9
"""Conditions for the estimate of a wander from the last lag: the largest correlation there that is expected of the
filter; the least share of the wander, in standard deviations of a correlation; the least ratio of the correlation to
that at the lag before.
"""

_DRIFTS, _DRIFT_BY_CHANCE = 0.35, 4.0
"""Drift over a phase, in standard deviations of the noise, that adds 0.01 to the correlations; drift that causes nearly
half of the variance; standard error of the drift, multiplied by the root of the number of rows.
"""

_ENOUGH_ROWS, _ENOUGH_SHARE = 500, 0.5
"""Least number of rows, and least share of all rows at rest, for which the correlations of the phases without a drift
are sufficient.
"""

_MEMORY, _MOST_LAGS = 5.0, 200
"""Number of time constants after which the correlation of a filter's noise is negligible, and largest number of lags in
rows.
"""

_ALL_LAGS = range(1, _LAGS + 3)
"""Lags to which the filter is fitted, and two further lags from which a wander is estimated."""

_MOST_REPEATED = 0.9
"""Upper limit of the share of repeated rows that is used in the fit of a filter."""

_FILTER_MISFIT = 0.1
"""Largest share of the sum of squared correlations that may remain after the fit of a filter. More remains with a
wander, a line or shared noise, and with some short digital filters.
"""

_BY_CHANCE = 2.0
"""Squared correlation, in variances of an estimated correlation, that is attributed to chance. The median of three axes
has less than half of this variance, so the sum over three lags exceeds six variances in one of 250 phases.
"""

_FAR_SMALLER, _LEAST_NOISE_SHARE = 0.5, 0.1
"""Least difference between the median of the correlations of three axes and those of the axis with the smallest ones,
as a share of the median, at which the median is that of a vibration; and the least share of the noise that is not
rounding by which correlations are divided.
"""

_EXPECTED = 0.35
"""Factor of that limit if the configured filter is below the Nyquist frequency of the rows and there are too few rows
for it to exceed the limit. This filter is expected, and a model without it would be wrong for most chips.
"""

_BELOW_NYQUIST = 0.9
"""Largest cutoff, as a share of half the chip's data rate, for which the configured filter is assumed if its
correlations are not significant. A filter with a cutoff of half the rate, as in the ADXL345, causes hardly any
correlation, but its digital form has a zero at half the rate.
"""

_AS_CONFIGURED = 0.006
"""Relative difference from the configured cutoff below which a filter counts as the configured one: slightly more than
half of the step between the cutoffs that are tried.
"""

_BETTER = 1.0
"""Least decrease of chi-squared for which the configured filter is preferred to none if the correlations are not
significant.
"""

_MEDIAN_VARIANCE = 0.45
"""Variance of the median of three independent correlations, divided by that of one (order statistics of the normal
distribution).
"""

_UNLIKELY = 4.0
"""Least ratio of the sum of squared correlations to its limit by chance at which a short filter is assumed although
none of the filters fits.
"""

_MEASURED = 1.5
"""Ratio of the misfit of the best filter to its limit by chance above which the measured correlations are used."""

_LARGEST_FORM_ERROR = 0.1
"""Largest uncertainty of the log of a cutoff that is attributed to the form of the filter. If the correlations hardly
depend on the cutoff, their residual does not determine its uncertainty.
"""

_FLICKER_SHOWS = 3.0
"""Least ratio of usual flicker to the standard error of the mean over a phase at which flicker can be noticeable."""

_RUNS = 64
"""Number of logs for which is drawn whether a machine in the surroundings runs; in later ones it does not."""

_GRAVITY_UP = np.array([0.0, 0.0, STANDARD_GRAVITY])

_FITTED = frozenset({"white_noise", "bias", "thermal_bias"})


@dataclass(frozen=True)
class Base:
    """The fitted base model of an array.

    `fitted`: parameters of the sensors by name. `model`: the other effects (None: the usual ones), whose populations
    are drawn with the `seed`. A sensor whose clock the model does not specify has a random clock phase at each boot.
    `queued`: sensors whose rows are the chip's own readings, for any error of its clock. `ambient_lines`: lines that
    all their sensors measure, with a different amplitude in each replicate. `common_bias_g`: standard deviation of the
    bias that the accelerometers of a replicate have in common; where an attitude is estimated from their readings, the
    fit mistakes a part of this bias for a tilt, as it does in the recording. `flickering`: sensors that have usual
    flicker of a random size in each replicate, since their phases are long enough for it to exceed the white noise.
    """

    headers: Mapping[str, SensorHeader]
    fitted: Mapping[str, FittedParameters]
    model: Model | None = None
    seed: int = 0
    queued: frozenset[str] = frozenset()
    ambient_lines: tuple[AmbientLine, ...] = ()
    common_bias_g: float = 0.0
    flickering: frozenset[str] = frozenset()

    def effects(self, replicate: int) -> dict[str, tuple[Effect, ...]]:
        """Return the effects of every sensor; `replicate` 0, 1, ... is the number of the drawn units."""
        drawn_effects = self.drawn(replicate)
        return {
            name: (*drawn_effects[name], *fitted.effects(self.filter_draw(name, replicate)))
            for name, fitted in self.fitted.items()
        }

    def filter_draw(self, sensor: str, replicate: int) -> FilterDraw:
        """Return the filter of a sensor in a replicate. Its cutoff deviates by at most 2 standard deviations, since a
        fit to few rows is less precise than the statistics of all rows; the noise of half of the replicates has the
        measured correlations.
        """
        stream = Streams(replicate_seed(self.seed, replicate)).of_unit(sensor, Bandwidth.name, "cutoff")
        return FilterDraw(float(np.clip(stream.standard_normal(), -2.0, 2.0)), bool(stream.uniform() < 0.5))

    def drawn(self, replicate: int) -> dict[str, tuple[Effect, ...]]:
        """Return the effects that are not fitted. They include neither white noise nor the individual bias; of a bias
        over temperature they include the curve, and the slope if the recording's temperatures do not determine it; for
        an accelerometer they include its position in the box, drawn around that of its header.

        In even replicates data clocks without a fitted error are in step with the polls; in odd ones these clocks have
        a rate error. A recording can be of either kind.
        """
        units = Streams(replicate_seed(self.seed, replicate))
        return {name: self._drawn(self.headers[name], units, replicate) for name in self.fitted}

    @cached_property
    def _usual(self) -> Model:
        return usual_model(self.headers.values())

    def __getstate__(self) -> dict[str, Any]:
        """Return the fields without cached results, which are computed again when needed."""
        return {item.name: getattr(self, item.name) for item in fields(self)}

    def _drawn(self, header: SensorHeader, units: Streams, replicate: int) -> tuple[Effect, ...]:
        is_slope_known = self.fitted[header.name].is_slope_known
        effects = tuple(_unfitted((self.model or self._usual).effects(header, units), is_slope_known))
        if header.quantity == "specific_force":
            effects = (*with_position(effects, _position_mm(header, units)), *self._common_bias(header, units))
        effects = (
            *effects,
            *self._tones(header, units),
            *self._thermal_effects(header, units, {type(effect) for effect in effects}),
            *self._flicker(header, units),
        )
        is_odd = bool(replicate % 2)
        if header.name in self.queued:  # rows have the times at which the chip took the readings
            return tuple(effect for effect in effects if not isinstance(effect, OwnClock))
        if not any(isinstance(effect, OwnClock) for effect in effects):
            effects = (_IN_STEP, *effects)
        clock_error = self.fitted[header.name].clock_error
        if math.isfinite(clock_error):
            clock = OwnClock(clock_error, math.nan, 1.0)
            effects = tuple(clock if isinstance(effect, OwnClock) else effect for effect in effects)
        if not is_odd:
            return effects
        deviate = float(units.of_unit(header.name, OwnClock.name, "rate_error").standard_normal())
        slow = CLOCK_SIGMA * min(max(deviate, -TOLERANCE_SIGMAS), TOLERANCE_SIGMAS)
        return tuple(_with_rate_error(effect, slow) for effect in effects)

    def _common_bias(self, header: SensorHeader, units: Streams) -> Iterator[Effect]:
        """Yield the components of the common bias along the axes of an accelerometer."""
        if self.common_bias_g:
            bias_box = self.common_bias_g * units.of_unit("", Bias.name, "common").standard_normal(3)
            bias = bias_box @ np.array(header.orientation) * STANDARD_GRAVITY / SI_PER_UNIT[header.unit]
            x, y, z = bias.tolist()
            yield Bias((x, y, z))

    def _thermal_effects(
        self, header: SensorHeader, units: Streams, kinds: Collection[type[Effect]]
    ) -> Iterator[Effect]:
        """Yield, if its slope is fitted, a random quadratic term of the bias over temperature, about 25 degC, and the
        bias by a part of the board that warms up later and stresses the chip; otherwise, for an inertial sensor with a
        bias over temperature and no lag among the `kinds` of its effects, a random lag of the element, which is not
        determined either.
        """
        if not self.fitted[header.name].is_slope_known:
            stream = units.of_unit(header.name, ThermalLag.name, "element")
            if header.quantity in INERTIAL and ThermalBias in kinds and ThermalLag not in kinds:
                yield ThermalLag(float(stream.uniform(0.0, LONGEST_LAG_S)))
            return
        slope = np.array(self.fitted[header.name].raw_slope)
        growth = THERMAL_GROWTH_SIGMA * units.of_unit(header.name, ThermalBias.name, "growth").standard_normal(3)
        x, y, z = (growth * slope).tolist()
        yield ThermalBias(quadratic=(x, y, z), reference_degc=REFERENCE_DEGC)
        stream = units.of_unit(header.name, ThermalLag.name, "board")
        shares, (shortest_s, longest_s) = BOARD_STRESS_SIGMA * stream.standard_normal(3), BOARD_LAGS_S
        x, y, z = (shares * slope).tolist()
        lag_s = shortest_s * (longest_s / shortest_s) ** float(stream.uniform())
        yield ThermalLag(lag_s, (x, y, z), REFERENCE_DEGC)

    def _flicker(self, header: SensorHeader, units: Streams) -> Iterator[Effect]:
        """Yield usual flicker of a random size for a sensor that is `flickering`."""
        if header.name in self.flickering:
            shares = units.of_unit(header.name, BiasInstability.name, "usual").uniform(0.0, 1.0, 3)
            x, y, z = (FLICKER_FLOOR[header.unit] * shares).tolist()
            yield usual_flicker((x, y, z))

    def _tones(self, header: SensorHeader, units: Streams) -> Iterator[Effect]:
        """Yield the ambient lines as a sensor of this replicate measures them. In half of the replicates the machine
        runs in each log only by chance.
        """
        for line in self.ambient_lines:
            if header.name in line.sensors:
                stream = units.of_unit("", Tone.name, f"{line.frequency_hz!r} Hz")
                tone = line.tone(header, float(stream.uniform(0.0, MOST_FACTOR)))
                by_chance, *is_running = (stream.uniform(0.0, 1.0, _RUNS + 1) < 0.5).tolist()
                runs = [run for run, runs_then in enumerate(is_running) if runs_then] if by_chance else []
                yield replace(tone, spans=tuple(value for run in runs for value in (run, 0.0, FOREVER_S)))


def _position_mm(header: SensorHeader, units: Streams) -> Triple:
    deviation_mm = POSITION_SIGMA_MM * units.of_unit(header.name, SizeEffect.name, "position").standard_normal(3)
    x, y, z = (np.array(header.position_mm) + deviation_mm).tolist()
    return x, y, z


def fit(
    campaign: Campaign,
    motions: Sequence[Motion],
    *,
    model: Model | None = None,
    seed: int = 0,
    accelerometers: int | None = None,
    vibrations: Sequence[Sequence[Vibration]] = (),
) -> Base:
    """Return the base model of a campaign; `motions` are the motions of the box, one for each log.

    The fit uses the segments of the phases at rest. The noise is the median of their variances. The offset is the mean
    of the readings less the stimulus along the nominal axes, with equal weights of the faces (opposite faces cancel a
    scale error). The slope is that of the means over temperature, with a separate mean for each log and face. If the
    attitude of the box was not noted, the stimulus is estimated from the array itself (`imuarray.gap.model.gravity`).
    `model` specifies the other effects. Their contributions to noise and level are included in the fitted figures too
    and are removed by `imuarray.gap.inference.comparison.settle_bench`. `accelerometers` is the number of
    accelerometers of the array, by default those of the campaign. `vibrations` are those of the surroundings in each
    log (none by default), which are not the sensors' noise.
    """
    headers = headers_in(campaign)
    vibrations = vibrations or ((),) * len(campaign.logs)
    lags_s = _lags(campaign, motions, headers)
    campaign = with_element_temperatures(campaign, motions, lags_s)
    forces = estimated_forces(campaign, motions, _thermal_change(campaign, motions, headers))
    rests = {
        name: [
            _without_vibrations(rest, header, vibrations[rest.group[0]])
            for rest in _at_rest(campaign, motions, forces, name)
        ]
        for name, header in headers.items()
    }
    if accelerometers is None:
        accelerometers = number_of_accelerometers(headers.values())
    fitted = {
        name: fit_sensor(header, rests[name], response_tolerance(header, accelerometers), steepest_slope(header))
        for name, header in headers.items()
    }
    for name, lag_s in lags_s.items():
        fitted[name] = replace(fitted[name], lag_s=lag_s)
    noise_counts = {name: np.array(fitted[name].rms) * header.sensitivity for name, header in headers.items()}
    errors = clock_errors(campaign, headers, noise_counts)
    for name, header in headers.items():
        fitted[name] = replace(fitted[name], clock_error=errors[name], delay=stated_delay(header))
        if model is not None and Bandwidth.name in model.parts(header):
            continue  # the model specifies the filter
        chip_filter = _filter_of(campaign, header, fitted[name], vibrations)
        if chip_filter.low_pass is not None:
            rms = rms_of(header, rests[name], _row_correlations(campaign, header, chip_filter.low_pass))
            fitted[name] = replace(fitted[name], rms=rms, **chip_filter._asdict())
    flickering = frozenset(name for name, header in headers.items() if _may_flicker(header, fitted[name], rests[name]))
    return Base(headers, fitted, model, seed, flickering=flickering)


def _may_flicker(header: SensorHeader, fitted: FittedParameters, rests: Sequence[Rest]) -> bool:
    """Return whether usual flicker exceeds the standard error of the mean over the longest phase at rest, due to white
    noise, by the factor `_FLICKER_SHOWS`.
    """
    rows = max((int(rest.rows.sum()) for rest in rests), default=0)
    floor = FLICKER_FLOOR.get(header.unit, 0.0)
    return bool(rows and _FLICKER_SHOWS * min(fitted.rms) / math.sqrt(rows) < floor)


def number_of_accelerometers(headers: Iterable[SensorHeader]) -> int:
    """Return the number of accelerometers among the sensors with these headers."""
    return sum(header.quantity == "specific_force" for header in headers)


def headers_in(campaign: Campaign) -> dict[str, SensorHeader]:
    """Return the headers of a campaign's sensors by name."""
    phases = (phase for log in campaign.logs for phase in log.phases)
    return {name: summary.header for phase in phases for name, summary in phase.sensors.items()}


def residual(campaign: Campaign, motions: Sequence[Motion], base: Base) -> Campaign:
    """Return the campaign with the predictions of `base` subtracted from the means of the segments at rest. The
    remaining levels, slopes and differences between faces are those that the fit does not explain. An attitude that was
    not noted is the mean of those that the accelerometers measure, corrected by their parameters. In turns only the
    bias is subtracted.
    """
    fitted = base.fitted
    campaign = select_fitted(campaign, fitted)
    campaign = with_element_temperatures(campaign, motions, {name: part.lag_s for name, part in fitted.items()})
    forces = residual_forces(campaign, motions, lambda summary: fitted[summary.header.name].mean_force(summary))
    logs = []
    for number, (log, motion) in enumerate(zip(campaign.logs, motions, strict=True)):
        parts = [
            _residual_phase(part, motion, forces.get((number, part.phase.start_ns)), base)
            if part.is_still
            else _residual_turn(part, log)
            for part in log.phases
        ]
        logs.append(replace(log, phases=tuple(parts)))
    return Campaign(tuple(logs))


def select_fitted(campaign: Campaign, fitted: Collection[str]) -> Campaign:
    """Return the campaign with only these sensors; others, for example sensors that are only in the held-out part, have
    no parameters.
    """
    if headers_in(campaign).keys() <= set(fitted):
        return campaign
    logs = []
    for log in campaign.logs:
        phases = [
            replace(part, sensors={name: summary for name, summary in part.sensors.items() if name in fitted})
            for part in log.phases
        ]
        logs.append(replace(log, phases=tuple(phases)))
    return Campaign(tuple(logs))


def residual_statistics(campaign: Campaign, motions: Sequence[Motion], base: Base) -> Statistics:
    """Return the statistics of the residuals of a fit, which was made to the campaign or to another part of it: levels
    less the predicted ones, and noises divided by the fitted ones.
    """
    raw = statistics(residual(campaign, motions, base))
    return replace(raw, values=raw.values - _predictions(raw.keys, [base])[0])


def replicated_statistics(
    campaigns: Sequence[Campaign], motions: Sequence[Motion], bases: Sequence[Base], sensors: Collection[str]
) -> ReplicateStatistics:
    """Return the values of `residual_statistics` for some sensors in several replicates that were summarised with the
    same layouts, each with its own fit.
    """
    residuals = [residual(campaign, motions, base) for campaign, base in zip(campaigns, bases, strict=True)]
    keys, values = replicate_statistics(residuals, sensors)
    return ReplicateStatistics(keys, values - _predictions(keys, bases))


def _predictions(keys: Sequence[Key], bases: Sequence[Base]) -> Floats:
    """Return the contribution (r, n) of the fitted noise to the statistics in `_NOISE_POWERS`; 0 for others."""
    noises = [
        {name: fitted.noise(base.headers[name]).tolist() for name, fitted in base.fitted.items()} for base in bases
    ]
    predicted = np.zeros((len(bases), len(keys)))
    for place in [place for place, key in enumerate(keys) if key.probe in _NOISE_POWERS]:
        key = keys[place]
        axis = AXES.index(key.axis)
        predicted[:, place] = [_NOISE_POWERS[key.probe] * math.log(noise[key.sensor][axis]) for noise in noises]
    return predicted


def replicate_seed(seed: int, replicate: int) -> int:
    """Return a 64-bit seed for each replicate that differs from every small seed."""
    high, low = np.random.SeedSequence((seed, replicate)).generate_state(2).tolist()
    return int(high) << 32 | int(low) | 1 << 63


def _at_rest(campaign: Campaign, motions: Sequence[Motion], forces: Forces, sensor: str) -> Iterator[Rest]:
    for number, (log, motion) in enumerate(zip(campaign.logs, motions, strict=True)):
        attitudes = attitude_numbers([phase.phase for phase in log.phases])
        for phase, attitude in zip(log.phases, attitudes, strict=True):
            if not phase.is_still or sensor not in phase.sensors:
                continue
            summary = phase.sensors[sensor]
            part = summary.segments
            has_rows = part.rows > 0
            if has_rows.any():
                place = (number, phase.phase.start_ns)
                stimulus = segment_stimulus(summary, motion, forces.get(place))
                alone = part.mean / summary.header.sensitivity - stimulus.quantity
                face = phase.phase.up or phase.phase.name
                group = (number, face if place not in forces else f"attitude {attitude}")
                force = np.average(stimulus.force[has_rows], axis=0, weights=part.rows[has_rows])
                yield Rest(
                    face,
                    group,
                    part,
                    alone[has_rows],
                    part.steady_variance[has_rows],
                    np.asarray(force),
                )


def _thermal_change(
    campaign: Campaign, motions: Sequence[Motion], headers: Mapping[str, SensorHeader]
) -> Callable[[Summary], Floats]:
    """Return a function that returns the change (3,) of a sensor's mean reading relative to 25 degC, in its unit, from
    the slope within single attitudes.
    """
    slopes = {
        name: slope_of(list(_in_any_attitude(campaign, motions, name))) if _is_heated(campaign, name) else None
        for name in headers
    }

    def change(summary: Summary) -> Floats:
        slope, part = slopes[summary.header.name], summary.segments
        has_rows = part.rows > 0
        if slope is None or not has_rows.any():
            return NO_CHANGE
        degc = float(np.average(part.temperature_degc[has_rows], weights=part.rows[has_rows]))
        return np.array(slope) * (degc - REFERENCE_DEGC)

    return change


def _in_any_attitude(campaign: Campaign, motions: Sequence[Motion], sensor: str) -> Iterator[Rest]:
    """Return the phases at rest with an arbitrary attitude; only changes within one attitude are meaningful."""
    nowhere = {
        (number, part.phase.start_ns): _GRAVITY_UP for number, log in enumerate(campaign.logs) for part in log.phases
    }
    return _at_rest(campaign, motions, nowhere, sensor)


def _lags(campaign: Campaign, motions: Sequence[Motion], headers: Mapping[str, SensorHeader]) -> dict[str, float]:
    """Return the time constants, in s, with which the sensors' elements follow the temperature of the box."""

    rests = {name: list(_in_any_attitude(campaign, motions, name)) for name in headers if _is_heated(campaign, name)}
    readings = {
        name: [HeatedRest(rest.group, rest.segments, motions[rest.group[0]], rest.deviation) for rest in phases]
        for name, phases in rests.items()
    }
    longest_s = longest_lags_s(readings)
    lags_s = {}
    for name, header in headers.items():
        if rests.get(name):
            noise = np.sqrt(np.mean([np.median(rest.variance, axis=0) for rest in rests[name]], axis=0))
            lags_s[name] = fit_lag(readings[name], noise / header.sensitivity, longest_s[name])
        else:
            lags_s[name] = usual_lag_s(
                [motion for log, motion in zip(campaign.logs, motions, strict=True) if _rows_at_rest(log, name)]
            )
    return lags_s


def _is_heated(campaign: Campaign, sensor: str) -> bool:
    """Return whether the temperatures of a sensor at rest in one log, over all attitudes, may differ enough to
    determine a slope or a lag.
    """
    for log in campaign.logs:
        degc = [phase.segments.temperature_degc for phase in log.still(sensor)]
        if degc and not float(np.ptp(np.concatenate(degc))) < LEAST_HEATING_DEGC:
            return True
    return False


def _rows_at_rest(log: LogSummary, sensor: str) -> int:
    """Return the number of rows of a sensor at rest."""
    return sum(phase.rows for phase in log.still(sensor))


def _residual_phase(phase: PhaseSummary, motion: Motion, force_box: Floats | None, base: Base) -> PhaseSummary:
    sensors = {}
    for name, summary in phase.sensors.items():
        predicted = base.fitted[name].predicted(summary, segment_stimulus(summary, motion, force_box))
        less = summary.segments.mean - predicted * summary.header.sensitivity
        sensors[name] = replace(summary, segments=replace(summary.segments, mean=less))
    return replace(phase, sensors=sensors)


def _residual_turn(phase: PhaseSummary, log: LogSummary) -> PhaseSummary:
    """Return a turn less the mean reading of each sensor at rest in the log, which for a gyroscope is its bias."""
    if phase.ups_box is None:
        return phase
    sensors = {}
    for name, summary in phase.sensors.items():
        rests = [mean(rest) for rest in log.still(name) if rest.rows]
        bias = np.mean(rests, axis=0) if rests else np.full(3, np.nan)
        less = summary.segments.mean - bias * summary.header.sensitivity
        sensors[name] = replace(summary, segments=replace(summary.segments, mean=less))
    return replace(phase, sensors=sensors)


class _Correlations(NamedTuple):
    """Correlations (p, k) of a sensor's noise in p phases at rest, at the first k lags, less those due to readings that
    are read repeatedly; the `reads` and the number of `rows` (p,) of the phases, and the least share (p,) of a wander
    that is detectable. `covers`: whether the phases have more than half of the rows at rest of the campaign.
    """

    values: Floats
    reads: tuple[_Reads, ...]
    rows: Floats
    least_wander: Floats
    covers: bool

    @property
    def by_chance(self) -> float:
        """Limit of the sum of squares over the lags that is attributed to chance, for the mean over the phases."""
        return _BY_CHANCE * _LAGS / float(self.rows.sum())

    def misfit(self, expected: Floats) -> float:
        """Return the sum of squares over the lags of the correlations less those `expected` (p, k) and a wander,
        averaged over the phases weighted by rows.
        """
        (misfit,) = self.misfits(expected[None])
        return misfit

    def misfits(self, expected: Floats) -> list[float]:
        """Return the `misfit` of each of several expected correlations (f, p, k)."""
        squares = np.square(self.beyond(expected)).sum(axis=-1)
        return [float(self.rows @ of_phases / self.rows.sum()) for of_phases in squares]

    def beyond(self, expected: Floats) -> Floats:
        """Return the correlations at the lags of the fit less those `expected` (..., p, k) and a wander."""
        return _beyond_wander(self.values, expected, self.least_wander)

    def mean(self, values: Floats) -> Floats:
        """Return the mean (k,) of values (p, k) over the phases, weighted by rows."""
        return np.asarray(self.rows @ values / self.rows.sum())


def _correlations(
    campaign: Campaign, header: SensorHeader, fitted: FittedParameters, vibrations: Sequence[Sequence[Vibration]]
) -> _Correlations | None:
    """Return the correlations of the noise in the phases that determine them; None if no phase does.

    Rows of a chip that is polled faster than it samples are 0, 1, ... samples apart (`_samples_apart`); rows that
    repeat a sample are equal for any filter. Rounding noise does not pass the filter, so the correlations are divided
    by the share of the other noise. Phases that drift, for example during heating, are left out if the others are
    sufficient (`_level_phases`).
    """
    every_rest = [
        (phase, of_log)
        for log, of_log in zip(campaign.logs, vibrations, strict=True)
        for phase in log.still(header.name)
        if phase.intervals.count
    ]
    is_level = _level_phases([phase for phase, _ in every_rest], fitted.noise(header))
    has_level = any(is_level)
    rests = [
        _with_correlations_of_noise(phase, of_log, has_drift=not level)
        for (phase, of_log), level in zip(every_rest, is_level, strict=True)
        if level or not has_level
    ]
    if not rests:
        return None
    is_flagged = flags_repeats(campaign, header)
    reads = tuple(_reads(phase, header.rate_hz, is_flagged) for phase in rests)
    again = np.array([[_samples_apart(pace.samples_a_row, lag).get(0, 0.0) for lag in _ALL_LAGS] for pace in reads])
    noise_share = np.maximum(np.square(fitted.rms) / np.square(fitted.noise(header)), _LEAST_NOISE_SHARE)
    rows = np.array([max(phase.rows, 1) for phase in rests], float)
    each = [
        (phase.correlation[list(_ALL_LAGS)] - at[:, None]) / noise_share for phase, at in zip(rests, again, strict=True)
    ]
    values = np.array([_of_filter(correlations, count) for correlations, count in zip(each, rows, strict=True)])
    covers = bool(2 * rows.sum() > sum(phase.rows for phase, _ in every_rest))
    least_wander = _WANDERS / np.sqrt([phase.rows for phase in rests])
    return _Correlations(values, reads, rows, least_wander, covers) if np.isfinite(values).all() else None


def _with_correlations_of_noise(phase: Summary, vibrations: Sequence[Vibration], *, has_drift: bool) -> Summary:
    """Return the phase with the correlations that the sensor's noise has without the vibrations of the surroundings and
    (`has_drift`) without the variance between the means of the segments, in each of the parts of the phase in which
    correlations are computed.
    """
    segments = phase.segments
    known = segments.rows > 0
    rows, mean = segments.rows[known].astype(float), segments.mean[known]
    within = rows @ segments.variance[known] / rows.sum()
    part = ((np.cumsum(rows) - rows / 2) // CORRELATED_ROWS).astype(int)
    of_part = np.eye(part.max() + 1)[part] * rows[:, None]
    between = rows @ np.square(mean - ((of_part.T @ mean) / of_part.sum(axis=0)[:, None])[part]) / rows.sum()
    variance = within + between
    other = np.zeros_like(phase.correlation)
    if has_drift:
        other += np.maximum(between - within * (len(rows) - part.max() - 1) / rows.sum(), 0.0)
    if any(vibration.quantity == phase.header.quantity for vibration in vibrations):
        span_ns = phase.phase.start_ns, phase.phase.end_ns
        lags_s = (np.arange(len(other)) * phase.intervals.mean_s).tolist()
        other += np.array([vibration_along(phase.header, vibrations, *span_ns, lag_s) for lag_s in lags_s])
    if not other.any():
        return phase
    remaining = np.maximum(variance - other[0], _LEAST_NOISE_SHARE * within)
    correlation = (phase.correlation * variance - other) / np.where(remaining > 0, remaining, 1.0)
    return replace(phase, correlation=np.where(remaining > 0, correlation.clip(-1.0, 1.0), phase.correlation))


def _without_vibrations(rest: Rest, header: SensorHeader, vibrations: Sequence[Vibration]) -> Rest:
    """Return the rest with the variances that its segments have without the vibrations of the surroundings."""
    if not any(vibration.quantity == header.quantity for vibration in vibrations):
        return rest
    time_s = rest.segments.time_s[rest.segments.rows > 0]
    shaken = np.zeros_like(rest.variance)
    for vibration in vibrations:
        within = (time_s >= vibration.start_ns * 1e-9) & (time_s < vibration.end_ns * 1e-9)
        if vibration.quantity == header.quantity and within.any():
            shaken[within] += vibration_along(header, [vibration], vibration.start_ns, vibration.end_ns)
    return replace(rest, variance=np.maximum(rest.variance - shaken, _LEAST_NOISE_SHARE * rest.variance))


def _of_filter(correlations: Floats, rows: float) -> Floats:
    """Return the correlations (k,) of the noise of a chip's filter from those (k, 3) of its axes: their median, or
    those of the axis with the smallest ones if these are far smaller. A filter acts on all axes, a vibration on some.
    """
    median = np.median(correlations, axis=1)
    least = correlations[:, np.square(correlations).sum(axis=0).argmin()]
    difference = np.linalg.norm(median - least)
    by_chance = _BY_CHANCE * math.sqrt(len(correlations) / rows)
    return least if difference > max(_FAR_SMALLER * float(np.linalg.norm(median)), by_chance) else median


class _ChipFilter(NamedTuple):
    """A chip's own filter, as in `FittedParameters`: None if the rows do not show one; the standard deviation of the
    log of its cutoff; and the same filter with the measured correlations, None if they are not known.
    """

    low_pass: Bandwidth | None = None
    low_pass_sd: float = 0.0
    measured_low_pass: Bandwidth | None = None


_NO_FILTER = _ChipFilter()
"""The filter of white noise."""


def _filter_of(
    campaign: Campaign, header: SensorHeader, fitted: FittedParameters, vibrations: Sequence[Sequence[Vibration]]
) -> _ChipFilter:
    """Return the chip's own filter.

    The filter is a least-squares fit to the correlations at lags 1 to 3. The candidates are filters of one and two
    poles with cutoffs within `CUTOFF_TOLERANCE` of the configured one, analogue and digital (behind a converter that
    samples at the chip's data rate), and white noise. If the misfit of the best filter is larger than chance allows,
    that filter is returned with the measured correlations. If no filter fits at all, this is done only if the
    correlations vanish after a few rows, as those of a short filter do; correlations of a wander, a line or shared
    noise persist. If neither the correlations nor their mean over the phases are larger than those of white noise by
    chance, the configured filter is returned if it fits better than none.
    """
    configured_hz = noise_bandwidth_hz(header)
    measured = _correlations(campaign, header, fitted, vibrations) if configured_hz > 0 else None
    if measured is None:
        return _NO_FILTER
    without_memory = measured.beyond(np.zeros_like(measured.values))
    if np.abs(without_memory).max() < LEAST_CORRELATION:
        return _NO_FILTER
    reads, phases = measured.reads, len(measured.reads)
    kinds = tuple(dict.fromkeys(reads))
    of_kind = [kinds.index(pace) for pace in reads]
    fastest_hz = max(pace.rows_per_s for pace in reads)
    is_seen = 0 < header.rate_hz < _SAMPLES_A_ROW * fastest_hz
    sampled_hz = header.rate_hz if is_seen else math.inf
    filters = _filters(configured_hz, sampled_hz)
    expected = np.stack([_filter_correlations(configured_hz, sampled_hz, pace) for pace in kinds], axis=1)[:, of_kind]
    shown = min(
        float(measured.mean(np.square(of_filter[:, :_LAGS])).sum())
        for effect, of_filter in zip(filters, expected, strict=True)
        if abs(effect.cutoff_hz / configured_hz - 1) < _AS_CONFIGURED
    )
    has_margin = header.rate_hz <= 0 or 2 * configured_hz < _BELOW_NYQUIST * header.rate_hz
    is_expected = has_margin and 2 * configured_hz < fastest_hz and measured.covers and shown < measured.by_chance
    chance = measured.by_chance * (_EXPECTED if is_expected else 1.0)
    white = measured.misfit(np.zeros_like(measured.values))
    misfits = measured.misfits(expected)
    places = range(len(filters))
    if white <= chance * phases and float(np.square(measured.mean(without_memory)).sum()) <= chance:
        as_configured = min(places, key=lambda at: (abs(filters[at].cutoff_hz - configured_hz), misfits[at]))
        is_better = has_margin and white - misfits[as_configured] > _BETTER / float(measured.rows.sum())
        return _ChipFilter(filters[as_configured]) if is_better else _NO_FILTER
    nearest = min(places, key=misfits.__getitem__)
    best, least = filters[nearest], misfits[nearest]
    is_filter = least < min(white, _FILTER_MISFIT * white + measured.by_chance * phases)
    correlations = _of_samples(measured, expected[nearest])
    if not is_filter or least > _MEASURED * measured.by_chance * phases:
        is_short = white > _UNLIKELY * measured.by_chance * phases and _is_forgotten(correlations, measured.rows.sum())
        if correlations and (is_filter or is_short):
            return _ChipFilter(replace(best, correlations=correlations))
    if not is_filter:
        return _NO_FILTER
    near = least + _MEDIAN_VARIANCE / float(measured.rows.sum())
    cutoffs_hz = [
        effect.cutoff_hz
        for effect, misfit in zip(filters, misfits, strict=True)
        if misfit < near and _form_of(effect) == _form_of(best)
    ]
    by_fit = math.log(max(cutoffs_hz) / min(cutoffs_hz)) / 2
    form_error = _form_error(measured, best, dict(zip(filters, expected, strict=True)))
    of_samples = replace(best, correlations=correlations) if correlations else None
    return _ChipFilter(best, math.hypot(by_fit, form_error), of_samples)


def _form_error(measured: _Correlations, best: Bandwidth, filters: Mapping[Bandwidth, Floats]) -> float:
    """Return the change of the log of the cutoff that changes the correlations by as much as their residual after the
    fit of the `best` filter, at most `_LARGEST_FORM_ERROR`: the response of a chip's filter is not exactly that of any
    of these filters.
    """
    family = {other.cutoff_hz: other for other in filters if _form_of(other) == _form_of(best)}
    low_hz, high_hz = min(family), max(family)
    change = measured.mean((filters[family[high_hz]] - filters[family[low_hz]])[:, :_LAGS])
    rest = measured.mean(measured.beyond(filters[best]))
    slope = float(np.linalg.norm(change)) / math.log(high_hz / low_hz)
    return min(float(np.linalg.norm(rest)) / slope, _LARGEST_FORM_ERROR) if slope > 0 else 0.0


def _form_of(effect: Bandwidth) -> tuple[float, float, float]:
    """Return what filters that differ only in their cutoff have in common."""
    return effect.poles, effect.sampled_hz, effect.warped


def _is_forgotten(correlations: Sequence[float], rows: float) -> bool:
    """Return whether the correlations, estimated from this number of rows, are negligible or due to chance beyond the
    lags to which filters are fitted.
    """
    by_chance = _BY_CHANCE * math.sqrt(_MEDIAN_VARIANCE / rows)
    return all(abs(correlation) < max(LEAST_CORRELATION, by_chance) for correlation in correlations[_LAGS:])


def _of_samples(measured: _Correlations, expected: Floats) -> tuple[float, ...]:
    """Return the correlations of successive samples of the chip without those of a wander, which is estimated from the
    last lag, beyond the correlation of the nearest filter, `expected` (p, k), there. Empty if the rows are not the
    chip's samples, or if no noise has these correlations.
    """
    if any(abs(pace.samples_a_row - 1) >= AT_ITS_RATE for pace in measured.reads):
        return ()
    samples_a_row = float(measured.mean(np.array([[pace.samples_a_row] for pace in measured.reads]))[0])
    apart = [_samples_apart(samples_a_row, lag) for lag in _ALL_LAGS]
    shares = np.array([[shares.get(samples, 0.0) for samples in _ALL_LAGS] for shares in apart])
    lasting = np.where(np.abs(expected[:, -1:]) < _FORGOTTEN, 0.0, expected)
    wander = _wander(measured.values, lasting, measured.least_wander)
    level = (measured.values - wander) / (1 - wander)
    correlations = tuple(np.linalg.lstsq(shares, measured.mean(level), rcond=None)[0].tolist())
    return correlations if has_correlations(correlations) else ()


def _level_phases(phases: Sequence[Summary], noise: Floats) -> list[bool]:
    """Return which phases have a level that does not drift compared with the `noise` (3,); none if those have few rows
    or less than half of all rows.

    A drift by d standard deviations of the noise over a phase adds d^2 / 12 to the correlations at all lags.
    """
    rows = np.array([max(phase.rows, 1) for phase in phases])
    drifts = np.array([float(np.median(np.abs(2 * halves(phase)) / noise)) for phase in phases])
    is_level = ~(drifts > _DRIFTS + 2 * _DRIFT_BY_CHANCE / np.sqrt(rows))
    if rows[is_level].sum() < max(_ENOUGH_ROWS, _ENOUGH_SHARE * rows.sum()):
        return [False] * len(phases)
    return [bool(level) for level in is_level]


def _row_correlations(campaign: Campaign, header: SensorHeader, effect: Bandwidth) -> Floats:
    """Return the correlations (k,) of noise behind a filter at lags of 1 ... k rows, up to the lag at which they are
    negligible.
    """
    phases = [phase for log in campaign.logs for phase in log.still(header.name) if phase.intervals.count]
    rows_per_s = 1 / float(np.median([phase.intervals.mean_s for phase in phases]))
    decay = effect.decay(rows_per_s)
    lags = range(1, min(math.ceil(_MEMORY / decay), _MOST_LAGS) + 1)
    by_filter = [effect.correlation(decay * lag) for lag in lags]
    return np.array([*effect.correlations, *by_filter[len(effect.correlations) :]])


def _beyond_wander(correlations: Floats, expected: Floats, least: Floats) -> Floats:
    """Return the correlations (p, k) of p phases at k lags less those `expected` (..., p, k) and those of a wander in
    each phase, at all lags except the last two.
    """
    wander = _wander(correlations, expected, least)
    return np.asarray((correlations - expected - wander * (1 - expected))[..., :_LAGS])


def _wander(correlations: Floats, expected: Floats, least: Floats) -> Floats:
    """Return the share (..., p, 1) of a slow wander in the variance in each of p phases.

    A wander with the share w of the variance changes a correlation r to r + w (1 - r) at every lag. The last lag
    determines w if the filter's correlation is small there, w is more than `least` (p,), and the correlation does not
    decrease significantly from the lag before. Otherwise the share is 0.
    """
    far, expected_far = correlations[:, -1], expected[..., -1]
    share = (far - expected_far) / (1 - expected_far)
    is_flat = far + least / _WANDERS > _FLAT * correlations[:, -2]
    is_wander = (np.abs(expected_far) < _FORGOTTEN) & (share > least) & is_flat
    return np.asarray(np.where(is_wander, share, 0.0)[..., None])


class _Reads(NamedTuple):
    """The reads of a sensor: their number per second, and the number of samples of the chip between two of them, which
    is computed from the share of repeated rows if it is near 1, below 1 or large.
    """

    rows_per_s: float
    samples_a_row: float


def _reads(phase: Summary, rate_hz: float, is_flagged: bool) -> _Reads:
    """Return the reads of a phase for a chip that samples at `rate_hz`, rounded so that results are cached for all
    phases with the same rate.
    """
    rows_per_s = round(1 / phase.intervals.mean_s, 2)
    samples_a_row = rate_hz / rows_per_s
    if not 1 + AT_ITS_RATE < samples_a_row < SEVERAL_SAMPLES:
        samples_a_row = 1 - min(max(repeated_share(phase, is_flagged), 0.0), _MOST_REPEATED)
    return _Reads(rows_per_s, round(samples_a_row, 2))


def _samples_apart(samples_a_row: float, lag: int) -> dict[int, float]:
    """Return the shares of the pairs of rows at the given lag that are 0, 1, ... samples of the chip apart, for uniform
    clocks.
    """
    least, rest = divmod(lag * samples_a_row, 1.0)
    return {int(least): 1 - rest, int(least) + 1: rest}


@lru_cache(maxsize=1024)
def _filter_correlations(configured_hz: float, sampled_hz: float, reads: _Reads) -> Floats:
    """Return the correlations (f, k) of noise behind each of f possible filters of a chip, at the first k lags of these
    reads, less those of white noise. Results are cached, since many replicates have the same reads.
    """
    rows_per_s, samples_a_row = reads
    filters = _filters(configured_hz, sampled_hz)
    expected = np.zeros((len(filters), len(_ALL_LAGS)))
    for at, effect in enumerate(filters):
        decay = effect.decay(rows_per_s * samples_a_row)
        for column, lag in enumerate(_ALL_LAGS):
            expected[at, column] = sum(
                share * effect.correlation(decay * samples)
                for samples, share in _samples_apart(samples_a_row, lag).items()
                if samples
            )
    expected.flags.writeable = False
    return expected


@lru_cache(maxsize=64)
def _filters(configured_hz: float, sampled_hz: float) -> tuple[Bandwidth, ...]:
    """Return the possible filters of the chip: analogue ones, and digital ones unless `sampled_hz` is infinite, which
    means that the rows are too slow to distinguish them from analogue ones.
    """
    return tuple(
        Bandwidth(ratio * configured_hz, poles=poles, sampled_hz=sampled, warped=warped)
        for sampled, warped in dict.fromkeys(((math.inf, 0.0), (sampled_hz, 0.0), (sampled_hz, 1.0)))
        for poles in ((1.0, 2.0) if math.isfinite(sampled) or not warped else ())
        for ratio in np.linspace(1 - CUTOFF_TOLERANCE, 1 + CUTOFF_TOLERANCE, _CUTOFFS).tolist()
    )


def _with_rate_error(effect: Effect, rate_error: float) -> Effect:
    """Return the clock with a rate error of the size of `rate_error` if its rate and phase are unknown; other effects
    are returned unchanged. The clock is made faster than the polls, since a slower one would repeat readings, and the
    rate of a clock with repeats is fitted.
    """
    if isinstance(effect, OwnClock) and not effect.rate_error and math.isnan(effect.phase_deg):
        return replace(effect, rate_error=abs(rate_error), polled=1.0)
    return effect


def _unfitted(effects: Iterable[Effect], is_slope_known: bool) -> Iterator[Effect]:
    for effect in effects:
        if isinstance(effect, ThermalBias) and not is_slope_known:
            yield effect
        elif isinstance(effect, ThermalBias) and any(effect.quadratic):
            yield replace(effect, slope=(0.0, 0.0, 0.0))
        elif effect.name not in _FITTED:
            yield effect
