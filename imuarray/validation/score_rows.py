"""Rows of the score: a figure with its interval, its bar, and its cells."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from math import isfinite
from typing import Any

from imuarray.validation.rates import RateEstimate, rate
from imuarray.validation.score_answers import Answer

Bar = tuple[float | None, float | None]
"""Least and greatest value allowed; None: no bound."""

NO_BAR: Bar = (None, None)
FULL = "full"
"""The plan on which bars are judged by default."""
EVERY = ""
"""Stands for all plans, on which the bars of random worlds are judged."""

_ROUNDING = 1e-9


@dataclass(frozen=True)
class ScoreRow:
    """A figure: `value` with its 95 % interval over `cases`; `about` says what is counted. `cells` are the same figure
    for parts of the cases; `group` says which parts ("plan", "severity", "mechanism", ...).
    """

    name: str
    value: float
    low: float
    high: float
    cases: int
    bar: Bar = NO_BAR
    about: str = ""
    cells: tuple[ScoreRow, ...] = ()
    group: str = ""

    @property
    def passes(self) -> bool | None:
        """True if the value is within the bar; None without cases or without a bar."""
        if self.bar == NO_BAR or not isfinite(self.value):
            return None
        return _within(self.value, self.value, self.bar)

    @property
    def is_refuted(self) -> bool:
        """True if the whole interval is outside the bar, so that the miss is more than chance."""
        return self.passes is False and isfinite(self.low) and not _within(self.high, self.low, self.bar)

    @property
    def mark(self) -> str:
        """ "ok", "FAIL", "n.a." without cases, "" without a bar."""
        if self.bar == NO_BAR:
            return ""
        return {True: "ok", False: "FAIL", None: "n.a."}[self.passes]

    def failing(self) -> tuple[ScoreRow, ...]:
        """Return the cells that miss their bar, the most certain first."""
        failed = [cell for cell in self.cells if cell.passes is False]
        return tuple(sorted(failed, key=lambda cell: (not cell.is_refuted, -cell.cases)))

    def as_json(self) -> dict[str, Any]:
        """Return the row as a table."""
        return {
            "name": self.name,
            **({"group": self.group} if self.group else {"about": self.about}),
            "value": self.value,
            "low": self.low,
            "high": self.high,
            "cases": self.cases,
            "bar": list(self.bar),
            "passes": self.passes,
            "refuted": self.is_refuted,
            **({} if self.group else {"cells": [cell.as_json() for cell in self.cells]}),
        }


def rate_of(answers: Sequence[Answer], is_hit: Callable[[Answer], bool]) -> RateEstimate:
    """Return the share of the answers that are hits."""
    return rate(sum(map(is_hit, answers)), len(answers))


def make_row(
    name: str, estimate: RateEstimate, bar: Bar, about: str, cells: Iterable[ScoreRow] = (), group: str = ""
) -> ScoreRow:
    """Return the row of an estimate."""
    return ScoreRow(name, *estimate, bar, about, tuple(cells), group)


@dataclass(frozen=True)
class Breakdown:
    """The plan on which bars are judged ("": every plan), and the groups of the cells that have the row's bar."""

    full: str = FULL
    groups: Sequence[str] = ("severity", "mechanism")


def rate_row(
    name: str,
    answers: Sequence[Answer],
    is_hit: Callable[[Answer], bool],
    bar: Bar,
    about: str,
    breakdown: Breakdown,
) -> ScoreRow:
    """Return the share of hits on the full plan with cells by plan; if bars are judged on every plan, with cells by
    experiment and by chip. The cells by the breakdown's groups cover the counted cases and have the same bar.
    """
    full = breakdown.full
    counted = on_plan(answers, full)
    parts = ("plan",) if full else ("experiment", "chip")
    cells = [cell for group in parts for cell in cells_of(group, answers, is_hit, NO_BAR)]
    for group in breakdown.groups:
        cells += cells_of(group, counted, is_hit, bar)
    return make_row(name, rate_of(counted, is_hit), bar, about, cells)


def on_plan(answers: Iterable[Answer], full: str) -> list[Answer]:
    """Return the answers of the plan on which bars are judged."""
    return [answer for answer in answers if full in (EVERY, answer.case.plan)]


def group_answers(group: str, answers: Iterable[Answer]) -> Mapping[str, Sequence[Answer]]:
    """Group answers by plan, severity, mechanism or kind, or by experiment, chip or stratum, of which a case may have
    several. Severities are in ascending order, the others by name.
    """
    groups: dict[str, list[Answer]] = {}
    for answer in sorted(answers, key=_by_limits if group == "severity" else _GROUPS[group]):
        for name in _GROUPS[group](answer):
            groups.setdefault(name, []).append(answer)
    return dict(sorted(groups.items())) if group in ("experiment", "chip", "stratum") else groups


def severity_name(limits: float) -> str:
    """Return the name of a severity: "2x the limit", or "there or not"."""
    return f"{limits:g}x the limit" if isfinite(limits) else "there or not"


_GROUPS: Mapping[str, Callable[[Answer], tuple[str, ...]]] = {
    "plan": lambda answer: (answer.case.plan,),
    "severity": lambda answer: (severity_name(answer.limits),),
    "mechanism": lambda answer: (answer.mechanisms,),
    "kind": lambda answer: (answer.case.kind,),
    "experiment": lambda answer: answer.experiments,
    "chip": lambda answer: answer.chips,
    "stratum": lambda answer: tuple(f"{name} {value}" for name, value in answer.case.strata.items()),
}


def cells_of(group: str, answers: Sequence[Answer], is_hit: Callable[[Answer], bool], bar: Bar) -> Iterable[ScoreRow]:
    """Yield the share of hits in each part."""
    parts = group_answers(group, answers)
    for name, own in parts.items() if len(parts) > 1 or group == "plan" else ():
        yield make_row(name, rate_of(own, is_hit), bar, "", group=group)


def _by_limits(answer: Answer) -> float:
    return answer.limits if isfinite(answer.limits) else float("inf")


def _within(value: float, other: float, bar: Bar) -> bool:
    """Return whether `value` reaches the lower end and `other` does not exceed the upper one."""
    low, high = bar
    return (low is None or value >= low - _ROUNDING) and (high is None or other <= high + _ROUNDING)
