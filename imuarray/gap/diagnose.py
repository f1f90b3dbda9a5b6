"""The whole diagnosis, from recordings to findings: read, fit and compare, search, verify, report."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from itertools import chain
from os import PathLike
from pathlib import Path

import numpy as np

import imuarray
from imuarray.arrays import Floats
from imuarray.errors import ConfigError, LogError
from imuarray.gap.findings.causes import causes_of, judged_of, lines_of, nearest_of, notes_of, pulls_of, with_origins
from imuarray.gap.findings.deviations import (
    NO_REMAINDER,
    Remainder,
    StatisticReport,
    lines_shown,
    map_of,
    remainder_of,
    shared_changes,
    tail_p,
    unexplained_lines,
    where_of,
)
from imuarray.gap.findings.diagnosis import (
    Cause,
    Diagnosis,
    Overlay,
    Pull,
    RecordingSummary,
    Unobservable,
    Where,
    needs_both_parts,
)
from imuarray.gap.findings.experiment_design import (
    facts_of,
    missing_in,
    next_experiment,
    uncertain_domains,
    unobservable_effects,
    with_unobservable_rivals,
)
from imuarray.gap.findings.labels import WrongLabel, cause_of, correct_labels, find_wrong_labels
from imuarray.gap.findings.overlays import overlays_of
from imuarray.gap.findings.repair import repair_model
from imuarray.gap.findings.verdict import (
    Judgement,
    deviating,
    deviating_in_either,
    floor_of,
    gap_of,
    judge,
    sentence_of,
    unknown_probability,
    with_limits,
)
from imuarray.gap.inference.assessment import FEWEST_REPLICATES, Assessment, assess, largest_of
from imuarray.gap.inference.comparison import (
    ENOUGH,
    Comparison,
    compare_with_base,
    compare_with_earlier,
    cut_to_equal_lengths,
    is_decided,
    observe_replicates,
    prepare,
)
from imuarray.gap.inference.effects import CANDIDATES, Candidate
from imuarray.gap.inference.search import SearchResult, search_causes
from imuarray.gap.inference.unit_state import least_scale
from imuarray.gap.model.bench import Bench, StatisticValues
from imuarray.gap.model.downstream import uses
from imuarray.gap.model.nuisance import nuisance_estimates
from imuarray.gap.model.workers import Bar, Run, no_bar, processes, runner
from imuarray.gap.recording.recordings import Recording, recordings_of, refuse_other_array
from imuarray.gap.statistics.environment import SharedSignal, environment_of
from imuarray.log import Log, open_log, require_logs
from imuarray.log.format import SensorHeader
from imuarray.shipped import find_model
from imuarray.simulate.effects import EFFECTS
from imuarray.simulate.model import Model, load_model
from imuarray.spelling import as_names, guess

LogLike = str | PathLike[str] | Log
"""A path, or an open log."""

Progress = Callable[[str], None]
"""Receives the name of each stage as it begins."""

REPLICATES = 128
"""Largest number of replicates of the base model. They determine the scatter of statistics to 6 %, and a p-value is at
least 1/129. Fewer are simulated for a recording that is well within chance (`imuarray.gap.inference.comparison.ENOUGH`)
or far beyond it (`imuarray.gap.inference.comparison.CLEAR`).
"""

REPAIRED = 32
"""Largest number of replicates of the model with its causes. Fewer are simulated if they show that the remainder is
well within chance or far beyond it, as for the base model.
"""

_FIRST_REPAIRED = 2_000_000


@dataclass(frozen=True)
class GapCase:
    """The recordings under diagnosis and their comparison with the base model or with `earlier` recordings.

    `as_noted` is the same comparison with the noted faces, if some were wrong (`wrong_labels`). `model` and `seed` are
    those of the comparison, `run` is the runner of the bench's functions, and `missing` names what could not be
    compared.
    """

    recordings: Sequence[Recording]
    comparison: Comparison
    as_noted: Comparison
    wrong_labels: tuple[WrongLabel, ...]
    model: Model | None
    seed: int
    run: Run
    earlier: Sequence[Recording] = ()
    missing: tuple[str, ...] = ()

    @property
    def names(self) -> list[str]:
        """The names of the logs."""
        return [recording.name for recording in self.recordings]

    @property
    def headers(self) -> Mapping[str, SensorHeader]:
        """The headers of the sensors, by name."""
        return self.comparison.bench.base.headers

    @property
    def is_gap(self) -> bool:
        """True if the recordings, with the noted faces, differ by more than chance."""
        return self.as_noted.localisation.is_gap

    @property
    def model_name(self) -> str:
        """The name of the reference of the recordings."""
        name = self.model.name if self.model else "data sheets"
        before = ", ".join(recording.name for recording in self.earlier)
        return f"{name}, fitted to {before}" if before else name


@dataclass(frozen=True)
class Explanation:
    """The result of the search: its rounds, the causes of sensors, and signals that sensors share."""

    search: SearchResult
    causes: Sequence[Cause]
    shared: Sequence[SharedSignal]


@dataclass(frozen=True)
class Verification:
    """The recordings compared with the model with all causes: statistics of its replicates (those of the base model if
    there are no causes), and the assessment by them.
    """

    replicates: Sequence[StatisticValues]
    after: Assessment

    @property
    def values(self) -> Floats:
        """Statistics (b, n) of the replicates."""
        return np.array([replicate.values for replicate in self.replicates])


@dataclass(frozen=True)
class Reference:
    """The reference of the recordings: the base model of `model` (None: of the data sheets), or `earlier` recordings of
    the same array if any are given.
    """

    model: Model | None = None
    earlier: Sequence[Recording] = ()


# The public interface of the package: keyword-only arguments, named like the options of the command.
def diagnose(  # noqa: PLR0913
    logs: LogLike | Iterable[LogLike],
    *,
    model: Model | str | PathLike[str] | None = None,
    only: Collection[str] = (),
    against: LogLike | Iterable[LogLike] = (),
    without: Collection[str] = (),
    seed: int = 0,
    replicates: int = REPLICATES,
    workers: int = 1,
    progress: Progress = lambda stage: None,
    bar: Bar = no_bar,
) -> Diagnosis:
    """Find the differences between recordings of an array and those of the simulator, their causes, and the share of
    the gap that the causes close.

    `logs` are paths, or open logs, which stay open (one, or several), of any experiments (static, tumble, heating,
    turn-on, motion), all of one array. `model` is the simulator's model: a model, its file, or the name of one that is
    part of the package ("datasheet", "martin2013"); by default that of the chips' data sheets. `only` names the sensors
    to compare (none: all accelerometers and gyroscopes), `without` the effects to leave out of the library of causes.

    `against` are earlier logs of the same array. With these the question is what has changed since then: noise, bias
    and slope are those of the earlier logs, and the deviation of each statistic in the earlier logs is subtracted from
    that in the new ones (`imuarray.gap.inference.comparison`). Statistics that the earlier logs do not determine are
    not compared.

    `seed` keys every draw: the same logs and seed give the same diagnosis, whatever the number of `workers`, which are
    processes (a program that uses several needs the usual ``if __name__ == "__main__":``). `replicates` of the base
    model distinguish a gap from chance; at least 19 are needed. `progress` is called with the name of each stage; `bar`
    makes the function that is called with the number of completed jobs.

    Raises LogError for a log that cannot be read, in which nothing can be compared, or that is of another array;
    ConfigError for an effect or a model that is not known, or for too few replicates.

    >>> diagnosis = diagnose(["run.h5"], only=["Gyro1"], replicates=40)
    >>> diagnosis.verdict in ("no gap", "explained", "partly explained", "unexplained")
    True
    >>> [recording.name for recording in diagnosis.recorded]
    ['run.h5']
    """
    if replicates < FEWEST_REPLICATES:
        raise ConfigError(f"replicates: {replicates} given; at least {FEWEST_REPLICATES} are needed")
    candidates = library(as_names(without))
    only = as_names(only)
    chosen = model if model is None or isinstance(model, Model) else load_model(find_model(Path(model)))
    with ExitStack() as stack:
        recorded = _open(logs, stack)
        if not recorded:
            raise LogError("no log is given; at least one is required")
        recordings, earlier = _read(recorded, _open(against, stack), only)
        executor = stack.enter_context(processes(workers)) if workers > 1 else None

        def run_on(bench: Bench) -> Run:
            return runner(bench, executor, bar)

        case = compare(
            recordings, run_on, Reference(chosen, earlier), seed=seed, replicates=replicates, progress=progress
        )
        return explain(case, candidates, progress)


def compare(
    recordings: Sequence[Recording],
    run_on: Callable[[Bench], Run],
    reference: Reference = Reference(),
    *,
    seed: int = 0,
    replicates: int = REPLICATES,
    progress: Progress = lambda stage: None,
) -> GapCase:
    """Compare recordings with a reference: the part of `diagnose` that needs no library of causes. `run_on` makes, for
    a bench, the runner of its functions (`imuarray.gap.model.workers.runner`).
    """
    progress("reading the recordings")
    case = _compare_once(recordings, run_on, reference, seed, replicates, progress)
    wrong_labels = find_wrong_labels(recordings, case.comparison.campaign)
    if not wrong_labels:
        return case
    progress("comparing again with corrected faces")
    again = _compare_once(correct_labels(recordings, wrong_labels), run_on, reference, seed, replicates, progress)
    is_same = case.comparison.pairs.keys == again.comparison.pairs.keys
    as_noted = case.comparison if is_same else again.comparison
    return replace(again, as_noted=as_noted, wrong_labels=wrong_labels)


def explain(
    case: GapCase,
    candidates: Mapping[str, Candidate],
    progress: Progress = lambda stage: None,
    known: Collection[str] = (),
    *,
    briefly: bool = False,
) -> Diagnosis:
    """Search for the causes among `candidates`, verify them and make the findings: the rest of `diagnose`.

    `known`: sensors that are known to have one of the candidates (`imuarray.gap.inference.search.search_causes`).
    `briefly`: without curves and next experiment, which need further simulations.
    """
    search = _search(case, candidates, progress, known)
    progress("simulating the repaired model")
    shared = environment_of(case.comparison.campaign) if case.is_gap else ()
    causes = with_origins(causes_of(case.comparison.bench, search.rounds, case.seed), case.headers, shared)
    verification = _verify(case, search, causes)
    return _report(case, candidates, Explanation(search, causes, shared), verification, briefly)


def library(without: Collection[str]) -> dict[str, Candidate]:
    """Return the candidates except those left out; ConfigError for a name that is no effect. Some effects are always
    nuisance quantities and never causes, so leaving them out changes nothing.
    """
    if unknown := sorted(set(without) - set(EFFECTS)):
        raise ConfigError(f"effect {unknown[0]!r}: allowed are {', '.join(EFFECTS)}{guess(unknown[0], EFFECTS)}")
    return {name: candidate for name, candidate in CANDIDATES.items() if name not in without}


def _open(logs: LogLike | Iterable[LogLike], stack: ExitStack) -> list[Log]:
    """Return the logs, each once; those opened here are closed with the stack."""
    if isinstance(logs, str | PathLike | Log):
        logs = [logs]
    several = list(logs) if isinstance(logs, Iterable) else logs
    if several != []:  # earlier recordings need not be given
        require_logs(several, "diagnose(logs)", or_paths=True)
    logs_by_path = {(log.path if isinstance(log, Log) else Path(log)).resolve(): log for log in several}
    return [log if isinstance(log, Log) else stack.enter_context(open_log(log)) for log in logs_by_path.values()]


def _read(
    logs: Sequence[Log], against: Sequence[Log], only: Collection[str]
) -> tuple[Sequence[Recording], Sequence[Recording]]:
    """Return the recordings and the earlier ones, with the sensors that both have, cut into pieces of one length."""
    recordings = recordings_of(logs, only)
    if not against:
        return recordings, ()
    earlier = recordings_of(against, only)
    refuse_other_array(recordings, earlier)
    sensors, known = (dict.fromkeys(chain.from_iterable(map(_sensors, some))) for some in (recordings, earlier))
    common = [name for name in sensors if name in known]
    if len(common) < max(len(sensors), len(known)):
        recordings, earlier = recordings_of(logs, common), recordings_of(against, common)
        notes = tuple(f"{name} is left out: no earlier log has it." for name in sensors if name not in known)
        recordings = (replace(recordings[0], notes=(*notes, *recordings[0].notes)), *recordings[1:])
    return cut_to_equal_lengths(recordings, earlier)


def _sensors(recording: Recording) -> Collection[str]:
    return recording.experiment.plan.sensors


def _compare_once(
    recordings: Sequence[Recording],
    run_on: Callable[[Bench], Run],
    reference: Reference,
    seed: int,
    replicates: int,
    progress: Progress,
) -> GapCase:
    """Compare the recordings, with their noted faces, with the reference."""
    model, earlier = reference.model, reference.earlier
    bench, campaign = prepare(recordings, model, seed, earlier)
    has_value = np.isfinite(bench.measured(campaign, bench.base.fitted).values)
    domains = [key.domain for key in bench.of_keys(has_value).keys]
    missing, before = missing_in(recordings, domains), None
    if earlier:
        progress("simulating the earlier recordings")
        bench, before = compare_with_earlier(bench, *prepare(earlier, model, seed), run_on, replicates)
        missing = (*missing, *_without_counterpart(domains, bench))
    progress("simulating the base model")
    run = run_on(bench)
    comparison = compare_with_base(bench, campaign, run, replicates, before)
    return GapCase(recordings, comparison, comparison, (), model, seed, run, earlier, missing)


def _without_counterpart(domains: Sequence[str], bench: Bench) -> tuple[str, ...]:
    """Return the domains of which only the new recordings have statistics, in phrases."""
    known = {key.domain for key in bench.keys}
    lost = [domain for domain in dict.fromkeys(domains) if domain not in known]
    return tuple(f"no statistic of {domain.replace('_', ' ')} in the earlier recordings" for domain in lost)


def _search(
    case: GapCase, candidates: Mapping[str, Candidate], progress: Progress, known: Collection[str]
) -> SearchResult:
    """Return the causes of the gap; none without a gap."""
    comparison = case.comparison
    if not comparison.localisation.is_gap:
        return SearchResult({}, comparison.bench.models())
    return search_causes(comparison, candidates, case.run, progress, known)


def _verify(case: GapCase, search: SearchResult, causes: Sequence[Cause]) -> Verification:
    """Compare the recordings with the model with its causes."""
    comparison = case.comparison
    if not causes:
        return Verification(comparison.replicates, comparison.assessment)
    floor = np.fmax(comparison.bench.resolutions, least_scale(comparison.assessment.likelihood))
    replicates: list[StatisticValues] = []
    for count in (*(count for count in ENOUGH if count < REPAIRED), REPAIRED):
        numbers = range(_FIRST_REPAIRED + len(replicates), _FIRST_REPAIRED + count)
        more = observe_replicates(comparison.bench, search.models, numbers, case.run)
        replicates += more if comparison.earlier is None else comparison.earlier.with_scatter(more, numbers)
        values = np.array([replicate.values for replicate in replicates])
        after = assess(comparison.pairs, comparison.real.values, values, floor)
        if is_decided(count, after.p, float(largest_of(after.normal)), after.furthest):
            break
    return Verification(replicates, after)


def _report(
    case: GapCase,
    candidates: Mapping[str, Candidate],
    explanation: Explanation,
    verification: Verification,
    briefly: bool,
) -> Diagnosis:
    """Return all findings; the remainder comes first, since the verdict and the causes depend on it."""
    search, sensor_causes = explanation.search, explanation.causes
    comparison, bench = case.comparison, case.comparison.bench
    report = StatisticReport(bench, comparison.campaign, comparison.pairs, case.names)
    suspected = (*map(cause_of, case.wrong_labels), *sensor_causes)
    remainder = _remainder(case, verification, suspected, report)
    suspected = suspected or with_origins(nearest_of(bench, search.rounds, case.seed), case.headers, explanation.shared)
    unobservable = _unobservable(case, candidates, suspected, report)
    judgement = _judge(case, verification, remainder, with_unobservable_rivals(suspected, unobservable))
    verdict, gap, causes, unknown, reason = judgement
    where = _where(case, report)
    in_use = uses(
        comparison.real.uses,
        [replicate.uses for replicate in comparison.replicates],
        [replicate.uses for replicate in verification.replicates],
    )
    against, pulls = tuple(recording.name for recording in case.earlier), _pulls(case, causes)
    return Diagnosis(
        verdict=verdict,
        sentence=with_limits(
            sentence_of(judgement, where, remainder.where, in_use, pulls, against), verdict, unobservable
        ),
        p=case.as_noted.localisation.p,
        gap=gap,
        where=where,
        causes=causes,
        unknown=unknown,
        unexplained=remainder.where,
        next_experiment=""
        if briefly
        else next_experiment(bench, search, causes, remainder.where, unobservable, case.run),
        unshown=unobservable,
        uses=in_use,
        judged=judged_of(search.rounds),
        map=map_of(comparison.pairs, case.as_noted.assessment, verification.after, tuple(case.headers)),
        overlays=() if briefly else _overlays(case, search, where),
        recorded=tuple(map(_summary, case.recordings)),
        notes=_notes(case, where, remainder.where, sensor_causes, explanation.shared),
        held_out=bench.split.words,
        seed=case.seed,
        replicates=len(comparison.replicates),
        model=case.model_name,
        software=f"imuarray {imuarray.__version__}",
        repaired=repair_model(bench, search.models, case.model, f"repaired {case.model_name}", logs=case.names),
        missing=case.missing,
        pulls=pulls,
        reason=reason,
        p_tail=tail_p(case.as_noted.assessment.normal),
    )


def _judge(case: GapCase, verification: Verification, remainder: Remainder, suspected: Sequence[Cause]) -> Judgement:
    """Judge the suspected causes by the share of the gap that they close on the held-out part, or on both parts if
    single parts do not show them.
    """
    pairs, before, after = case.comparison.pairs, case.as_noted.assessment, verification.after
    if needs_both_parts(suspected):
        counted = deviating_in_either(pairs, before.parts, after.parts)
    else:
        counted = deviating(pairs, before.parts, after.parts, before.likelihood.is_silent)
    gap = gap_of(counted, floor_of(counted, before, case.as_noted.chance), case.seed)
    unknown = unknown_probability(gap.closed, after, remainder.one_sidedness)
    return judge(
        gap, suspected, unknown, is_gap=case.is_gap, unlikely=remainder.unlikely, has_remainder=bool(remainder.sizes)
    )


def _remainder(
    case: GapCase, verification: Verification, suspected: Sequence[Cause], report: StatisticReport
) -> Remainder:
    """Return the remainder with the suspected causes in the model."""
    if not case.is_gap:
        return NO_REMAINDER
    return remainder_of(case.comparison, verification.after, verification.values, suspected, report)


def _where(case: GapCase, report: StatisticReport) -> tuple[Where, ...]:
    """Return the statistics in which the recordings, with the noted faces, differ; the worst first."""
    noted = case.as_noted
    if noted is not case.comparison:
        report = StatisticReport(noted.bench, noted.campaign, noted.pairs, case.names)
    order = sorted(noted.localisation.p_by_place, key=lambda at: -abs(noted.assessment.scores[at]))
    return where_of(report, noted.assessment, order, noted.localisation.p_by_place)


def _unobservable(
    case: GapCase, candidates: Mapping[str, Candidate], suspected: Sequence[Cause], report: StatisticReport
) -> tuple[Unobservable, ...]:
    """Return the candidates other than the causes that the recordings cannot show; without a gap, also those that are
    not excluded.
    """
    comparison, suspected_effects = case.comparison, {cause.effect for cause in suspected}
    others = {name: candidate for name, candidate in candidates.items() if name not in suspected_effects}
    hidden = unobservable_effects(set(comparison.bench.kinds), facts_of(comparison.campaign), others, case.headers)
    if case.is_gap:
        return hidden
    places = range(len(comparison.pairs.keys))
    uncertain = uncertain_domains(
        np.array([report.scale(at, comparison.assessment) for at in places]),
        np.array([report.margin(at) for at in places]),
        comparison.pairs.keys,
        np.array([report.rate_and_length(at)[1] for at in places]),
        case.headers,
    )
    return (*hidden, *uncertain)


def _notes(
    case: GapCase,
    where: Sequence[Where],
    unexplained: Sequence[Where],
    sensor_causes: Sequence[Cause],
    shared: Sequence[SharedSignal],
) -> tuple[str, ...]:
    """Return notes on unexplained and on all lines of the spectrum, on bias changes that units of a chip share, on
    signals that sensors share, and on assumptions about each recording.
    """
    comparison, bench = case.comparison, case.comparison.bench
    lines = unexplained_lines(comparison.campaign, unexplained, case.names)
    changes = shared_changes(bench.keys, comparison.real.values, bench.held_out.tolist(), case.headers)
    return (
        *lines,
        *(changes if case.is_gap else ()),
        *lines_shown(comparison.campaign, where, sensor_causes),
        *notes_of(lines_of(sensor_causes, case.headers), shared),
        *(f"{recording.name}: {note}" for recording in case.recordings for note in recording.notes),
        *(f"{recording.name} (earlier): {note}" for recording in case.earlier for note in recording.notes),
    )


def _pulls(case: GapCase, causes: Sequence[Cause]) -> tuple[Pull, ...]:
    """Return the nuisance quantities of all sensors with a tolerance, as fitted to the training part, with causes that
    may explain them.
    """
    comparison = case.comparison
    train = comparison.bench.split.train(comparison.campaign)
    has_reference = all(recording.has_reference_temperature for recording in case.recordings)
    estimates = nuisance_estimates(train.campaign, comparison.bench.base, has_reference=has_reference)
    return pulls_of(estimates, causes)


def _overlays(case: GapCase, search: SearchResult, where: Sequence[Where]) -> tuple[Overlay, ...]:
    """Return the curves of the recording and of both models."""
    comparison, bench = case.comparison, case.comparison.bench
    return overlays_of(bench, comparison.campaign, where, (bench.models(), search.models), case.run, case.names)


def _summary(recording: Recording) -> RecordingSummary:
    """Return the length and content of a recording."""
    sensors = _sensors(recording)
    seconds = sum((phase.end_ns - phase.start_ns) * 1e-9 for phase in recording.phases)
    rows = sum(len(recording.log[name]) for name in sensors)
    return RecordingSummary(recording.name, recording.kind, seconds, len(sensors), len(recording.phases), rows)
