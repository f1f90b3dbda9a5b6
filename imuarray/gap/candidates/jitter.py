"""`jitter` is recognised by noise under motion, in proportion to how fast the signal changes."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import numpy.typing as npt

from imuarray.gap.candidates.candidate import Candidate, Trial
from imuarray.gap.candidates.lag import motions, speed_squared
from imuarray.gap.candidates.removal import with_removal
from imuarray.gap.evidence import Evidence
from imuarray.gap.probes.motion import residual
from imuarray.simulate.effects.jitter import Jitter

Floats = npt.NDArray[np.float64]


def guesses(evidence: Evidence) -> Iterator[Trial]:
    """The time that makes the variance which is left over of the speed at which readings change."""
    yield from with_removal(evidence, Jitter.name, _found(evidence))


def _found(evidence: Evidence) -> Iterator[Trial]:
    if not (evidence.score("motion_residual") > 2.5).any():
        return
    name, usual = evidence.header.name, _usual_variance(evidence)
    excess = speed = 0.0
    for _, cross in motions(evidence):
        rows = max(cross.window_s * evidence.rows_per_s, 1.0)
        beyond = np.maximum(np.exp(residual(cross, name)) - usual, 0.0)
        excess += float(np.nansum(beyond * rows))
        speed += float(np.nansum(speed_squared(cross, name)))
    if excess > 0 and speed > 0:
        yield Trial((Jitter(float(np.sqrt(excess / speed))),), ("rms_s",))


def _usual_variance(evidence: Evidence) -> Floats:
    """(3,) what the model leaves of a window's mean in motion, squared units; the probe is relative to the noise."""
    rows = evidence.expected["motion_residual"]
    known = rows[np.isfinite(rows).all(axis=1)]
    return np.asarray(np.exp(np.median(known, axis=0)) * evidence.noise**2) if len(known) else np.zeros(3)


JITTER = Candidate(Jitter.name, guesses, {"motion": "shaking as fast as possible beside another sensor, 1 minute"})
