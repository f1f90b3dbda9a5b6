"""A recorded campaign beside replicates of a model of it: what was recorded, what chance makes, where they differ."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain
from types import MappingProxyType

import numpy as np

from imuarray.arrays import Floats
from imuarray.gap.inference.assessment import Assessment, assess
from imuarray.gap.inference.earlier import Earlier
from imuarray.gap.inference.localisation import Localisation, located
from imuarray.gap.model.base_model import Base, fit
from imuarray.gap.model.bench import Bench, StatisticValues, bench_of
from imuarray.gap.model.replication import Models, ReplicateRequest
from imuarray.gap.model.workers import Run
from imuarray.gap.recording.course import Stretches, stretches_of
from imuarray.gap.recording.events import events_of
from imuarray.gap.recording.phases import is_at_rest
from imuarray.gap.recording.recordings import Recording, sources_of, temperature_of
from imuarray.gap.recording.source import Source
from imuarray.gap.statistics.campaign import Campaign, LogSummary, summarise_log
from imuarray.gap.statistics.pairs import Pairs, scores_by_others
from imuarray.gap.statistics.split import Split, split_of
from imuarray.log.format import Phase
from imuarray.simulate.model import Model
from imuarray.simulate.motion.felt import Motion
from imuarray.simulate.motion.like import LikeLog

ENOUGH: Mapping[int, float] = MappingProxyType({40: 0.25, 64: 0.15})
"""After so many replicates of the base model no more are simulated, though more are asked for, if the p-value is
larger. The limits never rise, and are so far above `LEVEL` that hardly a gap is missed: one that all replicates
would find at p = 0.05 is given up by less than one in two hundred.
"""


QUEUED = 1.2
"""Times the rate of the frames: a sensor with more rows than that is not read once a frame."""

_PART_ROWS = 128
"""Of a phase within a stretch: fewer have no spectrum."""


@dataclass(frozen=True)
class Comparison:
    """The recorded campaign on its bench, beside replicates of the base model: statistics of the recording (`real`)
    and of the replicates, their pairs, the recording judged by them, and where it is beyond chance. `earlier` are the
    recordings with which this one is compared, if there are any.
    """

    bench: Bench
    campaign: Campaign
    real: StatisticValues
    replicates: tuple[StatisticValues, ...]
    pairs: Pairs
    judged: Assessment
    located: Localisation
    earlier: Earlier | None = None

    @cached_property
    def chance(self) -> Floats:
        """(b, n) the replicates' statistics."""
        return np.array([one.values for one in self.replicates])


def prepared(
    recordings: Sequence[Recording], model: Model | None, seed: int, fitted_to: Sequence[Recording] = ()
) -> tuple[Bench, Campaign]:
    """The recordings summarised, the base model fitted to their training part, or to all of other recordings of the
    same array (`fitted_to`); sensors that these lack are left out.
    """
    split = split_of([one.kind for one in recordings], [one.phases for one in recordings])
    campaign = _summarised(recordings, split)
    experiments = [one.experiment for one in recordings]
    if fitted_to:
        base = _base_of(fitted_to, model, seed)
        campaign = _of_fitted(campaign, base)
        return replace(bench_of(campaign, split, experiments, base), is_refitted=False), campaign
    train = split.train(campaign)
    base = fit(train.campaign, [experiments[at].motion for at in train.logs], model=model, seed=seed)
    base = replace(base, queued=_queued_in(recordings))
    campaign = _of_fitted(campaign, base)
    bench = bench_of(campaign, split, experiments, base)
    return (bench if model is None else settled(bench)), campaign


def _queued_in(recordings: Sequence[Recording]) -> frozenset[str]:
    """Sensors with more rows than frames: a queue of theirs is drained."""
    return frozenset(
        name
        for recording in recordings
        for name, (_, line) in recording.experiment.plan.sensors.items()
        if 0 < QUEUED * recording.experiment.plan.frame_rate_hz < line.rows_per_s
    )


def _summarised(recordings: Sequence[Recording], split: Split) -> Campaign:
    """All logs, in the phases of the split."""
    logs = []
    for one, phases in zip(recordings, split.phases(), strict=True):
        summary = summarise_log(one.kind, sources_of(one), phases, temperature_of(one.experiment.motion))
        lines = {name: line for name, (_, line) in one.experiment.plan.sensors.items()}
        moving = [phase for phase in one.phases if not is_at_rest(phase)]
        events = events_of(one.log, lines, moving, _tracked(one.experiment.motion))
        logs.append(replace(summary, events=events, spells=_Spells(one)))
    return Campaign(tuple(logs))


def _base_of(recordings: Sequence[Recording], model: Model | None, seed: int) -> Base:
    """The base model fitted to all of these recordings."""
    split = split_of([one.kind for one in recordings], [one.phases for one in recordings])
    campaign, experiments = _summarised(recordings, split), [one.experiment for one in recordings]
    base = fit(campaign, [experiment.motion for experiment in experiments], model=model, seed=seed)
    base = replace(base, queued=_queued_in(recordings))
    if model is None:
        return base
    return settled(bench_of(campaign, split, experiments, base)).base


