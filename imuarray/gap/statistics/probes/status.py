"""Probes of the flags of rows, and of words that no sensor sends."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np

from imuarray.arrays import Floats
from imuarray.gap.statistics.margins import ROWS
from imuarray.gap.statistics.probes.probe import PhaseProbe, Probes, arcsine, one_row
from imuarray.gap.statistics.probes.timing import counts_repeats
from imuarray.gap.statistics.summary import Summary

_TWICE = 2.0
"""Number of readings of a chip between two polls from which on every poll gets a new reading in spite of jitter."""


def flagged(names: tuple[str, ...], summary: Summary) -> Floats:
    """Return the arcsine of the sum of the shares of rows with these flags."""
    return arcsine(sum(summary.flags[name] for name in names), summary.rows)


def stale(summary: Summary) -> Floats:
    """Return the arcsine of the share of rows that are not a new reading. nan if the polls do not determine it, and for
    a chip that measures at least twice between polls: its flagged rows are equal by chance.
    """
    always_new = summary.header.rate_hz * summary.intervals.mean_s >= _TWICE
    return flagged(("stale",), summary) if counts_repeats(summary) and not always_new else np.asarray(np.nan)


def words(summary: Summary) -> Floats:
    """Return the arcsine of the share of rows whose axes all read -1, or all 0."""
    return arcsine(summary.words, summary.rows)


def _probe(about: str, moved_by: tuple[str, ...], statistic: Callable[[Summary], Floats]) -> PhaseProbe:
    about = f"arcsine of the share of rows {about}"
    return PhaseProbe("status", about, moved_by, ROWS, statistic, in_motion=True, resolution=one_row, by_column=False)


PROBES: Probes = {
    "stale": _probe("that are no new reading", ("stale_samples", "stuck", "odr_error"), stale),
    "saturated": _probe(
        "at an end of the span", ("saturation", "range_reset", "scale"), partial(flagged, ("saturated",))
    ),
    "lost": _probe("before which some were lost", ("dropped_samples",), partial(flagged, ("lost_before",))),
    "doubt": _probe("of a chip in doubt or just set up again", (), partial(flagged, ("suspect", "reconfigured"))),
    "words": _probe("that read -1 or 0 on all axes", ("glitches",), words),
}
