"""What is said in the end: where the recording still differs with the causes in, how much is closed, the verdict."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from imuarray.gap.findings.closure import DeviatingStatistics
from imuarray.gap.findings.diagnosis import Cause, Gap, Map, Verdict, Where
from imuarray.gap.findings.equivalence_margins import margin, sized
from imuarray.gap.inference.assessment import Assessment, largest_of
from imuarray.gap.model.bench import Bench
from imuarray.gap.statistics.campaign import Campaign
from imuarray.gap.statistics.catalogue import Key, statistics
from imuarray.gap.statistics.pairs import Pairs, spread_of
from imuarray.gap.statistics.probes import PROBES
from imuarray.gap.statistics.synthetic_likelihood import FORM

Floats = npt.NDArray[np.float64]

EXPLAINED, PARTLY = 0.9, 0.3
"""Shares of the gap closed from which on it is explained, or partly. What is at work closes more than nine tenths as a
rule: of causes of one mechanism that closed 0.8 to 0.9, in all runs that have been looked at, 6 were right and 11 not.
"""

DOUBT = 0.05
"""The p of what is left below which something is left."""

_HALF, _STEEP = 0.65, 6.0
"""Share closed at which something unknown is as probable as not, and how fast that changes."""


def where_of(told: StatisticReport, one: Assessment, found: Iterable[int], p: Mapping[int, float]) -> tuple[Where, ...]:
    """The statistics at places `found` of the pairs, as one model makes them; `p` of those that have their own."""
    return tuple(told.where(at, one, p.get(at, one.p)) for at in found)


def map_of(pairs: Pairs, before: Assessment, after: Assessment, sensors: Sequence[str]) -> Map:
    """Largest scores by sensor and domain."""
    domains = tuple(dict.fromkeys(probe.domain for probe in PROBES.values()))
    tables = []
    for one in (before, after):
        table = np.full((len(sensors), len(domains)), np.nan)
        for key, score in zip(pairs.keys, one.scores.tolist(), strict=True):
            if math.isfinite(score):
                place = sensors.index(key.sensor), domains.index(key.domain)
                table[place] = np.fmax(table[place], abs(score))
        tables.append(table)
    return Map(tuple(sensors), domains, tables[0], tables[1], before.limit)


def gap_of(counted: DeviatingStatistics, floor: float, seed: int) -> Gap:
    """Overall, and by domain."""
    whole = counted.shrunk(seed)
    domains = {}
    for domain in counted.domains():
        chosen = np.array([key.domain == domain for key in counted.keys], bool)
        part = counted.of(chosen).shrunk(seed)
        domains[domain] = (part.before, part.after, part.closed)
    return Gap(whole.before, whole.after, floor, whole.closed, whole.interval, domains)


def floor_of(counted: DeviatingStatistics, before: Assessment, replicates: Floats) -> float:
    """Root mean square score of the same statistics where nothing is wrong: the median of replicates."""
    if len(counted.places) == 0:
        return 1.0
    squares = np.nan_to_num(before.likeness.scores(replicates)[:, counted.places]) ** 2
    return float(np.sqrt(np.median(squares @ counted.weights / counted.weights.sum())))


def beyond_form(pairs: Pairs, before: Assessment, after: Assessment, real: Floats, replicates: Floats) -> Floats:
    """(m,) scores of the recording under the model with its causes in, as `after` has them by these `replicates`; but
    causes may miss what they have moved since `before` by the share by which the form of the right ones may be wrong.
    """
    moved = np.nan_to_num(np.abs(after.likeness.location - before.likeness.location))
    wider = replace(after.likeness, scale=np.hypot(after.likeness.scale, FORM * moved))
    return np.asarray(pairs.sums(wider.scores(real)) / spread_of(pairs.sums(after.likeness.scores(replicates))))


def verdict_of(is_gap: bool, gap: Gap, after: Assessment, causes: Sequence[Cause], is_left: bool = False) -> Verdict:
    """In one word or two. What closes most of a gap explains it in part if something that matters `is_left`, be it what
    the causes break: two converters in turn are nearly a line at half the rate, which makes noise uneven as they don't.
    """
    if not is_gap:
        return "no gap"
    if not causes:
        return "unexplained"
    if gap.closed is None:
        return "explained" if after.p > DOUBT else "partly explained"
    if gap.closed >= EXPLAINED:
        return "partly explained" if is_left else "explained"
    return "partly explained" if gap.closed >= PARTLY else "unexplained"


def unknown_of(is_gap: bool, gap: Gap, after: Assessment, alike: float = 0.0) -> float:
    """Probability that something outside the library is present: by the share of the gap that the causes leave open,
    and by how far beyond chance what is left goes, in one place or everywhere `alike`
    (`imuarray.gap.inference.residuals`), in units of what chance reaches.
    """
    if not is_gap:
        return 0.0
    closed = gap.closed if gap.closed is not None else (1.0 if after.p > DOUBT else 0.0)
    largest = float(largest_of(after.scores))
    beyond = math.log(max(largest / max(after.limit, 1.0), alike, 0.1))
    return 1 / (1 + math.exp(min(max(_STEEP * (closed - _HALF) - beyond, -50.0), 50.0)))


class StatisticReport:
    """What is needed to tell of single statistics of a recorded campaign; `names` are the logs'."""

    def __init__(self, bench: Bench, campaign: Campaign, pairs: Pairs, names: Sequence[str]) -> None:
        self._bench, self._pairs = bench, pairs
        sides = (bench.split.train(campaign), bench.split.held_out(campaign))
        self._raw = pairs.means(np.concatenate([statistics(side.campaign).values for side in sides]))
        self._logs = [[names[log] for log in side.logs] for side in sides]
        self._phases = [[log.phases for log in side.campaign.logs] for side in sides]

    def where(self, at: int, one: Assessment, p: float) -> Where:
        """One statistic."""
        key, header = self._pairs.keys[at], self._bench.base.headers[self._pairs.keys[at].sensor]
        probe = PROBES[key.probe]
        shift, scale = self._shift(at, one), self.scale(at, one)
        least = self.margin(at)
        raw = float(self._raw[at])
        return Where(
            self._log(at),
            key.sensor,
            key.axis,
            key.domain,
            key.phase,
            key.probe,
            probe.about,
            raw,
            raw - shift,
            probe.unit.replace("{u}", header.unit),
            float(one.scores[at]),
            p,
            shift / least if least > 0 else math.inf,
            least,
            sized(shift, scale, least),
        )

    def margin(self, at: int) -> float:
        """The least difference of a statistic that matters."""
        key = self._pairs.keys[at]
        header = self._bench.base.headers[key.sensor]
        return margin(key, header, self._bench.base.fitted[key.sensor].noise(header), *self.size(at))

    def _shift(self, at: int, one: Assessment) -> float:
        """How far the recording lies from the middle of the model, the mean over the parts."""
        places = [place for place in (self._pairs.train[at], self._pairs.held_out[at]) if place >= 0]
        parts = one.apart[places]
        return float(np.nanmean(parts)) if np.isfinite(parts).any() else math.nan

    def scale(self, at: int, one: Assessment) -> float:
        """Standard error of a statistic's difference, of both parts together."""
        places = [place for place in (self._pairs.train[at], self._pairs.held_out[at]) if place >= 0]
        scales = one.likeness.scale[places]
        known = scales[np.isfinite(scales)]
        return float(np.sqrt((known**2).sum()) / len(known)) if len(known) else math.nan

    def _log(self, at: int) -> str:
        key = self._key(at)
        return f"all {key.phase} logs" if key.log < 0 else self._logs[self._side(at)][key.log]

    def _key(self, at: int) -> Key:
        """As its own part has it."""
        places = (self._pairs.train, self._pairs.held_out)[self._side(at)]
        return self._bench.keys[int(places[at])]

    def _side(self, at: int) -> int:
        """0 for the training part, 1 for what the held-out part alone has."""
        return 0 if self._pairs.train[at] >= 0 else 1

    def size(self, at: int) -> tuple[float, float]:
        """Rows a second of the sensor, and how long its log was looked at."""
        key = self._key(at)
        phases = self._phases[self._side(at)][max(key.log, 0)]
        own = [phase.sensors[key.sensor] for phase in phases if key.sensor in phase.sensors]
        seconds = sum((phase.phase.end_ns - phase.phase.start_ns) * 1e-9 for phase in phases)
        rates = [1 / one.intervals.mean_s for one in own if one.intervals.count]
        return (float(np.median(rates)) if rates else 1.0), seconds
