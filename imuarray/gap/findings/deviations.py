"""Single statistics that deviate: where, by how much, and whether that matters.

A difference matters if it changes a figure of use by 5 %. Noise matters by the error of heading or velocity after
coasting for 60 s (`imuarray.gap.model.downstream`), E = sqrt(2) tau sigma_A(tau). For white noise sigma_A(tau) = noise
/ sqrt(tau rows_per_s), which every recording has at least. A level adds in quadrature: it matters if the integral over
these 60 s is 0.32 E, sqrt(1.05^2 - 1), which raises the error's rms by 5 %.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from imuarray.arrays import Floats
from imuarray.gap.findings.diagnosis import Map, Size, Where
from imuarray.gap.inference.assessment import Assessment
from imuarray.gap.model.bench import Bench
from imuarray.gap.statistics.campaign import Campaign
from imuarray.gap.statistics.catalogue import Key, statistics
from imuarray.gap.statistics.pairs import Pairs
from imuarray.gap.statistics.probes import PROBES
from imuarray.gap.statistics.summary import Grid
from imuarray.log.format import SensorHeader

COASTING_S = 60.0
SHARE = 0.05
"""Relative change of a figure of use that matters."""

TWO_SIDED_95 = 1.96

_QUADRATURE = math.sqrt((1 + SHARE) ** 2 - 1)
"""Contribution, as a share of an rms, that raises the rms by `SHARE` when added in quadrature."""

_RMS = math.log1p(SHARE)
_VARIANCE = 2 * _RMS
_GENEROUS = math.log(1.25)
"""Margin of the log density at one place of the spectrum, of which the integral over 60 s passes next to nothing."""

_RUN_ROWS = 2.0
"""Margin of the longest run of equal rows."""

_CORRELATION = SHARE
_SCORE = 3.0
_WARMING_DEGC = 10.0
_THREE_SIGMA = 3.0
_ROWS_SHARE = 0.001
_CODES_SHARE = 0.05
_STIMULUS: Mapping[str, float] = MappingProxyType({"angular_rate": 90.0, "specific_force": 1.0})
"""Stimulus of one second in the sensor's unit: a quarter turn, or gravity."""


class SensorConditions(NamedTuple):
    """Conditions of one sensor in one log: `noise` of single readings in its unit, rows per second, and length."""

    header: SensorHeader
    noise: float
    rows_per_s: float
    seconds: float

    @property
    def level(self) -> float:
        """A constant whose integral over 60 s raises the rms of E by 5 %: 0.32 sqrt(2) sigma_A(60 s)."""
        return _QUADRATURE * math.sqrt(2) * self.noise / math.sqrt(COASTING_S * self.rows_per_s)


Rule = Callable[[SensorConditions], float]


def fixed(value: float) -> Rule:
    """Return a rule with the same margin for every sensor."""
    return lambda _: value


def level(per: float = 1.0) -> Rule:
    """Return a rule for a coefficient whose product with `per` is a level."""
    return lambda setting: setting.level / per


def response(setting: SensorConditions) -> float:
    """Return the margin of a response to motion, or of a delay in s, that raises the rms of E by 5 % when the box makes
    a quarter turn in a second (or feels 1 g for one second).
    """
    return setting.level * COASTING_S / _STIMULUS.get(setting.header.quantity, 1.0)


def unevenness(setting: SensorConditions) -> float:
    """Return the log variance of segments' log variances if the noise of segments is 5 % apart: (2 ln 1.05)^2 beside
    the 2 / (rows - 1) of Gaussian noise.
    """
    rows = setting.seconds * setting.rows_per_s
    in_segment = rows / Grid.of(round(rows)).segments
    return math.log1p(_VARIANCE**2 * max(in_segment - 1, 1.0) / 2)


def share(of_rows: float, usual: float = 0.0) -> float:
    """Return the change of the arcsine statistic of a share that rises by `of_rows` from its `usual` value."""
    return math.asin(math.sqrt(usual + of_rows)) - math.asin(math.sqrt(usual))


_ROWS = fixed(share(_ROWS_SHARE))
"""One reading in a thousand that is late, missing, clipped or invalid."""

_CODES = fixed(share(_CODES_SHARE))
_HALF = fixed(share(_CODES_SHARE / 2, usual=0.5))
"""One reading in twenty on a grid twice as coarse: half of these have another code."""

