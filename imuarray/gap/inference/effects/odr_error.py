"""`odr_error` is recognised by rows that repeat at the poll's pace, by readings that are older than those of others, by
even codes of an ADXL345, by noise of another size.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import get_args

import numpy as np

from imuarray.chips import CHIPS
from imuarray.gap.inference.effects.candidate import Candidate, Hypothesis, Kind
from imuarray.gap.inference.effects.lag import mean_of, odd_lags
from imuarray.gap.inference.effects.removal import with_removal
from imuarray.gap.inference.effects.repetition import repeated_share
from imuarray.gap.inference.evidence import Evidence
from imuarray.simulate.converters import EVEN_ONLY_FROM_HZ, code_span
from imuarray.simulate.effects.conversion import OdrError

_REPEATS = ("repeats", "stale", "longest_repeat")
_NEAR = 0.15
"""An oscillator's tolerance, and what is lost in telling repeats from chance."""

_LEAST = 1e-3
_FEW_ODD = 0.01
_OSCILLATOR = 0.1
_RARITY, _ONLY = 3.0, 1.0
"""A rate to which the chip can't be set is rare; its oscillator is a tenth off at most. Of a chip that can't be set to
any other there is no other way to a wrong rate.
"""


def guesses(evidence: Evidence) -> Iterator[Hypothesis]:
    """Suggest rates that the chip can be set to, or the one that is seen; bandwidths likewise."""
    yield from with_removal(evidence, OdrError.name, _hypotheses(evidence))


def _hypotheses(evidence: Evidence) -> Iterator[Hypothesis]:
    if evidence.is_odd(*_REPEATS):
        yield from _by_repeats(evidence)
    else:
        yield from _by_age(evidence)
    if evidence.header.chip == "adxl345" and evidence.is_odd("odd_codes", "absent_codes"):
        yield from _by_even_codes(evidence)
    if evidence.is_odd("noise") and not evidence.is_odd(*_REPEATS):
        yield from _by_noise(evidence)


def _by_repeats(evidence: Evidence) -> Iterator[Hypothesis]:
    """Slower than the poll: new readings per second. Faster than configured, where repeats are missing: the two rates
    next to the poll's, since what lies beyond isn't seen.
    """
    rows_hz, allowed = evidence.rows_per_s, _rates_hz(evidence)
    repeated, configured_hz = repeated_share(evidence), evidence.header.rate_hz
    most_hz = min(rows_hz, configured_hz) if configured_hz else rows_hz
    real_hz = (1 - repeated) * most_hz
    if repeated > _LEAST:
        near = [rate for rate in allowed if rate < most_hz and abs(real_hz / rate - 1) < _NEAR]
        for rate in sorted(near, key=lambda rate: abs(real_hz / rate - 1))[:1]:
            yield Hypothesis((OdrError(rate),))
        is_setting = any(abs(real_hz / rate - 1) < _OSCILLATOR for rate in allowed)
        yield Hypothesis((OdrError(real_hz),), ("rate_hz",), rarity=0.0 if is_setting else _RARITY)
        if not is_setting and code_span(evidence.header).step != 1:  # what it is set to shows in its codes
            yield from _by_clock(evidence, real_hz)
    elif repeated < -_LEAST:
        for rate in [rate for rate in allowed if rate >= rows_hz][:2]:
            yield Hypothesis((OdrError(rate),))


def _by_age(evidence: Evidence) -> Iterator[Hypothesis]:
    """Faster than the poll, so that no row repeats, and slower than configured: readings are half a period old. It is
    set to a slower rate, or as it should be and its oscillator limps: then the codes are those of the set rate.
    """
    lags_seen = odd_lags(evidence)
    if not lags_seen:
        return
    lag_s = mean_of(lags_seen, "lag_s")
    configured_hz = evidence.header.rate_hz
    age_s = lag_s + (0.5 / configured_hz if configured_hz else 0.0)
    if lag_s <= 0 or age_s >= 0.5 / evidence.rows_per_s:
        return
    real_hz = 0.5 / age_s
    near = [rate for rate in _rates_hz(evidence) if abs(real_hz / rate - 1) < _NEAR and rate > evidence.rows_per_s]
    for rate in sorted(near, key=lambda rate: abs(real_hz / rate - 1))[:1]:
        yield Hypothesis((OdrError(rate),))
    yield from _by_clock(evidence, real_hz)


def _by_clock(evidence: Evidence, real_hz: float) -> Iterator[Hypothesis]:
    """Suggest readings at that rate by an oscillator that should make more; of a chip without a rate, simply at that
    rate.
    """
    configured_hz = evidence.header.rate_hz
    if not configured_hz:
        yield Hypothesis((OdrError(real_hz),), ("rate_hz",), rarity=_RARITY)
    elif _LEAST < real_hz / configured_hz < 1:
        rarity = _RARITY if _rates_hz(evidence) else _ONLY
        yield Hypothesis((OdrError(clock_ratio=real_hz / configured_hz),), ("clock_ratio",), rarity=rarity)


def _by_even_codes(evidence: Evidence) -> Iterator[Hypothesis]:
    """Suggest even codes, as from 1600 Hz on (ADX-47)."""
    codes = [histogram for item in evidence.phases for histogram in item.raw.codes]
    odd = sum(int(histogram.counts[histogram.codes % 2 == 1].sum()) for histogram in codes)
    total = sum(int(histogram.counts.sum()) for histogram in codes)
    is_even, expected_even = odd < _FEW_ODD * total, code_span(evidence.header).step == 2
    if is_even == expected_even:
        return
    allowed = _rates_hz(evidence)
    fast = [rate for rate in allowed if rate >= EVEN_ONLY_FROM_HZ]
    slow = [rate for rate in reversed(allowed) if rate < EVEN_ONLY_FROM_HZ]
    for rate in (fast if is_even else slow)[:2]:
        yield Hypothesis((OdrError(rate),))


def _by_noise(evidence: Evidence) -> Iterator[Hypothesis]:
    """Suggest a bandwidth by the variance. Where the noise is fitted there is nothing to see."""
    header, spec = evidence.header, CHIPS.get(evidence.header.chip)
    ratio = math.exp(2 * float(np.median(evidence.typical("noise"))))
    if spec is None or not header.bandwidth_hz:
        return
    wanted_hz = ratio * header.bandwidth_hz
    others = [width for width in spec.allowed_bandwidths_hz(header.rate_hz) if width != header.bandwidth_hz]
    others.sort(key=lambda width: abs(math.log(width / wanted_hz)))
    if others and abs(math.log(others[0] / wanted_hz)) < abs(math.log(ratio)):
        yield Hypothesis((OdrError(bandwidth_hz=others[0]),))


def _rates_hz(evidence: Evidence) -> list[float]:
    """Ascending, without the configured one."""
    spec = CHIPS.get(evidence.header.chip)
    return sorted(rate for rate in (spec.rates_hz if spec else ()) if rate != evidence.header.rate_hz)


ODR_ERROR = Candidate(OdrError.name, guesses, dict.fromkeys(get_args(Kind), "polled faster than the chip's data rate"))
