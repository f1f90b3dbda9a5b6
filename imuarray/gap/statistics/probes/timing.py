"""Probes of the times of rows, and of repeated readings."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from imuarray.arrays import Floats
from imuarray.gap.statistics.margins import GENEROUS, ROWS, RUN, VARIANCE
from imuarray.gap.statistics.probes.probe import CampaignProbe, PhaseProbe, Probes, arcsine, log, one_row
from imuarray.gap.statistics.summary import Summary


def interval(summary: Summary) -> Floats:
    """Return the log of the mean interval in s."""
    return log(summary.intervals.mean_s)


def irregularity(summary: Summary) -> Floats:
    """Return the log of the standard deviation of intervals over their mean, 1e-6 of it at least."""
    times = summary.intervals
    return np.asarray(log(math.hypot(times.std_s, 1e-6 * times.mean_s)) - log(times.mean_s))


def gaps(summary: Summary) -> Floats:
    """arcsine of the share of intervals that are gaps."""
    times = summary.intervals
    return arcsine(times.gaps, times.count + times.gaps)


def skips(summary: Summary) -> Floats:
    """arcsine of the share of intervals that are gaps of a few rows, beside stalls of the recorder, which hide them
    among all gaps; nan without stalls.
    """
    times = summary.intervals
    return arcsine(times.skips, times.count + times.gaps) if times.skips < times.gaps else np.asarray(np.nan)


def longest(summary: Summary) -> Floats:
    """Return the log of the longest interval over the mean."""
    return np.asarray(log(summary.intervals.longest_s) - log(summary.intervals.mean_s))


MOST_DOUBTFUL = 0.1
"""Rows that the recorder flags wrongly as no new reading, as a share of all that it flags so, up to which repetitions
are compared. Where many readings come while they are read, some are read half, and fewer are repeated than polls
repeat.
"""


def tells_repetitions(summary: Summary) -> bool:
    """Return whether the recorder's polls tell how many readings are repeated."""
    doubtful = summary.flags["doubtful"]
    return not doubtful > MOST_DOUBTFUL * (doubtful + summary.flags["stale"])


UNEVEN = 10.0
"""Ratio of readings missed and repeated, either way, within which both are due to uneven polls."""


def counts_repeats(summary: Summary) -> bool:
    """Return whether repeated readings are those of rates, and not of uneven polls.

    A poll that is late by some tenths of a millisecond finds that a reading was missed, and the one before or after it
    finds none. How often depends on the time from a row's stamp to the moment at which the chip is read, which no log
    has. Of a chip that is faster than the polls nearly every one finds that a reading was missed.
    """
    flags = summary.flags
    return tells_repetitions(summary) and not (flags["stale"] < UNEVEN * flags["overrun"] < UNEVEN**2 * flags["stale"])


def repeats(summary: Summary) -> Floats:
    """arcsine of the share of rows that equal the one before on all axes; nan if polls do not tell it."""
    if not counts_repeats(summary):
        return np.asarray(np.nan)
    share = summary.repeats.repeat_share
    return arcsine(share * (summary.rows - 1), summary.rows - 1)


def repeats_in_all(phases: Sequence[Summary]) -> Floats:
    """Return the arcsine of the share of rows of several phases that equal the one before on all axes; nan for fewer
    than two phases of which polls tell it.

    A few rows that are repeated now and then are beyond chance in all phases together before they are in any of them.
    """
    repeated, rows = _repeated_rows(phases)
    return arcsine(repeated, rows)


def _repeated_rows(phases: Sequence[Summary]) -> tuple[float, int]:
    """Return the number of rows that repeat the one before, and that of all rows that may; 0 for fewer than two
    phases of which polls tell it.
    """
    counted = [phase for phase in phases if phase.rows > 1 and counts_repeats(phase)]
    if len(counted) < _FEWEST_PHASES:
        return 0.0, 0
    rows = [phase.rows - 1 for phase in counted]
    return sum(phase.repeats.repeat_share * count for phase, count in zip(counted, rows, strict=True)), sum(rows)


_FEWEST_PHASES = 2
_FORM = 0.25
"""Relative error of the share of readings that are equal by chance: a noise that is no normal one makes it, and no
number of rows reduces it.
"""


def _resolution_in_all(phases: Sequence[Summary]) -> float:
    """Standard error of a share of all rows, and what `_FORM` makes of the arcsine of the present share."""
    repeated, rows = _repeated_rows(phases)
    return math.hypot(0.5, _FORM / 2 * math.sqrt(repeated)) / math.sqrt(max(rows, 1))


def longest_repeat(summary: Summary) -> Floats:
    """Return rows of the longest run of equal rows. The length of chance runs has an exponential tail."""
    return np.asarray(float(summary.repeats.longest))


def _hundredth(_: Summary) -> float:
    """Resolution of logs of a scatter that may be very small."""
    return 0.01


_DROPPED = ("dropped_samples",)


_probe = partial(PhaseProbe, "timing", in_motion=True, resolution=one_row, by_column=False)

PROBES: Probes = {
    "interval": replace(
        _probe("log of the mean interval between rows", (), VARIANCE, interval, resolution=lambda _: 1e-6), unit="log s"
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
