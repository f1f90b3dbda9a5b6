"""Probes of the times of rows and of repeated readings."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from imuarray.arrays import Floats
from imuarray.gap.recording.phases import is_at_rest
from imuarray.gap.statistics.margins import GENEROUS, ROWS, RUN, VARIANCE
from imuarray.gap.statistics.probes.probe import CampaignProbe, PhaseProbe, Probes, arcsine, log, one_row
from imuarray.gap.statistics.summary import Summary


def interval(summary: Summary) -> Floats:
    """Return the log of the mean interval in s."""
    return log(summary.intervals.mean_s)


def irregularity(summary: Summary) -> Floats:
    """Return the log of the ratio of the standard deviation of intervals to their mean; the ratio is at least 1e-6."""
    times = summary.intervals
    return np.asarray(log(math.hypot(times.std_s, 1e-6 * times.mean_s)) - log(times.mean_s))


def gaps(summary: Summary) -> Floats:
    """Return the arcsine of the share of intervals that are gaps."""
    times = summary.intervals
    return arcsine(times.gaps, times.count + times.gaps)


def skips(summary: Summary) -> Floats:
    """Return the arcsine of the share of intervals that are gaps of a few rows, without stalls of the recorder; nan if
    there are no stalls, since `gaps` then has the same value.
    """
    times = summary.intervals
    return arcsine(times.skips, times.count + times.gaps) if times.skips < times.gaps else np.asarray(np.nan)


def longest(summary: Summary) -> Floats:
    """Return the log of the ratio of the longest interval to the mean."""
    return np.asarray(log(summary.intervals.longest_s) - log(summary.intervals.mean_s))


MOST_DOUBTFUL = 0.1
"""Largest share of wrong flags among the rows that the recorder flags as no new reading, up to which repetitions are
compared. If many readings are updated while they are read, some rows mix two readings, and fewer rows are equal than
polls repeat a reading.
"""


def tells_repetitions(summary: Summary) -> bool:
    """Return whether the number of repeated readings can be determined from the recorder's polls."""
    doubtful = summary.flags["doubtful"]
    return not doubtful > MOST_DOUBTFUL * (doubtful + summary.flags["stale"])


UNEVEN = 10.0
"""Largest ratio between the numbers of missed and repeated readings, either way, at which both are attributed to uneven
polls.
"""


def counts_repeats(summary: Summary) -> bool:
    """Return whether repeated readings are caused by different rates of chip and polls, and not by uneven polls.

    A poll that is late by some tenths of a millisecond misses a reading, and the poll before or after it gets no new
    one. How often this happens depends on the time between the time stamp of a row and the read-out of the chip, which
    is not logged. With a chip that is faster than the polls nearly every poll misses a reading.
    """
    flags = summary.flags
    return tells_repetitions(summary) and not (flags["stale"] < UNEVEN * flags["overrun"] < UNEVEN**2 * flags["stale"])


def repeats(summary: Summary) -> Floats:
    """Return the arcsine of the share of rows that equal the previous one on all axes; nan if the polls do not
    determine it (`counts_repeats`).
    """
    if not counts_repeats(summary):
        return np.asarray(np.nan)
    share = summary.repeats.repeat_share
    return arcsine(share * (summary.rows - 1), summary.rows - 1)


def repeats_in_all(phases: Sequence[Summary]) -> Floats:
    """Return the arcsine of the share of rows of several phases that equal the previous one on all axes; nan with fewer
    than two phases in which the polls determine it.

    Rare repetitions can be significant in all phases together although they are not in any single phase.
    """
    repeated, rows = _repeated_rows(phases)
    return arcsine(repeated, rows)


def _repeated_rows(phases: Sequence[Summary]) -> tuple[float, int]:
    """Return the number of rows that equal the previous one and the number of all rows but the first of each phase; 0
    for both with fewer than two phases in which the polls determine it.
    """
    counted = [phase for phase in phases if phase.rows > 1 and counts_repeats(phase)]
    if len(counted) < _FEWEST_PHASES:
        return 0.0, 0
    rows = [phase.rows - 1 for phase in counted]
    return sum(phase.repeats.repeat_share * count for phase, count in zip(counted, rows, strict=True)), sum(rows)


