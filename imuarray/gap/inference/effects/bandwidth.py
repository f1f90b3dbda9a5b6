"""`bandwidth`: correlation phi^k of readings k rows apart, and motion that comes late."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from scipy.optimize import brentq

from imuarray.gap.inference.effects.candidate import Candidate, Hypothesis
from imuarray.gap.inference.effects.lag import mean_of, odd_lags
from imuarray.gap.inference.effects.quietness import (
    BEYOND,
    cutoff_that_passes,
    noise_of_logs,
    rarity_behind,
    with_noise,
)
from imuarray.gap.inference.effects.removal import with_removal
from imuarray.gap.inference.evidence import Evidence
from imuarray.gap.inference.when import in_logs
from imuarray.simulate.effect import Effect
from imuarray.simulate.effects.bandwidth import Bandwidth, two_pole_cutoff_hz

_TRACES = ("lag_1", "lag_2", "lag_3", "allan_2", "allan_8", "band_5", "band_6", "band_1", "noise_excess")
_BEYOND = 2.7
_LEAST, _MOST = 0.01, 0.995
"""Correlations beyond are no low-pass that rows show."""

_ALIKE = 1.3
_OF_SPELL = ("cutoff_hz", "noise_share")
_QUIET = 0.7
"""Largest share of the noise that a filter leaves: half of the power, as one of half the bandwidth does."""
_MOST_NOISE = 10.0
_UNSEEN = 0.3
"""Correlation from which on rows tell the cutoff themselves."""

_NOTHING_LEFT = 0.75 * math.pi
"""Time constants after which noise behind two poles is not correlated any more, for the first time."""


_TWO_POLES = Bandwidth(1.0, poles=2.0)
"""The filter that is assumed unless correlations show another one."""


def guesses(evidence: Evidence) -> Iterator[Hypothesis]:
    """Suggest the cutoff by the correlation at lag 1, -ln(phi) rows_per_s / (2 pi); others by that at lag 2, sqrt, and
    by the ratio of both, where what is slower or white adds to them. Each with the signal as it is, and where a motion
    tells that it is late, or early, with the signal filtered too.

    Rows too slow to show any correlation still show the delay, 1 / (sqrt(2) pi cutoff) of a filter with two poles, and
    only that: what tells it from a reading that is merely late is how much noise is gone. A filter of a spell takes its
    share of the noise away, which the fit to the rest of the log knows nothing of.
    """
    if evidence.when.spans:
        yield from (
            replace(trial, effects=tuple(_quieter(evidence, trial)), free=_OF_SPELL) for trial in _hypotheses(evidence)
        )
        yield from _in_quiet_spell(evidence)
        return
    yield from _in_quiet_logs(evidence)
    yield from with_removal(evidence, Bandwidth.name, _hypotheses(evidence))
    if not any(isinstance(effect, Bandwidth) and effect.share for effect in evidence.effects):
        yield from _by_delay(evidence)


def _hypotheses(evidence: Evidence) -> Iterator[Hypothesis]:
    if not evidence.is_odd(*_TRACES, beyond=_BEYOND):
        return
    first, second = (float(np.tanh(evidence.typical(f"lag_{lag}")).mean()) for lag in (1, 2))
    shares = (0.0, 1.0) if evidence.is_odd("motion_delay", beyond=_BEYOND) else (0.0,)
    cutoffs_hz: list[float] = []
    for phi in (first, math.sqrt(max(second, 0.0)), second / first if first > 0 else 0.0):
        if not _LEAST < phi < _MOST:
            continue
        cutoff_hz = -math.log(phi) * evidence.rows_per_s / (2 * math.pi)
        if all(max(cutoff_hz / other, other / cutoff_hz) > _ALIKE for other in cutoffs_hz):
            cutoffs_hz.append(cutoff_hz)
            for share in shares:
                yield Hypothesis((Bandwidth(cutoff_hz, share),), ("cutoff_hz",))
    if _LEAST < first < _MOST:
        decay = float(brentq(lambda decay: _TWO_POLES.correlation(decay) - first, 0.0, _NOTHING_LEFT))
        for share in shares:
            yield Hypothesis(
                (Bandwidth(two_pole_cutoff_hz(1 / (decay * evidence.rows_per_s)), share, 2.0),), ("cutoff_hz",)
            )


def _quieter(evidence: Evidence, trial: Hypothesis) -> Iterator[Effect]:
    """Yield the effects of a trial with the share of the noise that the spell has."""
    share = min(float(np.exp(evidence.typical("noise").mean())), _MOST_NOISE)
    for effect in trial.effects:
        yield replace(effect, noise_share=share) if isinstance(effect, Bandwidth) else effect


def _in_quiet_spell(evidence: Evidence) -> Iterator[Hypothesis]:
    """Suggest a filter that reduces the noise in a spell, on all axes, whether or not its rows are fast enough to show
    a correlation.
    """
    if evidence.score("noise").max() < -BEYOND:
        share = float(np.exp(evidence.typical("noise").mean()))
        cutoff_hz = cutoff_that_passes(evidence, share)
        if cutoff_hz > 0:
            yield Hypothesis((Bandwidth(cutoff_hz, poles=2.0, noise_share=share),), _OF_SPELL)


def _in_quiet_logs(evidence: Evidence) -> Iterator[Hypothesis]:
    """Suggest a filter that reduces the noise in some logs, by the same share on all axes; whether or not their rows
    are fast enough to show a correlation. Where little is gone, the other logs rather have more noise.
    """
    logs = noise_of_logs(evidence)
    share = 1.0 if logs is None else float(np.exp((logs.less - logs.more).mean()))
    cutoff_hz = cutoff_that_passes(evidence, share)
    if logs is not None and share < _QUIET and cutoff_hz > 0:
        effect = Bandwidth(cutoff_hz, poles=2.0, noise_share=share)
        yield Hypothesis((effect,), _OF_SPELL, fitted=with_noise(evidence, logs.more)).at(in_logs(logs.quiet))


def _by_delay(evidence: Evidence) -> Iterator[Hypothesis]:
    """Two poles, as output stages have at least: with one, rows would sooner show it."""
    lags_seen = odd_lags(evidence)
    if not lags_seen or any(lag.is_large for lag in lags_seen):
        return
    lag_s = mean_of(lags_seen, "lag_s")
    if lag_s > 0 and _TWO_POLES.correlation(1 / (lag_s * evidence.rows_per_s)) < _UNSEEN:
        cutoff_hz = two_pole_cutoff_hz(lag_s)
        yield Hypothesis((Bandwidth(cutoff_hz, 1.0, 2.0),), ("cutoff_hz",), rarity=rarity_behind(evidence, cutoff_hz))


BANDWIDTH = Candidate(
    Bandwidth.name,
    guesses,
    {"static": "still for 2 minutes, read at the sensor's data rate"},
)
