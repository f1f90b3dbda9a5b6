"""Evidence and states of units from recordings of the small bench, as input of the search."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache

import numpy as np

from imuarray.gap.inference.comparison import Comparison, compare_with_base
from imuarray.gap.inference.evidence import Evidence, PhaseEvidence
from imuarray.gap.inference.forward_selection import replicate_state
from imuarray.gap.inference.unit_state import UnitState
from imuarray.gap.model.rest import FittedParameters
from imuarray.gap.statistics.synthetic_likelihood import independent_share, likelihood_of
from imuarray.simulate.effect import Effect
from tests.gap.small_bench import Run, static
from tests.gap.small_campaign import header

FITTED = FittedParameters((0.01, 0.01, 0.02), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
REPLICATES = 40
"""As few as tell a gap at 5 %: a half scores the other."""


def evidence(
    scores: Mapping[str, Sequence[Sequence[float]]], scale: float = 0.5, seen: Sequence[PhaseEvidence] = ()
) -> Evidence:
    """Values of these scores about 10, in standard deviations of `scale`."""
    given = {probe: np.array(rows) for probe, rows in scores.items()}
    expected = {probe: np.full(rows.shape, 10.0) for probe, rows in given.items()}
    values = {probe: 10 + scale * rows for probe, rows in given.items()}
    return Evidence(header(), FITTED, tuple(seen), values, expected, given, ())


@cache
def found_in(*more: Effect, seed: int = 1) -> Comparison:
    """`static`, compared with its base model."""
    bench, campaign = static(*more, seed=seed)
    return compare_with_base(bench, campaign, Run(bench), REPLICATES)


def standing_of(found: Comparison, unit: tuple[str, ...] = ("G1",)) -> UnitState:
    """A unit under the base model."""
    bench = found.bench
    columns = bench.columns(unit, cross=len(unit) > 1)
    chance = found.chance[:, columns]
    likelihood = likelihood_of(chance, bench.resolutions[columns])
    models = {name: bench.models()[name] for name in unit}
    wanted = {name: found.real.fitted[name] for name in unit}
    share = independent_share(likelihood.scores(chance))
    first = UnitState(unit, models, found.real.values[columns], likelihood, np.zeros((0, 0)), wanted, share)
    return replicate_state(bench, first)
