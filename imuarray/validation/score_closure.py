"""Figures of quantities: the closed share against an oracle that knows the effects, probabilities, and time."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from math import isfinite, nan
from typing import NamedTuple

import numpy as np

from imuarray.arrays import Floats
from imuarray.validation.rates import (
    Bin,
    RateEstimate,
    bootstrap,
    bootstrap_groups,
    brier,
    calibration_error,
    calibration_error_by_chance,
    reliability,
)
from imuarray.validation.score_answers import Answer, number, probability
from imuarray.validation.score_causes import is_removed
from imuarray.validation.score_rows import (
    EVERY,
    NO_BAR,
    Bar,
    Breakdown,
    ScoreRow,
    group_answers,
    make_row,
    on_plan,
    rate_row,
)

WITHIN = 0.05
NEAR: Bar = (0.90, None)
COVERED, WRONG, EMPTY = (0.90, 0.97), (None, 0.3), (0.95, None)
CALIBRATION, BRIER = (None, 0.05), (None, 0.15)

_KINDS = ("single", "pair", "removal")
"""The kinds of cases whose gap an oracle can close."""


class Closure(NamedTuple):
    """One case of the full plan: the reported closed share with its interval, and the oracle's. `is_right`: the first
    cause is right, or the extra effect was named.
    """

    name: str
    kind: str
    claimed: float
    low: float
    high: float
    oracle: float
    is_right: bool


def closure_rows(answers: Sequence[Answer], full: str, seed: int) -> Iterator[ScoreRow]:
    """Yield the figures of the closed share: against the oracle, for wrong causes, and without a gap."""
    solvable = [answer for answer in answers if _has_oracle(answer)]
    groups = ("kind", "severity", "mechanism")
    about = f"detected, with an oracle: the share that it claims to close is within {WITHIN} of the oracle's"
    yield rate_row("closure near the oracle's", solvable, is_near, NEAR, about, Breakdown(full, groups))
    about = "as above: the oracle's share lies in the 95 % interval"
    yield rate_row(
        "closure's interval covers the oracle's", solvable, is_covered, COVERED, about, Breakdown(full, groups)
    )
    own = [answer for answer in on_plan(answers, full) if answer.is_detected()]
    yield _wrong(own, seed)
    yield _without(own, seed)
    controls = [answer for answer in answers if answer.case.kind == "none"]
    about = "no fault: no closure is reported, or its interval contains 0"
    yield rate_row("without a gap, closure may be 0", controls, is_empty, EMPTY, about, Breakdown(full, ()))


def probability_rows(answers: Sequence[Answer], full: str, seed: int) -> Iterator[ScoreRow]:
    """Yield the calibration error and Brier score of all reported causes, and the error expected by chance."""
    counted = on_plan(answers, full)
    about = "all reported causes in cases of one mechanism, two or none: right if the name is, at one of the sensors"
    for name, statistic, bar in (
        ("calibration error (ECE)", calibration_error, CALIBRATION),
        ("Brier score of causes", brier, BRIER),
    ):
        cells = [
            make_row(part, bootstrap_groups(statistic, _probabilities(own), seed), NO_BAR, "", group=group)
            for group in (("experiment", "chip") if full == EVERY else ("plan",))
            for part, own in group_answers(group, answers).items()
        ]
        estimate = bootstrap_groups(statistic, _probabilities(counted), seed)
        yield make_row(name, estimate, bar, f"{about}; counted are causes", cells)
    values = np.array([value for own, _ in _probabilities(counted) for value in own])
    about = (
        "what the calibration error would be, on average, if all these probabilities were right: bins have few causes"
    )
    floor = calibration_error_by_chance(values, seed) if len(values) else nan
    yield make_row("calibration error by chance alone", RateEstimate(floor, nan, nan, len(values)), NO_BAR, about)


def time_rows(answers: Sequence[Answer], full: str, seed: int) -> Iterator[ScoreRow]:
    """Yield the median and the 90 % quantile of the processing time of a case."""
    seconds = [answer.outcome.seconds for answer in on_plan(answers, full)]
    for name, share in (("median", 0.5), ("90 % quantile", 0.9)):
        estimate = bootstrap(lambda sample, share=share: float(np.quantile(sample, share)), seconds, seed=seed)
        yield make_row(f"seconds a case, {name}", estimate, NO_BAR, "recording, diagnosis and oracle of one case")


def is_near(answer: Answer) -> bool:
    """Return whether the reported closed share is close to the oracle's; False without a reported share."""
    return abs(answer.closed - answer.oracle) <= WITHIN + 1e-9


def is_covered(answer: Answer) -> bool:
    """Return whether the reported interval contains the oracle's share; False without an interval."""
    low, high = answer.closed_ci95
    return low <= answer.oracle <= high


def is_empty(answer: Answer) -> bool:
    """Return whether the interval of the reported closed share contains 0, or no share is reported."""
    low, high = answer.closed_ci95
    return not answer.is_detected() or not isfinite(answer.closed) or low <= 0 <= high


def closures_of(answers: Sequence[Answer], full: str) -> tuple[Closure, ...]:
    """Return the cases of the full plan that have an oracle."""
    return tuple(
        Closure(
            answer.case.name, answer.case.kind, answer.closed, *answer.closed_ci95, answer.oracle, _is_right(answer)
        )
        for answer in on_plan(answers, full)
        if _has_oracle(answer)
    )


def reliability_of(answers: Sequence[Answer], full: str) -> tuple[Bin, ...]:
    """Return the reliability of all causes reported on the full plan."""
    groups = _probabilities(on_plan(answers, full))
    return reliability([value for own, _ in groups for value in own], [flag for _, own in groups for flag in own])


def _wrong(answers: Sequence[Answer], seed: int) -> ScoreRow:
    wrong = [
        number(answer.first.get("closed"))
        for answer in answers
        if answer.case.kind == "single" and answer.first and not answer.is_first_right()
    ]
    claims = [value for value in wrong if isfinite(value)]
    about = "single mechanisms that were detected, the first cause a wrong one: the mean share that it claims to close"
    return make_row("closure claimed for a wrong cause", bootstrap(_mean, claims, seed=seed), WRONG, about)


def _without(answers: Sequence[Answer], seed: int) -> ScoreRow:
    """Measure how much a wrong cause can close when no right one is available, unlike for wrong causes that were
    reported.
    """
    claims = [
        max(answer.closed, 0.0) if isfinite(answer.closed) else 0.0
        for answer in answers
        if answer.case.kind == "withheld"
    ]
    about = "detected, the right cause withheld: the mean share that it claims to close, 0 where it claims none"
    return make_row("closure claimed without the right cause", bootstrap(_mean, claims, seed=seed), NO_BAR, about)


def _mean(drawn: Floats) -> float:
    return float(np.mean(drawn))


def _probabilities(answers: Sequence[Answer]) -> list[tuple[list[float], list[bool]]]:
    """Return the probabilities of each case's causes, and whether they are right."""
    return [
        (
            [probability(cause) for cause in answer.causes],
            [any(work.is_located_by(cause) for work in answer.active) for cause in answer.causes],
        )
        for answer in answers
        if answer.case.kind in ("single", "pair", "none")
    ]


def _is_right(answer: Answer) -> bool:
    return is_removed(answer) if answer.case.kind == "removal" else answer.is_first_right()


def _has_oracle(answer: Answer) -> bool:
    return answer.case.kind in _KINDS and answer.is_detected() and isfinite(answer.oracle)
