"""Figures of causes: the right cause first, within its class, at the right sensor; pairs; removals; unknown effects."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from itertools import permutations
from math import isclose, isfinite
from typing import Any, NamedTuple

import numpy as np

from imuarray.validation.rates import RateEstimate, auroc, bootstrap, limit_of, permute_labels, rate
from imuarray.validation.score_answers import NO_GAP, NOTHING_NAMED, ActiveMechanism, Answer, meets
from imuarray.validation.score_detection import Hidden, shown_singles
from imuarray.validation.score_rows import NO_BAR, Bar, Breakdown, ScoreRow, make_row, on_plan, rate_row, severity_name

FIRST: Bar = (0.90, None)
FIRST_LARGE, IN_CLASS, PLACE = (0.97, None), (0.97, None), (0.98, None)
UNKNOWN, FALSE_UNKNOWN = (0.90, None), (None, 0.10)
APART, TOGETHER, REMOVED = (0.75, None), (0.55, None), (0.90, None)
LARGE = 5.0
"""Detection limits from which on a mechanism is easy, and at which a known one must not be called unknown."""

_OPEN = ("unexplained", "partly explained")
_SURE = 3.0
"""Standard deviations beyond chance."""


class Confusion(NamedTuple):
    """Active mechanisms (rows) against the first reported cause (columns), `counts` (rows, columns) of cases; `right`
    says which columns are names of a row's mechanism.
    """

    truths: tuple[str, ...]
    said: tuple[str, ...]
    counts: tuple[tuple[int, ...], ...]
    right: tuple[tuple[bool, ...], ...]


def cause_rows(
    answers: Sequence[Answer], hidden: Hidden, full: str, sensors: Collection[str], seed: int
) -> Iterator[ScoreRow]:
    """Yield the figures of detected single mechanisms, unknown mechanisms, pairs and removals, and the control."""
    singles = [answer for answer in shown_singles(answers, hidden) if answer.is_detected()]
    yield from _first_rows(singles, full)
    right = [answer for answer in singles if answer.is_first_right()]
    placed = sensors or {sensor for answer in answers for work in answer.active for sensor in work.sensors}
    about = "of right first causes: sensors (those of all likely causes of that name) and axes are the truth's"

    def is_right(answer: Answer) -> bool:
        return is_place_right(answer, set(answer.case.chips) or placed)

    yield rate_row("right sensor and axis", right, is_right, PLACE, about, Breakdown(full))
    yield from _unknown_rows(answers, singles, full, seed)
    yield from _pair_rows([answer for answer in answers if answer.case.kind == "pair"], full)
    removals = [answer for answer in answers if answer.case.kind == "removal"]
    about = "the model has an effect that the sensors lack: a likely cause removes or replaces it"
    yield rate_row("removed base effect named", removals, is_removed, REMOVED, about, Breakdown(full))
    yield _control(on_plan(singles, full), seed)


def is_in_class(answer: Answer) -> bool:
    """Return whether the first cause, or an effect that it is reported to be confusable with, has a right name."""
    first = answer.first
    if first is None or _takes_out(answer):
        return False
    names = {first["effect"], *first.get("confusable_with", ())}
    return any(names & mechanism.resembles for mechanism in answer.active)


def is_place_right(answer: Answer, sensors: Collection[str]) -> bool:
    """Return whether the likely causes of the right name, including the first cause, affect exactly those of `sensors`
    that the truth names, and its axes if it names any.
    """
    first, (work, *_) = answer.first, answer.active
    if first is None:
        return False
    causes = [first, *(cause for cause in answer.named if cause is not first and work.is_named_by(cause))]
    reported = {sensor for cause in causes for sensor in cause.get("sensors") or sensors}
    axes = {axis for cause in causes for axis in cause.get("axes") or "xyz"}
    return reported & set(sensors) == work.sensors & set(sensors) and (not work.axes or axes == work.axes)


def are_both_named(answer: Answer) -> bool:
    """Return whether every mechanism has a likely cause of its name at its sensors. One cause serves two mechanisms
    only if they have a name in common.
    """
    works, causes = answer.active, answer.named
    if _share_a_name(works):
        return all(any(work.is_located_by(cause) for cause in causes) for work in works)
    return any(
        all(work.is_located_by(cause) for work, cause in zip(works, chosen, strict=True))
        for chosen in permutations(causes, len(works))
    )


def is_removed(answer: Answer) -> bool:
    """Return whether a likely cause removes or replaces the model's extra effect at its sensor."""
    effects, sensors = extra_of(answer.case.extra, answer.case.resembles)
    return any(
        cause["effect"] in effects and cause.get("action") != "add" and meets(sensors, cause.get("sensors", ()))
        for cause in answer.named
    )


