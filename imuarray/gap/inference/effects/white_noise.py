"""`white_noise`: fitted wherever a sensor was at rest. Only one that never was has an unknown noise, and one that was
fitted to an earlier recording may have changed.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from imuarray.gap.inference.effects.candidate import Candidate, Hypothesis
from imuarray.gap.inference.evidence import Evidence
from imuarray.simulate.effects.white_noise import WhiteNoise

_BEYOND = 3.0


def guesses(evidence: Evidence) -> Iterator[Hypothesis]:
    """What a motion leaves that the other sensors don't explain. Where the base model was fitted its noise can't be too
    large or small, and one that changes is no white noise: nothing is guessed, unless it was fitted to an earlier
    recording.
    """
    if not evidence.is_refitted:
        yield from _since(evidence)
    if any(evidence.fitted.rms) or not evidence.is_odd("motion_residual", beyond=_BEYOND):
        return
    moving = [one.cross for one in evidence.seen if not one.is_still and one.cross is not None]
    window_rows = max(moving[0].window_s * evidence.rows_per_s, 1.0) if moving else 1.0
    variance = evidence.noise**2 * np.exp(np.nanmedian(evidence.values["motion_residual"], axis=0))
    x, y, z = np.sqrt(np.nan_to_num(variance) * window_rows).tolist()
    yield Hypothesis((WhiteNoise((x, y, z)),), ("rms",))


def _since(evidence: Evidence) -> Iterator[Hypothesis]:
    """Another noise than in the earlier recording, on the axes on which it is odd."""
    if not any(evidence.fitted.rms) or not evidence.is_odd("noise", beyond=_BEYOND):
        return
    ratio = np.where(np.abs(evidence.score("noise")) > _BEYOND, np.exp(evidence.typical("noise")), 1.0)
    rounding = evidence.noise**2 - np.square(evidence.fitted.rms)
    x, y, z = np.sqrt(np.maximum((ratio * evidence.noise) ** 2 - rounding, 0.0)).tolist()
    without = replace(evidence.fitted, rms=(0.0, 0.0, 0.0))
    yield Hypothesis((WhiteNoise((x, y, z)),), ("rms",), removed=WhiteNoise.name, fitted=without)


WHITE_NOISE = Candidate(WhiteNoise.name, guesses, {"static": "still for 1 minute"})
