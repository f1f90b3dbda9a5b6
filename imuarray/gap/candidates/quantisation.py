"""`quantisation` is recognised by codes that are all multiples of a number."""

from __future__ import annotations

from collections.abc import Iterator
from typing import get_args

import numpy as np

from imuarray.characterise.codes import NOTHING
from imuarray.gap.candidates.candidate import Candidate, Kind, Trial
from imuarray.gap.candidates.removal import with_removal
from imuarray.gap.evidence import Evidence
from imuarray.simulate.converters import code_span
from imuarray.simulate.effects.quantisation import Quantisation

_PROBES = ("odd_codes", "second_bit", "absent_codes", "repeats")
_STEPS = tuple(2**bits for bits in range(1, 13))
_ODD_ONES = 0.01
"""Share of codes that are anything: glitches."""

_FEWEST = 3
"""Fewer different codes have a common divisor by chance."""


def guesses(evidence: Evidence) -> Iterator[Trial]:
    """The greatest step of which (nearly) all codes are multiples, and the power of two in it."""
    yield from with_removal(evidence, Quantisation.name, _found(evidence))


def _found(evidence: Evidence) -> Iterator[Trial]:
    usual = code_span(evidence.header).step
    if not evidence.is_odd(*_PROBES):
        return
    divisor = _divisor(evidence)
    powers = [step for step in _STEPS if divisor and divisor % step == 0]
    for step in dict.fromkeys((divisor, *powers[-1:])):
        if step > usual:
            yield Trial((Quantisation(float(step)),))


def _divisor(evidence: Evidence) -> int:
    """Of all codes but a hundredth of the readings, over all axes and phases; 0 without one."""
    merged = NOTHING
    for seen in evidence.seen:
        for codes in seen.raw.codes:
            merged = merged.merge(codes)
    least = (1 - _ODD_ONES) * merged.counts.sum()
    for step in range(_STEPS[-1], 1, -1):
        on = merged.codes % step == 0
        if np.count_nonzero(on) >= _FEWEST and merged.counts[on].sum() >= least:
            return step
    return 0


QUANTISATION = Candidate(
    Quantisation.name, guesses, dict.fromkeys(get_args(Kind), "1000 readings, at rest or in motion")
)
