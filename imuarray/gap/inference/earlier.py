"""Earlier recordings of the same array in the simulator's place: what changed since then.

The method calibrates the simulator at every statistic. The parameters of the base model (noise, bias, slope) are fitted
to the earlier recordings, and nothing is fitted to the new one. Each statistic of the new recording has counterparts in
the earlier ones: the same probe of the same sensor and axis, in a phase of the same name of a log of the same kind,
else in a phase of that name, else in any phase at rest. The *discrepancy* of a statistic is the distance of its
counterparts from the middle of their own replicates (the median over them). It is the error of the simulator for this
array, and is subtracted from the new recording. A line, a correlation or a coarse code that was there before is then no
difference, and an axis that leans leans as before.

Phases at rest are evaluated in pieces of one length on both sides, so that a long phase shows nothing that a short one
can't.

Both sides scatter. A replicate of the comparison is one of the new recording less one of the counterparts, each about
its own middle, of the same drawn units and with independent noise. Properties of the units (scale, misalignment) cancel
as they do between the recordings, and noise adds in quadrature: sqrt(2) times that of one recording where both are as
long. A statistic without a counterpart is left out.

A discrepancy is a shift. Where the effect of a new cause and that of an old one on a statistic do not add (a noise that
doubles hides half of an old line), the shift is subtracted as it was measured.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain

import numpy as np

from imuarray.arrays import Floats, Indices
from imuarray.gap.model.bench import Bench, StatisticValues
from imuarray.gap.model.replication import TOGETHER, ReplicateRequest
from imuarray.gap.model.workers import Run
from imuarray.gap.recording.phases import is_at_rest
from imuarray.gap.recording.recordings import Recording
from imuarray.gap.statistics.campaign import Campaign
from imuarray.log.format import Phase

_Place = tuple[str, ...]

MOST_PIECES = 8
"""Most pieces of a phase: each costs as much as a short phase, and eight determine the median of an earlier recording
to half of the scatter of one.
"""


@dataclass(frozen=True)
class Earlier:
    """Earlier recordings on their own `bench`.

    `values` (e,) of their statistics, the median (`middle`, (e,)) over replicates of the base model fitted to them, and
    for each of n statistics of the new recording the places of its `counterparts` among these.
    """

    bench: Bench
    values: Floats = field(repr=False)
    middle: Floats = field(repr=False)
    counterparts: tuple[Indices, ...] = field(repr=False)
    run: Run

    def without_discrepancy(self, real: StatisticValues) -> StatisticValues:
        """Return statistics (n,) of the new recording less the discrepancy of the simulator in the earlier ones."""
        return replace(real, values=real.values - self._discrepancy(self.values))

    def with_scatter(self, simulated: Sequence[StatisticValues], numbers: Sequence[int]) -> tuple[StatisticValues, ...]:
        """Return replicates of the new recording less the scatter of the earlier ones' replicates
        of the same numbers.
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
        """Return the median (n,) over the counterparts of the deviation of `values` (e,) from the
        middle; nan without.
        """
        deviation = values - self.middle
        known = [deviation[places][np.isfinite(deviation[places])] for places in self.counterparts]
        return np.array([np.median(some) if len(some) else np.nan for some in known])


def compare_with_earlier(
    bench: Bench, before: Bench, campaign: Campaign, run_on: Callable[[Bench], Run], replicates: int
) -> tuple[Bench, Earlier]:
    """Return a new recording's `bench` without the statistics that have no counterpart, and the earlier `campaign` on
    its bench `before`, measured by the parameters of the new bench's base model, which are fitted to it.
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
    """Cut the phases at rest of both sides into pieces of one length, since statistics such as the strongest line
    depend on the length.

    The length is that of the shorter phases of the same name, or of any name where one side has none of it.
    """
    longest = [_longest_ns(side) for side in (recordings, earlier)]

    def cut(recording: Recording) -> Recording:
        pieces = (_pieces(phase, min(side.get(phase.name, side[""]) for side in longest)) for phase in recording.phases)
        return replace(recording, phases=tuple(chain.from_iterable(pieces)))

    return list(map(cut, recordings)), list(map(cut, earlier))


def _longest_ns(recordings: Sequence[Recording]) -> dict[str, int]:
    """Return the length of the longest phase at rest of each name, and of any ("")."""
    longest = {"": 0}
    for phase in chain.from_iterable(recording.phases for recording in recordings):
        if is_at_rest(phase):
            for name in ("", phase.name):
                longest[name] = max(longest.get(name, 0), phase.end_ns - phase.start_ns)
    return longest


def _pieces(phase: Phase, length_ns: int) -> Iterator[Phase]:
    """Pieces of about that length, evenly over the phase; a phase that is little longer, or a motion, stays whole."""
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
    """Return statistics (e,) of several replicates."""
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
