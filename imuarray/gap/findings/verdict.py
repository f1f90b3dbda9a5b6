"""The verdict, and the probabilities of causes and of an unknown effect, by rules that keep them consistent. Also the
closure, and the diagnosis in one paragraph.

A share among rivals states which effect the data prefer. It is overconfident: simulated effects do not have exactly the
form of real ones, and the true effect may not be in the library. The share is therefore tempered by rates measured on
cases from other generators, in which effects have other forms (`imuarray.validation.calibration`). A test comes first:
if no combination of known effects makes a recording likely, no known effect is probable.

The closure is the share by which the causes reduce the excess of squared scores on held-out data. The statistics that
count are those that deviate on the training part. Their scores on the held-out part, before and after the causes are
added to the model, give the closure. Domains have equal weights, whatever their number of statistics, and no score
counts for more than `LARGEST`. Without a gap the mean square of scores is 1, which is subtracted.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from math import floor
from typing import NamedTuple

import numpy as np

from imuarray.arrays import Booleans, Floats, Indices
from imuarray.gap.findings.diagnosis import (
    EVEN,
    Cause,
    Gap,
    Interval,
    Pull,
    Unobservable,
    Verdict,
    Where,
    needs_both_parts,
)
from imuarray.gap.findings.text import (
    closed_text,
    domain_text,
    effect_text,
    explained_pulls_text,
    limits_text,
    off_text,
    parameters_text,
    place_text,
    places_text,
    readable_statistic,
    share,
    specification_text,
    unexplained_pulls,
    use_text,
)
from imuarray.gap.inference.assessment import Assessment, largest_of
from imuarray.gap.model.use import Use
from imuarray.gap.statistics.catalogue import Key
from imuarray.gap.statistics.pairs import Pairs
from imuarray.printable import listed, percent
from imuarray.simulate.effects import meaning

LARGEST = 100.0
DEVIATES, BY_ITSELF = 3.5, 5.0
"""Least score, on the training part, at which a statistic counts; and least score on the held-out part for statistics
that the training part cannot show.
"""

BEYOND_CHOICE = 8.0
"""Least score, on the held-out part, at which a statistic counts whatever the training part shows. For a score this
large, the effects of chance and of selecting the largest score are small.
"""

_DRAWS = 400
_FAR = 10.0
_LEAST_EXCESS = 1.0
"""Least mean excess of squared scores for which a closed share is given."""


class ClosureEstimate(NamedTuple):
    """Root mean square scores before and after, and the closed share of the excess with its 95 % interval; both are
    None if the excess is too small.
    """

    before: float
    after: float
    closed: float | None
    interval: Interval | None


@dataclass(frozen=True)
class DeviatingStatistics:
    """The statistics that count: keys, places (k,) among all, weights (k,), and scores `before` and `after` (k,). The
    scores are on held-out data, or on the part that shows them for events that only one part shows.
    """

    keys: tuple[Key, ...]
    places: Indices
    weights: Floats
    before: Floats
    after: Floats

    def closure(self, seed: int) -> ClosureEstimate:
        """Return the closure over all statistics. Its interval is a bootstrap over blocks (one sensor, phase and
        domain) that adds the recording's chance to each draw once more.
        """
        if len(self.keys) == 0:
            return ClosureEstimate(1.0, 1.0, None, None)
        excess = np.stack([_squares(self.before) - 1, _squares(self.after) - 1])
        before, after = (excess @ self.weights / self.weights.sum()).tolist()
        roots = (float(np.sqrt(max(before + 1, 0.0))), float(np.sqrt(max(after + 1, 0.0))))
        if before < _LEAST_EXCESS:
            return ClosureEstimate(*roots, None, None)
        return ClosureEstimate(*roots, min(1.0, 1 - after / before), self._interval(seed))

    def of(self, chosen: Booleans) -> DeviatingStatistics:
        """Return the chosen statistics, with equal weights for domains."""
        keys = tuple(key for key, is_chosen in zip(self.keys, chosen, strict=True) if is_chosen)
        return DeviatingStatistics(keys, self.places[chosen], _weights(keys), self.before[chosen], self.after[chosen])

    def domains(self) -> tuple[str, ...]:
        """Return the domains of the statistics."""
        return tuple(dict.fromkeys(key.domain for key in self.keys))

    def _interval(self, seed: int) -> Interval | None:
        """Return the interval over the draws that have a gap.

        Chance adds 1 to a squared score in each draw. Without this, the interval from few blocks would be too narrow,
        and that from a single block would have width 0.
        """
        stream = np.random.default_rng(seed)
        blocks = list(_blocks(self.keys).values())
        chance = stream.standard_normal((_DRAWS, len(self.keys)))
        excess = np.stack([_squares(scores + chance) - 2 for scores in (self.before, self.after)])
        weighted = np.stack([(excess[:, :, rows] * self.weights[rows]).sum(axis=-1) for rows in blocks], axis=-1)
        weights = np.array([self.weights[rows].sum() for rows in blocks])
        draws = stream.integers(0, len(blocks), (_DRAWS, len(blocks)))
        total = np.take_along_axis(weighted, np.broadcast_to(draws, weighted.shape), axis=-1).sum(axis=-1)
        before, after = total / weights[draws].sum(axis=-1)
        has_gap = before >= _LEAST_EXCESS
        if not has_gap.any():
            return None
        closed = np.clip(1 - after[has_gap] / before[has_gap], -_FAR, 1.0)
        low, high = np.quantile(closed, (0.025, 0.975)).tolist()
        return low, high


def deviating(pairs: Pairs, before: Floats, after: Floats, silent: Booleans) -> DeviatingStatistics:
    """Return the statistics that deviate on the training part, from the scores (n,) of all statistics.

    A statistic that the training part lacks, or that the fit makes zero there (`silent` (n,)), such as the level of
    another run, is selected by its score on the held-out part with a higher threshold. Any other statistic that
    deviates on the held-out part alone needs a still higher score. For example, the first half of a heating may hardly
    show the curvature that the second half shows.
    """
    train, held_out = (np.where(places >= 0, before[places], np.nan) for places in (pairs.train, pairs.held_out))
    alone = ~np.isfinite(train) | ((pairs.train >= 0) & silent[pairs.train])
    held_out_size = np.abs(np.nan_to_num(held_out))
    size = np.where(alone, held_out_size - (BY_ITSELF - DEVIATES), np.abs(np.nan_to_num(train)))
    chosen = np.isfinite(held_out) & ((size > DEVIATES) | (held_out_size > BEYOND_CHOICE))
    if not chosen.any():
        chosen = np.isfinite(held_out) & (held_out_size > DEVIATES)
    places = pairs.held_out[chosen]
    keys = tuple(key for key, is_chosen in zip(pairs.keys, chosen, strict=True) if is_chosen)
    return _of(keys, places, before, after)


def deviating_in_either(pairs: Pairs, before: Floats, after: Floats) -> DeviatingStatistics:
    """Return the statistics that deviate in either part, for events that occur in one part only."""
    chosen = [
        (key, at)
        for places in (pairs.train, pairs.held_out)
        for key, at in zip(pairs.keys, places.tolist(), strict=True)
        if at >= 0 and abs(np.nan_to_num(before[at])) > BY_ITSELF
    ]
    return _of(tuple(key for key, _ in chosen), np.array([at for _, at in chosen], np.intp), before, after)


def gap_of(counted: DeviatingStatistics, floor: float, seed: int) -> Gap:
    """Return the gap, overall and by domain."""
    whole = counted.closure(seed)
    domains = {}
    for domain in counted.domains():
        chosen = np.array([key.domain == domain for key in counted.keys], bool)
        part = counted.of(chosen).closure(seed)
        domains[domain] = (part.before, part.after, part.closed)
    return Gap(whole.before, whole.after, floor, whole.closed, whole.interval, domains)


def floor_of(counted: DeviatingStatistics, before: Assessment, replicates: Floats) -> float:
    """Return the root mean square score that the same statistics have without a gap: the median of replicates."""
    if len(counted.places) == 0:
        return 1.0
    squares = np.nan_to_num(before.likelihood.scores(replicates)[:, counted.places]) ** 2
    return float(np.sqrt(np.median(squares @ counted.weights / counted.weights.sum())))


def _of(keys: tuple[Key, ...], places: Indices, before: Floats, after: Floats) -> DeviatingStatistics:
    return DeviatingStatistics(
        keys, places, _weights(keys), np.nan_to_num(before[places]), np.nan_to_num(after[places])
    )


def _weights(keys: Sequence[Key]) -> Floats:
    """Return the weights (k,): one over the number of statistics of the same domain."""
    domains = [key.domain for key in keys]
    return np.array([1 / domains.count(domain) for domain in domains])


def _blocks(keys: Sequence[Key]) -> dict[tuple[object, ...], list[int]]:
    blocks: dict[tuple[object, ...], list[int]] = {}
    for at, key in enumerate(keys):
        blocks.setdefault((key.log, key.phase_number, key.sensor, key.domain), []).append(at)
    return blocks


def _squares(scores: Floats) -> Floats:
    return np.asarray(np.minimum(np.abs(scores), LARGEST) ** 2)


EXPLAINED, PARTLY = 0.95, 0.3
"""Least closed shares of an explained gap, and of a partly explained one. In opened cases of the foreign world and of
the emulator, 50 of 64 first causes that close 0.95 or more are right, 4 of 8 that close 0.9 to 0.95 (the others stand
for an effect that the library lacks), and 5 of 11 that close 0.8 to 0.9.
"""

DOUBT = 0.05
"""p-value of the remainder below which it is significant."""

_HALF, _STEEP = 0.65, 6.0
"""Closed share at which an unknown effect has even odds, and the steepness of the transition."""

_MOST_REASONS = 2
"""Largest number of reasons that are given for a verdict, the most important first."""

_SURE = 1e-4
"""Shares are limited to this distance from 0 and 1."""


class Rates(NamedTuple):
    """The rates at which causes are right. `least` is the rate for causes without a rival that together close nothing
    of their sensors' gap, `most` the rate if they close all of it. In between, the rate depends on the closed share
    raised to the power `steep`. Odds against rivals are raised to the power `rivals`.
    """

    least: float
    most: float
    steep: float
    rivals: float


RATES = Rates(0.3, 0.87, 1.3, 0.6)
"""Values between two maximum likelihood estimates. One is from 93 causes of opened cases of worlds that others
generated (0.28, 0.88, 1.5, 0.55; 57 causes were right). The other is from 61 causes of two later halves of these worlds
(0.38, 0.83, 0.5, 1.0; 37 were right). The former rates, which were not fitted to these 61, have a calibration error of
0.08 there (0.12 by chance) and a Brier score of 0.18.
"""


class Judgement(NamedTuple):
    """The result of `judge`: the verdict, the gap, the causes (most probable first), the probability that something
    outside the library is present, and the reason for the verdict in words.
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

    `causes` have their calibrated probabilities; `unknown` is the estimate of `unknown_probability`. `unlikely` names
    the sensors with recordings that no combination of known effects makes likely: with all causes in the model, their
    remainder is far beyond chance and matters. A cause is *sound* if it concerns none of these sensors. `has_remainder`
    states whether a sensor has a remainder that matters, which a slightly different form of a cause may explain. The
    first rule that applies gives the verdict:

    1. "no gap" if `is_gap` is false.
    2. "unexplained" if there is no cause; if less than `PARTLY` of the gap is closed; if the closed share cannot be
       measured and no cause is as probable as `EVEN`; or if a sensor is unlikely and no sound cause is as probable as
       `EVEN`.
    3. "explained" if at least `EXPLAINED` of the gap is closed, there is no remainder, no sensor is unlikely, the most
       probable cause is at least as probable as `EVEN`, and something unknown is less probable.
    4. "partly explained" otherwise.

    The rest follows from the verdict:

    * Without a gap, `closed` and its interval are None, there are no causes, and unknown is 0.
    * Unknown is below `EVEN` if the gap is explained, at most `EVEN` if it is partly explained, and at least `EVEN` if
      it is unexplained.
    * No cause is more probable than 1 - unknown, and no cause that isn't sound is more probable than `EVEN`. If no
      effect is accepted, unknown is at most 1 less the probability of the nearest effect.
    * An interval of `closed` is given only with `closed`. With a gap, `closed` is None only if it cannot be measured on
      held-out data; such a gap is never explained.
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
    """Return the verdict on a gap, by the rules of `judge` except for the remainder."""
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
    """Return in words why the gap is not explained, or that it is."""
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
        reasons.append("the remaining differences still matter")
    if max(cause.probability for cause in causes) < EVEN:
        reasons.append("the cause remains open: none has a probability of one half or more")
    if unknown >= EVEN:
        reasons.append("something outside the library has a probability of at least one half")
    return "; ".join(reasons[:_MOST_REASONS]) or "the causes close the gap, except what their approximate models leave"


