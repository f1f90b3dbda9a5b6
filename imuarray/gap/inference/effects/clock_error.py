"""`clock_error` is recognised by a sensor that is behind the others, or ahead, by more and more; that of the host by
all sensors of a log, which are so behind the track of its motion.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from imuarray.arrays import Floats
from imuarray.gap.inference.effects.candidate import Candidate, Hypothesis
from imuarray.gap.inference.effects.lag import odd_lags
from imuarray.gap.inference.effects.removal import with_removal
from imuarray.gap.inference.evidence import Evidence
from imuarray.simulate.effects.timing import ClockError

_MOST_PPM = 2e5
_FURTHER = (1.0, -1.0, 3.0, -3.0)
"""Where a lag is so large that its sign and its periods can't be told."""

_FLOOR_S = 1e-3
"""By so much lags of polled sensors scatter beside what their noise makes: readings are now older, now younger."""

_TELLING = 10.0
"""Nats that a rate, or its change, has to explain of the lags."""

_WARM_UPS = 24
_SHORTEST_S, _FEWEST = 2.0, 3


def guesses(evidence: Evidence) -> Iterator[Hypothesis]:
    """Suggest a clock error by the growth of the lag from the log's epoch on; a sensor ahead has a positive error. The
    host's clock has a constant rate, or one that settles. The lag at the epoch, which filters and the age of readings
    make, does not count.
    """
    yield from with_removal(evidence, ClockError.name, _hypotheses(evidence))


def _hypotheses(evidence: Evidence) -> Iterator[Hypothesis]:
    yield from _of_the_host(evidence)
    lags_seen = odd_lags(evidence)
    at_s, lag_s, _, weight = np.array(lags_seen).reshape(-1, 4).T
    square = float(weight @ at_s**2)
    if not square > 0:
        return
    error_ppm = -1e6 * float((weight * at_s) @ lag_s) / square
    for factor in _FURTHER if any(lag.is_large for lag in lags_seen) else (1.0,):
        yield Hypothesis((ClockError(float(np.clip(factor * error_ppm, -_MOST_PPM, _MOST_PPM))),), ("error_ppm",))


def _of_the_host(evidence: Evidence) -> Iterator[Hypothesis]:
    """Suggest an error of the host's clock, by which all sensors lag alike, polled or not.

    Lags are of whole logs, and what they make of a phase shows where the motion begins or ends too soon for it: in
    either part, or in one.
    """
    host_lags = [lag for host in evidence.hosts for lag in host.lags]
    if len(host_lags) < _FEWEST:
        return
    at_s, lag_s, error_s = np.array(host_lags).T
    weight = 1 / np.hypot(error_s, _FLOOR_S)
    still, steady = _fit([np.ones_like(at_s)], lag_s, weight), _steady(at_s, lag_s, weight)
    if still.nats - steady.nats > _TELLING and abs(steady.ppm[0]) < _MOST_PPM:
        yield Hypothesis((ClockError(steady.ppm[0]),), ("error_ppm",), shared=True, everywhere=True, whole=True)
    longest_s = float(np.ptp(at_s))
    settling = [
        (_settling(at_s, lag_s, weight, warm_up_s), warm_up_s)
        for warm_up_s in np.geomspace(_SHORTEST_S, max(longest_s, 2 * _SHORTEST_S), _WARM_UPS).tolist()
    ]
    best, warm_up_s = min(settling, key=lambda lag: lag[0].nats)
    if min(still.nats, steady.nats) - best.nats > _TELLING and max(map(abs, best.ppm)) < _MOST_PPM:
        effect = ClockError(best.ppm[0], best.ppm[1], warm_up_s)
        yield Hypothesis((effect,), ("error_ppm", "warm_up_ppm"), shared=True, everywhere=True, whole=True)


class _Fit(NamedTuple):
    """`ppm` of the columns after the first, which is what the lag is at the epoch; `nats` that are left."""

    ppm: tuple[float, ...]
    nats: float


def _steady(at_s: Floats, lag_s: Floats, weight: Floats) -> _Fit:
    return _fit([np.ones_like(at_s), at_s], lag_s, weight)


def _settling(at_s: Floats, lag_s: Floats, weight: Floats, warm_up_s: float) -> _Fit:
    return _fit([np.ones_like(at_s), at_s, -warm_up_s * np.expm1(-at_s / warm_up_s)], lag_s, weight)


def _fit(columns: list[Floats], lag_s: Floats, weight: Floats) -> _Fit:
    """Fit the columns to the lag. A log whose clock is fast is behind, and its error is negative."""
    design = np.stack(columns, axis=1) * weight[:, None]
    coefficients = np.linalg.lstsq(design, lag_s * weight, rcond=None)[0]
    residuals = lag_s * weight - design @ coefficients
    return _Fit(tuple((-1e6 * coefficients[1:]).tolist()), float(residuals @ residuals) / 2)


CLOCK_ERROR = Candidate(
    ClockError.name,
    guesses,
    {"motion": "shaking beside another sensor, or a reference, 20 s at the beginning and after an hour"},
)
