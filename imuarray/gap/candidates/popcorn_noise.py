"""`popcorn_noise`: levels that jump to and fro between two values."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import numpy.typing as npt

from imuarray.gap.candidates.candidate import Candidate, Trial
from imuarray.gap.candidates.levels import levels
from imuarray.gap.candidates.removal import with_removal
from imuarray.gap.candidates.slow import BEYOND, TRACES, longest_s, sized, wander_of
from imuarray.gap.evidence import Evidence
from imuarray.simulate.effects.popcorn_noise import PopcornNoise

Floats = npt.NDArray[np.float64]

_FREE = ("amplitude", "switches_per_s")
_RARITY = 2.0
"""A drift without two clear levels is seldom a telegraph."""

_FEWEST = 3.0
"""Fewer jumps in the longest phase don't tell a telegraph from a slow drift."""

_CLEAR = 4.0
"""A jump so many standard errors of a segment's mean high is one."""


def guesses(evidence: Evidence) -> Iterator[Trial]:
    """The telegraph with the autocovariance of the Gauss-Markov process that fits best (rms = amplitude / 2, one over
    its time constant = twice the switches a second); another by the jumps themselves, where segments show them.
    """
    yield from with_removal(evidence, PopcornNoise.name, _found(evidence))


def _found(evidence: Evidence) -> Iterator[Trial]:
    if not evidence.is_odd(*TRACES, beyond=BEYOND):
        return
    score = evidence.score(*TRACES)
    found = wander_of(evidence)
    limits = {"switches_per_s": (_FEWEST / longest_s(evidence), np.inf)}
    if found is not None:
        yield Trial(
            (PopcornNoise(sized(2 * found.rms, score), 0.5 / found.time_constant_s),),
            _FREE,
            limits=limits,
            rarity=_RARITY,
        )
    amplitude, switches_per_s = _jumps(evidence)
    if switches_per_s > 0:
        yield Trial((PopcornNoise(sized(amplitude, score), switches_per_s),), _FREE, limits=limits, rarity=_RARITY)


def _jumps(evidence: Evidence) -> tuple[Floats, float]:
    """(3,) heights of the jumps and how many there are a second on an axis that has any; 0 where none is clear."""
    found, amplitude, rates = levels(evidence), np.zeros(3), []
    for axis in range(3):
        heights, jumps = [], 0
        for at in found.groups():
            height, crossings = _between(found.mean[at, axis], float(np.sqrt(found.square_error[at, axis].mean())))
            jumps += crossings
            heights += [height] * bool(crossings)
        if heights:
            amplitude[axis] = float(np.median(heights))
            rates.append(jumps / found.seconds)
    return amplitude, float(np.mean(rates)) if rates else 0.0


def _between(mean: Floats, error: float) -> tuple[float, int]:
    """How far the upper segments lie above the lower ones, and how often the level changes: only if by much."""
    middle = (mean.max() + mean.min()) / 2
    upper = mean > middle
    if upper.all() or not upper.any():
        return 0.0, 0
    height = float(np.median(mean[upper]) - np.median(mean[~upper]))
    beyond = np.abs(mean - middle) > height / 4
    state = upper[beyond]
    crossings = int(np.count_nonzero(state[1:] != state[:-1]))
    return (height, crossings) if height > _CLEAR * error else (0.0, 0)


POPCORN_NOISE = Candidate(
    PopcornNoise.name, guesses, {"static": "still for as long as 20 jumps take, an hour at least"}
)
