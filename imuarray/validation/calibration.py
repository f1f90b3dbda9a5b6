"""How often told causes are right, by how far the gap of their sensors closes: what probabilities are made of.

    python -m imuarray.validation.calibration DIR...

Of development runs, and of sealed ones that have been opened. Printed are how often causes without a rival were right,
and the rates that make the causes of these runs likeliest (`imuarray.gap.findings.verdict.RATES`), with
the calibration error and Brier score before and after, and the calibration error that so many causes would show if all
probabilities were right; the same of probabilities that are fitted to other worlds; and which effects are confused.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from itertools import pairwise
from math import isfinite, nan
from pathlib import Path
from typing import NamedTuple

import click
import numpy as np
from scipy.optimize import OptimizeResult, minimize

from imuarray.arrays import Floats
from imuarray.gap.findings.verdict import RATES, Rates, calibrated_probability
from imuarray.validation.rates import brier, calibration_error, calibration_error_by_chance, rate
from imuarray.validation.score_answers import Answer, number, read_run
from imuarray.validation.score_rows import FULL, grouped

_SOLE = 0.9
"""Share from which on a cause has no rival."""

FOLDS = 5
"""Of the worlds, each of which is judged by rates fitted to the other four."""
LEAST_CAUSES = 20
"""To which rates are fitted, or by which they are judged, where a chip or an experiment is left out."""
CONFUSED = 0.1
"""Share of an effect's cases in which another is said first, from which on the two are confusable."""

_BOUNDS = ((0.01, 0.99), (0.01, 0.99), (0.5, 20.0), (0.1, 1.0))
_STARTS = ((0.3, 0.9, 4.0, 0.9), (0.1, 0.97, 1.5, 0.4))
_SURE = 1e-3

_EDGES = (0.0, 0.5, 0.8, 0.9, 0.95, 0.98, 1.0)


class CauseClaim(NamedTuple):
    """A cause that was told: its share among rivals, what is closed of its sensors' gap in all, whether it is right."""

    share: float
    all_closed: float
    is_right: bool


class Fold(NamedTuple):
    """Probabilities that were fitted to other cases: calibration error and Brier score of so many `causes`, and what
    the error would be by chance.
    """

    part: str
    error: float
    score: float
    by_chance: float
    causes: int


class Confused(NamedTuple):
    """Of so many `cases` in which `effect` was at work and a gap was told, so many in which `said` came first."""

    effect: str
    said: str
    times: int
    cases: int


def claims_in(answers: Sequence[Answer]) -> list[CauseClaim]:
    """Causes in cases of one mechanism, two or none, in random worlds or on the full plan; those that have no share are
    left out.
    """
    found = []
    for one in answers:
        if not (one.case.world or one.case.plan == FULL) or one.case.kind not in ("single", "pair", "none"):
            continue
        for cause in one.causes:
            share = number(cause.get("share"))
            if isfinite(share):
                is_right = any(work.is_met(cause) for work in one.at_work)
                found.append(CauseClaim(share, number(cause.get("all_closed"), 0.0), is_right))
    return found


def cross_validated(answers: Sequence[Answer], folds: int = FOLDS, seed: int = 0) -> list[Fold]:
    """Rates fitted to all worlds but those of a fold, on these: all folds together ("other worlds"); those fitted to
    one kind of world, on each of the others; those fitted to the cases without a chip or an experiment, on those with.
    """
    if not answers:
        return []
    drawn = np.random.default_rng(seed).permutation(len(answers)) % folds
    parts = [[one for one, fold in zip(answers, drawn, strict=True) if fold == number] for number in range(folds)]
    chances, right = list[float](), list[bool]()
    for part in parts:
        claims = claims_in(part)
        rest = claims_in([one for other in parts if other is not part for one in other])
        if claims and rest:
            chances += chances_of(claims, rates_of(rest)).tolist()
            right += [one.is_right for one in claims]
    found = [_fold("other worlds", np.array(chances), right)] if chances else []
    kinds = dict.fromkeys(one.case.world for one in answers)
    own = {kind: claims_in([one for one in answers if one.case.world == kind]) for kind in kinds}
    for kind, claims in own.items():
        for other, judged in own.items():
            if kind != other and claims and judged:
                name = f"{other or 'fixed plans'}, fitted to {kind or 'fixed plans'}"
                found.append(_fold(name, chances_of(judged, rates_of(claims)), [one.is_right for one in judged]))
    return [*found, *_without_a_part(answers)]


