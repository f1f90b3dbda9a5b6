"""The whole diagnosis, from recordings to what is said of them."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

import imuarray
from imuarray.errors import ConfigError
from imuarray.gap.findings.causes import causes_of, judged_of
from imuarray.gap.findings.closure import deviating, deviating_in_either
from imuarray.gap.findings.description import changes_alike, lines_left, lines_shown
from imuarray.gap.findings.diagnosis import (
    Cause,
    Diagnosis,
    Gap,
    Pull,
    RecordingSummary,
    Unobservable,
    Where,
    is_told_by_both,
)
from imuarray.gap.findings.experiment_design import next_experiment
from imuarray.gap.findings.labels import WrongLabel, cause_of, corrected, mislabelled
from imuarray.gap.findings.observability import alike, facts_of, unshown, unsure
from imuarray.gap.findings.origins import lines_of, notes_of, with_origins
from imuarray.gap.findings.overlays import overlays_of
from imuarray.gap.findings.repair import repaired
from imuarray.gap.findings.sentence import sentence_of
from imuarray.gap.findings.unexplained import is_left_single, left_alike, left_single, worst_of
from imuarray.gap.findings.verdict import StatisticReport, floor_of, gap_of, map_of, unknown_of, verdict_of, where_of
from imuarray.gap.inference.assessment import Assessment, assess
from imuarray.gap.inference.comparison import Comparison, compared_with_base, observed, prepared
from imuarray.gap.inference.effects import CANDIDATES, Candidate
from imuarray.gap.inference.search import SearchResult, searches
from imuarray.gap.inference.unit_state import least_scale
from imuarray.gap.model.bench import Bench, StatisticValues
from imuarray.gap.model.downstream import uses
from imuarray.gap.model.nuisance import nuisance_estimates
from imuarray.gap.model.workers import Run
from imuarray.gap.recording.recordings import Recording
from imuarray.gap.statistics.environment import environment_of
from imuarray.simulate.model import Model

Floats = npt.NDArray[np.float64]

REPLICATES = 100
"""Of the base model at most: they say how statistics scatter, and how far chance goes. Fewer are simulated of a
recording that is well within it (`imuarray.gap.inference.comparison.ENOUGH`).
"""

REPAIRED = 32
"""Replicates of the model with its causes in."""

_FIRST_REPAIRED = 2_000_000


@dataclass(frozen=True)
class GapCase:
    """What is diagnosed: the recordings, compared with the base model; those as they were `noted`, if some of their
    faces were noted wrongly (`wrong`); the model, the seed, and what calls functions of the bench.
    """

    recordings: Sequence[Recording]
    found: Comparison
    noted: Comparison
    wrong: tuple[WrongLabel, ...]
    model: Model | None
    seed: int
    run: Run

    @property
    def names(self) -> list[str]:
        """The logs'."""
        return [one.name for one in self.recordings]


def diagnose(
    recordings: Sequence[Recording],
    run: Callable[[Bench], Run],
    *,
    model: Model | None = None,
    without: Collection[str] = (),
    seed: int = 0,
    replicates: int = REPLICATES,
    progress: Callable[[str], None] = lambda what: None,
) -> Diagnosis:
    """Where recordings differ from what the model makes of them, why, and how far that is closed by the causes.

    `run` gives, for a bench, what calls its functions (`imuarray.gap.model.workers.runner`). `without` takes effects
    out of the library of causes; ConfigError for one that isn't in it. `progress` hears what is going on.
    """
    candidates = library(without)
    begin = begun(recordings, run, model=model, seed=seed, replicates=replicates, progress=progress)
    return explained(begin, candidates, progress)


