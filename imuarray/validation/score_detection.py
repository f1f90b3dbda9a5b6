"""Figures of detection: false alarms, detection by severity, and effects that cannot be determined."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from math import isclose
from typing import NamedTuple

from imuarray.validation.rates import RateEstimate
from imuarray.validation.score_answers import Answer, meets
from imuarray.validation.score_rows import (
    EVERY,
    NO_BAR,
    Bar,
    Breakdown,
    ScoreRow,
    cells_of,
    group_answers,
    make_row,
    on_plan,
    rate_of,
    rate_row,
    severity_name,
)

FALSE_ALARMS: Bar = (0.035, 0.065)
"""Allowed range of a nominal 5 %."""
DETECTION: Mapping[float, Bar] = {2.0: (0.80, None), 5.0: (0.98, None)}
"""Bars by detection limits."""

Hidden = Mapping[str, Collection[str]]
"""The effects that a plan cannot show, by plan."""


class DetectionCurve(NamedTuple):
    """Detection on one plan ("all": on all of them): (limits, share) in ascending order, of mechanisms with a size."""

    plan: str
    points: tuple[tuple[float, RateEstimate], ...]


class Power(NamedTuple):
    """Detected and all cases (hits, cases) by mechanism (rows) and severity (columns), on the full plan."""

    mechanisms: tuple[str, ...]
    severities: tuple[str, ...]
    counts: tuple[tuple[tuple[int, int], ...], ...]


def detection_rows(answers: Sequence[Answer], hidden: Hidden, full: str) -> Iterator[ScoreRow]:
    """Yield false alarms by plan, detection at 2 and 5 limits, and the reporting of effects that a plan cannot show."""
    yield from _false_alarms([answer for answer in answers if answer.case.kind == "none"], full)
    shown = shown_singles(answers, hidden)
    for limits, bar in DETECTION.items():
        own = [answer for answer in shown if isclose(answer.limits, limits)]
        about = "single mechanisms: a gap is reported; those that a plan can't show are judged below"
        yield rate_row(
            f"detection at {severity_name(limits)}",
            own,
            Answer.is_detected,
            bar,
            about,
            Breakdown(full, ("mechanism",)),
        )
    yield _undetermined_row([answer for answer in answers if is_hidden(answer, hidden)])


def is_hidden(answer: Answer, hidden: Hidden) -> bool:
    """Return whether the plan cannot show a single mechanism under any of its names."""
    effects = set(hidden.get(answer.case.plan, ()))
    is_of_plan = all(mechanism.resembles and mechanism.resembles <= effects for mechanism in answer.active)
    return answer.case.kind == "single" and (answer.case.is_hidden or is_of_plan)


def shown_singles(answers: Sequence[Answer], hidden: Hidden) -> list[Answer]:
    """Return the single mechanisms that the plan can show."""
    return [answer for answer in answers if answer.case.kind == "single" and not is_hidden(answer, hidden)]


def is_reported_undetermined(answer: Answer) -> bool:
    """Return whether the diagnosis reports that it cannot determine the active mechanism, and what to record."""
    return all(
        any(
            entry["effect"] in mechanism.resembles
            and entry.get("record")
            and meets(mechanism.sensors, entry.get("sensors", ()))
            for entry in answer.undetermined
        )
        for mechanism in answer.active
    )


def curves_of(answers: Sequence[Answer], hidden: Hidden) -> tuple[DetectionCurve, ...]:
    """Return the detection curves of all plans together and of each; for random worlds by experiment."""
    find_severity = [answer for answer in shown_singles(answers, hidden) if answer.limits == answer.limits]
    parts = group_answers("experiment" if any(answer.case.world for answer in find_severity) else "plan", find_severity)
    return tuple(
        DetectionCurve(
            plan,
            tuple(
                (own[0].limits, rate_of(own, Answer.is_detected)) for own in group_answers("severity", part).values()
            ),
        )
        for plan, part in {"all": find_severity, **parts}.items()
        if part
    )


def power_of(answers: Sequence[Answer], full: str) -> Power:
    """Count the detected single mechanisms on the full plan."""
    counted = [answer for answer in on_plan(answers, full) if answer.case.kind == "single"]
    severities, mechanisms = tuple(group_answers("severity", counted)), group_answers("mechanism", counted)
    counts = []
    for own in mechanisms.values():
        by_severity = group_answers("severity", own)
        parts = [by_severity.get(name, ()) for name in severities]
        counts.append(tuple((sum(map(Answer.is_detected, part)), len(part)) for part in parts))
    return Power(tuple(mechanisms), severities, tuple(counts))


def _false_alarms(controls: Sequence[Answer], full: str) -> Iterator[ScoreRow]:
    about = "no fault, but a gap is reported (nominally 5 %)"
    if full == EVERY and controls:
        parts = ("experiment", "chip", "stratum")
        cells = [cell for group in parts for cell in cells_of(group, controls, Answer.is_false_alarm, NO_BAR)]
        yield make_row("false alarms", rate_of(controls, Answer.is_false_alarm), FALSE_ALARMS, about, cells)
        return
    for plan, own in group_answers("plan", controls).items():
        yield make_row(f"false alarms, plan {plan}", rate_of(own, Answer.is_false_alarm), FALSE_ALARMS, about)
    if not controls:
        yield make_row("false alarms", rate_of(controls, Answer.is_false_alarm), FALSE_ALARMS, about)


def _undetermined_row(answers: Sequence[Answer]) -> ScoreRow:
    about = "the plan can't show the mechanism: the diagnosis says that it can't tell, and what to record"
    cells = [
        make_row(name, rate_of(own, is_reported_undetermined), (1.0, None), "", group=group)
        for group in ("plan", "mechanism")
        for name, own in group_answers(group, answers).items()
    ]
    return make_row(
        "effects that a plan can't show, reported so",
        rate_of(answers, is_reported_undetermined),
        (1.0, None),
        about,
        cells,
    )
