"""The next experiment: the one of a menu that best separates two causes that explain the recordings equally well.

Both models of one sensor are simulated in every experiment. The criterion is the expected log-likelihood ratio, in
nats, of a recording under its own model and the other one (Kullback and Leibler 1951), per hour of work.

This module also lists the effects that a campaign cannot show: those that no recorded experiment shows, and statistics
with more scatter than the differences that matter.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from imuarray.arrays import Floats
from imuarray.gap.findings.deviations import TWO_SIDED_95, length_words, needed
from imuarray.gap.findings.diagnosis import DIFFERENCES, Cause, Unobservable, Where
from imuarray.gap.findings.text import domain_text, number, place_text
from imuarray.gap.inference.effects.candidate import Candidate, Kind, Need
from imuarray.gap.inference.forward_selection import Evaluation, Round
from imuarray.gap.inference.search import SearchResult
from imuarray.gap.model.bench import Bench, bench_of
from imuarray.gap.model.downstream import attitude_of
from imuarray.gap.model.replication import Models, Stage
from imuarray.gap.model.workers import Run
from imuarray.gap.recording.recordings import Experiment, Recording
from imuarray.gap.recording.source import simulated_sources
from imuarray.gap.statistics.campaign import Campaign, Layout, PhaseSummary, layout_of
from imuarray.gap.statistics.catalogue import Key
from imuarray.gap.statistics.split import split_of
from imuarray.gap.statistics.summary import Summary
from imuarray.gap.statistics.synthetic_likelihood import FORM, FREEDOM, LARGEST_SCORE
from imuarray.log.format import Phase, SensorHeader
from imuarray.printable import listed, series
from imuarray.simulate.converters import THERMOMETERS
from imuarray.simulate.motion.faces import Still, turn_on_run
from imuarray.simulate.motion.hand_shake import HandShake
from imuarray.simulate.motion.heating import Heating
from imuarray.simulate.motion.stimulus import Motion
from imuarray.simulate.motion.tumble import Tumble
from imuarray.simulate.record import phases_within
from imuarray.simulate.simulation import Plan, Simulation
from imuarray.simulate.timeline import PollTimes

LEAST_FACES, LEAST_DEGC, LEAST_RUNS, LEAST_REST_S = 2, 5.0, 4, 60.0
"""Least contents of a campaign: number of faces (fewer do not separate level and scale), span of temperature in degC
(for drift and slope), number of runs (for a spread, `imuarray.gap.statistics.probes.run_to_run`), and time at rest in s
of a static log.
"""

LONGEST_S = 48 * 3600.0
MOST_RUNS = 20.0
"""Longest log, in s, and largest multiple of the recorded runs that are suggested."""

_EXPERIMENTS: Mapping[Need, tuple[Kind, str]] = MappingProxyType(
    {
        "faces": ("tumble", "all six faces, 1 minute each"),
        "warmth": ("heating", "warmer by 10 degC or more and cool again, twice"),
        "runs": ("turn-on", "a dozen short logs, switched off in between"),
        "turns": ("motion", "turns to and fro about every axis, 1 minute"),
        "rest": ("static", "still for 1 minute"),
        "warm_faces": ("heating", "warmer by 10 degC or more on two opposite faces"),
        "warm_turns": (
            "motion",
            "turns to and fro about every axis, 1 minute, and again when it is warmer by 10 degC or more",
        ),
    }
)
"""The kind of experiment that meets a need, and what to record if the candidate has no text for that kind."""

_DONE_BY: tuple[Need, ...] = ("faces", "warmth", "runs", "turns")
"""The needs that, if they are met, count as an experiment of their kind."""

_OF_A_GYROSCOPE: Mapping[Need, Need] = MappingProxyType({"faces": "turns", "warm_faces": "warm_turns"})
"""Needs of a gyroscope that differ from those of other sensors: it does not measure gravity, so faces show nothing."""

_SAME_AS: Mapping[str, str] = MappingProxyType({"thermal_scale": "thermal_bias"})
"""For an effect, the other one from which it cannot be separated as long as no recorded experiment shows it."""

_INSTEAD: Mapping[str, str] = MappingProxyType(
    {
        "level": f"tumble: {_EXPERIMENTS['faces'][1]}, separate scale and misalignment from a level",
        "force": "tumble: all six faces, several times",
        "temperature": "heating: by more degC, several times",
        "motion": "motion: faster and longer turns",
        "cross_sensor": "heating: shared errors grow with their cause",
    }
)
"""What to record, by domain, if a longer log is not enough."""

_ABSENT: Mapping[str, str] = MappingProxyType(
    {
        "temperature": "temperature: no log spans 1 degC",
        "force": "force: no log has faces",
        "motion": "motion: no log has a motion that a track or several sensors show",
        "run_to_run": "runs: there is only one log of each kind",
        "cross_sensor": "shared errors: there is only one sensor",
    }
)
"""Domains without statistics in some campaigns, and the reason."""

_TRIAD = 3


@dataclass(frozen=True)
class Facts:
    """The facts about a campaign's recordings.

    `faces`: number of faces on which the box rested, poses by hand included; `span_degc`: largest span of temperature
    in one log; `runs`: number of runs of a turn-on series; `has_turned`: whether the box turned while gyroscopes were
    read; `rest_s`: total time at rest. `warm_faces` is the number of faces, and `has_turned_warm` whether the box
    turned, at temperatures that differ by `LEAST_DEGC` or more.
    """

    faces: int
    span_degc: float
    runs: int
    has_turned: bool
    rest_s: float
    warm_faces: int = 0
    has_turned_warm: bool = False


def facts_of(campaign: Campaign) -> Facts:
    """Return the facts of a campaign from its phases."""
    phases = [phase for log in campaign.logs for phase in log.phases]
    still = [phase for phase in phases if phase.is_still]
    moving = [sensor for phase in phases if not phase.is_still for sensor in phase.sensors.values()]
    turned = [summary for summary in moving if summary.rows and summary.header.quantity == "angular_rate"]
    faces = {attitude_of(phase.phase) for phase in still} - {""}
    return Facts(
        faces=len(faces),
        span_degc=max((_span_degc(_sensors(log.phases)) for log in campaign.logs), default=0.0),
        runs=sum(log.kind == "turn-on" for log in campaign.logs),
        has_turned=bool(turned),
        rest_s=sum((phase.phase.end_ns - phase.phase.start_ns) * 1e-9 for phase in still),
        warm_faces=sum(
            _span_degc(_sensors([phase for phase in still if attitude_of(phase.phase) == face])) >= LEAST_DEGC
            for face in faces
        ),
        has_turned_warm=_span_degc(turned) >= LEAST_DEGC,
    )


def unobservable_effects(
    kinds: Collection[str], facts: Facts, candidates: Mapping[str, Candidate], sensors: Mapping[str, SensorHeader]
) -> tuple[Unobservable, ...]:
    """Return the candidate effects that no recorded kind of experiment shows, each with the triads that need the same
    record.

    A kind counts only with enough content: a tumble needs 2 faces, a heating 5 degC, a turn-on series 4 runs, and a
    static log a minute at rest. Faces, heating and turns in a log of another kind count as well. A candidate with an
    empty `shown_by` and without known needs is left out, since nothing can be suggested for it.
    """
    met_needs = _met_needs(kinds, facts)
    recorded_kinds = {_EXPERIMENTS[need][0] for need in _DONE_BY if need in met_needs}
    if "static" in kinds and facts.rest_s >= LEAST_REST_S:
        recorded_kinds.add("static")
    triads = {name: header for name, header in sensors.items() if len(header.columns) == _TRIAD}
    return tuple(
        hidden
        for candidate in candidates.values()
        for hidden in _of_candidate(candidate, recorded_kinds, met_needs, triads)
    )


def uncertain_domains(
    scales: Floats, margins: Floats, keys: Sequence[Key], seconds: Floats | float, sensors: Mapping[str, SensorHeader]
) -> tuple[Unobservable, ...]:
    """Return the domains and chips for which differences that matter can't be excluded.

    These have statistics with a 95 % interval, 1.96 of their `scales` (n,) of chance to either side, that is wider than
    their `margins` (n,); nan is ignored. `seconds` (n,), or one number, are the lengths of the logs of the statistics.
    """
    lasted = np.broadcast_to(np.asarray(seconds, float), len(keys))
    places: dict[tuple[str, str], list[int]] = {}
    with np.errstate(invalid="ignore"):
        wide = np.flatnonzero(TWO_SIDED_95 * scales > margins)
    for at in wide.tolist():
        places.setdefault((keys[at].domain, sensors[keys[at].sensor].chip), []).append(at)
    return tuple(
        Unobservable(
            f"{DIFFERENCES}{domain.replace('_', ' ')}",
            tuple(dict.fromkeys(keys[at].sensor for at in members)),
            _more_of(domain, [(float(lasted[at]), float(scales[at]), float(margins[at])) for at in members]),
        )
        for (domain, _), members in places.items()
    )


def missing_in(recordings: Sequence[Recording], domains: Collection[str]) -> tuple[str, ...]:
    """Return what the recordings lack for statistics that are therefore not compared, in phrases: reference
    temperatures, chip thermometers, and statistics of domains that are not among `domains`.
    """
    phrases = []
    for recording in recordings:
        if not recording.has_reference_temperature:
            phrases.append(f"no reference temperature in {recording.name}")
        if recording.temperature_source == "chip":
            phrases.append(f"no thermometer beside those of the chips in {recording.name}")
            continue
        headers = [header for header, _ in recording.experiment.plan.sensors.values() if header.chip in THERMOMETERS]
        without = [header.name for header in headers if not header.has_temperature]
        if without and len(without) == len(headers):
            phrases.append(f"no chip thermometer in {recording.name}")
        elif without:
            phrases.append(f"no chip thermometer of {', '.join(without)} in {recording.name}")
    phrases += [f"no statistic of {words}" for domain, words in _ABSENT.items() if domain not in domains]
    return tuple(phrases)


def with_unobservable_rivals(causes: Sequence[Cause], hidden: Sequence[Unobservable]) -> tuple[Cause, ...]:
    """Return the causes, with further rivals: `hidden` effects that no recording of at least one of their sensors
    shows.
    """
    twins = {_SAME_AS[effect.effect]: effect for effect in hidden if effect.effect in _SAME_AS}

    def with_rival(cause: Cause) -> Cause:
        twin = twins.get(cause.effect)
        if twin is None or not set(twin.sensors) & set(cause.sensors):
            return cause
        return replace(cause, confusable_with=tuple(sorted({*cause.confusable_with, twin.effect})))

    return tuple(map(with_rival, causes))


def _sensors(phases: Sequence[PhaseSummary]) -> list[Summary]:
    return [sensor for phase in phases for sensor in phase.sensors.values()]


def _span_degc(sensors: Sequence[Summary]) -> float:
    parts = [sensor.segments.temperature_degc for sensor in sensors]
    degc = np.concatenate(parts) if parts else np.zeros(0)
    known = degc[np.isfinite(degc)]
    return float(np.ptp(known)) if len(known) else 0.0


def _met_needs(kinds: Collection[str], facts: Facts) -> frozenset[Need]:
    is_met: Mapping[Need, bool] = {
        "faces": facts.faces >= LEAST_FACES,
        "warmth": facts.span_degc >= LEAST_DEGC,
        "runs": facts.runs >= LEAST_RUNS,
        "turns": facts.has_turned or "motion" in kinds,
        "rest": facts.rest_s >= LEAST_REST_S,
        "warm_faces": facts.warm_faces >= LEAST_FACES,
        "warm_turns": facts.has_turned_warm,
    }
    return frozenset(need for need, met in is_met.items() if met)


def _of_candidate(
    candidate: Candidate,
    recorded_kinds: Collection[str],
    met_needs: frozenset[Need],
    triads: Mapping[str, SensorHeader],
) -> Iterator[Unobservable]:
    """Yield what to record for a candidate, with the sensors that need it."""
    sensors: dict[str, list[str]] = {}
    for name, header in triads.items():
        if candidate.can_concern(header):
            text = _needed_record(candidate, header.quantity, recorded_kinds, met_needs)
            sensors.setdefault(text, []).append(name)
    for text, names in sensors.items():
        if text:
            yield Unobservable(candidate.effect, tuple(names), text)


def _needed_record(
    candidate: Candidate, quantity: str, recorded_kinds: Collection[str], met_needs: frozenset[Need]
) -> str:
    """Return what to record so that a sensor of this quantity shows the effect; "" if it was recorded."""
    needs = candidate.needs
    if quantity == "angular_rate" != candidate.quantity:
        needs = tuple(_OF_A_GYROSCOPE.get(need, need) for need in needs)
    if not needs:
        is_shown = any(kind in recorded_kinds for kind in candidate.shown_by)
        return "" if is_shown else next((f"{kind}: {text}" for kind, text in candidate.shown_by.items()), "")
    if met_needs.intersection(needs):
        return ""
    kind, record = _EXPERIMENTS[needs[0]]
    return f"{kind}: {candidate.shown_by.get(kind, record)}"


def _more_of(domain: str, known: Sequence[tuple[float, float, float]]) -> str:
    """Return the median length of a log that resolves the differences, from (seconds, scale, margin) of each statistic,
    or what is more useful than a longer log.
    """
    wanted_s = float(np.median([needed(*item) for item in known]))
    if domain == "run_to_run":
        times = wanted_s / float(np.median([seconds for seconds, _, _ in known]))
        return f"turn-on: {times:.1f} times as many runs" if times < MOST_RUNS else "no series is long enough"
    if wanted_s <= LONGEST_S:
        return length_words(wanted_s)
    return "; ".join(["a longer log is not enough", *filter(None, [_INSTEAD.get(domain)])])


LEAST = 3.0
"""Least log-likelihood ratio, in nats, that separates two causes: odds of 20 to 1."""

ENOUGH = 12.0
"""Log-likelihood ratio, in nats, above which a larger one has no value."""

REPLICATES = 6
_FIRST = 4_000_000


@dataclass(frozen=True)
class Offer:
    """An experiment: the motions of the box in its logs, the hours of work with all handling, and the instructions."""

    motions: tuple[Motion, ...] = field(repr=False)
    hours: float
    words: str


MENU: Mapping[Kind, Offer] = MappingProxyType(
    {
        "static": Offer((Still(seconds=1800.0),), 0.55, "a static log: at rest for 30 minutes"),
        "tumble": Offer((Tumble(60.0, 5.0),), 0.25, "a tumble: all six faces and the first again, 1 minute each"),
        "heating": Offer(
            (Heating(scale=0.3),), 0.65, "a heating: warmer by 20 degC, by 30 degC, and cool again, in half an hour"
        ),
        "turn-on": Offer(
            tuple(turn_on_run(run, 60.0) for run in range(1, 13)),
            0.4,
            "a turn-on series: 12 runs of 1 minute, switched off in between",
        ),
        "motion": Offer(
            (HandShake(still_s=20.0, motion_s=60.0),), 0.1, "a motion: shaken and turned about every axis for 1 minute"
        ),
    }
)
"""The experiments by kind. The hours are our estimate: the length of the logs, 3 minutes to set up, 1 minute for each
power-on, and 15 minutes for each heating.
"""

_MORE: Mapping[str, Kind] = MappingProxyType(
    {
        "level": "tumble",
        "spread": "static",
        "distribution": "static",
        "codes": "static",
        "spectrum": "static",
        "autocorrelation": "static",
        "allan": "static",
        "temperature": "heating",
        "force": "tumble",
        "motion": "motion",
        "cross_sensor": "heating",
        "run_to_run": "turn-on",
        "timing": "static",
        "status": "static",
    }
)
"""The experiment that shows more of the statistics of a domain."""


class Rivals(NamedTuple):
    """Two confusable causes of one unit, `selection` (the accepted one) and `rival`, and the share of its statistics
    that is independent.
    """

    sensors: tuple[str, ...]
    selection: Evaluation
    rival: Evaluation
    independent: float


def next_experiment(
    bench: Bench,
    searched: SearchResult,
    causes: Sequence[Cause],
    unexplained: Sequence[Where],
    unshown: Sequence[Unobservable],
    run: Run,
) -> str:
    """Return what to record next, in words.

    It is the experiment that separates the most probable cause from its rivals. Without rivals, it is the one that
    shows more of the unexplained remainder (worst first), or else of what is not observable.
    """
    rivals = rivals_of(searched, causes)
    if rivals is not None:
        return _separating_experiment(bench, rivals, run)
    if unexplained:
        worst = unexplained[0]
        kind = _MORE[worst.domain]
        place = f"{domain_text(worst.domain)} of {place_text(worst)}"
        if kind in bench.kinds:
            what = f"whether the {place}, which is not explained, differs in the same way"
            return f"Record {_offered(kind, again=True)}: it shows {what}."
        return f"Record {_offered(kind)}: it shows more of the {place}, which is not explained."
    return _showing_experiment(unshown)


def _showing_experiment(unshown: Sequence[Unobservable]) -> str:
    """Return the experiment that shows the most unobservable effects per hour; if no experiment of the menu shows any,
    the first thing to record.
    """
    effects: dict[Kind, list[str]] = {}
    for hidden in unshown:
        for kind in MENU:
            if hidden.record.startswith(f"{kind}: "):
                effects.setdefault(kind, []).append(hidden.effect)
    if effects:
        distinct = {kind: list(dict.fromkeys(names)) for kind, names in effects.items()}
        best = max(distinct, key=lambda kind: len(distinct[kind]) / MENU[kind].hours)
        what = f"{series(distinct[best])}, which these recordings cannot; what to do for each is listed with it"
        return f"Record a {best} log: it can show {what}."
    if unshown:
        sensors = f" of {listed(unshown[0].sensors)}" if unshown[0].sensors else ""
        return f"To observe {unshown[0].effect.replace('_', ' ')}{sensors}, record {unshown[0].record}."
    return "Nothing: these recordings separate all causes of the library."


def rivals_of(searched: SearchResult, causes: Sequence[Cause]) -> Rivals | None:
    """Return the most probable cause that has a confusable effect in the same round; None without one."""
    for cause in causes:
        for unit, rounds in searched.rounds.items():
            for round_ in rounds if cause.confusable_with and set(unit) <= set(cause.sensors) else ():
                pair = _pair(cause, round_)
                if pair is not None:
                    return Rivals(unit, *pair, round_.before.independent)
    return None


def separations(bench: Bench, rivals: Rivals, run: Run) -> dict[Kind, float]:
    """Return the expected nats of each experiment of the menu, for the unit's first two sensors (or its only one)."""
    sides = [_models_of(bench, rivals, evaluation.standing.models) for evaluation in (rivals.selection, rivals.rival)]
    sensors = rivals.sensors[:2]
    benches = run(_bench_of_experiment, [_ExperimentRequest(kind, sides[0]) for kind in MENU])
    numbers = range(_FIRST, _FIRST + REPLICATES)
    values = run(
        _replicates,
        [
            _SimulationRequest(experiment_bench, side, sensors, numbers)
            for experiment_bench in benches
            for side in sides
        ],
    )
    nats: dict[Kind, float] = {}
    for kind, experiment_bench, first, second in zip(MENU, benches, values[::2], values[1::2], strict=True):
        nats[kind] = nats_between(
            first,
            second,
            experiment_bench.resolutions[experiment_bench.columns(sensors, cross=True)],
            rivals.independent,
        )
    return nats