def _limit(cause: Cause, unknown: float, unlikely: Collection[str]) -> float:
    """Return the largest probability that a cause may have."""
    return 1 - unknown if _is_sound(cause, unlikely) else min(1 - unknown, EVEN)


def _is_sound(cause: Cause, unlikely: Collection[str]) -> bool:
    """Return whether, with the causes in the model, the recordings of all sensors of a cause (without names: of all
    sensors) are likely.
    """
    return not set(unlikely) & set(cause.sensors) if cause.sensors else not unlikely


def unknown_probability(closed: float | None, after: Assessment, one_sided: float = 0.0) -> float:
    """Return the probability that something outside the library is present.

    It increases with the share of the gap that the causes leave open, and with the ratio by which the remainder exceeds
    the largest chance value in one place or with one sign (`one_sided`, `imuarray.gap.inference.assessment`).
    """
    share = closed if closed is not None else (1.0 if after.p > DOUBT else 0.0)
    largest = float(largest_of(after.normal))
    beyond = math.log(max(largest / max(after.limit, 1.0), one_sided, 0.1))
    return 1 / (1 + math.exp(min(max(_STEEP * (share - _HALF) - beyond, -50.0), 50.0)))


def calibrated_probability(share: float, all_closed: float | None, rates: Rates = RATES) -> float:
    """Return the probability of a cause with this `share` among its rivals and the share of their sensors' gap that all
    causes close (None: nothing to close), before the remainder is considered (`judge`).
    """
    closed = min(max(all_closed or 0.0, 0.0), 1.0)
    right = rates.least + (rates.most - rates.least) * math.pow(closed, rates.steep)
    return right * _temper(share, rates.rivals)


