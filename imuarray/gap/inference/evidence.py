"""Evidence of one sensor in the training part of a campaign, from which candidates derive hypotheses.

A hypothesis holds at these times: always, from a moment on, in some logs, or during stretches of logs.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple, TypedDict

import numpy as np

from imuarray.arrays import Floats
from imuarray.gap.model.base_model import Base, FittedParameters, residual
from imuarray.gap.model.bench import Bench
from imuarray.gap.model.replication import SensorModel
from imuarray.gap.recording.events import Host, RepeatedRows
from imuarray.gap.recording.outliers import Outliers
from imuarray.gap.recording.phases import Up
from imuarray.gap.recording.resets import Reset
from imuarray.gap.statistics.campaign import Campaign, runs_in
from imuarray.gap.statistics.catalogue import Key
from imuarray.gap.statistics.cross import Cross
from imuarray.gap.statistics.probes import PROBES, PhaseProbe
from imuarray.gap.statistics.runs import Runs
from imuarray.gap.statistics.split import Side, Split
from imuarray.gap.statistics.summary import Summary
from imuarray.gap.statistics.synthetic_likelihood import LARGEST_SCORE
from imuarray.log.format import SensorHeader
from imuarray.simulate.effect import Effect


class Span(NamedTuple):
    """Part of log number `log`: from `moment_s`, in seconds since its epoch, for `length_s`."""

    log: int
    moment_s: float
    length_s: float

    @property
    def is_whole(self) -> bool:
        """True if the span is the whole log."""
        return self.moment_s <= 0 and math.isinf(self.length_s)


@dataclass(frozen=True)
class When:
    """`spans` of logs; always, if empty. `chosen`: how many numbers determine the spans (None: a log for each, and the
    moments at which it begins and ends).
    """

    spans: tuple[Span, ...] = ()
    chosen: int | None = None

    @property
    def triples(self) -> list[tuple[int, float, float]]:
        """(log, from, until), in the form of the simulation."""
        return [(span.log, span.moment_s, span.moment_s + span.length_s) for span in self.spans]

    @property
    def numbers(self) -> int:
        """The number of fitted or chosen numbers that determine the time."""
        if self.chosen is not None:
            return self.chosen
        return sum(1 + (span.moment_s > 0) + math.isfinite(span.length_s) for span in self.spans)

    def is_in_both(self, split: Split) -> bool:
        """Return whether both parts of a campaign contain a sufficient share of the spans."""
        if not self.spans:
            return True
        train_s, held_out_s = (self._seconds(split, held_out) for held_out in (False, True))
        return min(train_s, held_out_s) >= _SHARE * (train_s + held_out_s) > 0

    def _seconds(self, split: Split, held_out: bool) -> float:
        phases = split.phases(held_out)
        return sum(
            max(0.0, min(phase.end_ns * 1e-9, end_s) - max(phase.start_ns * 1e-9, begin_s))
            for log, begin_s, end_s in self.triples
            for phase in phases[log]
        )


ALWAYS = When()

SINGLE = 64
"""Largest number of events that are listed one by one."""

NATS_PER_NUMBER = 1.0
"""Cost in nats of each number that was chosen for a time: the moment of an event, or its length. A hypothesis that
needs both parts gains the mean of their gains, and an event lies in one part.
"""

_CHOSEN_EVENTS = 4
"""Largest number of events that cost a number each."""

_SHARE = 0.2
"""Least share of the time of an effect in each part of the campaign: with less, a part does not determine the
effect.
"""


def rarity_of_events(count: int) -> float:
    """Return the nats by which an effect at this many known moments is rarer than one without moments. From a few
    events on, the moments do not matter: others of the same frequency explain the statistics as well.
    """
    return NATS_PER_NUMBER * min(count, _CHOSEN_EVENTS)


def in_logs(logs: Collection[int]) -> When:
    """Return the time of the whole of these logs."""
    return When(tuple(Span(log, 0.0, math.inf) for log in sorted(logs)))


def since(first: Span, logs: Collection[int]) -> When:
    """Return the time from the beginning of a span on, in its log and in the later `logs`."""
    return When((first, *in_logs([log for log in logs if log > first.log]).spans), 2)


def join_spans(whens: Iterable[When]) -> When:
    """Return all spans of these times."""
    return When(tuple(sorted(span for when in whens for span in when.spans)))


class Stretches(TypedDict):
    """Parameters of an effect whose single stretches are known."""

    runs: tuple[float, ...]
    moments_s: tuple[float, ...]
    lengths_s: tuple[float, ...]


def stretches(spans: Sequence[Span]) -> Stretches:
    """Return the stretches of the spans: log, begin and length."""
    return {
        "runs": tuple(float(span.log) for span in spans),
        "moments_s": tuple(span.moment_s for span in spans),
        "lengths_s": tuple(span.length_s for span in spans),
    }


@dataclass(frozen=True)
class PhaseEvidence:
    """One phase of log number `log` of the campaign.

    `raw` is the summary as recorded; `residual` is the same with the model's prediction (bias, slope, nominal axes)
    subtracted from the means of its segments (in turns only the bias). `cross` has the moments that the array's sensors
    share in the phase, `ups_box` the directions up at the beginning and the end of a turn.
    """

    log: int
    kind: str
    is_still: bool
    raw: Summary
    residual: Summary
    cross: Cross | None
    ups_box: tuple[Up, Up] | None = None


@dataclass(frozen=True)
class Spell:
    """Evidence of a sensor at the time `when` it reads differently from the rest of a log."""

    when: When
    phases: tuple[PhaseEvidence, ...]


class Repetition(NamedTuple):
    """A stretch `span` of `rows` rows that repeat the row before, all with the same `counts`."""

    span: Span
    rows: int
    counts: tuple[int, int, int]


@dataclass(frozen=True)
class Evidence:
    """Evidence of one sensor, and its present model.

    `values`, `expected` and `scores` of each probe are (m, 3), or (m, 1) for a probe of the whole sensor, with a row
    for every phase, log or series of the training part: the statistic, its value under the model, and the deviation in
    standard deviations; nan if it is not known. `effects` are those of the present model, `runs` the sensor's boots if
    there is a turn-on series, `others` the sensors that measure the same quantity.

    Events: `holes` are times of lost rows; `repeated` rows lie in any phase or in none; `outliers` are given with their
    log for each phase in which the box moves; `hosts` are delays of the host that show in all sensors; `resets` are
    stretches, with their log, in which the recorder noticed that the chip had lost its configuration.

    `rows_of`: the log of each row of a probe, -1 for several logs. `is_refitted`: noise, bias and slope are fitted to
    this evidence; otherwise they come from an earlier recording and may have changed. `spells`: stretches in which the
    sensor reads differently from the rest of the log. `twins` are the phases of others of the same chip, under the base
    model with the parameters `twin_fitted`. All evidence lies within `when`.
    """

    header: SensorHeader
    fitted: FittedParameters
    phases: tuple[PhaseEvidence, ...]
    values: Mapping[str, Floats]
    expected: Mapping[str, Floats]
    scores: Mapping[str, Floats]
    effects: tuple[Effect, ...]
    runs: Runs | None = None
    others: tuple[SensorHeader, ...] = ()
    holes: tuple[Span, ...] = ()
    repeated: tuple[Repetition, ...] = ()
    outliers: tuple[tuple[int, Outliers], ...] = ()
    hosts: tuple[Host, ...] = ()
    resets: tuple[tuple[int, Reset], ...] = ()
    rows_of: Mapping[str, tuple[int, ...]] = field(default_factory=dict)
    is_refitted: bool = True
    spells: tuple[Spell, ...] = ()
    twins: Mapping[str, tuple[PhaseEvidence, ...]] = field(default_factory=dict)
    twin_fitted: Mapping[str, FittedParameters] = field(default_factory=dict)
    when: When = ALWAYS

    def within(self, logs: Collection[int]) -> Evidence:
        """Return the evidence of these logs alone, by their numbers in the campaign, without statistics of several
        logs.
        """
        chosen = {probe: [at in logs for at in row_logs] for probe, row_logs in self.rows_of.items()}
        values, expected, scores = (
            {probe: rows[chosen[probe]] for probe, rows in table.items() if any(chosen.get(probe, ()))}
            for table in (self.values, self.expected, self.scores)
        )
        return replace(
            self,
            phases=tuple(phase for phase in self.phases if phase.log in logs),
            values=values,
            expected=expected,
            scores=scores,
            runs=None,
            holes=tuple(hole for hole in self.holes if hole.log in logs),
            repeated=tuple(repetition for repetition in self.repeated if repetition.span.log in logs),
            outliers=tuple((log, lone) for log, lone in self.outliers if log in logs),
            resets=tuple((log, reset) for log, reset in self.resets if log in logs),
            rows_of={probe: tuple(at for at in row_logs if at in logs) for probe, row_logs in self.rows_of.items()},
            spells=(),
            twins={name: tuple(phase for phase in phases if phase.log in logs) for name, phases in self.twins.items()},
        )

    def during(self, spell: Spell) -> Evidence:
        """Return the evidence of a spell, relative to the model of whole phases of its log, with larger errors for
        fewer rows.
        """
        (log,) = {phase.log for phase in spell.phases}
        whole = self.within([log])
        rows = [sum(phase.raw.rows for phase in phases) / len(phases) for phases in (whole.phases, spell.phases)]
        values: dict[str, Floats] = {}
        expected: dict[str, Floats] = {}
        scores: dict[str, Floats] = {}
        for name, probe in PROBES.items():
            if not isinstance(probe, PhaseProbe) or name not in whole.scores:
                continue
            middle, scatter = _usual(whole, name)
            statistic_values = np.array([probe.statistic(phase.residual) for phase in spell.phases]).reshape(
                len(spell.phases), -1
            )
            values[name] = statistic_values - np.log(self.noise) if name == _OVER_NOISE else statistic_values
            expected[name] = np.broadcast_to(middle, statistic_values.shape)
            scores[name] = (values[name] - middle) / (scatter * math.sqrt(max(rows[0] / rows[1], 1.0)))
        return replace(
            whole,
            phases=spell.phases,
            values=values,
            expected=expected,
            scores=scores,
            rows_of={name: (log,) * len(spell.phases) for name in values},
            when=spell.when,
        )

    @property
    def furthest(self) -> float:
        """The largest absolute score of all probes."""
        return max((float(np.nan_to_num(np.abs(rows)).max(initial=0.0)) for rows in self.scores.values()), default=0.0)

    @property
    def still(self) -> tuple[PhaseEvidence, ...]:
        """The phases at rest."""
        return tuple(phase for phase in self.phases if phase.is_still)

    @property
    def noise(self) -> Floats:
        """Standard deviation (3,) of single readings as fitted, in the sensor's unit, rounding included."""
        return self.fitted.noise(self.header)

    @property
    def rows_per_s(self) -> float:
        """Median over phases of the mean rate of the sensor's rows, 1/s."""
        intervals = [phase.raw.intervals.mean_s for phase in self.phases if phase.raw.intervals.count]
        return float(1 / np.median(intervals)) if intervals else max(self.header.rate_hz, 1.0)

    def score(self, *probes: str) -> Floats:
        """Return the score (3,) of these probes with the largest absolute value on each axis; 0 without scores. The
        score of a whole sensor counts for each axis.
        """
        rows = [np.broadcast_to(self.scores[probe], (len(self.scores[probe]), 3)) for probe in self._scored(probes)]
        scores = np.nan_to_num(np.concatenate([np.zeros((1, 3)), *rows]))
        return np.asarray(scores[np.abs(scores).argmax(axis=0), range(3)])

    def is_odd(self, *probes: str, beyond: float = 3.0) -> bool:
        """Return whether the score of any of these probes exceeds `beyond` on an axis."""
        return bool((np.abs(self.score(*probes)) > beyond).any())

    def shift(self, probe: str) -> Floats:
        """Return the deviation (3,) from the model in the row with the largest score, by axis; 0 without rows."""
        if probe not in self.scores:
            return np.zeros(3)
        shape = (len(self.scores[probe]), 3)
        size = np.abs(np.nan_to_num(np.broadcast_to(self.scores[probe], shape)))
        deviation = np.nan_to_num(np.broadcast_to(self.values[probe] - self.expected[probe], shape))
        return np.asarray(deviation[size.argmax(axis=0), range(3)])

    def typical(self, probe: str) -> Floats:
        """Return the median (3,) over the rows of the deviation from the model; 0 without rows."""
        deviation = self.values[probe] - self.expected[probe] if probe in self.scores else np.zeros((0, 1))
        known = deviation[np.isfinite(deviation).all(axis=1)]
        return np.asarray(np.broadcast_to(np.median(known, axis=0) if len(known) else np.zeros(1), (3,)))

    def _scored(self, probes: Sequence[str]) -> list[str]:
        return [probe for probe in probes if probe in self.scores]