_FEWEST_PHASES = 2
_FORM, _FORM_IN_MOTION = 0.25, 3.0
"""Relative error of the share of readings that are equal by chance, at rest and in motion. It is caused by noise that
is not normal, and by a motion or a vibration that the simulation lacks, and is not reduced by a larger number of rows.
"""

_FEW_IN_MOTION = 4.0
"""Number that is added to that of the equal readings in a motion: such a motion may make none of them equal."""


def _resolution(summary: Summary) -> float:
    """Return the resolution of `repeats`: the standard error of the arcsine of a share of the rows and, in motion, the
    change of the arcsine of the measured share by `_FORM_IN_MOTION`, added in quadrature.
    """
    if is_at_rest(summary.phase):
        return one_row(summary)
    repeated = summary.repeats.repeat_share * (summary.rows - 1) if summary.rows > 1 else 0.0
    return _resolution_of_share(repeated + _FEW_IN_MOTION, summary.rows, _FORM_IN_MOTION)


def _resolution_in_all(phases: Sequence[Summary]) -> float:
    """Return the resolution of `repeats_in_all`: the standard error of the arcsine of a share of all rows, and the
    change of the arcsine of the measured share by its relative error, added in quadrature.
    """
    repeated, rows = _repeated_rows(phases)
    form, few = (_FORM, 0.0) if all(is_at_rest(phase.phase) for phase in phases) else (_FORM_IN_MOTION, _FEW_IN_MOTION)
    return _resolution_of_share(repeated + few, rows, form)


def _resolution_of_share(repeated: float, rows: int, form: float) -> float:
    """Return the standard error of the arcsine of the share `repeated` / `rows` and its change by the relative error
    `form` of the share, added in quadrature.
    """
    return math.hypot(0.5, form / 2 * math.sqrt(repeated)) / math.sqrt(max(rows, 1))


def longest_repeat(summary: Summary) -> Floats:
    """Return the number of rows in the longest run of equal rows. The distribution of chance runs has an exponential
    tail.
    """
    return np.asarray(float(summary.repeats.longest))


def _hundredth(_: Summary) -> float:
    """Return the resolution of the log of a scatter that may be very small: 0.01."""
    return 0.01


_DROPPED = ("dropped_samples",)


_probe = partial(PhaseProbe, "timing", in_motion=True, resolution=one_row, by_column=False)


def _one_interval(summary: Summary) -> float:
    """Return the change of the log of the mean interval by one row: a single reading is lost on any bus."""
    return 1 / max(summary.rows, 1)


PROBES: Probes = {
    "interval": replace(
        _probe("log of the mean interval between rows", (), VARIANCE, interval, resolution=_one_interval), unit="log s"
    ),
    "irregularity": _probe(
        "log of the scatter of intervals over their mean", _DROPPED, GENEROUS, irregularity, resolution=_hundredth
    ),
    "gaps": _probe("arcsine of the share of gaps", _DROPPED, ROWS, gaps),
    "skips": _probe("arcsine of the share of gaps that are no stalls", _DROPPED, ROWS, skips),
    "longest_interval": _probe(
        "log of the longest interval over the mean", _DROPPED, GENEROUS, longest, resolution=_hundredth
    ),
    "repeats": _probe(
        "arcsine of the share of rows that repeat the one before",
        ("odr_error", "stale_samples", "stuck", "adaptive_range"),
        ROWS,
        repeats,
        resolution=_resolution,
    ),
    "repeats_in_all": CampaignProbe(
        "timing",
        "arcsine of the share of rows of all phases that repeat the one before",
        ("stale_samples", "odr_error", "stuck"),
        ROWS,
        repeats_in_all,
        _resolution_in_all,
    ),
    "longest_repeat": _probe(
        "rows of the longest run of equal rows", ("stuck", "odr_error"), RUN, longest_repeat, resolution=lambda _: 1.0
    ),
}
