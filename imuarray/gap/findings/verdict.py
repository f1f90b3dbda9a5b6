"""The verdict, and how probable each cause and something outside the library are: rules by which these can't contradict
each other.

A share among rivals says which effect the data prefer. It says too much: simulated effects have not quite the form of
real ones, and what is at work need not be in the library. So it is tempered, by rates measured on emulated cases whose
mechanisms have forms of their own (`imuarray.validation.calibration`), and a gate comes before it: where no combination
of known effects makes a recording likely, no known effect is probable.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import replace
from typing import NamedTuple

from imuarray.gap.findings.diagnosis import Cause, Gap, Verdict
from imuarray.gap.inference.assessment import Assessment, largest_of

EXPLAINED, PARTLY = 0.9, 0.3
"""Shares of the gap closed from which on it is explained, or partly. What is at work closes more than nine tenths as a
rule: of causes of one mechanism that closed 0.8 to 0.9, in all runs that have been looked at, 6 were right and 11 not.
"""

EVEN = 0.5
"""As probable as not: what explains a gap is at least as probable, and what is unknown explains none that is explained.
"""

DOUBT = 0.05
"""The p of what is left below which something is left."""

_HALF, _STEEP = 0.65, 6.0
"""Share closed at which something unknown is as probable as not, and how fast that changes."""

_SURE = 1e-4
"""No share counts as nearer to 0 or 1."""


class Rates(NamedTuple):
    """Of being right: `least` of causes without a rival that together close nothing of their sensors' gap, `most` where
    they close all of it; between them it goes with the power `steep` of what is closed. Odds against rivals count with
    the power `rivals`.
    """

    least: float
    most: float
    steep: float
    rivals: float


RATES = Rates(0.02, 0.99, 1.6, 0.33)
"""The likeliest of 160 causes told in cases of two sealed runs that had been opened and of one of the development half,
105 of them right. Of those without a rival that closed 0.98 and more, 30 of 31 were right in the latest; of odds of ten
against a rival every third was wrong.
"""


class Judgement(NamedTuple):
    """What `judge` says: the verdict, the gap, the causes (most probable first), and the probability that something
    outside the library is present.
    """

    verdict: Verdict
    gap: Gap
    causes: tuple[Cause, ...]
    unknown: float


def judge(
    gap: Gap,
    causes: Sequence[Cause],
    unknown: float,
    *,
    is_gap: bool,
    unlikely: Collection[str] = (),
    is_left: bool = False,
) -> Judgement:
    """The verdict, and the probabilities and the closure that agree with it.

    `causes` have their calibrated probabilities, `unknown` is the estimate of `unknown_probability`. `unlikely` names
    the sensors whose recordings no combination of known effects makes likely: what is left of them with all causes in
    is far beyond chance, and matters. A cause is *sound* if it concerns none of these. `is_left`: something that
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
    * No cause is more probable than 1 - unknown, and none that isn't sound more probable than `EVEN`.
    * An interval of `closed` is given only with `closed`. With a gap `closed` is None only where nothing of it can be
      measured on held-out data; such a gap is never explained.
    """
    if not is_gap:
        return Judgement("no gap", replace(gap, after=gap.before, closed=None, closed_ci95=None), (), 0.0)
    verdict = _verdict(gap.closed, causes, unknown, unlikely)
    if verdict == "explained" and is_left:
        verdict = "partly explained"
    if verdict != "explained":
        unknown = max(unknown, EVEN) if verdict == "unexplained" else min(unknown, EVEN)
    limited = [replace(cause, probability=min(cause.probability, _limit(cause, unknown, unlikely))) for cause in causes]
    ranked = tuple(sorted(limited, key=lambda cause: -cause.probability))
    interval = None if gap.closed is None else gap.closed_ci95
    return Judgement(verdict, replace(gap, closed_ci95=interval), ranked, unknown)


def _verdict(closed: float | None, causes: Sequence[Cause], unknown: float, unlikely: Collection[str]) -> Verdict:
    """Of a gap, by the rules of `judge`."""
    most = max((cause.probability for cause in causes), default=0.0)
    most_sound = max((cause.probability for cause in causes if _is_sound(cause, unlikely)), default=0.0)
    closes = most >= EVEN if closed is None else closed >= PARTLY
    if not causes or not closes or (unlikely and most_sound < EVEN):
        return "unexplained"
    is_explained = closed is not None and closed >= EXPLAINED and not unlikely
    return "explained" if is_explained and most >= EVEN and unknown < EVEN else "partly explained"


def _limit(cause: Cause, unknown: float, unlikely: Collection[str]) -> float:
    """The greatest probability that a cause may have."""
    return 1 - unknown if _is_sound(cause, unlikely) else min(1 - unknown, EVEN)


def _is_sound(cause: Cause, unlikely: Collection[str]) -> bool:
    """Whether the recordings of all sensors concerned (no names: of all) are likely with the causes in."""
    return not set(unlikely) & set(cause.sensors) if cause.sensors else not unlikely


def unknown_probability(closed: float | None, after: Assessment, one_sided: float = 0.0) -> float:
    """Probability that something outside the library is present: by the share of the gap that the causes leave open,
    and by how far beyond chance what is left goes, in one place or always to one side (`one_sided`,
    `imuarray.gap.inference.residuals`), in units of what chance reaches.
    """
    share = closed if closed is not None else (1.0 if after.p > DOUBT else 0.0)
    largest = float(largest_of(after.scores))
    beyond = math.log(max(largest / max(after.limit, 1.0), one_sided, 0.1))
    return 1 / (1 + math.exp(min(max(_STEEP * (share - _HALF) - beyond, -50.0), 50.0)))


def calibrated_probability(share: float, all_closed: float | None, rates: Rates = RATES) -> float:
    """The probability of a cause with such a `share` among its rivals, by what is closed of its sensors' gap in all
    (None: nothing was to be closed), before what is left is looked at (`judge`).
    """
    closed = min(max(all_closed or 0.0, 0.0), 1.0)
    right = rates.least + (rates.most - rates.least) * math.pow(closed, rates.steep)
    return right * _tempered(share, rates.rivals)


def _tempered(share: float, power: float) -> float:
    """With odds raised to that power."""
    share = min(max(share, _SURE), 1 - _SURE)
    return 1 / (1 + math.exp(-power * math.log(share / (1 - share))))
