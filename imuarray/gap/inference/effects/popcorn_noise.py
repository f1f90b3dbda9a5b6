"""`popcorn_noise`: levels that jump to and fro between two values."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from imuarray.arrays import Floats
from imuarray.gap.inference.effects.candidate import Candidate, Hypothesis
from imuarray.gap.inference.effects.levels import levels
from imuarray.gap.inference.effects.removal import with_removal
from imuarray.gap.inference.effects.slow import BEYOND, TRACES, Wander, longest_s, sized, slower, wander_of
from imuarray.gap.inference.evidence import Evidence
from imuarray.simulate.effects.bias import PopcornNoise

_FREE = ("amplitude", "switches_per_s")
_SELDOM = 0.05
"""The upper level is there so much of the time at the least, by a first guess."""

_RARITY = 2.0
"""A drift without two clear levels is seldom a telegraph."""

_FEWEST = 3.0
"""Fewer jumps in the longest phase don't tell a telegraph from a slow drift."""

_CLEAR = 4.0
"""A jump so many standard errors of a segment's mean high is one."""


def guesses(evidence: Evidence) -> Iterator[Hypothesis]:
    """Suggest the telegraph noise with the autocovariance of the Gauss-Markov process that fits best (rms = amplitude /
    2, one over its time constant = twice the switches a second), and a slower one; the same with one level more seldom
    than the other, where segments lie to one side; another by the jumps themselves, where segments show them.
    """
    yield from with_removal(evidence, PopcornNoise.name, _hypotheses(evidence))


def _hypotheses(evidence: Evidence) -> Iterator[Hypothesis]:
    if not evidence.is_odd(*TRACES, beyond=BEYOND):
        return
    score = evidence.score(*TRACES)
    wander = wander_of(evidence)
    fewest_per_s = _FEWEST / longest_s(evidence)
    limits = {"switches_per_s": (fewest_per_s, np.inf)}
    is_uneven = evidence.is_odd("wander_uneven", beyond=BEYOND)
    for process in (wander, slower(evidence, wander)) if wander is not None else ():
        for amplitude in sized(2 * process.rms, score):
            effect = PopcornNoise(amplitude, 0.5 / process.time_constant_s)
            yield Hypothesis((effect,), _FREE, limits=limits, rarity=_RARITY)
        if is_uneven and process.rms.any():
            yield from _one_sided(evidence, process, score, limits)
    heights, switches_per_s = _jumps(evidence)
    for amplitude in sized(heights, score) if switches_per_s >= fewest_per_s else ():
        yield Hypothesis((PopcornNoise(amplitude, switches_per_s),), _FREE, limits=limits, rarity=_RARITY)


def _one_sided(
    evidence: Evidence, wander: Wander, score: Floats, limits: Mapping[str, tuple[float, float]]
) -> Iterator[Hypothesis]:
    """Suggest the share p of time at the seldom level by the skewness of what segments differ by, (1 - 2 p) / sqrt(p (1
    - p)), on the axis that wanders most; the variance is amplitude^2 p (1 - p), one over the time constant the switches
    a second over 2 p (1 - p). On each axis it lies to its own side.
    """
    level = levels(evidence)
    square = level.apart.var(axis=0) - level.square_error.mean(axis=0)
    skewness = (level.apart**3).mean(axis=0) / np.maximum(square, level.apart.var(axis=0) / 10) ** 1.5
    largest = float(np.abs(skewness[int(wander.rms.argmax())]))
    share = min(max((1 - largest / float(np.hypot(largest, 2.0))) / 2, _SELDOM), 0.5)
    half = float(np.sqrt(share * (1 - share)))
    limits = {**limits, "high_share": (_SELDOM / 2, 1 - _SELDOM / 2)}
    for sizes in sized(wander.rms / half, score):
        x, y, z = (np.array(sizes) * np.where(skewness < 0, -1.0, 1.0) + 0.0).tolist()
        effect = PopcornNoise((x, y, z), 2 * half**2 / wander.time_constant_s, share)
        yield Hypothesis((effect,), (*_FREE, "high_share"), limits=limits, rarity=_RARITY)


def _jumps(evidence: Evidence) -> tuple[Floats, float]:
    """Return (3,) heights of the jumps and how many there are a second on an axis that has any; 0
    where none is clear.
    """
    table, amplitude, rates = levels(evidence), np.zeros(3), []
    for axis in range(3):
        heights, jumps = [], 0
        for at in table.groups():
            height, crossings = _between(table.mean[at, axis], float(np.sqrt(table.square_error[at, axis].mean())))
            jumps += crossings
            heights += [height] * bool(crossings)
        if heights:
            amplitude[axis] = float(np.median(heights))
            rates.append(jumps / table.seconds)
    return amplitude, float(np.mean(rates)) if rates else 0.0


def _between(mean: Floats, error: float) -> tuple[float, int]:
    """Return how far the upper segments lie above the lower ones, and how often the level changes: only if by much."""
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
    PopcornNoise.name, guesses, {"static": "still until 20 jumps have occurred, an hour at least"}
)
