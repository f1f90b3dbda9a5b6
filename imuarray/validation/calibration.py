"""Fit the probabilities of reported causes: how often a cause is right, given the share of the gap that it closes.

    python -m imuarray.validation.calibration DIR...

The runs are development runs and sealed runs that have been opened. The program prints how often causes without a rival
were right, and the maximum-likelihood rates for these runs (`imuarray.gap.findings.verdict.RATES`), with the
calibration error and Brier score before and after, and the calibration error expected by chance from this number of
causes; the same for probabilities fitted to other worlds; and which effects are confused.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from itertools import pairwise
from math import isfinite, nan
from operator import attrgetter
from pathlib import Path
from typing import NamedTuple

import click
import numpy as np
from scipy.optimize import minimize

from imuarray.arrays import Floats
from imuarray.gap.findings.verdict import RATES, Rates, calibrated_probability
from imuarray.validation.rates import brier, calibration_error, calibration_error_by_chance, rate
from imuarray.validation.score_answers import Answer, number, read_run
from imuarray.validation.score_rows import FULL, group_answers

_SOLE = 0.9
"""Share among rivals from which on a cause counts as having no rival."""

FOLDS = 5
"""Number of folds; each is evaluated with rates fitted to the others."""
LEAST_CAUSES = 20
"""Minimum number of causes for fitting or evaluating rates when a chip or an experiment is omitted."""
CONFUSED = 0.1
"""Two effects are confusable if, in at least this share of the cases of one of them, the other is reported first."""

_BOUNDS = ((0.01, 0.99), (0.01, 0.99), (0.5, 20.0), (0.1, 1.0))
_STARTS = ((0.3, 0.9, 4.0, 0.9), (0.1, 0.97, 1.5, 0.4))
_SURE = 1e-3

_EDGES = (0.0, 0.5, 0.8, 0.9, 0.95, 0.98, 1.0)


class CauseClaim(NamedTuple):
    """A reported cause: its share among rivals, the share of its sensors' gap that all causes together close, and
    whether it is right.
    """

    share: float
    all_closed: float
    is_right: bool


class Fold(NamedTuple):
    """Calibration error and Brier score of probabilities that were fitted to other cases, over `causes` causes, and the
    calibration error expected by chance.
    """

    part: str
    error: float
    score: float
    by_chance: float
    causes: int


class ConfusablePair(NamedTuple):
    """Effects that are confused: in `times` of the `cases` in which `effect` was active and a gap was reported,
    `reported` was the first cause.
    """

    effect: str
    reported: str
    times: int
    cases: int


def claims_in(answers: Sequence[Answer]) -> list[CauseClaim]:
    """Return the causes reported in cases of one mechanism, two or none, in random worlds or on the full plan. Causes
    without a share are omitted.
    """
    claims = []
    for answer in answers:
        if not (answer.case.world or answer.case.plan == FULL) or answer.case.kind not in ("single", "pair", "none"):
            continue
        for cause in answer.causes:
            share = number(cause.get("share"))
            if isfinite(share):
                is_right = any(work.is_located_by(cause) for work in answer.active)
                claims.append(CauseClaim(share, number(cause.get("all_closed"), 0.0), is_right))
    return claims


def cross_validate(answers: Sequence[Answer]) -> list[Fold]:
    """Evaluate rates on cases to which they were not fitted: all folds together ("other worlds"); rates fitted to one
    kind of world on each of the others; rates fitted to the cases without a chip or an experiment on those with it.
    """
    if not answers:
        return []
    drawn = np.random.default_rng(0).permutation(len(answers)) % FOLDS
    parts = [[answer for answer, fold in zip(answers, drawn, strict=True) if fold == number] for number in range(FOLDS)]
    chances, right = list[float](), list[bool]()
    for part in parts:
        claims = claims_in(part)
        rest = claims_in([answer for other in parts if other is not part for answer in other])
        if claims and rest:
            chances += probabilities_of(claims, fit_rates(rest)).tolist()
            right += [answer.is_right for answer in claims]
    scores = [_fold("other worlds", np.array(chances), right)] if chances else []
    kinds = dict.fromkeys(answer.case.world for answer in answers)
    own = {kind: claims_in([answer for answer in answers if answer.case.world == kind]) for kind in kinds}
    for kind, claims in own.items():
        for other, judged in own.items():
            if kind != other and claims and judged:
                name = f"{other or 'fixed plans'}, fitted to {kind or 'fixed plans'}"
                scores.append(
                    _fold(name, probabilities_of(judged, fit_rates(claims)), [answer.is_right for answer in judged])
                )
    return [*scores, *_validate_without_parts(answers)]


def _validate_without_parts(answers: Sequence[Answer]) -> Iterator[Fold]:
    for group in ("chip", "experiment"):
        for part, own in group_answers(group, answers).items():
            names = {answer.case.name for answer in own}
            claims, rest = claims_in(own), claims_in([answer for answer in answers if answer.case.name not in names])
            if min(len(claims), len(rest)) >= LEAST_CAUSES:
                chances = probabilities_of(claims, fit_rates(rest))
                yield _fold(f"{group} {part}, fitted to those without", chances, [answer.is_right for answer in claims])


def confusable_pairs(answers: Sequence[Answer]) -> list[ConfusablePair]:
    """Return, for single effects, the other effects reported as the first cause in at least `CONFUSED` of the cases and
    at least two, most frequent first. The diagnosis may report these effects as confusable.
    """
    first_causes: dict[str, Counter[str]] = {}
    for answer in answers:
        if answer.case.kind == "single" and answer.is_detected() and answer.first is not None:
            reported = str(answer.first["effect"])
            for effect in answer.active[0].resembles:
                first_causes.setdefault(effect, Counter())[effect if answer.is_first_right() else reported] += 1
    pairs = [
        ConfusablePair(effect, other, count, sum(counts.values()))
        for effect, counts in first_causes.items()
        for other, count in counts.items()
        if other != effect and count >= max(2, CONFUSED * sum(counts.values()))
    ]
    return sorted(pairs, key=lambda pair: (-pair.times / pair.cases, pair.effect, pair.reported))


def _fold(part: str, chances: Floats, right: Sequence[bool]) -> Fold:
    by_chance = calibration_error_by_chance(chances, seed=0)
    return Fold(part, calibration_error(chances, right), brier(chances, right), by_chance, len(right))


def fit_rates(claims: Sequence[CauseClaim]) -> Rates:
    """Return the maximum-likelihood rates within `_BOUNDS`; nan without claims."""
    if not claims:
        return Rates(nan, nan, nan, nan)
    right = np.array([claim.is_right for claim in claims])

    def unlikely(values: Floats) -> float:
        chances = np.clip(probabilities_of(claims, Rates(*values.tolist())), _SURE, 1 - _SURE)
        return -float(np.log(np.where(right, chances, 1 - chances)).sum())

    fits = (minimize(unlikely, start, bounds=_BOUNDS, method="Nelder-Mead") for start in _STARTS)
    fit = min(fits, key=attrgetter("fun"))
    return Rates(*fit.x.tolist())


def probabilities_of(claims: Sequence[CauseClaim], rates: Rates) -> Floats:
    """Return the (k,) probabilities that these rates give to the claims."""
    return np.array([calibrated_probability(claim.share, claim.all_closed, rates) for claim in claims])


@click.command()
@click.argument("runs", type=click.Path(exists=True, file_okay=False, path_type=Path), nargs=-1, required=True)
def program(runs: tuple[Path, ...]) -> None:
    """Measure how often the causes reported in RUNS, folders of validation runs, are right for each stated probability.

    Prints the share of right causes, the rates behind the probabilities as they are and as they fit these runs best,
    and which effects were confused.
    """
    answers = [answer for run in runs for answer in read_run(run).answers]
    claims = claims_in(answers)
    sole = [claim for claim in claims if claim.share >= _SOLE]
    click.echo(f"{len(claims)} causes, {sum(claim.is_right for claim in claims)} right; without a rival {len(sole)}:")
    for low, high in pairwise(_EDGES):
        own = [claim for claim in sole if low <= claim.all_closed < high or claim.all_closed == high == 1.0]
        share = rate(sum(claim.is_right for claim in own), len(own))
        click.echo(f"  {low:.2f} to {high:.2f} closed: {share.value:.2f} of {len(own)}")
    right = [claim.is_right for claim in claims]
    for name, rates in (("now", RATES), ("likeliest", fit_rates(claims))):
        chances = probabilities_of(claims, rates)
        error, score = calibration_error(chances, right), brier(chances, right)
        floor = calibration_error_by_chance(chances, seed=0) if claims else nan
        click.echo(
            f"{name}: {', '.join(f'{value:.2f}' for value in rates)};"
            f" calibration error {error:.3f} (by chance {floor:.3f}), Brier score {score:.3f}"
        )
    for claim in cross_validate(answers):
        click.echo(
            f"{claim.part}: calibration error {claim.error:.3f} (by chance {claim.by_chance:.3f}), "
            f"Brier score {claim.score:.3f}, {claim.causes} causes"
        )
    for pair in confusable_pairs(answers):
        click.echo(f"{pair.effect}: {pair.reported} reported first in {pair.times} of {pair.cases}")


if __name__ == "__main__":
    program()