def begun(
    recordings: Sequence[Recording],
    run: Callable[[Bench], Run],
    *,
    model: Model | None = None,
    seed: int = 0,
    replicates: int = REPLICATES,
    progress: Callable[[str], None] = lambda what: None,
) -> GapCase:
    """Where recordings differ from the base model: the part of `diagnose` that needs no library of causes."""
    progress("reading the recordings")
    bench, campaign = prepared(recordings, model, seed)
    called = run(bench)
    progress("simulating the base model")
    found = noted = compared_with_base(bench, campaign, called, replicates)
    wrong = mislabelled(recordings, campaign)
    if wrong:
        progress("once more, with faces as they lay")
        recordings = corrected(recordings, wrong)
        bench, campaign = prepared(recordings, model, seed)
        called = run(bench)
        found = compared_with_base(bench, campaign, called, replicates)
        noted = noted if noted.pairs.keys == found.pairs.keys else found
    return GapCase(recordings, found, noted, wrong, model, seed, called)


def explained(
    begin: GapCase,
    candidates: Mapping[str, Candidate],
    progress: Callable[[str], None] = lambda what: None,
    known: Collection[str] = (),
    *,
    briefly: bool = False,
) -> Diagnosis:
    """The rest of `diagnose`: the search for causes among `candidates`, and what is said of them. `known`: sensors that
    are known to have one of them (`imuarray.gap.inference.search.searches`). `briefly`: without curves and without what
    to record next, for which more is simulated.
    """
    found = begin.found
    if found.located.is_gap:
        searched = searches(found, candidates, begin.run, progress, known)
    else:
        searched = SearchResult({}, found.bench.models())
    progress("simulating the repaired model")
    return _said(begin, candidates, searched, briefly)


def library(without: Collection[str]) -> dict[str, Candidate]:
    """The candidates but those left out."""
    if unknown := sorted(set(without) - set(CANDIDATES)):
        raise ConfigError(f"effect {unknown[0]!r}: allowed are {', '.join(CANDIDATES)}")
    return {name: one for name, one in CANDIDATES.items() if name not in without}


def _said(case: GapCase, candidates: Mapping[str, Candidate], searched: SearchResult, briefly: bool) -> Diagnosis:
    """Everything that follows from the search."""
    found, noted, bench, names, run = case.found, case.noted, case.found.bench, case.names, case.run
    is_gap = noted.located.is_gap
    shared = environment_of(found.campaign) if is_gap else ()
    causes = with_origins(causes_of(bench, searched.rounds, case.seed), bench.base.headers, shared)
    came = _repaired(searched, run) if causes else found.replicates
    after = _after(found, came) if causes else found.judged
    lines = lines_of(causes, bench.base.headers)
    causes = tuple(sorted((*map(cause_of, case.wrong), *causes), key=lambda one: -one.probability))
    told = StatisticReport(bench, found.campaign, found.pairs, names)
    untold = _untold(case, candidates, causes, told)
    causes = alike(causes, untold)
    as_noted = told if noted is found else StatisticReport(noted.bench, noted.campaign, found.pairs, names)
    where = where_of(as_noted, noted.judged, noted.located.found, noted.located.found)
    gap = _gap(case, after, causes)
    left = left_single(after) if is_gap else []
    kept_up = left_alike(found, after, came, causes) if is_gap and causes else []
    single = where_of(told, after, left, {})
    unexplained = (*single, *where_of(told, after, worst_of(found, after, kept_up, left), {}))
    is_left = bool(kept_up) or (bool(left) and is_left_single(found, after, came, left, single))
    verdict = verdict_of(is_gap, gap, after, causes, is_left)
    in_use = uses(found.real.uses, [one.uses for one in found.replicates], [one.uses for one in came])
    model = case.model.name if case.model else "data sheets"
    return Diagnosis(
        verdict,
        sentence_of(verdict, gap, causes, where, unexplained, in_use),
        noted.located.p,
        gap,
        where,
        causes,
        unknown_of(is_gap, gap, after, max((abs(one.score) / one.furthest for one in kept_up), default=0.0)),
        unexplained,
        "" if briefly else next_experiment(bench, searched, causes, unexplained, untold, run),
        untold,
        in_use,
        judged_of(searched.rounds),
        map_of(found.pairs, noted.judged, after, tuple(bench.base.headers)),
        () if briefly else overlays_of(bench, found.campaign, where, bench.models(), searched.models, run, names=names),
        tuple(map(_recorded, case.recordings)),
        (
            *_described(case, unexplained),
            *lines_shown(found.campaign, where, causes),
            *notes_of(lines, shared),
            *(f"{one.name}: {note}" for one in case.recordings for note in one.notes),
        ),
        bench.split.words,
        case.seed,
        len(found.replicates),
        model,
        f"imuarray {imuarray.__version__}",
        repaired(bench, searched.models, case.model, f"repaired {model}", logs=names),
        pulls=_pulls(found, case.recordings),
    )


