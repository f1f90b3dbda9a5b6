"""Probes of the distribution of codes, independent of the signal."""

from __future__ import annotations

import math
from functools import partial

import numpy as np

from imuarray.arrays import Floats
from imuarray.characterise.codes import Histogram
from imuarray.gap.statistics.margins import CODES, HALF_OF_CODES, ROWS, SCORE
from imuarray.gap.statistics.probes.probe import PhaseProbe, Probes, arcsine, once, one_row
from imuarray.gap.statistics.summary import Summary
from imuarray.log.format import RESOLUTION
from imuarray.simulate.converters import CodeSpan, code_span

_MIDDLE = np.array([0.05, 0.95])
"""Quantiles of the readings between which absent codes are counted."""


def odd(summary: Summary) -> Floats:
    """Return the arcsine of the share of odd codes; nan if the counts are not codes of a chip."""
    return _of_codes(summary, arcsine(_having(summary, 1), summary.rows))


def second_bit(summary: Summary) -> Floats:
    """Return the arcsine of the share of codes with bit 1 set; nan if the counts are not codes of a chip."""
    return _of_codes(summary, arcsine(_having(summary, 2), summary.rows))


def absent(summary: Summary) -> Floats:
    """Return the arcsine of the share of codes in the middle nine tenths of the readings that are absent.

    0 if there are fewer than `_ROWS_A_CODE` rows per code, for example in a quick turn: codes are then absent by
    chance, and the share depends on the path of the box. nan if the counts are not codes of a chip.
    """
    middles = _middles(summary)
    absent_codes = [missing if summary.rows >= _ROWS_A_CODE * codes else 0 for missing, codes in middles]
    return _of_codes(summary, arcsine(absent_codes, [codes for _, codes in middles]))


def _of_codes(summary: Summary, values: Floats) -> Floats:
    """Return the values (3,), or nan if an import computed the counts from rounded or computed values."""
    return np.full(len(values), math.nan) if RESOLUTION in summary.header.extra else values


def at_ends(summary: Summary) -> Floats:
    """Return the arcsine of the share of readings at or beyond an end of the code span."""
    span = code_span(summary.header)
    return arcsine([_beyond(histogram, span) for histogram in summary.codes], summary.rows)


def pile(summary: Summary) -> Floats:
    """Return by how much the outermost code is more frequent than the next one inwards, in standard deviations, at the
    end where this is larger; 0 if it is rarer at both ends.

    The root of a Poisson count has a standard deviation of 1/2 whatever its mean.
    """
    return np.array([_pile(histogram.counts) for histogram in summary.codes])


def _beyond(histogram: Histogram, span: CodeSpan) -> int:
    if len(histogram.codes) == 0 or (span.lowest < histogram.codes[0] and histogram.codes[-1] < span.highest):
        return 0
    return int(histogram.counts[(histogram.codes <= span.lowest) | (histogram.codes >= span.highest)].sum())


def _having(summary: Summary, bit: int) -> list[int]:
    return [int(histogram.counts @ (histogram.codes & bit)) // bit for histogram in summary.codes]


@once
def _middles(summary: Summary) -> list[tuple[int, int]]:
    return [_absent(histogram) for histogram in summary.codes]


def _absent(histogram: Histogram) -> tuple[int, int]:
    """Return the number of absent codes and of all codes between the quantiles `_MIDDLE`."""
    if len(histogram.codes) == 0:
        return 0, 0
    upto = histogram.counts.cumsum()
    low, high = upto.searchsorted(_MIDDLE * upto[-1])
    span = int(histogram.codes[high] - histogram.codes[low]) + 1
    return span - int(high - low) - 1, span


def _pile(counts: np.ndarray) -> float:
    if len(counts) < 2:
        return math.nan
    first, inner, before_last, last = (math.sqrt(count + 3 / 8) for count in counts[[0, 1, -2, -1]].tolist())
    return math.sqrt(2) * max(first - inner, last - before_last, 0.0)


def _one_code(summary: Summary) -> float:
    """Return the resolution of the share of absent codes: one code of the axis with the fewest codes, which can be
    absent by chance.
    """
    spans = [codes for _, codes in _middles(summary)]
    return 0.5 / math.sqrt(max(min(spans, default=1), 1))


_ROWS_A_CODE = 4
"""Least number of rows per code. With uniform readings the share e^-4, one code in fifty, is then absent by chance."""

_STEPS = ("quantisation", "odr_error")
_CLIPPED = ("saturation", "range_reset", "scale", "nonlinearity")


_probe = partial(PhaseProbe, "codes", in_motion=True, resolution=one_row)

PROBES: Probes = {
    "odd_codes": _probe("arcsine of the share of odd codes", _STEPS, HALF_OF_CODES, odd),
    "second_bit": _probe(
        "arcsine of the share of codes with bit 1 set",
        ("quantisation",),
        HALF_OF_CODES,
        second_bit,
        in_motion=False,  # depends on the level, which is known to less than a code only at rest
    ),
    "absent_codes": _probe(
        "arcsine of the share of absent codes among those in the middle", _STEPS, CODES, absent, resolution=_one_code
    ),
    "code_ends": _probe("arcsine of the share at the ends of the span", _CLIPPED, ROWS, at_ends),
    "code_pile": _probe(
        "by how much the outermost code outnumbers the next", _CLIPPED, SCORE, pile, resolution=lambda _: 1.0
    ),
}
