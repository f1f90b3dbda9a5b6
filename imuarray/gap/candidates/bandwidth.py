"""`bandwidth`: correlation phi^k of readings k rows apart, and motion that comes late."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from imuarray.gap.candidates.candidate import Candidate, Trial
from imuarray.gap.candidates.removal import with_removal
from imuarray.gap.evidence import Evidence
from imuarray.simulate.effects.bandwidth import Bandwidth

_TRACES = ("lag_1", "lag_2", "lag_3", "allan_2", "allan_8", "band_5", "band_6", "band_1", "noise_excess")
_BEYOND = 2.7
_LEAST, _MOST = 0.01, 0.995
"""Correlations beyond are no low-pass that rows show."""

_ALIKE = 1.3


def guesses(evidence: Evidence) -> Iterator[Trial]:
    """The cutoff by the correlation at lag 1, -ln(phi) rows_per_s / (2 pi); others by that at lag 2, sqrt, and by the
    ratio of both, where what is slower or white adds to them. Each with the signal as it is, and where a motion tells
    that it is late, or early, with the signal filtered too.
    """
    yield from with_removal(evidence, Bandwidth.name, _found(evidence))


def _found(evidence: Evidence) -> Iterator[Trial]:
    if not evidence.is_odd(*_TRACES, beyond=_BEYOND):
        return
    first, second = (float(np.tanh(evidence.typical(f"lag_{lag}")).mean()) for lag in (1, 2))
    shares = (0.0, 1.0) if evidence.is_odd("motion_delay", beyond=_BEYOND) else (0.0,)
    tried: list[float] = []
    for phi in (first, math.sqrt(max(second, 0.0)), second / first if first > 0 else 0.0):
        if not _LEAST < phi < _MOST:
            continue
        cutoff_hz = -math.log(phi) * evidence.rows_per_s / (2 * math.pi)
        if all(max(cutoff_hz / other, other / cutoff_hz) > _ALIKE for other in tried):
            tried.append(cutoff_hz)
            for share in shares:
                yield Trial((Bandwidth(cutoff_hz, share),), ("cutoff_hz",))


BANDWIDTH = Candidate(
    Bandwidth.name,
    guesses,
    {"static": "still for 2 minutes, read as fast as the sensor's data rate"},
)
