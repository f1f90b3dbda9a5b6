"""`quantisation` is recognised by codes that are all multiples of a number, or that never have one of their bits."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import reduce
from typing import get_args

import numpy as np

from imuarray.characterise.codes import NOTHING, Histogram
from imuarray.gap.candidates.candidate import Candidate, Kind, Trial
from imuarray.gap.candidates.removal import with_removal
from imuarray.gap.evidence import Evidence
from imuarray.simulate.converters import code_span
from imuarray.simulate.effects.bias import Bias
from imuarray.simulate.effects.quantisation import Quantisation

_PROBES = ("odd_codes", "second_bit", "absent_codes", "repeats")
_LEAPS = ("kurtosis", "extreme", "noise_excess", "force_square")
"""Probes that move where readings leap from one stretch of codes to another."""

_STEPS = tuple(2**bits for bits in range(1, 13))
_ODD_ONES = 0.01
"""Share of codes that are anything: glitches."""

_HIGHEST_BIT = 12

_NORMAL = np.array([-3.0, -1.28, -0.52, 0.0, 0.52, 1.28, 3.0])
"""Standard deviations: about equally likely parts of a normal distribution, and its ends."""

_REACH, _SHIFTS = 1.5, 49
"""Biases are looked for up to so many stretches off, at so many places."""

_UNITS_DIFFER = 0.015
"""Of what is felt: a scale, and an angle, of a chip's population; no bias is to depend on which one this is."""

_FEWEST = 3
"""Fewer different codes have a common divisor by chance."""


def guesses(evidence: Evidence) -> Iterator[Trial]:
    """The greatest step of which (nearly) all codes are multiples, and the power of two in it; bits that are never set,
    though codes leap over where they would be.
    """
    yield from with_removal(evidence, Quantisation.name, _found(evidence))


def _found(evidence: Evidence) -> Iterator[Trial]:
    usual = code_span(evidence.header).step
    if not evidence.is_odd(*_PROBES, *_LEAPS):
        return
    codes = [codes for seen in evidence.seen for codes in seen.raw.codes if len(codes.codes)]
    merged = reduce(Histogram.merge, codes, NOTHING)
    divisor = _divisor(merged)
    powers = [step for step in _STEPS if divisor and divisor % step == 0]
    for step in dict.fromkeys((divisor, *powers[-1:])):
        if step > usual:
            yield Trial((Quantisation(float(step)),))
    for bit in range(_HIGHEST_BIT) if divisor in (0, usual) else ():
        if _is_dead(bit, merged, codes):
            dead = Quantisation(dead_bits=float(1 << bit))
            yield Trial((dead,))
            for bias in _moved(evidence, 1 << bit):
                yield Trial((dead, bias))


def _moved(evidence: Evidence, dead: int) -> Iterator[Bias]:
    """By how much the bias has to be another one for the same levels to come out without that bit: the fit took its
    own from what came out, a stretch too low on some of the faces.
    """
    if not evidence.still:
        return
    raw, left = (
        np.array([np.nanmean(part.segments.mean, axis=0) for part in parts])
        for parts in ([seen.raw for seen in evidence.still], [seen.left for seen in evidence.still])
    )
    scale = evidence.header.sensitivity
    felt = np.abs(raw - left - np.mean(raw - left, axis=0)).max(axis=0) * _UNITS_DIFFER
    noise, units = (np.multiply.outer(_NORMAL, width)[:, None] for width in (evidence.noise * scale, felt))
    shifts = np.unique(np.rint(np.linspace(-_REACH * dead, _REACH * dead, _SHIFTS)))
    shifts = shifts[np.argsort(np.abs(shifts), kind="stable")]  # of equals the nearest
    apart = np.zeros((len(shifts), 3))
    for unit in units:
        true = np.rint((raw - left) + unit + shifts[:, None, None, None] + noise).astype(np.int64)
        apart += np.abs((true & ~dead).mean(axis=1) - raw).mean(axis=1)
    x, y, z = (shifts[apart.argmin(axis=0)] / scale).tolist()
    if any((x, y, z)):
        yield Bias((x, y, z))


def _divisor(merged: Histogram) -> int:
    """Of all codes but a hundredth of the readings, over all axes and phases; 0 without one."""
    least = (1 - _ODD_ONES) * merged.counts.sum()
    for step in range(_STEPS[-1], 1, -1):
        on = merged.codes % step == 0
        if np.count_nonzero(on) >= _FEWEST and merged.counts[on].sum() >= least:
            return step
    return 0


def _is_dead(bit: int, merged: Histogram, each: Sequence[Histogram]) -> bool:
    """Whether a bit is clear in all codes but a hundredth of the readings, though those of an axis in a phase leap
    over a stretch in which it would be set.
    """
    clear = merged.counts[merged.codes >> bit & 1 == 0].sum()
    return bool(clear >= (1 - _ODD_ONES) * merged.counts.sum()) and any(_leaps(bit, codes) for codes in each)


def _leaps(bit: int, codes: Histogram) -> bool:
    upto = np.cumsum(codes.counts)
    low, high = codes.codes[np.searchsorted(upto, np.array([_ODD_ONES, 1 - _ODD_ONES]) * upto[-1])]
    return bool(low >> (bit + 1) != high >> (bit + 1))


QUANTISATION = Candidate(
    Quantisation.name, guesses, dict.fromkeys(get_args(Kind), "1000 readings, at rest or in motion")
)