def _temper(share: float, power: float) -> float:
    """Return a probability with its odds raised to this power."""
    share = min(max(share, _SURE), 1 - _SURE)
    return 1 / (1 + math.exp(-power * math.log(share / (1 - share))))


_MOST_CAUSES = 4
_MOST_PLACES = 3
_MOST_PULLS = 3


def sentence_of(
    judgement: Judgement,
    where: Sequence[Where],
    unexplained: Sequence[Where],
    uses: Sequence[Use],
    pulls: Sequence[Pull] = (),
    against: Sequence[str] = (),
) -> str:
    """Return a paragraph that states what differs, why, how much of the gap is closed, and which parts are out of
    specification; `against` names the earlier recordings of a comparison.
    """
    causes = judgement.causes
    other = ", ".join(against) or "the simulator"
    if judgement.verdict == "no gap":
        agreement = "nothing has changed beyond chance" if against else "no statistic is beyond chance"
        return " ".join([f"The recordings agree with {other}: {agreement}.", *_out_of_specification(pulls)])
    parts = [
        f"The recordings differ from {other}, most in the {domain_text(where[0].domain)} of {place_text(where[0])}."
    ]
    if judgement.verdict == "unexplained":
        parts += [_unexplained(unexplained or where), *_nearest(causes, unexplained or where)]
    else:
        likely = [cause for cause in causes if cause.probability >= EVEN] or list(causes[:1])
        parts += [f"{_named(cause)}." for cause in likely[:_MOST_CAUSES]]
        parts += _closure(judgement, likely)
    parts += [f"{text}." for text in [use_text(uses, causes)] if text]
    if judgement.verdict == "partly explained" and unexplained:
        remaining = unexplained[0]
        at = f" in {remaining.phase}" if remaining.phase else ""
        parts.append(f"Not explained: {readable_statistic(remaining).about}, {place_text(remaining)}{at}.")
    return " ".join([*parts, *_out_of_specification(pulls)])


