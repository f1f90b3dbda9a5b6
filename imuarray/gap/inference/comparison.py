"""Comparison of a recorded campaign with replicates of its model: statistics, the chance level, and the significant
differences. Or with earlier recordings of the same array instead of the simulator: the changes since then.

With earlier recordings, the simulator is calibrated at every statistic. The parameters of the base model (noise, bias,
slope) are fitted to the earlier recordings, and nothing is fitted to the new one. Each statistic of the new recording
has counterparts in the earlier ones: the same probe of the same sensor and axis, in a phase of the same name of a log
of the same kind, else in a phase of that name, else in any phase at rest. The *discrepancy* of a statistic is the
median, over its counterparts, of their distance from the median of their own replicates. It is the error of the
simulator for this array, and is subtracted from the new recording. A line, a correlation or a coarse code that was
present before is then not a difference, and neither is the misalignment of an axis.

Phases at rest are evaluated in pieces of one length on both sides, so that a long phase does not show what a short one
cannot.

Both sides scatter. A replicate of the comparison is a replicate of the new recording less one of the counterparts, each
relative to its own median, with the same drawn units and independent noise. Properties of the units (scale,
misalignment) cancel as they do between the recordings, and noise adds in quadrature: it is sqrt(2) times that of one
recording if both are as long. A statistic without a counterpart is left out.

A discrepancy is a shift. It is subtracted as measured, even if the effects of a new cause and an old one on a statistic
do not add (doubled noise hides half of an old line).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from itertools import chain
from types import MappingProxyType

import numpy as np

from imuarray.array import recorded_sensors
from imuarray.arrays import Floats, Indices
from imuarray.gap.inference.assessment import Assessment, Localisation, assess, largest_of, localise, p_value
from imuarray.gap.model.ambient_lines import fit_ambient_lines
from imuarray.gap.model.base_model import Base, fit, select_fitted
from imuarray.gap.model.bench import Bench, StatisticValues, bench_of
from imuarray.gap.model.populations import common_bias_sigma_g
from imuarray.gap.model.replication import TOGETHER, Models, ReplicateRequest
from imuarray.gap.model.signal_delay import DelayTrial, can_fit_signal_delays, fit_signal_delays, stated_delay
from imuarray.gap.model.workers import Run
from imuarray.gap.recording.course import Stretches, stretches_of
from imuarray.gap.recording.events import events_of
from imuarray.gap.recording.phases import is_at_rest
from imuarray.gap.recording.recorder_gaps import QUEUED, usual_interval_ns
from imuarray.gap.recording.recordings import Recording, reference_of, sources_of
from imuarray.gap.recording.source import Source
from imuarray.gap.statistics.campaign import Campaign, LogSummary, summarise_log
from imuarray.gap.statistics.catalogue import Key
from imuarray.gap.statistics.pairs import Pairs, scores_by_others
from imuarray.gap.statistics.pooled import equal_shares, pooled_scores
from imuarray.gap.statistics.split import Split, split_of
from imuarray.gap.statistics.tails import normal_scores_by_others
from imuarray.log.format import Phase
from imuarray.simulate.model import Model

_Place = tuple[str, ...]

MOST_PIECES = 8
"""Largest number of pieces of a phase. Each costs as much as a short phase, and eight determine the median of an
earlier recording to half of the scatter of a single piece.
"""


@dataclass(frozen=True)
class Earlier:
    """Earlier recordings on their own `bench`.

    `values` (e,) of their statistics; their median over replicates of the base model fitted to them (`middle`, (e,));
    and for each of n statistics of the new recording the places of its `counterparts` among these.
    """

    bench: Bench
    values: Floats = field(repr=False)
    middle: Floats = field(repr=False)
    counterparts: tuple[Indices, ...] = field(repr=False)
    run: Run

    def without_discrepancy(self, real: StatisticValues) -> StatisticValues:
        """Return the statistics (n,) of the new recording less the simulator's discrepancy in the earlier ones."""
        return replace(real, values=real.values - self._discrepancy(self.values))

    def with_scatter(self, simulated: Sequence[StatisticValues], numbers: Sequence[int]) -> tuple[StatisticValues, ...]:
        """Return replicates of the new recording less the scatter of the earlier recordings' replicates with the same
        numbers.
        """
        models = self.bench.models()
        groups = [numbers[first : first + TOGETHER] for first in range(0, len(numbers), TOGETHER)]
        requests = [[(models, number) for number in group] for group in groups]
        scatter = [self._discrepancy(values) for values in chain.from_iterable(self.run(_replicated, requests))]
        return tuple(
            replace(replicate, values=replicate.values - np.nan_to_num(discrepancy))
            for replicate, discrepancy in zip(simulated, scatter, strict=True)
        )

    def _discrepancy(self, values: Floats) -> Floats:
        """Return the median (n,) over the counterparts of the deviation of `values` (e,) from the median of their
        replicates; nan without counterparts.
        """
        deviation = values - self.middle
        known = [deviation[places][np.isfinite(deviation[places])] for places in self.counterparts]
        return np.array([np.median(some) if len(some) else np.nan for some in known])