_TAILS = fixed(share(_ROWS_SHARE, usual=0.0027))
"""One step in a thousand more than the 0.27 % of Gaussian noise beyond 3 sigma."""

_SKEW = fixed(math.asinh(SHARE * _THREE_SIGMA * 6 / (_THREE_SIGMA**2 - 1)))
_KURTOSIS = fixed(math.log1p(SHARE * _THREE_SIGMA * 24 / (_THREE_SIGMA**3 - 3 * _THREE_SIGMA) / 3))
"""Skewness, and kurtosis over 3, that move the limit of 3 sigma, by which readings are thought wrong, by 5 % (Cornish
and Fisher 1937, first terms: (z^2 - 1) / 6 of the skewness, (z^3 - 3 z) / 24 of the excess)."""

MARGINS: Mapping[str, Rule] = MappingProxyType(
    {
        "mean": level(),
        "mean_halves": level(),
        "wander": fixed(_VARIANCE),
        "wander_uneven": _SKEW,
        "mean_return": level(),
        "level": level(),
        "noise": fixed(_RMS),
        "noise_excess": fixed(_RMS),
        "noise_halves": fixed(_VARIANCE),
        "noise_uneven": unevenness,
        "noise_force": fixed(_VARIANCE),
        "skewness": _SKEW,
        "kurtosis": _KURTOSIS,
        "tail": _TAILS,
        "extreme": fixed(_SCORE),
        "odd_codes": _HALF,
        "second_bit": _HALF,
        "absent_codes": _CODES,
        "code_ends": _ROWS,
        "code_pile": fixed(_SCORE),
        "band_1": fixed(_VARIANCE),
        "band_2": fixed(_VARIANCE),
        "band_3": fixed(_VARIANCE),
        "band_4": fixed(_GENEROUS),
        "band_5": fixed(_GENEROUS),
        "band_6": fixed(_GENEROUS),
        "line": fixed(_SCORE),
        "line_of_log": fixed(_SCORE),
        "alternation": fixed(_GENEROUS),
        "every_other": fixed(_SCORE),
        "lag_1": fixed(_CORRELATION),
        "lag_2": fixed(_CORRELATION),
        "lag_3": fixed(_CORRELATION),
        "lag_5": fixed(_CORRELATION),
        "arch": fixed(_CORRELATION),
        "allan_2": fixed(_VARIANCE),
        "allan_8": fixed(_VARIANCE),
        "allan_32": fixed(_VARIANCE),
        "allan_128": fixed(_VARIANCE),
        "allan_512": fixed(_VARIANCE),
        "allan_2048": fixed(_VARIANCE),
        "allan_longest": fixed(_VARIANCE),
        "jumps_8": _KURTOSIS,
        "jumps_32": _KURTOSIS,
        "jumps_128": _KURTOSIS,
        "thermal_slope": level(_WARMING_DEGC),
        "thermal_square": level(_WARMING_DEGC**2),
        "thermal_change": level(_WARMING_DEGC / COASTING_S),
        "thermal_residual": fixed(_VARIANCE),
        "thermal_noise": fixed(_VARIANCE / _WARMING_DEGC),
        "force_own": level(),
        "force_next": level(),
        "force_after": level(),
        "force_square": level(),
        "motion_gain": response,
        "motion_along": response,
        "motion_next": response,
        "motion_after": response,
        "motion_delay": response,
        "motion_residual": fixed(_VARIANCE),
        "motion_coupling": fixed(_VARIANCE),
        "motion_square": fixed(_CORRELATION),
        "motion_cube": fixed(_CORRELATION),
        "slow_own_axes": fixed(_CORRELATION),
        "slow_box_axes": fixed(_CORRELATION),
        "slow_between_axes": fixed(_CORRELATION),
        "fast_own_axes": fixed(_CORRELATION),
        "fast_box_axes": fixed(_CORRELATION),
        "fast_between_axes": fixed(_CORRELATION),
        "fast_other_chips": fixed(_CORRELATION),
        "level_apart": level(),
        "run_spread": fixed(_RMS),
        "run_scatter": fixed(_VARIANCE),
        "run_two_states": fixed(_GENEROUS),
        "run_outlier": fixed(_GENEROUS),
        "run_creep": level(),
        "run_profile": fixed(_VARIANCE),
        "interval": fixed(_VARIANCE),
        "irregularity": fixed(_GENEROUS),
        "gaps": _ROWS,
        "skips": _ROWS,
        "longest_interval": fixed(_GENEROUS),
        "repeats": _ROWS,
        "longest_repeat": fixed(_RUN_ROWS),
        "stale": _ROWS,
        "saturated": _ROWS,
        "lost": _ROWS,
        "doubt": _ROWS,
        "words": _ROWS,
    }
)
"""A rule for every probe; logs of noise change E by their own share, logs of variances by half of it.

A correlation r between neighbours, or between three sensors that are averaged, raises the variance of means by 2 r:
their rms by 5 % at r = 0.05. White noise makes an error with the root of the interval between rows: a log of the
interval counts as one of a variance. Slopes over temperature are for a warming by 10 degC, changes with dT/dt for one
within the 60 s, responses to force for the turn from a level axis to an upright one. Scores matter beyond 3.
"""