def with_limits(sentence: str, verdict: Verdict, unshown: Sequence[Unobservable]) -> str:
    """Return the paragraph of `sentence_of` with what the recordings cannot show, if they have no gap."""
    limits = limits_text(verdict, unshown)
    return f"{sentence} {limits[0].upper()}{limits[1:]}." if limits else sentence


def _named(cause: Cause) -> str:
    about = [meaning(cause.effect), parameters_text(cause.parameters)] if cause.parameters else []
    words = f" ({': '.join(about)})" if about else ""
    confusable = f"; it may also be {' or '.join(cause.confusable_with)}" if cause.confusable_with else ""
    return f"{places_text(cause)}: {effect_text(cause)}{words}, probability {share(cause.probability)}{confusable}"


def _closure(judgement: Judgement, likely: Sequence[Cause]) -> list[str]:
    """Return how much of the gap all causes in the model close; these may be more than those that are named."""
    gap, in_model = judgement.gap, [cause for cause in judgement.causes if cause.is_in_model]
    if gap.closed is None or not in_model:
        return []
    names = ("it" if len(in_model) == 1 else "them") if in_model == [*likely] else "all accepted causes"
    data = "the data that showed it" if needs_both_parts(in_model) else "held-out data"
    return [f"With {names} {closed_text(gap.closed, gap.closed_ci95)} of the gap is closed on {data}."]