def nats_between(first: Floats, second: Floats, floor: Floats, independent: float) -> float:
    """Return the expected log-likelihood ratio between two models, in nats, from replicates (r, n) of both with the
    same draws.

    `floor` (n,) is the least meaningful scatter, `independent` the share of the n statistics that is independent. Each
    statistic contributes the squared distance of the means divided by the variance of single recordings, limited by
    Student's t as in the search. The expected chance contribution of r replicates is subtracted.
    """
    there = [np.isfinite(side).all(axis=0) for side in (first, second)]
    known = there[0] & there[1]
    strange = (there[0] & ~np.isfinite(second).any(axis=0)) | (there[1] & ~np.isfinite(first).any(axis=0))
    difference = first[:, known] - second[:, known]
    distance = difference.mean(axis=0)
    scatter = (first[:, known].var(axis=0, ddof=1) + second[:, known].var(axis=0, ddof=1)) / 2
    least = np.maximum(floor[known], _ROUNDING * (1 + np.abs(first[:, known].mean(axis=0))))
    freedom = 2 * (len(first) - 1)
    chance = (
        difference.var(axis=0, ddof=1) / len(first) * freedom / (freedom - 2)
    )  # the mean of 1 / variance is too large by this factor
    square = (distance**2 - chance) / (np.maximum(scatter, least**2) + (FORM * distance) ** 2)
    bounded = np.sign(square) * np.log1p(np.abs(square) / FREEDOM)
    total = bounded.sum() + np.count_nonzero(strange) * math.log1p(LARGEST_SCORE**2 / FREEDOM)
    return max(independent * (FREEDOM + 1) / 2 * float(total), 0.0)


