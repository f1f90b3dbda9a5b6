"""Probes of the Allan variance: differences of means over increasing numbers of rows."""

from __future__ import annotations

from functools import partial

import numpy as np

from imuarray.arrays import Floats
from imuarray.gap.statistics.margins import KURTOSIS, VARIANCE
from imuarray.gap.statistics.probes.probe import NOTHING, PhaseProbe, Probes, log, once
from imuarray.gap.statistics.summary import Summary

_TERMS = 12
"""Least number of differences for an Allan variance; there are four of them in an averaging time."""

_MANY_TERMS = 100
"""Least number of differences for a fourth moment."""


def at(octave: int, summary: Summary) -> Floats:
    """Return the log of the ratio of the Allan variance at 2^octave rows to that of white noise with the same Allan
    variance at one row.
    """
    return np.asarray(_logs(summary)[octave])


def jumps(octave: int, summary: Summary) -> Floats:
    """Return the log of the kurtosis of the differences of neighbouring means over 2^octave rows, less log 3."""
    share = summary.allan.kurtosis[octave] / 3
    return log(share if summary.allan.terms[octave] >= _MANY_TERMS else np.full_like(share, np.nan))


def longest(summary: Summary) -> Floats:
    """Return `at` the longest averaging time for which the phase has enough rows."""
    known = np.flatnonzero(summary.allan.terms >= _TERMS)
    return at(int(known[-1]), summary) if len(known) else NOTHING


@once
def _logs(summary: Summary) -> Floats:
    """Return (o, 3) the values of `at` for all octaves; nan for octaves with too few terms."""
    variance, terms, _ = summary.allan
    factors = np.where(terms >= _TERMS, 2.0 ** np.arange(len(terms)), np.nan)
    return np.asarray(log(variance * factors[:, None]) - log(variance[0]))


_MOVED = ("bias_instability", "random_walk", "popcorn_noise", "common_mode", "bandwidth", "tone")
_JUMP = "log of a third of the kurtosis of steps between means over {} rows"

PROBES: Probes = {
    **{
        f"allan_{1 << octave}": PhaseProbe(
            "allan", f"log Allan variance at {1 << octave} rows", _MOVED, VARIANCE, partial(at, octave)
        )
        for octave in (1, 3, 5, 7, 9, 11)
    },
    "allan_longest": PhaseProbe("allan", "log Allan variance at the longest averaging time", _MOVED, VARIANCE, longest),
    **{
        f"jumps_{1 << octave}": PhaseProbe(
            "allan", _JUMP.format(1 << octave), ("popcorn_noise", "glitches"), KURTOSIS, partial(jumps, octave)
        )
        for octave in (3, 5, 7)
    },
}