def _without_a_part(answers: Sequence[Answer]) -> Iterator[Fold]:
    for group in ("chip", "experiment"):
        for part, own in grouped(group, answers).items():
            names = {one.case.name for one in own}
            claims, rest = claims_in(own), claims_in([one for one in answers if one.case.name not in names])
            if min(len(claims), len(rest)) >= LEAST_CAUSES:
                chances = chances_of(claims, rates_of(rest))
                yield _fold(f"{group} {part}, fitted to those without", chances, [one.is_right for one in claims])


def confused_in(answers: Sequence[Answer]) -> list[Confused]:
    """What the first cause says instead of a single effect that is at work, in `CONFUSED` of its cases and in two at
    least, the most frequent first: what may rightly be called confusable.
    """
    said: dict[str, Counter[str]] = {}
    for one in answers:
        if one.case.kind == "single" and one.is_detected and one.first is not None:
            told = str(one.first["effect"])
            for effect in one.at_work[0].resembles:
                said.setdefault(effect, Counter())[effect if one.is_first_right() else told] += 1
    found = [
        Confused(effect, other, count, sum(counts.values()))
        for effect, counts in said.items()
        for other, count in counts.items()
        if other != effect and count >= max(2, CONFUSED * sum(counts.values()))
    ]
    return sorted(found, key=lambda one: (-one.times / one.cases, one.effect, one.said))


def _fold(part: str, chances: Floats, right: Sequence[bool]) -> Fold:
    by_chance = calibration_error_by_chance(chances, seed=0)
    return Fold(part, calibration_error(chances, right), brier(chances, right), by_chance, len(right))


def rates_of(told: Sequence[CauseClaim]) -> Rates:
    """The likeliest, within `_BOUNDS`; nan of none."""
    if not told:
        return Rates(nan, nan, nan, nan)
    right = np.array([one.is_right for one in told])

    def unlikely(values: Floats) -> float:
        chances = np.clip(chances_of(told, Rates(*values.tolist())), _SURE, 1 - _SURE)
        return -float(np.log(np.where(right, chances, 1 - chances)).sum())

    found = min((minimize(unlikely, start, bounds=_BOUNDS, method="Nelder-Mead") for start in _STARTS), key=_height)
    return Rates(*found.x.tolist())


def chances_of(told: Sequence[CauseClaim], rates: Rates) -> Floats:
    """(k,) probabilities with these rates in the place of those that are used."""
    return np.array([calibrated_probability(one.share, one.all_closed, rates) for one in told])


def _height(found: OptimizeResult) -> float:
    return float(found.fun)


@click.command()
@click.argument("runs", type=click.Path(exists=True, file_okay=False, path_type=Path), nargs=-1, required=True)
def program(runs: tuple[Path, ...]) -> None:
    """Measure how often told causes are right."""
    answers = [one for run in runs for one in read_run(run).answers]
    told = claims_in(answers)
    sole = [one for one in told if one.share >= _SOLE]
    click.echo(f"{len(told)} causes, {sum(one.is_right for one in told)} right; without a rival {len(sole)}:")
    for low, high in pairwise(_EDGES):
        own = [one for one in sole if low <= one.all_closed < high or one.all_closed == high == 1.0]
        found = rate(sum(one.is_right for one in own), len(own))
        click.echo(f"  {low:.2f} to {high:.2f} closed: {found.value:.2f} of {len(own)}")
    right = [one.is_right for one in told]
    for name, rates in (("now", RATES), ("likeliest", rates_of(told))):
        chances = chances_of(told, rates)
        error, score = calibration_error(chances, right), brier(chances, right)
        floor = calibration_error_by_chance(chances, seed=0) if told else nan
        click.echo(
            f"{name}: {', '.join(f'{value:.2f}' for value in rates)};"
            f" calibration error {error:.3f} (by chance {floor:.3f}), Brier score {score:.3f}"
        )
    for one in cross_validated(answers):
        click.echo(
            f"{one.part}: calibration error {one.error:.3f} (by chance {one.by_chance:.3f}), "
            f"Brier score {one.score:.3f}, {one.causes} causes"
        )
    for pair in confused_in(answers):
        click.echo(f"{pair.effect}: {pair.said} said first in {pair.times} of {pair.cases}")


if __name__ == "__main__":
    program()