class _Spells(Mapping[str, tuple[tuple[Stretches, LogSummary], ...]]):
    """By sensor, stretches in which it reads otherwise than in the rest of a log at rest, with what it shows in these:
    told when they are asked for, which they are only of a sensor that differs.
    """

    def __init__(self, recording: Recording) -> None:
        self._recording = recording
        self._found: dict[str, tuple[tuple[Stretches, LogSummary], ...]] = {}

    def __getitem__(self, sensor: str) -> tuple[tuple[Stretches, LogSummary], ...]:
        if sensor not in self._found:
            self._found[sensor] = tuple(_spells(self._recording, sensor))
        return self._found[sensor]

    def __iter__(self) -> Iterator[str]:
        return iter(self._recording.experiment.plan.sensors)

    def __len__(self) -> int:
        return len(self._recording.experiment.plan.sensors)


def _spells(recording: Recording, sensor: str) -> Iterator[tuple[Stretches, LogSummary]]:
    still = [phase for phase in recording.phases if is_at_rest(phase)]
    source, temperature = sources_of(recording)[sensor], temperature_of(recording.experiment.motion)
    for stretches in stretches_of(source, still):
        parts = list(_cut(still, stretches, source))
        yield stretches, summarise_log(recording.kind, {sensor: source}, parts, temperature)


def _cut(phases: Sequence[Phase], stretches: Stretches, source: Source) -> Iterator[Phase]:
    """The parts of phases within stretches that hold enough rows."""
    for phase in phases:
        for begin_s, end_s in stretches:
            start_ns = max(phase.start_ns, round(begin_s * 1e9))
            end_ns = phase.end_ns if math.isinf(end_s) else min(phase.end_ns, round(end_s * 1e9))
            if start_ns < end_ns and source.rows(start_ns, end_ns) >= _PART_ROWS:
                yield phase._replace(start_ns=start_ns, end_ns=end_ns)


def _tracked(motion: Motion) -> Motion | None:
    """A motion that a track of the log tells; None if it is only known on which face the box lay."""
    return motion if isinstance(motion, LikeLog) and motion.source != "phases" else None


def _of_fitted(campaign: Campaign, base: Base) -> Campaign:
    """Without sensors to which nothing was fitted, such as those that only the held-out part has."""
    logs = []
    for log in campaign.logs:
        phases = [
            replace(part, sensors={name: one for name, one in part.sensors.items() if name in base.fitted})
            for part in log.phases
        ]
        logs.append(replace(log, phases=tuple(phases)))
    return Campaign(tuple(logs))


def settled(bench: Bench, replicates: int = 8) -> Bench:
    """The bench with the base model's ordinary parameters moved by as much as the fit of its replicates misses that of
    the recording: what the other effects of a model add to noise and level is not in them twice.
    """
    models = bench.models()
    came = [one.fitted for one in bench.replicates([(models, number) for number in range(replicates)], held_out=False)]
    fitted = {
        name: one.moved(bench.base.fitted[name], [each[name] for each in came])
        for name, one in bench.base.fitted.items()
    }
    return replace(bench, base=replace(bench.base, fitted=fitted))


def compared_with_base(
    bench: Bench, campaign: Campaign, run: Run, replicates: int, earlier: Earlier | None = None
) -> Comparison:
    """Where the recording leaves what the base model makes of it, or what `earlier` recordings and the base model that
    is fitted to these make of it, by so many `replicates`, or fewer where they tell that it is well within chance
    (`ENOUGH`).

    The p-value is that of a sequential Monte Carlo test, which goes on only as long as the recording is among the
    strangest (Besag and Clifford, Biometrika 78, 1991). It is valid: a recording without a gap is found at p <= a in at
    most a share a of all cases. For whichever look is the first that may end at such a p, those before it have ended at
    larger ones only, since the limits of `ENOUGH` never rise, and it ends at p <= a, or goes on, only where its own p,
    an exact one, is at most a.
    """
    real, pairs = bench.observed(campaign, bench.base.fitted), bench.pairs()
    real = real if earlier is None else earlier.without_discrepancy(real)
    came: tuple[StatisticValues, ...] = ()
    looks = [(count, limit) for count, limit in ENOUGH.items() if count < replicates]
    for count, limit in (*looks, (replicates, 0.0)):
        numbers = range(len(came), count)
        more = observed(bench, bench.models(), numbers, run)
        came += tuple(more) if earlier is None else earlier.with_scatter(more, numbers)
        chance = np.array([one.values for one in came])
        scores = scores_by_others(pairs, np.vstack([real.values, chance]), bench.resolutions)
        where = located(pairs.keys, bench.base.headers, scores[0], scores[1:])
        if where.p > limit:
            break
    whole = replace(assess(pairs, real.values, chance, bench.resolutions, scores[1:]), p=where.p, limit=where.limit)
    return Comparison(bench, campaign, real, came, pairs, whole, where, earlier)


def observed(bench: Bench, models: Models, numbers: Sequence[int], run: Run) -> list[StatisticValues]:
    """Replicates, by their numbers, of sensors modelled so; a few of them in each job."""
    asked, together = [(models, number) for number in numbers], bench.together
    groups = [asked[first : first + together] for first in range(0, len(asked), together)]
    return list(chain.from_iterable(run(_observed, groups)))


def _observed(bench: Bench, asked: Sequence[ReplicateRequest]) -> list[StatisticValues]:
    return bench.each_observed(bench.campaigns(asked), asked[0][0])
