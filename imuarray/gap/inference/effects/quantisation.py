"""`quantisation` is recognised by codes that are all multiples of a number, that never have one of their bits, or of
which those before every carry are missing.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import reduce
from typing import get_args

import numpy as np

from imuarray.arrays import Booleans, Floats, Integers
from imuarray.characterise.codes import NOTHING, Histogram
from imuarray.gap.inference.effects.behind_codes import behind
from imuarray.gap.inference.effects.candidate import Candidate, Hypothesis, Kind
from imuarray.gap.inference.effects.removal import with_removal
from imuarray.gap.inference.evidence import Evidence
from imuarray.simulate.converters import code_span
from imuarray.simulate.effects.conversion import Quantisation

_PROBES = ("odd_codes", "second_bit", "absent_codes", "repeats")
_LEAPS = ("kurtosis", "extreme", "noise_excess", "force_square")
"""Probes that move where readings leap from one stretch of codes to another."""

_STEPS = tuple(2**bits for bits in range(1, 13))
_ODD_ONES = 0.01
"""Share of codes that are anything: glitches."""

_HIGHEST_BIT = 12

_FURTHEST_CARRY = 64
"""Carries of coarser bits are looked for so many codes from a multiple at most: a histogram of more codes than a chip's
noise spans has gaps by itself.
"""

_LEAST_EXPECTED = 14.0
"""Readings that missing codes would hold if they were as frequent as their neighbours. Chance leaves out so many at one
of 64 places of 12 carries in one recording of a thousand: exp(-14) 64 12 < 0.001.
"""

_FEWEST = 3
"""Fewer different codes have a common divisor by chance."""


def guesses(evidence: Evidence) -> Iterator[Hypothesis]:
    """Suggest the greatest step of which (nearly) all codes are multiples, and the power of two in it, or those of each
    axis where not all have one; bits that are never set, though codes leap over where they would be; codes before a
    carry that never come.
    """
    yield from with_removal(evidence, Quantisation.name, _hypotheses(evidence))


def _hypotheses(evidence: Evidence) -> Iterator[Hypothesis]:
    usual = code_span(evidence.header).step
    if not evidence.is_odd(*_PROBES, *_LEAPS):
        return
    of_axes = [[phase.raw.codes[axis] for phase in evidence.phases] for axis in range(3)]
    codes = [codes for axis in of_axes for codes in axis if len(codes.codes)]
    merged = reduce(Histogram.merge, codes, NOTHING)
    divisor = _divisor(merged)
    for step in dict.fromkeys(_with_power(divisor)):
        if step > usual:
            yield Hypothesis((Quantisation((float(step),) * 3),))
    if divisor not in (0, usual):
        return
    each = [_divisor(reduce(Histogram.merge, axis, NOTHING)) for axis in of_axes]
    if max(each) > usual:
        for steps in dict.fromkeys(zip(*map(_with_power, each), strict=True)):
            x, y, z = (float(step) if step > usual else 1.0 for step in steps)
            yield Hypothesis((Quantisation((x, y, z)),))
        return
    for bit in range(_HIGHEST_BIT):
        if _is_dead(bit, merged, codes):
            yield from _with_what_hides(evidence, Quantisation(dead_bits=float(1 << bit)), 2 << bit, 1 << bit)
    short = {carry: place for carry in _STEPS[1:] if (place := _before_a_carry(carry, merged, codes))[0]}
    if short:  # of every 16 all but two are, of every four, two
        carry = max(short, key=lambda carry: short[carry][0] / carry)
        missing, at = map(float, short[carry])
        coarse = Quantisation(carry_lsb=float(carry), missing_lsb=missing, carry_at_lsb=at)
        yield from _with_what_hides(evidence, coarse, carry, short[carry][0])


def _with_power(divisor: int) -> tuple[int, int]:
    """Return the divisor, and the greatest power of two in it; itself where there is none."""
    return divisor, max((step for step in _STEPS if divisor and divisor % step == 0), default=divisor)


def _with_what_hides(evidence: Evidence, coarse: Quantisation, period: int, stretch: int) -> Iterator[Hypothesis]:
    """Suggest the step with the fitted parameters, and with those that the sensor has before its codes are rounded."""
    yield Hypothesis((coarse,))
    fitted = behind(evidence, coarse.coded, period, stretch)
    if fitted is not None:
        yield Hypothesis((coarse,), fitted=fitted)


def _divisor(merged: Histogram) -> int:
    """Greatest common divisor of all codes but a hundredth of the readings; 0 without one."""
    least = (1 - _ODD_ONES) * merged.counts.sum()
    for step in np.flatnonzero(_are_divisors(merged, least))[::-1].tolist():
        on = merged.codes % step == 0
        if np.count_nonzero(on) >= _FEWEST and merged.counts[on].sum() >= least:
            return int(step)
    return 0


def _are_divisors(merged: Histogram, least: float) -> Booleans:
    """Return which numbers up to the largest step have only prime factors that `least` readings are multiples of."""
    possible = np.arange(_STEPS[-1] + 1) > 1
    for prime in range(2, len(possible)):
        if possible[prime] and merged.counts[merged.codes % prime == 0].sum() < least:
            possible[prime::prime] = False
    return possible


def _is_dead(bit: int, merged: Histogram, each: Sequence[Histogram]) -> bool:
    """Return whether a bit is clear in all codes but a hundredth of the readings, though those of an axis in a phase
    leap over a stretch in which it would be set.
    """
    clear = merged.counts[merged.codes >> bit & 1 == 0].sum()
    return bool(clear >= (1 - _ODD_ONES) * merged.counts.sum()) and any(_leaps(bit, codes) for codes in each)


def _leaps(bit: int, codes: Histogram) -> bool:
    low, high = _most(codes)
    return low >> (bit + 1) != high >> (bit + 1)


def _most(codes: Histogram) -> tuple[int, int]:
    """Return the lowest and the highest one, but for a hundredth of the readings at either end."""
    upto = np.cumsum(codes.counts)
    low, high = codes.codes[np.searchsorted(upto, np.array([_ODD_ONES, 1 - _ODD_ONES]) * upto[-1])].tolist()
    return low, high


def _before_a_carry(carry: int, merged: Histogram, each: Sequence[Histogram]) -> tuple[int, int]:
    """Return how many codes before every carry never come, but that of the carry in their place, and how far from a
    multiple of `carry` these are; (0, 0) if none are missing. Carries are at multiples, unless an offset moved them.
    """
    counts = np.bincount(merged.codes % carry, weights=merged.counts, minlength=carry)
    spans = np.array([_most(codes) for codes in each])
    for at in range(min(carry, _FURTHEST_CARRY)):
        if missing := _missing(carry, np.roll(counts, -at), spans - at):
            return missing, at
    return 0, 0


def _missing(carry: int, counts: Floats, spans: Integers) -> int:
    """Return how many codes before every multiple of `carry` never come, of readings `counts` (carry,) by what is left
    of their codes, though readings of an axis in a phase, from and to `spans` (p, 2), lie on either side; 0 if none.
    """
    upto = np.cumsum(counts[::-1])  # of so many and one codes before the carry
    few = upto <= _ODD_ONES * counts.sum() * np.arange(1, carry + 1) / carry
    missing = int(np.argmin(few)) if few[0] else 0
    there = counts[1 : carry - missing]
    edges = np.concatenate([there[:2], there[-2:]])
    if not missing or not len(there) or missing * edges.mean() < _LEAST_EXPECTED:
        return 0
    if counts[0] < (1 + missing / 2) * edges.mean():
        return 0
    return missing if ((spans[:, 0] - 1) // carry < (spans[:, 1] - 1) // carry).any() else 0


QUANTISATION = Candidate(
    Quantisation.name, guesses, dict.fromkeys(get_args(Kind), "1000 readings, at rest or in motion")
)
