"""The diagnosis in one paragraph of plain sentences."""

from __future__ import annotations

from collections.abc import Sequence

from imuarray.gap.findings.diagnosis import EVEN, Cause, Pull, Where, needs_both_parts
from imuarray.gap.findings.formatting import (
    closed_text,
    domain_text,
    effect_text,
    explained_pulls_text,
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
from imuarray.gap.findings.verdict import Judgement
from imuarray.gap.model.use import Use
from imuarray.simulate.effects import meaning

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
    """Return a paragraph that states what differs, why, how much of it is closed, and which parts are out of
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


def _named(cause: Cause) -> str:
    about = [meaning(cause.effect), parameters_text(cause.parameters)] if cause.parameters else []
    words = f" ({': '.join(about)})" if about else ""
    confusable = f"; it may also be {' or '.join(cause.confusable_with)}" if cause.confusable_with else ""
    return f"{places_text(cause)}: {effect_text(cause)}{words}, probability {share(cause.probability)}{confusable}"


def _closure(judgement: Judgement, likely: Sequence[Cause]) -> list[str]:
    """Return how much closes with all causes in the model, which may be more than those that are named."""
    gap, in_model = judgement.gap, [cause for cause in judgement.causes if cause.is_in_model]
    if gap.closed is None or not in_model:
        return []
    names = ("it" if len(in_model) == 1 else "them") if in_model == [*likely] else "all accepted causes"
    data = "the data that showed it" if needs_both_parts(in_model) else "held-out data"
    return [f"With {names} {closed_text(gap.closed, gap.closed_ci95)} of the gap is closed on {data}."]


def _unexplained(where: Sequence[Where]) -> str:
    """Describe something outside the library by the places in which it shows, each axis and domain once."""
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
    """Return the most probable cause of a gap that none explains. One of other sensors than those that differ most is
    not near it.
    """
    if not causes:
        return []
    is_near = not causes[0].sensors or where[0].sensor in causes[0].sensors
    start = "the nearest is" if is_near else f"of other differences than those of {place_text(where[0])} one may be"
    return [f"No known effect makes these recordings likely; {start} {_named(causes[0])}."]


def _out_of_specification(pulls: Sequence[Pull]) -> list[str]:
    """Return the parts that are out of specification, and quantities that only seem so because of a cause."""
    outside = unexplained_pulls(pulls)
    texts = [f"{specification_text(pull)}: this part is out of specification." for pull in outside[:_MOST_PULLS]]
    more = len(outside) - _MOST_PULLS
    texts += [f"{more} more quantities are out of specification."] if more > 1 else []
    texts += ["1 more quantity is out of specification."] if more == 1 else []
    return [*texts, *(f"{text}." for text in [explained_pulls_text(pulls)] if text)]
