"""Single statistics that deviate: where, by how much, and whether that matters (`imuarray.gap.statistics.margins`)."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence

import numpy as np
from scipy.special import ndtr

from imuarray.arrays import Floats
from imuarray.gap.findings.diagnosis import Map, Size, Where
from imuarray.gap.inference.assessment import Assessment
from imuarray.gap.model.bench import Bench
from imuarray.gap.statistics.campaign import Campaign
from imuarray.gap.statistics.catalogue import Key, statistics
from imuarray.gap.statistics.margins import SensorConditions
from imuarray.gap.statistics.pairs import Pairs
from imuarray.gap.statistics.probes import PROBES
from imuarray.log.format import SensorHeader

TWO_SIDED_95 = 1.96


def margin(key: Key, header: SensorHeader, noise: Floats, rows_per_s: float, seconds: float) -> float:
    """Return the least difference of a statistic that matters, in its own unit.

    `noise` (3,) of single readings in the sensor's unit, `rows_per_s` and `seconds` of the log. KeyError for a probe
    without a rule.
    """
    axis_noise = float(noise["xyz".index(key.axis)]) if key.axis else float(np.sqrt(np.mean(np.square(noise))))
    return PROBES[key.probe].margin(SensorConditions(header, axis_noise, rows_per_s, seconds))


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


def tail_p(normal: Floats) -> float:
    """Return the p-value of the largest of normal scores (m,), by the fitted tails and multiplied by their number
    (Bonferroni); nan without any.
    """
    known = np.abs(normal[np.isfinite(normal)])
    return float(min(1.0, 2 * len(known) * ndtr(-known.max()))) if len(known) else math.nan


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
