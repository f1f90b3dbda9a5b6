"""What figures are worth elsewhere: in another world; on the cases with a chip or an experiment against all others."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import isclose, nan
from typing import NamedTuple

from imuarray.validation.score_answers import Answer
from imuarray.validation.score_causes import LARGE, is_in_class
from imuarray.validation.score_detection import Hidden, shown_singles
from imuarray.validation.score_rows import Row, grouped

LEAST_CASES = 5
"""Of a part, below which nothing is said of it."""


@dataclass(frozen=True)
class Transfer:
    """A figure, and its row in each world, that of the world on which the diagnosis was developed first."""

    name: str
    rows: Mapping[str, Row]

    @property
    def lost(self) -> float:
        """How much worse it is in the worst of the other worlds: less, or more where a bar is a most."""
        home, *others = self.rows.values()
        is_most = home.bar[0] is None and home.bar[1] is not None
        if None not in home.bar:  # a rate that is to be met from both sides
            return max(abs(one.value - home.value) for one in others)
        return max((one.value - home.value) * (1 if is_most else -1) for one in others)


class LeftOut(NamedTuple):
    """A figure on the cases with a chip or an experiment, and on all others; `cases` are those with it."""

    part: str
    figure: str
    value: float
    others: float
    cases: int


def left_out_of(answers: Sequence[Answer], hidden: Hidden) -> tuple[LeftOut, ...]:
    """Of each chip and each experiment: false alarms, detection and causes. Probabilities that were fitted to the cases
    without it: `imuarray.validation.calibration`.
    """
    return tuple(_left_out(answers, hidden))


def _left_out(answers: Sequence[Answer], hidden: Hidden) -> Iterator[LeftOut]:
    shown = shown_singles(answers, hidden)
    detected = [one for one in shown if one.is_detected]
    figures: Mapping[str, tuple[Sequence[Answer], Callable[[Answer], bool]]] = {
        "detection at 5x the limit": ([one for one in shown if isclose(one.limits, LARGE)], _is_detected),
        "right cause first": (detected, Answer.is_first_right),
        "right within the reported class": (detected, is_in_class),
        "without a false alarm": ([one for one in answers if one.case.kind == "none"], _is_silent),
    }
    for group in ("chip", "experiment"):
        for part in grouped(group, answers):
            for name, (counted, is_hit) in figures.items():
                own, others = _split(counted, group, part)
                if min(len(own), len(others)) >= LEAST_CASES:
                    yield LeftOut(f"{group} {part}", name, _share(own, is_hit), _share(others, is_hit), len(own))


def _split(answers: Sequence[Answer], group: str, part: str) -> tuple[list[Answer], list[Answer]]:
    """Those with it, and those without."""
    own = grouped(group, answers).get(part, ())
    names = {one.case.name for one in own}
    return list(own), [one for one in answers if one.case.name not in names]


def _share(answers: Sequence[Answer], is_hit: Callable[[Answer], bool]) -> float:
    return sum(map(is_hit, answers)) / len(answers) if answers else nan


def _is_detected(answer: Answer) -> bool:
    return answer.is_detected


def _is_silent(answer: Answer) -> bool:
    return not answer.is_false_alarm