def evidence_of(
    bench: Bench, train: Side, sensor: str, scored: ScoredStatistics, modelled: SensorModel, effects: tuple[Effect, ...]
) -> Evidence:
    """Return the evidence of a sensor in the recorded training part, with this model; `effects` are those of the
    model.
    """
    logs = [(log, bench.motions[at]) for log, at in zip(train.campaign.logs, train.logs, strict=True)]
    base = replace(bench.base, fitted={**bench.base.fitted, sensor: modelled.fitted})
    residuals = residual(train.campaign, [motion for _, motion in logs], base)
    phases = _phases_of(sensor, train, residuals)
    header = phases[0].raw.header
    others = tuple(
        other for other in bench.base.headers.values() if other.quantity == header.quantity and other.name != sensor
    )
    twins = [other.name for other in others if other.chip == header.chip]
    series = train.campaign.series().get("turn-on", ())
    numbered = zip(train.logs, train.campaign.logs, strict=True)
    events = [(number, log.events[sensor]) for number, log in numbered if sensor in log.events]
    return Evidence(
        header,
        modelled.fitted,
        phases,
        _by_probe(scored, scored.values),
        _by_probe(scored, scored.expected),
        _by_probe(scored, scored.scores),
        effects,
        runs_in(series, sensor) if series else None,
        others,
        tuple(hole for log, log_events in events for hole in _holes(log, log_events.holes)),
        tuple(repetition for log, log_events in events for repetition in _repeated(log, log_events.repeated)),
        tuple((log, lone) for log, log_events in events for lone in log_events.outliers),
        tuple(log_events.host for _, log_events in events),
        tuple((log, reset) for log, log_events in events for reset in log_events.resets),
        _logs_by_probe(scored),
        bench.is_refitted,
        tuple(_spells(bench, train, sensor, base)),
        {name: twin_phases for name in twins if (twin_phases := _phases_of(name, train, residuals))},
        {name: bench.base.fitted[name] for name in twins},
    )