def margin(key: Key, header: SensorHeader, noise: Floats, rows_per_s: float, seconds: float) -> float:
    """Return the least difference of a statistic that matters, in its own unit.

    `noise` (3,) of single readings in the sensor's unit, `rows_per_s` and `seconds` of the log. KeyError for a probe
    without a rule.
    """
    axis_noise = float(noise["xyz".index(key.axis)]) if key.axis else float(np.sqrt(np.mean(np.square(noise))))
    return MARGINS[key.probe](SensorConditions(header, axis_noise, rows_per_s, seconds))


def sized(shift: float, scale: float, margin: float) -> Size:
    """Judge a difference `shift` with standard error `scale` by two one-sided tests.

    "material" if the 95 % interval of its size is beyond the margin, "harmless" if it is within (however significant),
    otherwise "can't tell", also for nan.
    """
    return sizes(np.array([shift]), np.array([scale]), np.array([margin]))[0]


def sizes(shift: Floats, scale: Floats, margin: Floats) -> tuple[Size, ...]:
    """Apply `sized` to arrays (n,)."""
    size, reach = np.abs(shift), TWO_SIDED_95 * np.asarray(scale)
    names: tuple[Size, ...] = ("can't tell", "harmless", "material")
    with np.errstate(invalid="ignore"):
        place = np.where(size - reach > margin, 2, np.where(size + reach < margin, 1, 0))
    return tuple(names[number] for number in place.tolist())


def needed(seconds: float, scale: float, margin: float) -> float:
    """Return the seconds of a log that would resolve a difference of `margin`, if one of `seconds` has the standard
    error `scale`, which falls with the root of the length; inf for a margin of 0.
    """
    return seconds * (TWO_SIDED_95 * scale / margin) ** 2 if margin > 0 else math.inf


def length_words(seconds: float) -> str:
    """Return the length to record in words with two digits, rounded up: "25 minutes"."""
    if not math.isfinite(seconds):
        return "no log is long enough"
    unit, size = next((name, size) for name, size, limit in _UNITS if seconds <= limit)
    count = max(seconds / size, 1.0)
    step = 10 ** max(math.floor(math.log10(count)) - 1, 0)
    rounded = math.ceil(count / step - 1e-9) * step
    return f"{rounded} {unit}{'' if rounded == 1 else 's'}"


def where_of(
    report: StatisticReport, assessment: Assessment, places: Iterable[int], p: Mapping[int, float]
) -> tuple[Where, ...]:
    """Return report entries of the statistics at these places of the pairs, by one model; `p` of those that have their
    own.
    """
    return tuple(report.where(at, assessment, p.get(at, assessment.p)) for at in places)


def map_of(pairs: Pairs, before: Assessment, after: Assessment, sensors: Sequence[str]) -> Map:
    """Return the largest normal scores by sensor and domain."""
    domains = tuple(dict.fromkeys(probe.domain for probe in PROBES.values()))
    tables = []
    for assessment in (before, after):
        table = np.full((len(sensors), len(domains)), np.nan)
        for key, score in zip(pairs.keys, assessment.normal.tolist(), strict=True):
            if math.isfinite(score):
                place = sensors.index(key.sensor), domains.index(key.domain)
                table[place] = np.fmax(table[place], abs(score))
        tables.append(table)
    return Map(tuple(sensors), domains, tables[0], tables[1], before.limit)


