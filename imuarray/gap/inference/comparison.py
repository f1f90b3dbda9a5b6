"""Comparison of a recorded campaign with replicates of its model: statistics, the chance level, and where they
differ.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain
from types import MappingProxyType

import numpy as np

from imuarray.array import recorded_sensors
from imuarray.arrays import Floats
from imuarray.gap.inference.assessment import Assessment, assess
from imuarray.gap.inference.earlier import Earlier
from imuarray.gap.inference.localisation import Localisation, localise
from imuarray.gap.model.ambient_lines import fit_ambient_lines
from imuarray.gap.model.base_model import Base, fit, select_fitted
from imuarray.gap.model.bench import Bench, StatisticValues, bench_of
from imuarray.gap.model.populations import common_bias_sigma_g
from imuarray.gap.model.replication import Models, ReplicateRequest
from imuarray.gap.model.signal_delay import DelayTrial, can_fit_signal_delays, fit_signal_delays, stated_delay
from imuarray.gap.model.workers import Run
from imuarray.gap.recording.course import Stretches, stretches_of
from imuarray.gap.recording.events import events_of
from imuarray.gap.recording.phases import is_at_rest
from imuarray.gap.recording.recorder_gaps import QUEUED
from imuarray.gap.recording.recordings import Recording, reference_of, sources_of
from imuarray.gap.recording.source import Source
from imuarray.gap.statistics.campaign import Campaign, LogSummary, summarise_log
from imuarray.gap.statistics.catalogue import Key
from imuarray.gap.statistics.pairs import Pairs, scores_by_others
from imuarray.gap.statistics.pooled import pooled_scores
from imuarray.gap.statistics.split import Split, split_of
from imuarray.gap.statistics.tails import normal_scores_by_others
from imuarray.log.format import Phase
from imuarray.simulate.model import Model

ENOUGH: Mapping[int, float] = MappingProxyType({40: 0.25, 64: 0.15})
"""Numbers of replicates after which no more are simulated if the p-value is larger than the limit. The limits never
rise, and are so far above `LEVEL` that hardly a gap is missed: one that all replicates would detect at p = 0.05 is
given up in less than one of two hundred cases.
"""


_DELAY_STEPS = 3
"""Steps of the fit of delays: the delay of readings that wait for a poll is not quite the sum of all delays."""

_PART_ROWS = 128
"""Fewest rows of a phase within a stretch, to have a spectrum."""


@dataclass(frozen=True)
class Comparison:
    """The recorded campaign on its bench with replicates of the base model.

    Statistics of the recording (`real`) and of the replicates, their pairs, the assessment of the recording by them,
    and where it is beyond chance. `earlier`: the recordings with which it is compared, if any.
    """

    bench: Bench
    campaign: Campaign
    real: StatisticValues
    replicates: tuple[StatisticValues, ...]
    pairs: Pairs
    assessment: Assessment
    localisation: Localisation
    earlier: Earlier | None = None

    @cached_property
    def chance(self) -> Floats:
        """Statistics (b, n) of the replicates."""
        return np.array([replicate.values for replicate in self.replicates])


def prepare(
    recordings: Sequence[Recording], model: Model | None, seed: int, fitted_to: Sequence[Recording] = ()
) -> tuple[Bench, Campaign]:
    """Summarise the recordings and fit the base model to their training part, or to all of other recordings of the
    same array (`fitted_to`); sensors that these lack are left out.
    """
    split = split_of([recording.kind for recording in recordings], [recording.phases for recording in recordings])
    campaign = _summarise(recordings, split)
    experiments = [recording.experiment for recording in recordings]
    if fitted_to:
        base = _base_of(fitted_to, model, seed)
        campaign = select_fitted(campaign, base.fitted)
        return replace(bench_of(campaign, split, experiments, base), is_refitted=False), campaign
    train = split.train(campaign)
    base = fit(train.campaign, [experiments[at].motion for at in train.logs], model=model, seed=seed)
    base = replace(
        base,
        queued=_queued_in(recordings),
        ambient_lines=fit_ambient_lines(train.campaign, base.headers),
        common_bias_g=common_bias_sigma_g(base.headers.values()),
    )
    campaign = select_fitted(campaign, base.fitted)
    return _correct(bench_of(campaign, split, experiments, base), campaign), campaign


def _queued_in(recordings: Sequence[Recording]) -> frozenset[str]:
    """Return sensors whose rows come from a queue in the chip: the configuration says so, or they have more rows than
    there are frames.
    """
    plans = [recording.experiment.plan for recording in recordings]
    configured = {
        name
        for text in {plan.config for plan in plans}
        for name, sensor in recorded_sensors(text).items()
        if sensor.fifo
    }
    return frozenset(
        name
        for plan in plans
        for name, (_, line) in plan.sensors.items()
        if name in configured or 0 < QUEUED * plan.frame_rate_hz < line.rows_per_s
    )


def _summarise(recordings: Sequence[Recording], split: Split) -> Campaign:
    """Return all logs, in the phases of the split."""
    logs = []
    for recording, phases in zip(recordings, split.phases(), strict=True):
        reference = reference_of(recording.experiment.motion)
        summary = summarise_log(recording.kind, sources_of(recording), phases, reference)
        lines = {name: line for name, (_, line) in recording.experiment.plan.sensors.items()}
        moving = [phase for phase in recording.phases if not is_at_rest(phase)]
        events = events_of(recording.log, lines, moving, reference.track)
        logs.append(replace(summary, events=events, spells=_Spells(recording)))
    return Campaign(tuple(logs))


def _base_of(recordings: Sequence[Recording], model: Model | None, seed: int) -> Base:
    """Return the base model fitted to all of these recordings."""
    split = split_of([recording.kind for recording in recordings], [recording.phases for recording in recordings])
    campaign, experiments = _summarise(recordings, split), [recording.experiment for recording in recordings]
    base = fit(campaign, [experiment.motion for experiment in experiments], model=model, seed=seed)
    base = replace(base, queued=_queued_in(recordings), ambient_lines=fit_ambient_lines(campaign, base.headers))
    return _correct(bench_of(campaign, split, experiments, base), campaign).base


class _Spells(Mapping[str, tuple[tuple[Stretches, LogSummary], ...]]):
    """Stretches, by sensor, in which it reads differently from the rest of a log at rest, with the summary in them.
    They are computed on demand, which is only for sensors that deviate.
    """

    def __init__(self, recording: Recording) -> None:
        self._recording = recording
        self._cache: dict[str, tuple[tuple[Stretches, LogSummary], ...]] = {}

    def __getitem__(self, sensor: str) -> tuple[tuple[Stretches, LogSummary], ...]:
        if sensor not in self._cache:
            self._cache[sensor] = tuple(_spells(self._recording, sensor))
        return self._cache[sensor]

    def __iter__(self) -> Iterator[str]:
        return iter(self._recording.experiment.plan.sensors)

    def __len__(self) -> int:
        return len(self._recording.experiment.plan.sensors)


def _spells(recording: Recording, sensor: str) -> Iterator[tuple[Stretches, LogSummary]]:
    still = [phase for phase in recording.phases if is_at_rest(phase)]
    source, reference = sources_of(recording)[sensor], reference_of(recording.experiment.motion)
    for stretches in stretches_of(source, still):
        parts = list(_cut(still, stretches, source))
        yield stretches, summarise_log(recording.kind, {sensor: source}, parts, reference)


def _cut(phases: Sequence[Phase], stretches: Stretches, source: Source) -> Iterator[Phase]:
    """Yield the parts of phases within stretches that hold enough rows."""
    for phase in phases:
        for begin_s, end_s in stretches:
            start_ns = max(phase.start_ns, round(begin_s * 1e9))
            end_ns = phase.end_ns if math.isinf(end_s) else min(phase.end_ns, round(end_s * 1e9))
            if start_ns < end_ns and source.rows(start_ns, end_ns) >= _PART_ROWS:
                yield phase._replace(start_ns=start_ns, end_ns=end_ns)


def _correct(bench: Bench, campaign: Campaign) -> Bench:
    """Return the bench with what of its base model only replicates tell: delays, or what the effects of a given model
    add.
    """
    return with_signal_delays(bench, campaign) if bench.base.model is None else settle_bench(bench)


def with_signal_delays(bench: Bench, campaign: Campaign, replicates: int = 6) -> Bench:
    """Return the bench with the delays of the signals fitted to all motions of the campaign, by so many replicates for
    each step: often the box moves much in one part only.
    """
    if not can_fit_signal_delays(campaign, bench.base.headers, bench.base.queued):
        return bench
    moving = [number for number, log in enumerate(campaign.logs) if not all(part.is_still for part in log.phases)]
    trials: list[DelayTrial] = []
    for _ in range(_DELAY_STEPS):
        base = bench.base
        requests = [(bench.models(), number) for number in range(replicates)]
        simulated = bench.campaigns(requests, logs=moving)
        trials.append(({name: parameters.delay for name, parameters in base.fitted.items()}, simulated))
        delays = fit_signal_delays(campaign, base.headers, base.queued, trials)
        fitted = {
            name: replace(parameters, delay=delays.get(name, stated_delay(base.headers[name])))
            for name, parameters in base.fitted.items()
        }
        bench = replace(bench, base=replace(base, fitted=fitted))
    return bench


def settle_bench(bench: Bench, replicates: int = 8) -> Bench:
    """Return the bench with the base model's ordinary parameters corrected by the difference between the fits of its
    replicates and of the recording, so that the contribution of other effects to noise and level is not counted twice.
    """
    models = bench.models()
    replicated = bench.replicates([(models, number) for number in range(replicates)], held_out=False)
    fitted = {
        name: parameters.moved(bench.base.fitted[name], [replicate.fitted[name] for replicate in replicated])
        for name, parameters in bench.base.fitted.items()
    }
    return replace(bench, base=replace(bench.base, fitted=fitted))


def compare_with_base(
    bench: Bench, campaign: Campaign, run: Run, replicates: int, earlier: Earlier | None = None
) -> Comparison:
    """Compare the recording with the base model, or with `earlier` recordings and the base model fitted to these.

    Uses so many `replicates`, or fewer if they show that it is well within chance (`ENOUGH`). The p-value is that of a
    sequential Monte Carlo test, which continues only as long as the recording is among the most extreme (Besag and
    Clifford, Biometrika 78, 1991). It is valid: a recording without a gap has p <= a in at most a share a of all cases.
    For the first look that may end at such a p, those before it ended at larger ones only, since the limits of `ENOUGH`
    never rise, and it ends at p <= a, or continues, only if its own p, an exact one, is at most a.
    """
    real, pairs = bench.observed(campaign, bench.base.fitted), bench.pairs()
    real = real if earlier is None else earlier.without_discrepancy(real)
    real = replace(real, values=_without_flags_never_set(bench.keys, real.values))
    simulated: tuple[StatisticValues, ...] = ()
    looks = [(count, limit) for count, limit in ENOUGH.items() if count < replicates]
    for count, limit in (*looks, (replicates, 0.0)):
        numbers = range(len(simulated), count)
        more = observe_replicates(bench, bench.models(), numbers, run)
        simulated += tuple(more) if earlier is None else earlier.with_scatter(more, numbers)
        chance = np.array([replicate.values for replicate in simulated])
        scores = scores_by_others(pairs, np.vstack([real.values, chance]), bench.resolutions)
        normal = normal_scores_by_others(scores, pairs.keys)
        where = localise(pairs.keys, bench.base.headers, normal[0], normal[1:], pooled_scores(normal, pairs.keys))
        if where.p > limit:
            break
    whole = replace(assess(pairs, real.values, chance, bench.resolutions, scores[1:]), p=where.p, limit=where.limit)
    return Comparison(bench, campaign, real, simulated, pairs, whole, where, earlier)


def _without_flags_never_set(keys: Sequence[Key], values: Floats) -> Floats:
    """Return the statistics (n,) of a recording without the share of repeated rows if no row of any sensor is flagged
    as one: not every recorder compares readings.
    """
    places = np.array([place for place, key in enumerate(keys) if key.probe == "stale"], np.intp)
    if not len(places) or np.nan_to_num(values[places]).any():
        return values
    known = values.copy()
    known[places] = np.nan
    return known


def observe_replicates(bench: Bench, models: Models, numbers: Sequence[int], run: Run) -> list[StatisticValues]:
    """Return statistics of numbered replicates of sensors with these models, a few in each job."""
    requests, together = [(models, number) for number in numbers], bench.together
    groups = [requests[first : first + together] for first in range(0, len(requests), together)]
    return list(chain.from_iterable(run(_observe, groups)))


def _observe(bench: Bench, requests: Sequence[ReplicateRequest]) -> list[StatisticValues]:
    return bench.each_observed(bench.campaigns(requests), requests[0][0])