def _unexplained(where: Sequence[Where]) -> str:
    """Return a sentence on something outside the library: the places that show it, each axis and domain once."""
    places: dict[tuple[str, str, str], Where] = {}
    for entry in where:  # worst first
        places.setdefault((entry.sensor, entry.axis, entry.domain), entry)
    looks = [
        f"the {domain_text(entry.domain)} of {place_text(entry)} ({readable_statistic(entry).about}: "
        f"{off_text(entry.significance, 'standard deviations')}{_in(entry)})"
        for entry in list(places.values())[:_MOST_PLACES]
    ]
    return f"Unexplained: something outside the library. It shows in {'; '.join(looks)}."


def _in(entry: Where) -> str:
    at = " of ".join(filter(None, (entry.phase, entry.log)))
    return f" in {at}" if at else ""


def _nearest(causes: Sequence[Cause], where: Sequence[Where]) -> list[str]:
    """Return a sentence on the most probable cause of an unexplained gap. It is called the nearest one only if it is in
    a sensor that differs most.
    """
    if not causes:
        return []
    is_near = not causes[0].sensors or where[0].sensor in causes[0].sensors
    elsewhere = f"a possible cause of differences elsewhere than in {place_text(where[0])} is"
    start = "the nearest is" if is_near else elsewhere
    return [f"No known effect makes these recordings likely; {start} {_named(causes[0])}."]


def _out_of_specification(pulls: Sequence[Pull]) -> list[str]:
    """Return sentences on the parts that are out of specification, and on quantities that a cause may explain."""
    outside = unexplained_pulls(pulls)
    texts = [f"{specification_text(pull)}: this part is out of specification." for pull in outside[:_MOST_PULLS]]
    more = len(outside) - _MOST_PULLS
    texts += [f"{more} more quantities are out of specification."] if more > 1 else []
    texts += ["1 more quantity is out of specification."] if more == 1 else []
    return [*texts, *(f"{text}." for text in [explained_pulls_text(pulls)] if text)]
