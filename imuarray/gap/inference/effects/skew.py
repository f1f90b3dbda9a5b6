"""`skew` is recognised by a sensor that is behind the others by the same time in every motion."""

from __future__ import annotations

import math
from collections.abc import Iterator

from imuarray.gap.inference.effects.candidate import Candidate, Hypothesis
from imuarray.gap.inference.effects.lag import mean_of, odd_lags
from imuarray.gap.inference.effects.removal import with_removal
from imuarray.gap.inference.evidence import Evidence
from imuarray.simulate.effects.timing import Skew

_AHEAD = 6.0
"""A reading may be old when it is stamped; one that is made after its stamp is rare. Of two sensors that differ the one
behind is late, rather than the other one early.
"""


def guesses(evidence: Evidence) -> Iterator[Hypothesis]:
    """Suggest the mean lag; a large one also a period earlier or later."""
    yield from with_removal(evidence, Skew.name, _hypotheses(evidence))


def _hypotheses(evidence: Evidence) -> Iterator[Hypothesis]:
    lags_seen = odd_lags(evidence)
    if not lags_seen:
        return
    lag_s, pace = mean_of(lags_seen, "lag_s"), mean_of(lags_seen, "pace")
    delays_s = [lag_s]
    if any(lag.is_large for lag in lags_seen):
        delays_s.append(lag_s - math.copysign(2 * math.pi / pace, lag_s))
    for delay_s in delays_s:
        yield Hypothesis((Skew(delay_s),), ("delay_s",), rarity=_AHEAD if delay_s < 0 else 0.0)


SKEW = Candidate(Skew.name, guesses, {"motion": "shaking at 2 Hz and more beside another sensor, 1 minute"})
