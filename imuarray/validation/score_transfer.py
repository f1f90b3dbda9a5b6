"""Transfer of figures: to other worlds, and between the cases with a chip or an experiment and all others."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import isclose, nan
from typing import NamedTuple

from imuarray.validation.score_answers import Answer
from imuarray.validation.score_causes import LARGE, is_in_class
from imuarray.validation.score_detection import Hidden, shown_singles
from imuarray.validation.score_rows import Row, group_answers

LEAST_CASES = 5
"""Minimum number of cases of a part for a figure."""


@dataclass(frozen=True)
class Transfer:
    """A figure and its row in each world, first the world on which the diagnosis was developed."""

    name: str
    rows: Mapping[str, Row]

    @property
    def lost(self) -> float:
        """The loss in the worst of the other worlds: how much lower, or higher if the bar is an upper bound."""
        home, *others = self.rows.values()
        is_most = home.bar[0] is None and home.bar[1] is not None
        if None not in home.bar:  # a rate that is to be met from both sides
            return max(abs(row.value - home.value) for row in others)
        return max((row.value - home.value) * (1 if is_most else -1) for row in others)


class LeftOut(NamedTuple):
    """A figure on the cases with a chip or an experiment and on all others; `cases` counts those with it."""

    part: str
    figure: str
    value: float
    others: float
    cases: int


def left_out_of(answers: Sequence[Answer], hidden: Hidden) -> tuple[LeftOut, ...]:
    """Return false alarms, detection and causes with and without each chip and each experiment. For probabilities
    fitted to the cases without it see `imuarray.validation.calibration`.
    """
    return tuple(_left_out(answers, hidden))


def _left_out(answers: Sequence[Answer], hidden: Hidden) -> Iterator[LeftOut]:
    shown = shown_singles(answers, hidden)
    detected = [answer for answer in shown if answer.is_detected]
    figures: Mapping[str, tuple[Sequence[Answer], Callable[[Answer], bool]]] = {
        "detection at 5x the limit": ([answer for answer in shown if isclose(answer.limits, LARGE)], _is_detected),
        "right cause first": (detected, Answer.is_first_right),
        "right within the reported class": (detected, is_in_class),
        "without a false alarm": ([answer for answer in answers if answer.case.kind == "none"], _is_silent),
    }
    for group in ("chip", "experiment"):
        for part in group_answers(group, answers):
            for name, (counted, is_hit) in figures.items():
                own, others = _split(counted, group, part)
                if min(len(own), len(others)) >= LEAST_CASES:
                    yield LeftOut(f"{group} {part}", name, _share(own, is_hit), _share(others, is_hit), len(own))


def _split(answers: Sequence[Answer], group: str, part: str) -> tuple[list[Answer], list[Answer]]:
    """Return the answers with the part, and those without."""
    own = group_answers(group, answers).get(part, ())
    names = {answer.case.name for answer in own}
    return list(own), [answer for answer in answers if answer.case.name not in names]


def _share(answers: Sequence[Answer], is_hit: Callable[[Answer], bool]) -> float:
    return sum(map(is_hit, answers)) / len(answers) if answers else nan


def _is_detected(answer: Answer) -> bool:
    return answer.is_detected


def _is_silent(answer: Answer) -> bool:
    return not answer.is_false_alarm