def _pulls(found: Comparison, recordings: Sequence[Recording]) -> tuple[Pull, ...]:
    """Nuisance quantities of all sensors whose tolerance is known, as the training part tells them."""
    train = found.bench.split.train(found.campaign)
    has_reference = all(recording.has_reference_temperature for recording in recordings)
    estimates = nuisance_estimates(train.campaign, found.bench.base, has_reference=has_reference)
    return tuple(
        Pull(*estimate[:-1], estimate.pull, estimate.source) for estimate in estimates if math.isfinite(estimate.pull)
    )


def _after(found: Comparison, came: Sequence[StatisticValues]) -> Assessment:
    """The recording judged by replicates of the model with the causes in."""
    floor = np.fmax(found.bench.resolutions, least_scale(found.judged.likeness))
    return assess(found.pairs, found.real.values, np.array([one.values for one in came]), floor)


def _untold(
    case: GapCase, candidates: Mapping[str, Candidate], causes: Sequence[Cause], told: StatisticReport
) -> tuple[Unobservable, ...]:
    """Which candidates beside the causes the recordings can't show; without a gap, also where one is not excluded."""
    found, headers = case.found, case.found.bench.base.headers
    unseen = {name: one for name, one in candidates.items() if name not in {cause.effect for cause in causes}}
    hidden = unshown(set(found.bench.kinds), facts_of(found.campaign), unseen, headers)
    return hidden if case.noted.located.is_gap else (*hidden, *_unsure(found, told))


def _described(case: GapCase, unexplained: Sequence[Where]) -> tuple[str, ...]:
    """Lines of the spectrum that are left, and changes of bias from log to log that units of a chip share."""
    found, bench = case.found, case.found.bench
    lines = lines_left(found.campaign, unexplained, case.names)
    if not case.noted.located.is_gap:
        return lines
    alike = changes_alike(bench.keys, found.real.values, bench.held_out.tolist(), bench.base.headers)
    return (*lines, *alike)


def _repaired(searched: SearchResult, run: Run) -> list[StatisticValues]:
    """Replicates with the causes in."""
    numbers = range(_FIRST_REPAIRED, _FIRST_REPAIRED + REPAIRED)
    return observed(searched.models, numbers, run)


def _gap(case: GapCase, after: Assessment, causes: Sequence[Cause]) -> Gap:
    """How far it is closed, on the held-out part; by causes that single parts don't show on both."""
    pairs, before = case.found.pairs, case.noted.judged
    if is_told_by_both(causes):
        counted = deviating_in_either(pairs, before.parts, after.parts)
    else:
        counted = deviating(pairs, before.parts, after.parts, before.likeness.is_silent)
    gap = gap_of(counted, floor_of(counted, before, case.noted.chance), case.seed)
    return gap if case.noted.located.is_gap else replace(gap, after=gap.before, closed=None, closed_ci95=None)


def _recorded(one: Recording) -> RecordingSummary:
    sensors = one.experiment.plan.sensors
    seconds = sum((phase.end_ns - phase.start_ns) * 1e-9 for phase in one.phases)
    rows = sum(len(one.log[name]) for name in sensors)
    return RecordingSummary(one.name, one.kind, seconds, len(sensors), len(one.phases), rows)


def _unsure(found: Comparison, told: StatisticReport) -> tuple[Unobservable, ...]:
    """In which domains a difference that matters can't be excluded."""
    places = range(len(found.pairs.keys))
    return unsure(
        np.array([told.scale(at, found.judged) for at in places]),
        np.array([told.margin(at) for at in places]),
        found.pairs.keys,
        np.array([told.size(at)[1] for at in places]),
        found.bench.base.headers,
    )