def _separating_experiment(bench: Bench, rivals: Rivals, run: Run) -> str:
    expected = separations(bench, rivals, run)
    what = f"{rivals.selection.trial.name} from {rivals.rival.trial.name} of {rivals.sensors[0]}"
    ranked = sorted(expected, key=lambda kind: -min(expected[kind], ENOUGH) / MENU[kind].hours)
    good = [kind for kind in ranked if expected[kind] >= LEAST]
    if not good:
        most = max(expected, key=expected.__getitem__)
        return (
            f"No usual experiment ({', '.join(MENU)}) separates {what}: the expected odds are at most "
            f"{_odds(expected[most])}, from {MENU[most].words}."
        )
    best = good[0]
    other = "static" if best != "static" else ranked[ranked[0] == best]
    again = " again" if best in bench.kinds else ""
    return (
        f"Record {MENU[best].words}{again}. It separates {what} (expected odds {_odds(expected[best])} in "
        f"{_hours(MENU[best].hours)}; {other} {_odds(expected[other])} in {_hours(MENU[other].hours)})."
    )


def _pair(cause: Cause, round_: Round) -> tuple[Evaluation, Evaluation] | None:
    """Return the first trials of the cause and of an effect that is confusable with it; None without either."""
    evaluation = next((trial for trial in round_.confirmed if _is(trial, cause)), None)
    rival = next((trial for trial in round_.confirmed if trial.trial.name in cause.confusable_with), None)
    return None if evaluation is None or rival is None else (evaluation, rival)