def extra_of(extra: Mapping[str, Any], resembles: Sequence[Sequence[str]] = ()) -> tuple[set[str], set[str]]:
    """Return the names and sensors of a model's extra effect: its "effect", otherwise its tables, otherwise the names
    that it resembles.
    """
    named = (
        {str(extra["effect"])}
        if "effect" in extra
        else {key for key, value in extra.items() if isinstance(value, Mapping)}
    )
    sensors = extra.get("sensors", extra.get("sensor", extra.get("name", ())))
    named = named or {name for names in resembles for name in names}
    return named, {sensors} if isinstance(sensors, str) else set(sensors)


def confusion_of(answers: Sequence[Answer], full: str) -> Confusion:
    """Return the confusion matrix of the cases of at most one mechanism on the full plan. Names are in the order of the
    mechanisms, so that correct answers are near the diagonal.
    """
    counted = [answer for answer in on_plan(answers, full) if len(answer.active) < 2 and answer.case.kind != "removal"]
    rows: dict[str, list[Answer]] = {}
    for answer in sorted(counted, key=_row_order):
        rows.setdefault(_row_name(answer), []).append(answer)
    names = {
        name: sorted({effect for answer in own for work in answer.active for effect in work.resembles})
        for name, own in rows.items()
    }
    said = {answer.said for answer in counted} - {NO_GAP, NOTHING_NAMED}
    ordered = dict.fromkeys(effect for effects in names.values() for effect in effects if effect in said)
    columns = (*ordered, *sorted(said - set(ordered)), NOTHING_NAMED, NO_GAP)
    counts = tuple(tuple(sum(answer.said == column for answer in own) for column in columns) for own in rows.values())
    right = tuple(tuple(_is_right_column(own, column) for column in columns) for own in rows.values())
    return Confusion(tuple(rows), columns, counts, right)


def _first_rows(singles: Sequence[Answer], full: str) -> Iterator[ScoreRow]:
    about = "single mechanisms that were detected: the most probable cause has a right name"
    yield rate_row("right cause first", singles, Answer.is_first_right, FIRST, about, Breakdown(full))
    large = [answer for answer in singles if answer.limits >= LARGE]
    yield rate_row("right cause first, 5x and above", large, Answer.is_first_right, FIRST_LARGE, about, Breakdown(full))
    about = "as above, or an effect of its stated class of confusable effects"
    yield rate_row("right within the reported class", singles, is_in_class, IN_CLASS, about, Breakdown(full))


def _unknown_rows(answers: Sequence[Answer], singles: Sequence[Answer], full: str, seed: int) -> Iterator[ScoreRow]:
    strangers = [answer for answer in answers if answer.case.kind in ("unnamed", "withheld") and answer.is_detected()]
    groups = ("kind", "severity", "mechanism")
    about = "detected mechanisms that no name of the library fits: the verdict"
    yield rate_row("unknown called unexplained or partly", strangers, _is_open, UNKNOWN, about, Breakdown(full, groups))
    known = [answer for answer in singles if isclose(answer.limits, LARGE)]
    about = f"detected single mechanisms at {severity_name(LARGE)} that the library names: the verdict"
    yield rate_row("known at 5x called unexplained", known, _is_unexplained, FALSE_UNKNOWN, about, Breakdown(full))
    yield rate_row("known at 5x called unexplained or partly", known, _is_open, NO_BAR, about, Breakdown(full))
    yield from _unknown_scores(on_plan(strangers, full), known, singles, full, seed)


