"""How often told causes are right, by how far the gap of their sensors closes: what probabilities are made of.

    python -m imuarray.validation.calibration DIR...

Of development runs. Printed are how often causes without a rival were right, and the rates at nothing and at all closed
that make the causes of these runs likeliest (`imuarray.gap.causes.LEAST_RIGHT`, `MOST_RIGHT`), with the calibration
error and Brier score before and after.
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
from scipy.optimize import minimize

from imuarray.gap.causes import LEAST_RIGHT, MOST_RIGHT, believed
from imuarray.validation.rates import brier, calibration_error, rate
from imuarray.validation.score_answers import Answer, number, read_run
from imuarray.validation.score_rows import FULL

Floats = npt.NDArray[np.float64]

_SOLE = 0.9
"""Share from which on a cause has no rival."""

_EDGES = (0.0, 0.5, 0.8, 0.9, 0.95, 0.98, 1.0)


class Told(NamedTuple):
    """A cause that was told: its share among rivals, what is closed of its sensors' gap in all, whether it is right."""

    share: float
    all_closed: float
    is_right: bool


def told_in(answers: Sequence[Answer]) -> Iterator[Told]:
    """Causes in cases of one mechanism, two or none on the full plan; those that have no share are left out."""
    for one in answers:
        if one.case.plan != FULL or one.case.kind not in ("single", "pair", "none"):
            continue
        for cause in one.causes:
            share = number(cause.get("share"))
            if isfinite(share):
                is_right = any(work.is_met(cause) for work in one.at_work)
                yield Told(share, number(cause.get("all_closed"), 0.0), is_right)


def rates_of(told: Sequence[Told]) -> tuple[float, float]:
    """Of causes without a rival where nothing, and where all is closed: the likeliest, between 0.01 and 0.99; (nan,
    nan) of none.
    """
    if not told:
        return nan, nan
    right = np.array([one.is_right for one in told])

    def unlikely(rates: Floats) -> float:
        chances = _chances(told, *rates.tolist())
        return -float(np.log(np.where(right, chances, 1 - chances)).sum())

    found = minimize(unlikely, (0.5, 0.5), bounds=[(0.01, 0.99)] * 2, method="Nelder-Mead")
    least, most = found.x.tolist()
    return least, most


def _chances(told: Sequence[Told], least: float, most: float) -> Floats:
    """(k,) with these rates in the place of those that are used."""
    return np.array([believed(one.share, one.all_closed, least, most) for one in told])


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
    for name, rates in (("now", (LEAST_RIGHT, MOST_RIGHT)), ("likeliest", rates_of(told))):
        chances = _chances(told, *rates)
        error, score = calibration_error(chances, right), brier(chances, right)
        click.echo(f"{name}: {rates[0]:.2f} to {rates[1]:.2f}; calibration error {error:.3f}, Brier score {score:.3f}")


if __name__ == "__main__":
    program()