def _is(trial: Evaluation, cause: Cause) -> bool:
    return trial.trial.name == cause.effect and bool(trial.trial.effects) == (cause.action != "remove")


def _models_of(bench: Bench, rivals: Rivals, models: Models) -> Models:
    """Return the models of the unit's first two sensors, and of the sensors from which they get data."""
    unit_models = {name: models[name] for name in rivals.sensors[:2]}
    drawn_effects = bench.base.effects(0)
    sources = {
        getattr(effect, "sensor", "")
        for name, model in unit_models.items()
        for effect in (*drawn_effects[name], *model.added)
    }
    return {**{name: model for name, model in bench.models().items() if name in sources}, **unit_models}


class _ExperimentRequest(NamedTuple):
    kind: Kind
    models: Models


class _SimulationRequest(NamedTuple):
    bench: Bench
    models: Models
    sensors: tuple[str, ...]
    numbers: Sequence[int]


def _bench_of_experiment(bench: Bench, request: _ExperimentRequest) -> Bench:
    """Return the bench of an experiment with its first replicate as the recording."""
    base = replace(
        bench.base,
        headers={name: bench.base.headers[name] for name in request.models},
        fitted={name: model.fitted for name, model in request.models.items()},
    )
    motions = MENU[request.kind].motions
    phases = [phases_within(motion.phases, round(motion.seconds * 1e9)) for motion in motions]
    split = split_of([request.kind] * len(motions), phases)
    experiments = [Experiment(_plan(bench, request.models, motion.seconds), motion) for motion in motions]
    kinds = (request.kind,) * len(motions)
    layouts = tuple(_layouts(*of_log) for of_log in zip(experiments, split.phases(), strict=True))
    stage = Stage(kinds, split, layouts, tuple(experiments), base)
    return bench_of(stage.simulated(request.models, _FIRST), split, experiments, base)


