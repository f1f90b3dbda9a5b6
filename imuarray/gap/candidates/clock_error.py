"""`clock_error` is recognised by a sensor that is behind the others, or ahead, by more and more."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from imuarray.gap.candidates.candidate import Candidate, Trial
from imuarray.gap.candidates.lag import odd_lags
from imuarray.gap.candidates.removal import with_removal
from imuarray.gap.evidence import Evidence
from imuarray.simulate.effects.clock_error import ClockError

_MOST_PPM = 2e5
_FURTHER = (1.0, -1.0, 3.0, -3.0)
"""Where a lag is so large that its sign and its periods can't be told."""


def guesses(evidence: Evidence) -> Iterator[Trial]:
    """The growth of the lag from the log's epoch on; a sensor ahead has a positive error."""
    yield from with_removal(evidence, ClockError.name, _found(evidence))


def _found(evidence: Evidence) -> Iterator[Trial]:
    found = odd_lags(evidence)
    at_s, lag_s, _, weight = np.array(found).reshape(-1, 4).T
    square = float(weight @ at_s**2)
    if not square > 0:
        return
    error_ppm = -1e6 * float((weight * at_s) @ lag_s) / square
    for factor in _FURTHER if any(lag.is_large for lag in found) else (1.0,):
        yield Trial((ClockError(float(np.clip(factor * error_ppm, -_MOST_PPM, _MOST_PPM))),), ("error_ppm",))


CLOCK_ERROR = Candidate(
    ClockError.name, guesses, {"motion": "shaking beside another sensor, 20 s at the beginning and after an hour"}
)
