"""`saturation` is recognised by readings that pile up at the outermost code, short of the converter's end."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator

import numpy as np

from imuarray.characterise.codes import Histogram
from imuarray.gap.inference.effects.candidate import Candidate, Hypothesis
from imuarray.gap.inference.effects.removal import with_removal
from imuarray.gap.inference.evidence import Evidence
from imuarray.simulate.converters import CodeSpan, code_span
from imuarray.simulate.effects.conversion import Saturation

_PROBES = ("code_pile", "skewness", "kurtosis", "motion_residual", "motion_gain", "force_square", "force_own")
_PILE = 3.0
"""Standard deviations by which the last code outnumbers the one before."""

_MOST = 2


def guesses(evidence: Evidence) -> Iterator[Hypothesis]:
    """Suggest the largest codes at which an axis piles up, as the limits of all axes; those of each axis that piles up
    alone; and both ends of each axis, about a centre of its own, where an axis piles up at both, or at one and passes
    the opposite of it at the other, which then is the converter's.
    """
    yield from with_removal(evidence, Saturation.name, _hypotheses(evidence))


def _hypotheses(evidence: Evidence) -> Iterator[Hypothesis]:
    if not evidence.is_odd(*_PROBES):
        return
    span = code_span(evidence.header)
    ends: list[set[int]] = [set(), set(), set()]
    for phase in evidence.phases:
        for axis_ends, codes in zip(ends, phase.raw.codes, strict=True):
            axis_ends |= {end for end in _piled(codes) if span.lowest < end < span.highest and end}
    limits = [{abs(end) for end in axis_ends} for axis_ends in ends]
    for limit in _apart(sorted(set().union(*limits), reverse=True))[:_MOST]:
        yield Hypothesis((Saturation((limit / evidence.header.sensitivity,) * 3),), ("limit",))
    if any(limits) and not all(limits):
        x, y, z = (
            max(axis_limits) / evidence.header.sensitivity if axis_limits else math.inf for axis_limits in limits
        )
        yield Hypothesis((Saturation((x, y, z)),), ("limit",))
    both = [_both_ends(axis_ends, _extremes(evidence, axis), span) for axis, axis_ends in enumerate(ends)]
    if any(both):
        scale = 2 * evidence.header.sensitivity
        x, y, z = ((max(codes) - min(codes)) / scale if codes else math.inf for codes in both)
        centre_x, centre_y, centre_z = ((max(codes) + min(codes)) / scale if codes else 0.0 for codes in both)
        yield Hypothesis((Saturation((x, y, z), (centre_x, centre_y, centre_z)),))


def _extremes(evidence: Evidence, axis: int) -> list[int]:
    """Return the lowest and the highest code of an axis in each phase."""
    histograms = [phase.raw.codes[axis] for phase in evidence.phases]
    return [int(end) for histogram in histograms if len(histogram.codes) for end in histogram.codes[[0, -1]]]


def _both_ends(ends: Collection[int], codes: Collection[int], span: CodeSpan) -> tuple[int, ...]:
    """Return the codes at which an axis ends: those with a pile, or one with a pile and the end of the converter's
    span, if the axis passes the opposite of the pile; () if it may end at opposite codes.
    """
    if len(ends) == 1:
        (end,) = ends
        if end > 0 and min(codes) < -end:
            return span.lowest, end
        return (end, span.highest) if end < 0 and max(codes) > -end else ()
    return tuple(ends)


def _piled(histogram: Histogram) -> Iterator[int]:
    """Yield the ends with a pile; the root of a Poisson count scatters by 1/2."""
    if len(histogram.codes) < 2:
        return
    for last, before in ((0, 1), (-1, -2)):
        here, roots = np.sqrt(histogram.counts[[last, before]] + 3 / 8)
        if np.sqrt(2) * (here - roots) > _PILE:
            yield int(histogram.codes[last])


def _apart(limits: list[int]) -> list[int]:
    """Descending codes without those that are the one before, rounded otherwise."""
    return [code for at, code in enumerate(limits) if at == 0 or limits[at - 1] - code > 1]


SATURATION = Candidate(
    Saturation.name,
    guesses,
    {
        "tumble": "all six faces, 1 minute each",
        "motion": "strokes and turns up to the range, along every axis",
    },
)
