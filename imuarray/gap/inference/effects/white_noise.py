"""`white_noise`: fitted wherever a sensor was at rest; what one part of the time has more of, or one that never was,
or that was fitted to an earlier recording and changed since.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from imuarray.arrays import Booleans, Floats
from imuarray.gap.inference.effects.candidate import Candidate, Hypothesis
from imuarray.gap.inference.effects.quietness import BEYOND, noise_of_logs, with_noise
from imuarray.gap.inference.effects.steps import Onset, onsets
from imuarray.gap.inference.evidence import Evidence
from imuarray.gap.inference.when import ALWAYS, Span, When, in_logs, join_spans, since
from imuarray.simulate.effects.noise import WhiteNoise

_GROWN = 0.1
"""Log of the ratio of noises after and before a moment from which on the noise has grown."""


def guesses(evidence: Evidence) -> Iterator[Hypothesis]:
    """Guess the residual of a motion that the other sensors don't explain as noise, for a sensor that was never
    fitted at rest. For one that was, the noise can't be too large everywhere, unless it was fitted to an earlier
    recording: guess the excess of some logs, or of a spell, over the rest.
    """
    if not evidence.is_refitted:
        yield from _since(evidence)
    if any(evidence.fitted.rms):
        yield from _more(evidence)
        if not evidence.when.spans:
            yield from _from_a_moment(evidence)
    elif evidence.is_odd("motion_residual", beyond=BEYOND):
        yield from _in_motion(evidence)


def _more(evidence: Evidence) -> Iterator[Hypothesis]:
    """Suggest more noise at some times. That of the rest is the smaller one: what was fitted may lie between."""
    if evidence.when.spans:
        if evidence.score("noise").max() > BEYOND:
            yield from _grown(evidence, evidence.typical("noise"), np.zeros(3), ALWAYS)
    elif (logs := noise_of_logs(evidence)) is not None:
        yield from _grown(evidence, logs.more, logs.less, in_logs(logs.noisy))


def _grown(evidence: Evidence, more: Floats, less: Floats, when: When) -> Iterator[Hypothesis]:
    """Guess the excess of the larger noise over the smaller one, (3,) each as the log of its ratio to the fitted."""
    larger, usual = (evidence.noise**2 * np.exp(2 * side) for side in (more, less))
    rms = np.sqrt(np.maximum(np.nan_to_num(larger - usual), 0.0))
    if rms.any():
        x, y, z = rms.tolist()
        yield Hypothesis((WhiteNoise((x, y, z)),), ("rms",), fitted=with_noise(evidence, less)).at(when)


def _from_a_moment(evidence: Evidence) -> Iterator[Hypothesis]:
    """Suggest the noise that grew within a log, also if its phases at rest are too short for spells; and in the logs
    after it that have as much; or in all that have as much, since the dates of logs need not be those of the clock of
    an effect.
    """
    for onset in onsets(evidence)[:1]:
        before, after = (
            np.log(noise / evidence.noise) for noise in (onset.states.noise_before, onset.states.noise_after)
        )
        is_larger = after - before > _GROWN
        first, noisy = Span(onset.log, onset.onset_s, math.inf), _as_noisy(evidence, onset, is_larger)
        later = [log for log in noisy if log > onset.log]
        whens = [since(first, later) if later else When((first,))]
        if later != noisy:
            whens.append(join_spans([When((first,)), in_logs(noisy)]))
        for when in whens:
            yield from _grown(evidence, np.where(is_larger, after, before), before, when)


def _as_noisy(evidence: Evidence, onset: Onset, grown: Booleans) -> list[int]:
    """Return the logs other than that of a moment whose noise on the `grown` axes is nearer to that after it."""
    middle = np.log(onset.states.noise_before * onset.states.noise_after) / 2
    logs = sorted({phase.log for phase in evidence.still} - {onset.log})
    level = {log: np.log(evidence.noise) + evidence.within([log]).typical("noise") for log in logs}
    return [log for log in logs if ((level[log] - middle)[grown] > 0).all()]


def _in_motion(evidence: Evidence) -> Iterator[Hypothesis]:
    moving = [phase.cross for phase in evidence.phases if not phase.is_still and phase.cross is not None]
    window_rows = max(moving[0].window_s * evidence.rows_per_s, 1.0) if moving else 1.0
    variance = evidence.noise**2 * np.exp(np.nanmedian(evidence.values["motion_residual"], axis=0))
    x, y, z = np.sqrt(np.nan_to_num(variance) * window_rows).tolist()
    yield Hypothesis((WhiteNoise((x, y, z)),), ("rms",))


def _since(evidence: Evidence) -> Iterator[Hypothesis]:
    """Another noise than in the earlier recording, on the axes on which it is odd."""
    if not any(evidence.fitted.rms) or not evidence.is_odd("noise", beyond=BEYOND):
        return
    ratio = np.where(np.abs(evidence.score("noise")) > BEYOND, np.exp(evidence.typical("noise")), 1.0)
    rounding = evidence.noise**2 - np.square(evidence.fitted.rms)
    x, y, z = np.sqrt(np.maximum((ratio * evidence.noise) ** 2 - rounding, 0.0)).tolist()
    without = replace(evidence.fitted, rms=(0.0, 0.0, 0.0))
    yield Hypothesis((WhiteNoise((x, y, z)),), ("rms",), removed=WhiteNoise.name, fitted=without)


WHITE_NOISE = Candidate(WhiteNoise.name, guesses, {"static": "still for 1 minute"})