def compare_with_earlier(
    bench: Bench, before: Bench, campaign: Campaign, run_on: Callable[[Bench], Run], replicates: int
) -> tuple[Bench, Earlier]:
    """Return a new recording's `bench` without the statistics that have no counterpart, and the earlier `campaign` on
    its bench `before`. The earlier campaign is evaluated with the base model of the new bench, which is fitted to it.
    """
    earlier_bench = replace(before, base=bench.base, is_refitted=False, first_boot=bench.first_boot + len(bench.kinds))
    run, models = run_on(earlier_bench), earlier_bench.models()
    groups = [range(first, min(first + TOGETHER, replicates)) for first in range(0, replicates, TOGETHER)]
    requests = [[(models, number) for number in group] for group in groups]
    simulated = np.array(list(chain.from_iterable(run(_replicated, requests))))
    known = np.isfinite(simulated).any(axis=0)
    middle = np.full(len(earlier_bench.keys), np.nan)
    middle[known] = np.nanmedian(simulated[:, known], axis=0)
    values = earlier_bench.measured(campaign, earlier_bench.base.fitted).values
    places = _counterparts(bench, earlier_bench)
    has_any = np.array([bool(np.isfinite(values[some] - middle[some]).any()) for some in places], bool)
    counterparts = tuple(some for some, is_present in zip(places, has_any.tolist(), strict=True) if is_present)
    return bench.of_keys(has_any), Earlier(earlier_bench, values, middle, counterparts, run)


def cut_to_equal_lengths(
    recordings: Sequence[Recording], earlier: Sequence[Recording]
) -> tuple[list[Recording], list[Recording]]:
    """Cut the phases at rest of both sides into pieces of one length, because statistics such as the strongest line
    depend on the length.

    The length is that of the side whose longest phase of the same name is shorter; of any name, if a side has none of
    that name.
    """
    longest = [_longest_ns(side) for side in (recordings, earlier)]

    def cut(recording: Recording) -> Recording:
        pieces = (_pieces(phase, min(side.get(phase.name, side[""]) for side in longest)) for phase in recording.phases)
        return replace(recording, phases=tuple(chain.from_iterable(pieces)))

    return list(map(cut, recordings)), list(map(cut, earlier))


def _longest_ns(recordings: Sequence[Recording]) -> dict[str, int]:
    """Return the length of the longest phase at rest of each name, and of any name ("")."""
    longest = {"": 0}
    for phase in chain.from_iterable(recording.phases for recording in recordings):
        if is_at_rest(phase):
            for name in ("", phase.name):
                longest[name] = max(longest.get(name, 0), phase.end_ns - phase.start_ns)
    return longest