def _phases_of(sensor: str, train: Side, residuals: Campaign) -> tuple[PhaseEvidence, ...]:
    """Return the phases of a sensor as recorded and with the model's prediction subtracted (`residuals`)."""
    return tuple(
        PhaseEvidence(
            number, log.kind, raw.is_still, raw.sensors[sensor], without.sensors[sensor], raw.cross, raw.ups_box
        )
        for number, log, bare in zip(train.logs, train.campaign.logs, residuals.logs, strict=True)
        for raw, without in zip(log.phases, bare.phases, strict=True)
        if sensor in raw.sensors
    )


_OVER_NOISE = "noise"
"""The statistic of a phase that is expressed relative to the fitted noise."""

_SURE = 0.01
"""Least absolute score from which the scatter of a statistic is inferred."""


def _usual(evidence: Evidence, probe: str) -> tuple[Floats, Floats]:
    """Return the median over rows (k,) of a probe's value under the model, and of its scatter."""
    values, expected, scores = (table[probe] for table in (evidence.values, evidence.expected, evidence.scores))
    sure = (np.abs(scores) > _SURE) & (np.abs(scores) < LARGEST_SCORE)
    with np.errstate(divide="ignore", invalid="ignore"):
        scatter = np.where(sure, (values - expected) / scores, np.nan)
    known = np.isfinite(expected).any(axis=0), np.isfinite(scatter).any(axis=0)
    medians = np.full((2, values.shape[1]), np.nan)
    for at, (table, columns) in enumerate(zip((expected, scatter), known, strict=True)):
        medians[at, columns] = np.nanmedian(table[:, columns], axis=0)
    return medians[0], medians[1]


