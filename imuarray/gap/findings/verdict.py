"""The verdict and the probabilities of causes and of an unknown effect, by rules that keep them consistent.

A share among rivals states which effect the data prefer. It is too confident: simulated effects do not have exactly the
form of real ones, and the true effect may not be in the library. It is therefore tempered by rates measured on cases
from other generators, whose effects have forms of their own (`imuarray.validation.calibration`), after a first test: if
no combination of known effects makes a recording likely, no known effect is probable.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import replace
from math import floor
from typing import NamedTuple

from imuarray.gap.findings.diagnosis import EVEN, Cause, Gap, Verdict
from imuarray.gap.inference.assessment import Assessment, largest_of
from imuarray.printable import listed, percent

EXPLAINED, PARTLY = 0.9, 0.3
"""Closed shares from which on a gap is explained, or partly explained. The true effect usually closes more than nine
tenths: of causes of one mechanism that closed 0.8 to 0.9, in all runs so far, 6 were right and 11 wrong.
"""

DOUBT = 0.05
"""p of the remainder below which it is significant."""

_HALF, _STEEP = 0.65, 6.0
"""Closed share at which an unknown effect has even odds, and the steepness of the transition."""

_MOST_REASONS = 2
"""Most reasons of a verdict that are given, the weightiest first."""

_SURE = 1e-4
"""Shares are limited to this distance from 0 and 1."""


class Rates(NamedTuple):
    """The rates at which causes are right: `least` for causes without a rival that together close nothing of their
    sensors' gap, `most` if they close all of it; in between the rate depends on the power `steep` of the closed share.
    Odds against rivals count with the power `rivals`.
    """

    least: float
    most: float
    steep: float
    rivals: float


RATES = Rates(0.12, 0.9, 2.3, 0.4)
"""Between the maximum likelihood on 93 causes that the present search reports in opened cases of worlds that others
generated (0.28, 0.88, 1.5, 0.55; 57 of them right), on 169 causes of five opened halves of such worlds, most by earlier
versions (0.18, 0.83, 3.7, 0.28; 81 right), and on 160 causes of the emulated plan (0.02, 0.99, 1.6, 0.33; 105 right).
On the 93 the calibration error is 0.09, as chance makes it, and the Brier score 0.16.
"""


class Judgement(NamedTuple):
    """The result of `judge`: the verdict, the gap, the causes (most probable first), the probability that something
    outside the library is present, and in words why the verdict is this one.
    """

    verdict: Verdict
    gap: Gap
    causes: tuple[Cause, ...]
    unknown: float
    reason: str = ""


def judge(
    gap: Gap,
    causes: Sequence[Cause],
    unknown: float,
    *,
    is_gap: bool,
    unlikely: Collection[str] = (),
    has_remainder: bool = False,
) -> Judgement:
    """Return the verdict, and the probabilities and the closure that agree with it.

    `causes` have their calibrated probabilities, `unknown` is the estimate of `unknown_probability`. `unlikely` names
    the sensors whose recordings no combination of known effects makes likely: what is left of them with all causes in
    is far beyond chance, and matters. A cause is *sound* if it concerns none of these. `has_remainder`: something that
    matters is left of any sensor, maybe no more than the form of a cause that is a little different. The first rule
    that applies gives the verdict:

    1. "no gap" if `is_gap` is false.
    2. "unexplained" if there is no cause; if less than `PARTLY` of the gap is closed; if nothing of it can be measured
       and no cause is as probable as `EVEN`; or if a sensor is unlikely and no sound cause is as probable as `EVEN`.
    3. "explained" if at least `EXPLAINED` of the gap is closed, nothing is left, no sensor is unlikely, the most
       probable cause is at least as probable as `EVEN`, and something unknown is less probable.
    4. "partly explained" else.

    The rest follows from the verdict:

    * Without a gap, `closed` and its interval are None, there are no causes, and unknown is 0.
    * Unknown is below `EVEN` if the gap is explained, at most `EVEN` if it is explained in part, at least `EVEN` if it
      is unexplained.
    * No cause is more probable than 1 - unknown, and none that isn't sound more probable than `EVEN`. Where no effect
      is accepted, unknown leaves room for the nearest one.
    * An interval of `closed` is given only with `closed`. With a gap `closed` is None only where nothing of it can be
      measured on held-out data; such a gap is never explained.
    """
    if not is_gap:
        no_closure = replace(gap, after=gap.before, closed=None, closed_ci95=None)
        return Judgement("no gap", no_closure, (), 0.0, "no statistic differs beyond chance")
    nearest = max((cause.probability for cause in causes if not cause.is_accepted), default=0.0)
    unknown = min(unknown, 1 - nearest)
    verdict = _verdict(gap.closed, causes, unknown, unlikely)
    reason = _reason(gap.closed, causes, unknown, unlikely, has_remainder)
    if verdict == "explained" and has_remainder:
        verdict = "partly explained"
    if verdict != "explained":
        unknown = max(unknown, EVEN) if verdict == "unexplained" else min(unknown, EVEN)
    limited = [replace(cause, probability=min(cause.probability, _limit(cause, unknown, unlikely))) for cause in causes]
    ranked = tuple(sorted(limited, key=lambda cause: -cause.probability))
    interval = None if gap.closed is None else gap.closed_ci95
    return Judgement(verdict, replace(gap, closed_ci95=interval), ranked, unknown, reason)


def _verdict(closed: float | None, causes: Sequence[Cause], unknown: float, unlikely: Collection[str]) -> Verdict:
    """Return the verdict on a gap, by the rules of `judge`."""
    most = max((cause.probability for cause in causes), default=0.0)
    most_sound = max((cause.probability for cause in causes if _is_sound(cause, unlikely)), default=0.0)
    closes = most >= EVEN if closed is None else closed >= PARTLY
    if not causes or not closes or (unlikely and most_sound < EVEN):
        return "unexplained"
    is_explained = closed is not None and closed >= EXPLAINED and not unlikely
    return "explained" if is_explained and most >= EVEN and unknown < EVEN else "partly explained"


def _reason(
    closed: float | None, causes: Sequence[Cause], unknown: float, unlikely: Collection[str], has_remainder: bool
) -> str:
    """Return in words what keeps the gap from being explained, or that nothing does."""
    if not any(cause.is_accepted for cause in causes):
        return "no known effect was accepted as a cause"
    reasons = []
    if closed is None:
        reasons.append("how much of the gap closes cannot be measured")
    elif closed < EXPLAINED:
        share = f"only {percent(floor(100 * closed + 1e-9) / 100)}" if closed >= 0.01 else "nothing"
        reasons.append(f"{share} of the gap closes (explained from {percent(EXPLAINED)} on)")
    if unlikely:
        reasons.append(
            f"{listed(sorted(unlikely))} still {'differs' if len(unlikely) == 1 else 'differ'} far beyond chance"
        )
    elif has_remainder:
        reasons.append("what is left still matters")
    if max(cause.probability for cause in causes) < EVEN:
        reasons.append("which of several causes it is remains open: none is more probable than not")
    if unknown >= EVEN:
        reasons.append("something outside the library is at least as probable as not")
    return "; ".join(reasons[:_MOST_REASONS]) or "the causes close the gap, up to what an inexact form of them leaves"


def _limit(cause: Cause, unknown: float, unlikely: Collection[str]) -> float:
    """Return the greatest probability that a cause may have."""
    return 1 - unknown if _is_sound(cause, unlikely) else min(1 - unknown, EVEN)


def _is_sound(cause: Cause, unlikely: Collection[str]) -> bool:
    """Return whether the recordings of all sensors concerned (no names: of all) are likely with the causes in the
    model.
    """
    return not set(unlikely) & set(cause.sensors) if cause.sensors else not unlikely


def unknown_probability(closed: float | None, after: Assessment, one_sided: float = 0.0) -> float:
    """Return the probability that something outside the library is present.

    It follows from the share of the gap that the causes leave open, and from how far the remainder exceeds chance in
    one place or with one sign (`one_sided`, `imuarray.gap.inference.residuals`), in units of the largest chance value.
    """
    share = closed if closed is not None else (1.0 if after.p > DOUBT else 0.0)
    largest = float(largest_of(after.normal))
    beyond = math.log(max(largest / max(after.limit, 1.0), one_sided, 0.1))
    return 1 / (1 + math.exp(min(max(_STEEP * (share - _HALF) - beyond, -50.0), 50.0)))


def calibrated_probability(share: float, all_closed: float | None, rates: Rates = RATES) -> float:
    """Return the probability of a cause with such a `share` among its rivals, given the share of their sensors' gap
    that all causes close (None: there was nothing to close), before the remainder is considered (`judge`).
    """
    closed = min(max(all_closed or 0.0, 0.0), 1.0)
    right = rates.least + (rates.most - rates.least) * math.pow(closed, rates.steep)
    return right * _temper(share, rates.rivals)


def _temper(share: float, power: float) -> float:
    """Return a probability whose odds are raised to that power."""
    share = min(max(share, _SURE), 1 - _SURE)
    return 1 / (1 + math.exp(-power * math.log(share / (1 - share))))