class StatisticReport:
    """Describes single statistics of a recorded campaign; `names` are the logs'."""

    def __init__(self, bench: Bench, campaign: Campaign, pairs: Pairs, names: Sequence[str]) -> None:
        self._bench, self._pairs = bench, pairs
        sides = (bench.split.train(campaign), bench.split.held_out(campaign))
        keys = (bench.keys[: bench.of_train], bench.keys[bench.of_train :])
        values = [statistics(side.campaign) for side in sides]
        self._raw = pairs.means(
            np.array(
                [side_values[key] for side_values, side_keys in zip(values, keys, strict=True) for key in side_keys]
            )
        )
        self._logs = [[names[log] for log in side.logs] for side in sides]
        self._phases = [[log.phases for log in side.campaign.logs] for side in sides]

    def where(self, at: int, assessment: Assessment, p: float) -> Where:
        """Return the report entry of the statistic at one place of the pairs."""
        key, header = self._pairs.keys[at], self._bench.base.headers[self._pairs.keys[at].sensor]
        probe = PROBES[key.probe]
        shift, scale = self._shift(at, assessment), self.scale(at, assessment)
        least = self.margin(at)
        raw = float(self._raw[at])
        return Where(
            log=self._log(at),
            sensor=key.sensor,
            axis=key.axis,
            domain=key.domain,
            phase=key.phase,
            statistic=key.probe,
            about=probe.about,
            real=raw,
            simulated=raw - shift,
            unit=probe.unit.replace("{u}", header.unit),
            significance=float(assessment.scores[at]),
            p=p,
            effect_size=shift / least if least > 0 else math.inf,
            margin=least,
            size=sized(shift, scale, least),
        )

    def margin(self, at: int) -> float:
        """Return the least difference of a statistic that matters."""
        key = self._pairs.keys[at]
        header = self._bench.base.headers[key.sensor]
        return margin(key, header, self._bench.base.fitted[key.sensor].noise(header), *self.rate_and_length(at))

    def rate_and_length(self, at: int) -> tuple[float, float]:
        """Return rows per second of the sensor, and the seconds of its log that were used."""
        key = self._key(at)
        phases = self._phases[self._side(at)][max(key.log, 0)]
        summaries = [phase.sensors[key.sensor] for phase in phases if key.sensor in phase.sensors]
        seconds = sum((phase.phase.end_ns - phase.phase.start_ns) * 1e-9 for phase in phases)
        rates = [1 / summary.intervals.mean_s for summary in summaries if summary.intervals.count]
        return (float(np.median(rates)) if rates else 1.0), seconds

    def scale(self, at: int, assessment: Assessment) -> float:
        """Standard error of a statistic's difference, of both parts together."""
        scales = assessment.likelihood.scale[self._parts(at)]
        known = scales[np.isfinite(scales)]
        return float(np.sqrt((known**2).sum()) / len(known)) if len(known) else math.nan

    def _shift(self, at: int, assessment: Assessment) -> float:
        """Difference of the recording from the model's location, averaged over the parts."""
        parts = assessment.deviation[self._parts(at)]
        return float(np.nanmean(parts)) if np.isfinite(parts).any() else math.nan

    def _parts(self, at: int) -> list[int]:
        """Return the places of the statistic in both parts."""
        return [int(place) for place in (self._pairs.train[at], self._pairs.held_out[at]) if place >= 0]

    def _log(self, at: int) -> str:
        key = self._key(at)
        return f"all {key.phase} logs" if key.log < 0 else self._logs[self._side(at)][key.log]

    def _key(self, at: int) -> Key:
        """Return the key of the statistic in its own part."""
        places = (self._pairs.train, self._pairs.held_out)[self._side(at)]
        return self._bench.keys[int(places[at])]

    def _side(self, at: int) -> int:
        """0 for the training part, 1 for a statistic of the held-out part alone."""
        return 0 if self._pairs.train[at] >= 0 else 1


_UNITS = (("second", 1.0, 90.0), ("minute", 60.0, 5400.0), ("hour", 3600.0, 172800.0), ("day", 86400.0, math.inf))