VIEWS = 4
"""Largest number of parts of the evidence that are viewed separately; more would repeat them."""

_SAYS = 3.0
"""Largest absolute score of a part from which on it is viewed separately."""

SAME_RATE = 1.1
"""Largest ratio of the row rates of logs that have the same rate."""


def views(evidence: Evidence) -> Iterator[Evidence]:
    """Yield the evidence of all logs; then of the logs of each rate, of each kind, of single logs, and of spells, those
    with the largest deviation first. An effect that shows at one rate, or in one log, vanishes in the median over all.
    """
    yield evidence
    logs = sorted({phase.log for phase in evidence.phases})
    parts = [
        *_group(logs, [round(math.log(_rows_per_s(evidence, log), SAME_RATE)) for log in logs]),
        *_group(logs, [next(phase.kind for phase in evidence.phases if phase.log == log) for log in logs]),
        *((log,) for log in logs),
    ]
    alone = [evidence.within(part) for part in dict.fromkeys(parts) if len(part) < len(logs)]
    spells = [evidence.during(spell) for spell in evidence.spells]
    for several in (alone, spells):
        ranked = sorted(several, key=lambda view: -view.furthest)
        yield from (view for view in ranked[:VIEWS] if view.furthest > _SAYS)


def _group(logs: Sequence[int], by: Sequence[object]) -> Iterator[tuple[int, ...]]:
    for value in dict.fromkeys(by):
        yield tuple(log for log, log_value in zip(logs, by, strict=True) if log_value == value)