def _pieces(phase: Phase, length_ns: int) -> Iterator[Phase]:
    """Yield pieces of about that length, evenly over the phase; a motion, or a phase that is little longer, is not
    cut.
    """
    whole_ns = phase.end_ns - phase.start_ns
    count = min(round(whole_ns / length_ns), MOST_PIECES) if length_ns > 0 and is_at_rest(phase) else 1
    if count < 2:
        yield phase
        return
    piece_ns = min(length_ns, whole_ns // count)
    for number in range(count):
        start_ns = phase.start_ns + number * (whole_ns - piece_ns) // (count - 1)
        yield phase._replace(start_ns=start_ns, end_ns=start_ns + piece_ns)


def _replicated(bench: Bench, requests: Sequence[ReplicateRequest]) -> list[Floats]:
    """Return the statistics (e,) of several replicates."""
    return [replicate.values for replicate in bench.replicates(requests)]


def _counterparts(bench: Bench, earlier: Bench) -> list[Indices]:
    """Return the places of the counterparts of each of the bench's keys among the earlier keys."""
    places_of: dict[_Place, list[int]] = {}
    for at, names in enumerate(_names(earlier)):
        for name in names:
            places_of.setdefault(name, []).append(at)
    nearest = [next((places_of[name] for name in names if name in places_of), []) for names in _names(bench)]
    return [np.array(places, np.intp) for places in nearest]


def _names(bench: Bench) -> Iterator[tuple[_Place, _Place, _Place]]:
    """Yield the properties that each key shares with its counterparts, the closest match first."""
    moving = {phase.name for phases in bench.split.phases() for phase in phases if not is_at_rest(phase)}
    for key, kind in zip(bench.keys, bench.log_kinds, strict=True):
        statistic = (key.sensor, key.axis, key.probe)
        state = "moving" if key.phase in moving else "at rest"
        yield (*statistic, "kind", kind, key.phase), (*statistic, "phase", key.phase, state), (*statistic, "any", state)


ENOUGH: Mapping[int, float] = MappingProxyType({20: 0.35, 28: 0.28, 40: 0.22, 64: 0.16, 96: 0.13})
"""Numbers of replicates after which no more are simulated if the p-values of single scores, of pooled ones and of all
exceed the limit. The limits are so far above `LEVEL` that a gap that all replicates would detect at p = 0.05 by the
same scores is missed in less than one of two hundred cases. More replicates also determine the scatter and the tails of
the scores better: with 20 of them, either kind of score can mask the other one, which is significant after 128.
"""


CLEAR: Mapping[int, float] = MappingProxyType({28: 3.0, 40: 1.5})
"""Numbers of replicates from which on no more are simulated if the ratio of the largest score of the recording to the
largest score of all replicates exceeds the limit. By the tails of the scores a gap is then certain, and more replicates
would change little.
"""

_DELAY_STEPS = 3
"""Steps of the fit of delays: the delay of readings that wait for a poll is not exactly the sum of all delays."""

_PART_ROWS = 128
"""Fewest rows of a part of a phase within a stretch: fewer have no spectrum."""


@dataclass(frozen=True)
class Comparison:
    """The recorded campaign on its bench with replicates of the base model.

    Statistics of the recording (`real`) and of the replicates, their pairs, the assessment of the recording by them,
    and the significant places. `earlier`: the recordings with which it is compared, if any.
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


_OWN_RATE, _APART = 0.15, 2e-3
"""Largest relative difference of a chip's rate from the configured one, and least difference between the intervals of
chips with the same configuration that are not polled by one clock.
"""


def prepare(
    recordings: Sequence[Recording], model: Model | None, seed: int, fitted_to: Sequence[Recording] = ()
) -> tuple[Bench, Campaign]:
    """Summarise the recordings, and fit the base model to their training part, or to all of other recordings of the
    same array (`fitted_to`). Sensors that these lack are left out.
    """
    split = split_of([recording.kind for recording in recordings], [recording.phases for recording in recordings])
    campaign = _summarise(recordings, split)
    experiments = [recording.experiment for recording in recordings]
    if fitted_to:
        base = _base_of(fitted_to, model, seed)
        campaign = select_fitted(campaign, base.fitted)
        return replace(bench_of(campaign, split, experiments, base), is_refitted=False), campaign
    train = split.train(campaign)
    base = fit(
        train.campaign,
        [experiments[at].motion for at in train.logs],
        model=model,
        seed=seed,
        vibrations=[experiments[at].vibrations for at in train.logs],
    )
    base = replace(
        base,
        queued=_queued_in(recordings),
        ambient_lines=fit_ambient_lines(campaign, base.headers),  # machines run in some logs only
        common_bias_g=common_bias_sigma_g(base.headers.values()),
    )
    campaign = select_fitted(campaign, base.fitted)
    return _correct(bench_of(campaign, split, experiments, base), campaign), campaign


def _queued_in(recordings: Sequence[Recording]) -> frozenset[str]:
    """Return the sensors whose rows are the chip's own readings, from a queue or at its data-ready signal: the
    configuration contains a queue, they have more rows than frames, or each of several chips has a rate of its own.
    """
    plans = [recording.experiment.plan for recording in recordings]
    configured = {
        name
        for text in {plan.config for plan in plans}
        for name, sensor in recorded_sensors(text).items()
        if sensor.fifo
    }
    queued = {
        name
        for plan in plans
        for name, (_, line) in plan.sensors.items()
        if name in configured or 0 < QUEUED * plan.frame_rate_hz < line.rows_per_s
    }
    return frozenset(queued.union(*map(_at_own_rates, recordings)))


def _at_own_rates(recording: Recording) -> set[str]:
    """Return the sensors that are configured to one rate and have rows at slightly different rates. Polls of one host
    would have the same intervals for all of them.
    """
    periods: dict[float, dict[str, float]] = {}
    for name, (header, _) in recording.experiment.plan.sensors.items():
        of_nominal = usual_interval_ns(recording.log[name]) * 1e-9 * header.rate_hz
        if abs(of_nominal - 1) < _OWN_RATE:
            periods.setdefault(header.rate_hz, {})[name] = of_nominal
    differ = [group for group in periods.values() if max(group.values()) - min(group.values()) > _APART]
    return {name for group in differ for name in group}


def _summarise(recordings: Sequence[Recording], split: Split) -> Campaign:
    """Return all logs, in the phases of the split."""
    logs = []
    for recording, phases in zip(recordings, split.phases(), strict=True):
        reference = reference_of(recording.experiment.motion)._replace(unresolved=partial(_unresolved_in, recording))
        summary = summarise_log(recording.kind, sources_of(recording), phases, reference)
        lines = {name: line for name, (_, line) in recording.experiment.plan.sensors.items()}
        moving = [phase for phase in recording.phases if not is_at_rest(phase)]
        events = events_of(recording.log, lines, moving, reference.track)
        logs.append(replace(summary, events=events, spells=_Spells(recording)))
    return Campaign(tuple(logs))


def _unresolved_in(recording: Recording, part: Phase) -> tuple[str, ...]:
    """Return the quantities with unresolved changes in the motion of which this is a part."""
    return next(
        (
            quantities
            for phase, quantities in recording.unresolved.items()
            if phase.start_ns <= part.start_ns and part.end_ns <= phase.end_ns
        ),
        (),
    )


def _base_of(recordings: Sequence[Recording], model: Model | None, seed: int) -> Base:
    """Return the base model fitted to all of these recordings."""
    split = split_of([recording.kind for recording in recordings], [recording.phases for recording in recordings])
    campaign, experiments = _summarise(recordings, split), [recording.experiment for recording in recordings]
    motions, vibrations = zip(*((each.motion, each.vibrations) for each in experiments), strict=True)
    base = fit(campaign, motions, model=model, seed=seed, vibrations=vibrations)
    base = replace(base, queued=_queued_in(recordings), ambient_lines=fit_ambient_lines(campaign, base.headers))
    return _correct(bench_of(campaign, split, experiments, base), campaign).base


class _Spells(Mapping[str, tuple[tuple[Stretches, LogSummary], ...]]):
    """Stretches, by sensor, in which it reads differently from the rest of a log at rest, with their summary. They are
    computed on demand, because only sensors that deviate need them.
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
    """Yield the parts of phases that lie within stretches and hold enough rows."""
    for phase in phases:
        for begin_s, end_s in stretches:
            start_ns = max(phase.start_ns, round(begin_s * 1e9))
            end_ns = phase.end_ns if math.isinf(end_s) else min(phase.end_ns, round(end_s * 1e9))
            if start_ns < end_ns and source.rows(start_ns, end_ns) >= _PART_ROWS:
                yield phase._replace(start_ns=start_ns, end_ns=end_ns)


def _correct(bench: Bench, campaign: Campaign) -> Bench:
    """Return the bench with a base model that is corrected by replicates: for delays, or for the contributions of the
    effects of a given model.
    """
    return with_signal_delays(bench, campaign) if bench.base.model is None else settle_bench(bench)


def with_signal_delays(bench: Bench, campaign: Campaign, replicates: int = 6) -> Bench:
    """Return the bench with the delays of the signals fitted to all motions of the campaign, by this number of
    `replicates` in each step. Both parts are used, because the box often moves in only one of them.
    """
    if not can_fit_signal_delays(campaign, bench.base.headers, bench.base.queued):
        return bench
    trials: list[DelayTrial] = []
    for _ in range(_DELAY_STEPS):
        base = bench.base
        requests = [(bench.models(), number) for number in range(replicates)]
        simulated = bench.motion_replicates(requests)
        trials.append(({name: parameters.delay for name, parameters in base.fitted.items()}, simulated))
        delays = fit_signal_delays(campaign, base.headers, base.queued, trials)
        fitted = {
            name: replace(parameters, delay=delays.get(name, stated_delay(base.headers[name])))
            for name, parameters in base.fitted.items()
        }
        bench = replace(bench, base=replace(base, fitted=fitted))
        if any(delays.items() <= tried.items() for tried, _ in trials):
            break
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

    Uses this number of `replicates`, or fewer if they show that the recording is well within chance (`ENOUGH`) or far
    beyond it (`CLEAR`; p is then the least value for that number, which is larger than after all replicates). The
    p-value is that of a sequential Monte Carlo test, which continues only as long as the recording is among the most
    extreme (Besag and Clifford, Biometrika 78, 1991). The test is valid: after all replicates the p-value is exact, an
    earlier end well within chance only makes small p-values rarer, and a recording without a gap is hardly ever clear.
    """
    real, pairs = bench.observed(campaign, bench.base.fitted), bench.pairs()
    real = real if earlier is None else earlier.without_discrepancy(real)
    real = replace(real, values=_without_flags_never_set(bench.keys, real.values))
    simulated: tuple[StatisticValues, ...] = ()
    looks = [count for count in ENOUGH if count < replicates]
    for count in (*looks, replicates):
        numbers = range(len(simulated), count)
        more = observe_replicates(bench, bench.models(), numbers, run)
        simulated += tuple(more) if earlier is None else earlier.with_scatter(more, numbers)
        chance = np.array([replicate.values for replicate in simulated])
        scores = scores_by_others(pairs, np.vstack([real.values, chance]), bench.resolutions)
        normal = normal_scores_by_others(scores, pairs.keys)
        pooled, largest = pooled_scores(normal, pairs.keys), largest_of(normal)
        where = localise(pairs.keys, bench.base.headers, normal[0], normal[1:], pooled)
        each = (largest_of(equal_shares(normal, pairs.keys)), largest_of(pooled.scores))
        p = min(where.p, *(p_value(float(scores_of_kind[0]), scores_of_kind[1:]) for scores_of_kind in each))
        if is_decided(count, p, float(largest[0]), float(largest[1:].max())):
            break
    whole = replace(assess(pairs, real.values, chance, bench.resolutions, scores[1:]), p=where.p, limit=where.limit)
    return Comparison(bench, campaign, real, simulated, pairs, whole, where, earlier)


def is_decided(count: int, p: float, largest: float, furthest: float) -> bool:
    """Return whether more than `count` replicates would change little: a recording with this p-value is well within
    chance (`ENOUGH`), or its `largest` normal score is far beyond the `furthest` of all replicates (`CLEAR`).
    """
    limits = [limit for least, limit in CLEAR.items() if least <= count]
    return p > ENOUGH.get(count, 1.0) or (bool(limits) and largest > min(limits) * furthest)


def _without_flags_never_set(keys: Sequence[Key], values: Floats) -> Floats:
    """Return the statistics (n,) of a recording without the share of stale rows if no row of any sensor is flagged as
    stale: not every recorder compares readings.
    """
    places = np.array([place for place, key in enumerate(keys) if key.probe == "stale"], np.intp)
    if not len(places) or np.nan_to_num(values[places]).any():
        return values
    known = values.copy()
    known[places] = np.nan
    return known


def observe_replicates(bench: Bench, models: Models, numbers: Sequence[int], run: Run) -> list[StatisticValues]:
    """Return the statistics of numbered replicates of sensors with these models, a few in each job."""
    requests, together = [(models, number) for number in numbers], bench.together
    groups = [requests[first : first + together] for first in range(0, len(requests), together)]
    return list(chain.from_iterable(run(_observe, groups)))


def _observe(bench: Bench, requests: Sequence[ReplicateRequest]) -> list[StatisticValues]:
    return bench.each_observed(bench.campaigns(requests), requests[0][0])
