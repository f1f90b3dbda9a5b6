"""Rows of the score: a figure with its interval and its bar, and the cells of which it is made."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from math import isfinite
from typing import Any

from imuarray.validation.rates import Estimate, rate
from imuarray.validation.score_answers import Answer

Bar = tuple[float | None, float | None]
"""Least and greatest value allowed; None: no end."""

NO_BAR: Bar = (None, None)
FULL = "full"
"""The plan on which bars are judged, unless said otherwise."""
EVERY = ""
"""In its place: bars are judged on all plans, as of random worlds."""

_ROUNDING = 1e-9


@dataclass(frozen=True)
class Row:
    """A figure: `value` with its 95 % interval, of `cases`; `about` says what is counted. `cells` are the same figure
    of parts of the cases; `group` says of what parts ("plan", "severity", "mechanism", ...).
    """

    name: str
    value: float
    low: float
    high: float
    cases: int
    bar: Bar = NO_BAR
    about: str = ""
    cells: tuple[Row, ...] = ()
    group: str = ""

    @property
    def passes(self) -> bool | None:
        """Whether the value is within the bar; None if there are no cases, or no bar."""
        if self.bar == NO_BAR or not isfinite(self.value):
            return None
        return _within(self.value, self.value, self.bar)

    @property
    def is_refuted(self) -> bool:
        """Whether the whole interval is outside the bar: more than chance with so few cases."""
        return self.passes is False and isfinite(self.low) and not _within(self.high, self.low, self.bar)

    @property
    def mark(self) -> str:
        """ "ok", "FAIL", "n.a." without cases, "" without a bar."""
        if self.bar == NO_BAR:
            return ""
        return {True: "ok", False: "FAIL", None: "n.a."}[self.passes]

    def failing(self) -> tuple[Row, ...]:
        """The cells below their bar, the surest first."""
        failed = [cell for cell in self.cells if cell.passes is False]
        return tuple(sorted(failed, key=lambda cell: (not cell.is_refuted, -cell.cases)))

    def as_json(self) -> dict[str, Any]:
        """Numbers that aren't finite are null."""
        return {
            "name": self.name,
            **({"group": self.group} if self.group else {"about": self.about}),
            "value": finite(self.value),
            "low": finite(self.low),
            "high": finite(self.high),
            "cases": self.cases,
            "bar": list(self.bar),
            "passes": self.passes,
            "refuted": self.is_refuted,
            **({} if self.group else {"cells": [cell.as_json() for cell in self.cells]}),
        }


def row_of(name: str, found: Estimate, bar: Bar, about: str, cells: Iterable[Row] = (), group: str = "") -> Row:
    """A row of an estimate."""
    return Row(name, *found, bar, about, tuple(cells), group)


def rate_row(
    name: str,
    answers: Sequence[Answer],
    is_hit: Callable[[Answer], bool],
    bar: Bar,
    about: str,
    full: str = FULL,
    groups: Sequence[str] = ("severity", "mechanism"),
) -> Row:
    """The share of hits on the full plan, and by plan; on every plan, by experiment and by chip. Cells of what is
    counted, by what `groups` name, have its bar.
    """
    counted = on_plan(answers, full)
    parts = ("plan",) if full else ("experiment", "chip")
    cells = [cell for group in parts for cell in cells_of(group, answers, is_hit, NO_BAR)]
    for group in groups:
        cells += cells_of(group, counted, is_hit, bar)
    return row_of(name, _rate(counted, is_hit), bar, about, cells)


def on_plan(answers: Iterable[Answer], full: str) -> list[Answer]:
    """Those of the plan on which bars are judged."""
    return [one for one in answers if full in (EVERY, one.case.plan)]


def grouped(group: str, answers: Iterable[Answer]) -> Mapping[str, Sequence[Answer]]:
    """By plan, severity, mechanism or kind; by experiment, chip or stratum, of which a case may have several.
    Severities from the smallest on, the others by name.
    """
    found: dict[str, list[Answer]] = {}
    for one in sorted(answers, key=_by_limits if group == "severity" else _GROUPS[group]):
        for name in _GROUPS[group](one):
            found.setdefault(name, []).append(one)
    return dict(sorted(found.items())) if group in ("experiment", "chip", "stratum") else found


def severity_name(limits: float) -> str:
    """ "2x the limit", or "there or not"."""
    return f"{limits:g}x the limit" if isfinite(limits) else "there or not"


def finite(value: float) -> float | None:
    """As JSON has it."""
    return value if isfinite(value) else None


_GROUPS: Mapping[str, Callable[[Answer], tuple[str, ...]]] = {
    "plan": lambda one: (one.case.plan,),
    "severity": lambda one: (severity_name(one.limits),),
    "mechanism": lambda one: (one.mechanisms,),
    "kind": lambda one: (one.case.kind,),
    "experiment": lambda one: one.experiments,
    "chip": lambda one: one.chips,
    "stratum": lambda one: tuple(f"{name} {value}" for name, value in one.case.strata.items()),
}


def cells_of(group: str, answers: Sequence[Answer], is_hit: Callable[[Answer], bool], bar: Bar) -> Iterable[Row]:
    """The share of hits in each part."""
    parts = grouped(group, answers)
    for name, own in parts.items() if len(parts) > 1 or group == "plan" else ():
        yield row_of(name, _rate(own, is_hit), bar, "", group=group)


def _rate(answers: Sequence[Answer], is_hit: Callable[[Answer], bool]) -> Estimate:
    return rate(sum(map(is_hit, answers)), len(answers))


def _by_limits(one: Answer) -> float:
    return one.limits if isfinite(one.limits) else float("inf")


def _within(value: float, other: float, bar: Bar) -> bool:
    """Whether `value` reaches the lower end and `other` does not exceed the upper one."""
    low, high = bar
    return (low is None or value >= low - _ROUNDING) and (high is None or other <= high + _ROUNDING)
