"""How often told causes are right, by how far the gap of their sensors closes: what probabilities are made of.

    python -m imuarray.validation.calibration DIR...

Of development runs, and of sealed ones that have been opened. Printed are how often causes without a rival were right,
and the rates that make the causes of these runs likeliest (`imuarray.gap.findings.verdict.RATES`), with
the calibration error and Brier score before and after, and the calibration error that so many causes would show if all
probabilities were right.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise
from math import isfinite, nan
from pathlib import Path
from typing import NamedTuple

import click
import numpy as np
import numpy.typing as npt
from scipy.optimize import OptimizeResult, minimize

from imuarray.gap.findings.verdict import RATES, Rates, calibrated_probability
from imuarray.validation.rates import brier, calibration_error, calibration_error_by_chance, rate
from imuarray.validation.score_answers import Answer, number, read_run
from imuarray.validation.score_rows import FULL

Floats = npt.NDArray[np.float64]

_SOLE = 0.9
"""Share from which on a cause has no rival."""

_BOUNDS = ((0.01, 0.99), (0.01, 0.99), (0.5, 20.0), (0.1, 1.0))
_STARTS = ((0.3, 0.9, 4.0, 0.9), (0.1, 0.97, 1.5, 0.4))
_SURE = 1e-3

_EDGES = (0.0, 0.5, 0.8, 0.9, 0.95, 0.98, 1.0)


class CauseClaim(NamedTuple):
    """A cause that was told: its share among rivals, what is closed of its sensors' gap in all, whether it is right."""

    share: float
    all_closed: float
    is_right: bool


def told_in(answers: Sequence[Answer]) -> Iterator[CauseClaim]:
    """Causes in cases of one mechanism, two or none on the full plan; those that have no share are left out."""
    for one in answers:
        if one.case.plan != FULL or one.case.kind not in ("single", "pair", "none"):
            continue
        for cause in one.causes:
            share = number(cause.get("share"))
            if isfinite(share):
                is_right = any(work.is_met(cause) for work in one.at_work)
                yield CauseClaim(share, number(cause.get("all_closed"), 0.0), is_right)


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
    told = [one for run in runs for one in told_in(read_run(run).answers)]
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


if __name__ == "__main__":
    program()
