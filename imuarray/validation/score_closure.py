"""Are the numbers right? How much is closed, against somebody who is told the effects; probabilities; time."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from math import isfinite, nan
from typing import NamedTuple

import numpy as np

from imuarray.arrays import Floats
from imuarray.validation.rates import (
    Bin,
    Estimate,
    bootstrapped,
    brier,
    calibration_error,
    calibration_error_by_chance,
    of_groups,
    reliability,
)
from imuarray.validation.score_answers import Answer, number, probability
from imuarray.validation.score_causes import is_removed
from imuarray.validation.score_rows import EVERY, NO_BAR, Bar, Row, grouped, on_plan, rate_row, row_of

WITHIN = 0.05
NEAR: Bar = (0.90, None)
COVERED, WRONG, EMPTY = (0.90, 0.97), (None, 0.3), (0.95, None)
CALIBRATION, BRIER = (None, 0.05), (None, 0.15)

_KINDS = ("single", "pair", "removal")
"""Of those an oracle can close the gap."""


class Closure(NamedTuple):
    """Of one case of the full plan: the share said to be closed with its interval, and the oracle's; `is_right`: the
    first cause is, or what has to go was named.
    """

    name: str
    kind: str
    claimed: float
    low: float
    high: float
    oracle: float
    is_right: bool


def closure_rows(answers: Sequence[Answer], full: str, seed: int) -> Iterator[Row]:
    """Against the oracle, for wrong causes, without a gap."""
    told = [one for one in answers if _has_oracle(one)]
    groups = ("kind", "severity", "mechanism")
    about = f"detected, with an oracle: the share said to be closed is within {WITHIN} of the oracle's"
    yield rate_row("closure near the oracle's", told, is_near, NEAR, about, full, groups)
    about = "as above: the oracle's share lies in the 95 % interval"
    yield rate_row("closure's interval covers the oracle's", told, is_covered, COVERED, about, full, groups)
    own = [one for one in on_plan(answers, full) if one.is_detected]
    yield _wrong(own, seed)
    yield _without(own, seed)
    controls = [one for one in answers if one.case.kind == "none"]
    about = "nothing is wrong: nothing is said to be closed, or the interval has 0 in it"
    yield rate_row("without a gap, closure may be 0", controls, is_empty, EMPTY, about, full, ())


def probability_rows(answers: Sequence[Answer], full: str, seed: int) -> Iterator[Row]:
    """Calibration error and Brier score of all causes told, and what the error is of so few."""
    counted = on_plan(answers, full)
    about = "all causes told in cases of one mechanism, two or none: right if the name is, at one of the sensors"
    for name, statistic, bar in (
        ("calibration error (ECE)", calibration_error, CALIBRATION),
        ("Brier score of causes", brier, BRIER),
    ):
        cells = [
            row_of(part, of_groups(statistic, _told(own), seed), NO_BAR, "", group=group)
            for group in (("experiment", "chip") if full == EVERY else ("plan",))
            for part, own in grouped(group, answers).items()
        ]
        found = of_groups(statistic, _told(counted), seed)
        yield row_of(name, found, bar, f"{about}; counted are causes", cells)
    values = np.array([value for own, _ in _told(counted) for value in own])
    about = (
        "what the calibration error would be, on average, if all these probabilities were right: bins have few causes"
    )
    floor = calibration_error_by_chance(values, seed) if len(values) else nan
    yield row_of("calibration error by chance alone", Estimate(floor, nan, nan, len(values)), NO_BAR, about)


def time_rows(answers: Sequence[Answer], full: str, seed: int) -> Iterator[Row]:
    """Median and 90 % quantile of what a case took."""
    seconds = [one.outcome.seconds for one in on_plan(answers, full)]
    for name, share in (("median", 0.5), ("90 % quantile", 0.9)):
        found = bootstrapped(lambda drawn, share=share: float(np.quantile(drawn, share)), seconds, seed=seed)
        yield row_of(f"seconds a case, {name}", found, NO_BAR, "recording, diagnosis and oracle of one case")


def is_near(answer: Answer) -> bool:
    """Whether the share said to be closed is about that of somebody who knows; nothing said is not."""
    return abs(answer.closed - answer.oracle) <= WITHIN + 1e-9


def is_covered(answer: Answer) -> bool:
    """Whether the interval said has the oracle's share in it; no interval has not."""
    low, high = answer.closed_ci95
    return low <= answer.oracle <= high


def is_empty(answer: Answer) -> bool:
    """Whether nothing is said to be closed for sure."""
    low, high = answer.closed_ci95
    return not answer.is_detected or not isfinite(answer.closed) or low <= 0 <= high


def closures_of(answers: Sequence[Answer], full: str) -> tuple[Closure, ...]:
    """Those of the full plan that have an oracle."""
    return tuple(
        Closure(one.case.name, one.case.kind, one.closed, *one.closed_ci95, one.oracle, _is_right(one))
        for one in on_plan(answers, full)
        if _has_oracle(one)
    )


def reliability_of(answers: Sequence[Answer], full: str) -> tuple[Bin, ...]:
    """Of all causes told on the full plan."""
    told = _told(on_plan(answers, full))
    return reliability([value for own, _ in told for value in own], [flag for _, own in told for flag in own])


def _wrong(answers: Sequence[Answer], seed: int) -> Row:
    wrong = [
        number(one.first.get("closed"))
        for one in answers
        if one.case.kind == "single" and one.first and not one.is_first_right()
    ]
    claims = [value for value in wrong if isfinite(value)]
    about = "single mechanisms that were detected, the first cause a wrong one: the mean share that it claims to close"
    return row_of("closure claimed for a wrong cause", bootstrapped(_mean, claims, seed=seed), WRONG, about)


def _without(answers: Sequence[Answer], seed: int) -> Row:
    """Other than of wrong causes that were told, it asks how far a wrong one can get where there is none but such."""
    claims = [max(one.closed, 0.0) if isfinite(one.closed) else 0.0 for one in answers if one.case.kind == "withheld"]
    about = "detected, the right cause withheld: the mean share said to be closed, 0 where none is said"
    return row_of("closure claimed without the right cause", bootstrapped(_mean, claims, seed=seed), NO_BAR, about)


def _mean(drawn: Floats) -> float:
    return float(np.mean(drawn))


def _told(answers: Sequence[Answer]) -> list[tuple[list[float], list[bool]]]:
    """Probabilities of a case's causes, and whether they are right."""
    return [
        (
            [probability(cause) for cause in one.causes],
            [any(work.is_met(cause) for work in one.at_work) for cause in one.causes],
        )
        for one in answers
        if one.case.kind in ("single", "pair", "none")
    ]


def _is_right(answer: Answer) -> bool:
    return is_removed(answer) if answer.case.kind == "removal" else answer.is_first_right()


def _has_oracle(answer: Answer) -> bool:
    return answer.case.kind in _KINDS and answer.is_detected and isfinite(answer.oracle)
