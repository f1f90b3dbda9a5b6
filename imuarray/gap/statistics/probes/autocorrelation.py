"""Probes of the correlation with the previous readings."""

from __future__ import annotations

from functools import partial

from imuarray.arrays import Floats
from imuarray.gap.statistics.margins import CORRELATION
from imuarray.gap.statistics.probes.probe import PhaseProbe, Probes, fisher_z
from imuarray.gap.statistics.summary import Summary

_APART = 2
"""Lag in rows at which two differences share no reading, so that their squares are uncorrelated for independent noise.
"""


def lag(rows: int, summary: Summary) -> Floats:
    """Return Fisher's z of the correlation with the reading `rows` rows before."""
    return fisher_z(summary.correlation[rows])


def arch(summary: Summary) -> Floats:
    """Return Fisher's z of the correlation of squared differences between neighbours at a lag of two rows, which
    detects noise in bursts.
    """
    return fisher_z(summary.arch[_APART])


_MOVED = ("bandwidth", "stale_samples", "odr_error", "bias_instability", "random_walk", "tone")

PROBES: Probes = {
    **{
        f"lag_{rows}": PhaseProbe(
            "autocorrelation", f"Fisher's z of the correlation at lag {rows}", _MOVED, CORRELATION, partial(lag, rows)
        )
        for rows in (1, 2, 3, 5)
    },
    "arch": PhaseProbe(
        "autocorrelation",
        "Fisher's z of the correlation of squared steps two rows apart",
        ("stuck", "range_reset", "odr_error"),
        CORRELATION,
        arch,
    ),
}
