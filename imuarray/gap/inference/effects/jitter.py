"""`jitter` is recognised by noise under motion, in proportion to how fast the signal changes; and by rows that repeat
the one before, if that was read late. The times of all sensors' rows tell when the host came late to all of them.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from imuarray.arrays import Floats
from imuarray.gap.inference.effects.candidate import Candidate, Hypothesis
from imuarray.gap.inference.effects.lag import motions, speed_squared
from imuarray.gap.inference.effects.removal import with_removal
from imuarray.gap.inference.effects.repetition import repeated_share
from imuarray.gap.inference.evidence import Evidence
from imuarray.gap.statistics.probes.motion import residual
from imuarray.simulate.effects.timing import Jitter

_LEAST, _MOST = 1e-4, 0.9

_OF_THE_HOST = ("repeats", "stale", "longest_repeat", "motion_residual", "motion_delay", "gaps", "lost", "interval")
_BEHIND = 3.0
"""Nats by which a program waits more rarely between a transfer and its clock than before the transfer, of which each
byte is one more occasion.
"""


def guesses(evidence: Evidence) -> Iterator[Hypothesis]:
    """Suggest the rms lateness that explains the residual variance by the speed at which readings change, and the share
    of late rows that explains both this and the repetitions.
    """
    yield from with_removal(evidence, Jitter.name, _hypotheses(evidence))


def _hypotheses(evidence: Evidence) -> Iterator[Hypothesis]:
    if evidence.is_odd(*_OF_THE_HOST):
        yield from _of_the_host(evidence)
    rms_s = _rms_s(evidence) if (evidence.score("motion_residual") > 2.5).any() else 0.0
    if rms_s > 0:
        yield Hypothesis((Jitter(rms_s),), ("rms_s",))
    repeated = repeated_share(evidence) if evidence.is_odd("repeats", "stale") else 0.0
    if repeated > _LEAST:
        yield from late(repeated, rms_s, 1 / evidence.rows_per_s, evidence.header.rate_hz)


def _of_the_host(evidence: Evidence) -> Iterator[Hypothesis]:
    """Suggest the waiting rows of the host, in every sensor that is read, before the transfer or behind it."""
    waits = sum(host.waits for host in evidence.hosts)
    if not waits and not any(host.missed for host in evidence.hosts):
        return
    rms_s = float(np.sqrt(sum(host.square_s2 for host in evidence.hosts) / max(waits, 1)))
    share = min(waits / sum(host.rows for host in evidence.hosts), 1.0)
    for sign in (1.0, -1.0):
        effect = Jitter(rms_s, share, sign)
        yield Hypothesis((effect,), shared=True, everywhere=True, rarity=0.0 if sign > 0 else _BEHIND)


def late(repeated: float, rms_s: float, row_s: float, rate_hz: float) -> Iterator[Hypothesis]:
    """Guess the lateness of a chip of `rate_hz` that is read every `row_s` and repeats a share `repeated` of its
    readings. A reading is repeated if it is late by more than the time between rows less the elapsed part of a period.
    Together with `rms_s` of all rows the share determines the mean lateness; without it, a row is assumed.
    """
    if rate_hz <= 0:
        return
    mean_s = row_s * np.geomspace(0.05, 1.5, 60)
    wait_s = np.maximum(row_s - np.linspace(0, 1, 21) / rate_hz, 0.0)
    share = repeated / np.exp(-wait_s / mean_s[:, None]).mean(axis=1)
    apart = np.abs(np.log(2 * share * mean_s**2 / rms_s**2)) if rms_s > 0 else np.abs(np.log(mean_s / row_s))
    best = int(np.argmin(np.where(share < _MOST, apart, np.inf)))
    if share[best] < _MOST:
        guess = Jitter(float(np.sqrt(2) * mean_s[best]), float(share[best]))
        yield Hypothesis((guess,), ("rms_s", "share"), limits={"share": (0.0, _MOST)})


def _rms_s(evidence: Evidence) -> float:
    """Rms lateness of all rows in s, from the residual of motion; 0 if there is no excess."""
    name, usual = evidence.header.name, _usual_variance(evidence)
    excess = speed = 0.0
    for _, cross in motions(evidence):
        rows = max(cross.window_s * evidence.rows_per_s, 1.0)
        beyond = np.maximum(np.exp(residual(cross, name)) - usual, 0.0)
        excess += float(np.nansum(beyond * rows))
        speed += float(np.nansum(speed_squared(cross, name)))
    return float(np.sqrt(excess / speed)) if excess > 0 and speed > 0 else 0.0


def _usual_variance(evidence: Evidence) -> Floats:
    """Return (3,) what the model leaves of a window's mean in motion, squared units; the probe is relative to the
    noise.
    """
    rows = evidence.expected["motion_residual"]
    known = rows[np.isfinite(rows).all(axis=1)]
    return np.asarray(np.exp(np.median(known, axis=0)) * evidence.noise**2) if len(known) else np.zeros(3)


JITTER = Candidate(Jitter.name, guesses, {"motion": "shaking as fast as possible beside another sensor, 1 minute"})