def _unknown_scores(
    strangers: Sequence[Answer], known: Sequence[Answer], singles: Sequence[Answer], full: str, seed: int
) -> Iterator[ScoreRow]:
    """Yield the figures of the stated probability that an unknown effect is present."""
    above = [answer.unknown for answer in strangers]
    at_large = [answer.unknown for answer in on_plan(known, full)]
    detected = sum(value > limit_of(at_large, 0.1) for value in above) if at_large else 0
    about = (
        "detected unknown ones whose probability of being unknown is above the limit that 10 % of the known at 5x pass"
    )
    yield make_row(
        "unknown at 5x recognised, 10 % false ones", rate(detected, len(above) if at_large else 0), UNKNOWN, about
    )
    every = [answer.unknown for answer in on_plan(singles, full)]
    about = "the chance that an unknown one has the greater probability of being unknown than a known one at 5x"
    area = bootstrap(auroc, above, at_large, seed=seed)
    cell = make_row(
        "against known ones of every size", bootstrap(auroc, above, every, seed=seed), NO_BAR, "", group="severity"
    )
    yield make_row("unknown against known at 5x, AUROC", area, UNKNOWN, about, [cell])


def _pair_rows(pairs: Sequence[Answer], full: str) -> Iterator[ScoreRow]:
    for name, is_apart, bar in (("on different units", True, APART), ("on one sensor", False, TOGETHER)):
        own = [answer for answer in pairs if _are_apart(answer.active) == is_apart]
        about = "every mechanism has a likely cause (probability 0.5) of a right name at one of its sensors"
        yield rate_row(f"two {name}, both named", own, are_both_named, bar, about, Breakdown(full))


def _control(singles: Sequence[Answer], seed: int) -> ScoreRow:
    """Permute the labels of the cases: no more of them may be right than by chance."""
    labels = [frozenset(effect for work in answer.active for effect in work.resembles) for answer in singles]
    effects = {
        label: np.array([answer.said in label and not _takes_out(answer) for answer in singles])
        for label in set(labels)
    }
    hits = np.stack([effects[label] for label in labels], axis=1) if labels else np.zeros((0, 0), bool)
    chance = permute_labels(hits, seed)
    share: RateEstimate = rate(chance.hits, len(singles))
    bar = (None, chance.mean + _SURE * chance.deviation) if isfinite(chance.mean) else (None, 0.5)
    about = "a control of the scoring: labels of cases permuted once"
    if isfinite(chance.mean):
        about += f", which gives {chance.mean:.3f} on average"
    return make_row("right cause first, labels shuffled", share, bar, about)


def _takes_out(answer: Answer) -> bool:
    return answer.first is not None and answer.first.get("action") == "remove"


def _is_open(answer: Answer) -> bool:
    return answer.verdict in _OPEN


def _is_unexplained(answer: Answer) -> bool:
    return answer.verdict == "unexplained"


def _are_apart(works: Sequence[ActiveMechanism]) -> bool:
    """Return whether no sensor has two of the mechanisms."""
    every = [sensor for work in works for sensor in work.sensors]
    return len(every) == len(set(every))


def _share_a_name(works: Sequence[ActiveMechanism]) -> bool:
    every = [effect for work in works for effect in work.resembles]
    return len(every) > len(set(every))


def _row_order(answer: Answer) -> tuple[int, list[str], str]:
    rank = {"none": 3, "unnamed": 2, "withheld": 1}.get(answer.case.kind, 0)
    return rank, sorted(effect for work in answer.active for effect in work.resembles), answer.mechanisms


def _row_name(answer: Answer) -> str:
    if not answer.active:
        return "nothing wrong"
    return f"{answer.mechanisms} (withheld)" if answer.case.kind == "withheld" else answer.mechanisms


def _is_right_column(answers: Sequence[Answer], column: str) -> bool:
    """Return whether this column is correct for the mechanism: a name, no gap, or no name."""
    first = answers[0]
    if not first.active:
        return column == NO_GAP
    if first.case.kind != "single":
        return column == NOTHING_NAMED
    return any(column in work.resembles for answer in answers for work in answer.active)