def _rows_per_s(evidence: Evidence, log: int) -> float:
    """Return the usual rate of rows in one log, 1/s."""
    return replace(evidence, phases=tuple(phase for phase in evidence.phases if phase.log == log)).rows_per_s


def _spells(bench: Bench, side: Side, sensor: str, base: Base) -> Iterator[Spell]:
    """Yield the spells of the logs of a part, with the model's prediction subtracted from their means."""
    for number, log in zip(side.logs, side.campaign.logs, strict=True):
        for stretches, part in log.spells.get(sensor, ()):
            (residuals,) = residual(Campaign((part,)), [bench.motions[number]], base).logs
            when = When(tuple(Span(number, begin_s, end_s - begin_s) for begin_s, end_s in stretches))
            phases = tuple(
                PhaseEvidence(number, log.kind, True, raw.sensors[sensor], without.sensors[sensor], None)
                for raw, without in zip(part.phases, residuals.phases, strict=True)
            )
            if phases:
                yield Spell(when, phases)


def _holes(log: int, holes: Sequence[tuple[int, int, int]]) -> Iterator[Span]:
    """Yield the holes in the rows, from half a row after the last row to half a row before the next one."""
    for before_ns, after_ns, missing in holes:
        row_s = (after_ns - before_ns) * 1e-9 / (missing + 1)
        yield Span(log, before_ns * 1e-9 + row_s / 2, missing * row_s)


def _repeated(log: int, repeated: RepeatedRows) -> Iterator[Repetition]:
    """Yield repeated rows, from half a row before the first repetition to half a row after the last one."""
    columns = (repeated.rows, repeated.begin_ns, repeated.end_ns, repeated.counts)
    for rows, begin_ns, end_ns, (x, y, z) in zip(*(column.tolist() for column in columns), strict=True):
        row_s = (end_ns - begin_ns) * 1e-9 / (rows - 1)
        yield Repetition(Span(log, begin_ns * 1e-9 - row_s / 2, rows * row_s), rows, (x, y, z))


class ScoredStatistics(NamedTuple):
    """Statistics of one sensor (n,): recorded values, values under the model, scores, and for each its part and its log
    of the campaign (-1: several logs).
    """

    keys: Sequence[Key]
    held_out: Sequence[bool]
    values: Floats
    expected: Floats
    scores: Floats
    logs: Sequence[int] = ()


def _logs_by_probe(scored: ScoredStatistics) -> dict[str, tuple[int, ...]]:
    """Return the log of each row of `_by_probe`."""
    rows: dict[str, dict[tuple[bool, int, str, int], int]] = {}
    for key, out, log in zip(scored.keys, scored.held_out, scored.logs, strict=False):
        rows.setdefault(key.probe, {})[out, key.log, key.phase, key.phase_number] = log
    return {probe: tuple(probe_rows.values()) for probe, probe_rows in rows.items()}


def _by_probe(scored: ScoredStatistics, values: Floats) -> dict[str, Floats]:
    """Return the table (m, 3) or (m, 1) of each probe."""
    rows: dict[str, dict[tuple[bool, int, str, int], list[float]]] = {}
    for key, out, value in zip(scored.keys, scored.held_out, values.tolist(), strict=True):
        rows.setdefault(key.probe, {}).setdefault((out, key.log, key.phase, key.phase_number), []).append(value)
    return {probe: np.array(list(probe_rows.values())) for probe, probe_rows in rows.items()}