def _replicates(_: Bench, request: _SimulationRequest) -> Floats:
    """Return the statistics (r, n) of the sensors concerned."""
    campaigns = request.bench.campaigns([(request.models, number) for number in request.numbers])
    return np.array([measured.values for measured in request.bench.each_measured(campaigns, request.sensors)])


def _plan(bench: Bench, names: Collection[str], seconds: float) -> Plan:
    """Return a plan that reads each sensor at its recorded rate, at even times."""
    rates = {
        name: line.rows_per_s
        for experiment in bench.experiments
        for name, (_, line) in experiment.plan.sensors.items()
        if name in names
    }
    lines = {name: PollTimes(math.ceil(seconds * rate), round(1e9 / rate)) for name, rate in rates.items()}
    sensors = {name: (bench.base.headers[name], line) for name, line in lines.items()}
    return Plan(sensors, next(iter(lines.values())))


def _layouts(experiment: Experiment, phases: Sequence[Phase]) -> tuple[Layout, ...]:
    """Return the layouts of an experiment's phases."""
    sources = simulated_sources(Simulation(experiment.plan, experiment.motion, {}))
    return tuple(layout_of(sources, phase) for phase in phases)


def _offered(kind: Kind, *, again: bool = False) -> str:
    """Return the instructions for an experiment, with its hours of work."""
    return f"{MENU[kind].words}{' again' if again else ''} ({_hours(MENU[kind].hours)})"


def _hours(hours: float) -> str:
    return f"{hours:.2g} h"


def _odds(nats: float) -> str:
    """Return a log-likelihood ratio as odds of the true cause against the other one."""
    least = f"more than {number(math.exp(ENOUGH), 1)}" if nats > ENOUGH else number(math.exp(nats), 2)
    return f"{least} to 1"


_ROUNDING = 1e-9
