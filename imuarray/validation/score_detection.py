"""Is there a gap? False alarms, detection against severity, and what can't be told."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from math import isclose
from typing import NamedTuple

from imuarray.validation.rates import Estimate, rate
from imuarray.validation.score_answers import Answer, meets
from imuarray.validation.score_rows import (
    EVERY,
    NO_BAR,
    Bar,
    Row,
    cells_of,
    grouped,
    on_plan,
    rate_row,
    row_of,
    severity_name,
)

FALSE_ALARMS: Bar = (0.035, 0.065)
"""Of a nominal 5 %."""
DETECTION: Mapping[float, Bar] = {2.0: (0.80, None), 5.0: (0.98, None)}
"""By detection limits."""

Hidden = Mapping[str, Collection[str]]
"""By plan, the effects that it can't show."""


class Curve(NamedTuple):
    """Detection on one plan ("all": on all of them): (limits, share), the smallest first, of mechanisms that have a
    size.
    """

    plan: str
    points: tuple[tuple[float, Estimate], ...]


class Power(NamedTuple):
    """Detected and all cases (hits, cases) by mechanism (rows) and severity (columns), on the full plan."""

    mechanisms: tuple[str, ...]
    severities: tuple[str, ...]
    counts: tuple[tuple[tuple[int, int], ...], ...]


def detection_rows(answers: Sequence[Answer], hidden: Hidden, full: str) -> Iterator[Row]:
    """False alarms by plan, detection at 2 and 5 limits, and what can't be told."""
    yield from _false_alarms([one for one in answers if one.case.kind == "none"], full)
    shown = shown_singles(answers, hidden)
    for limits, bar in DETECTION.items():
        own = [one for one in shown if isclose(one.limits, limits)]
        about = "single mechanisms: a gap is told; those that a plan can't show are judged below"
        yield rate_row(f"detection at {severity_name(limits)}", own, _is_detected, bar, about, full, ("mechanism",))
    yield _untold([one for one in answers if is_hidden(one, hidden)])


def is_hidden(answer: Answer, hidden: Hidden) -> bool:
    """Whether the plan can't show a single mechanism, by none of its names."""
    effects = set(hidden.get(answer.case.plan, ()))
    is_of_plan = all(one.resembles and one.resembles <= effects for one in answer.at_work)
    return answer.case.kind == "single" and (answer.case.is_hidden or is_of_plan)


def shown_singles(answers: Sequence[Answer], hidden: Hidden) -> list[Answer]:
    """Single mechanisms that the plan can show."""
    return [one for one in answers if one.case.kind == "single" and not is_hidden(one, hidden)]


def is_told_untold(answer: Answer) -> bool:
    """Whether the diagnosis says that it can't tell what is at work, and what to record."""
    return all(
        any(
            told["effect"] in one.resembles and told.get("record") and meets(one.sensors, told.get("sensors", ()))
            for told in answer.untold
        )
        for one in answer.at_work
    )


def curves_of(answers: Sequence[Answer], hidden: Hidden) -> tuple[Curve, ...]:
    """Of all plans together, then of each; of those of random worlds by experiment."""
    sized = [one for one in shown_singles(answers, hidden) if one.limits == one.limits]
    parts = grouped("experiment" if any(one.case.world for one in sized) else "plan", sized)
    return tuple(
        Curve(plan, tuple((own[0].limits, _detected(own)) for own in grouped("severity", part).values()))
        for plan, part in {"all": sized, **parts}.items()
        if part
    )


def power_of(answers: Sequence[Answer], full: str) -> Power:
    """Single mechanisms on the full plan."""
    counted = [one for one in on_plan(answers, full) if one.case.kind == "single"]
    severities, mechanisms = tuple(grouped("severity", counted)), grouped("mechanism", counted)
    counts = []
    for own in mechanisms.values():
        by_severity = grouped("severity", own)
        parts = [by_severity.get(name, ()) for name in severities]
        counts.append(tuple((sum(map(_is_detected, part)), len(part)) for part in parts))
    return Power(tuple(mechanisms), severities, tuple(counts))


def _false_alarms(controls: Sequence[Answer], full: str) -> Iterator[Row]:
    about = "nothing is wrong, a gap is told all the same (nominally 5 %)"
    if full == EVERY and controls:
        parts = ("experiment", "chip", "stratum")
        cells = [cell for group in parts for cell in cells_of(group, controls, _is_false_alarm, NO_BAR)]
        yield row_of("false alarms", _alarmed(controls), FALSE_ALARMS, about, cells)
        return
    for plan, own in grouped("plan", controls).items():
        yield row_of(f"false alarms, plan {plan}", _alarmed(own), FALSE_ALARMS, about)
    if not controls:
        yield row_of("false alarms", _alarmed(controls), FALSE_ALARMS, about)


def _untold(answers: Sequence[Answer]) -> Row:
    about = "the plan can't show the mechanism: the diagnosis says that it can't tell, and what to record"
    cells = [
        row_of(name, _told(own), (1.0, None), "", group=group)
        for group in ("plan", "mechanism")
        for name, own in grouped(group, answers).items()
    ]
    return row_of("what a plan can't show is told", _told(answers), (1.0, None), about, cells)


def _told(answers: Sequence[Answer]) -> Estimate:
    return rate(sum(map(is_told_untold, answers)), len(answers))


def _detected(answers: Sequence[Answer]) -> Estimate:
    return rate(sum(map(_is_detected, answers)), len(answers))


def _alarmed(answers: Sequence[Answer]) -> Estimate:
    return rate(sum(map(_is_false_alarm, answers)), len(answers))


def _is_false_alarm(answer: Answer) -> bool:
    return answer.is_false_alarm


def _is_detected(answer: Answer) -> bool:
    return answer.is_detected
