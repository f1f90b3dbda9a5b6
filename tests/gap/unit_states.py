"""States of units with given statistics."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

from imuarray.gap.inference.unit_state import REPLICATES, UnitState
from imuarray.gap.model.replication import SensorModel
from imuarray.gap.model.rest import FittedParameters
from imuarray.gap.statistics.synthetic_likelihood import SyntheticLikelihood

Floats = npt.NDArray[np.float64]
FITTED = FittedParameters((0.1, 0.1, 0.1), (1.0, 2.0, 3.0), (0.0, 0.0, 0.0))


def standing(
    real: list[float],
    values: Floats,
    likelihood: SyntheticLikelihood | None = None,
    models: Mapping[str, SensorModel] | None = None,
    independent: float = 1.0,
) -> UnitState:
    """A state with standard statistics before a change."""
    count = len(real)
    usual = SyntheticLikelihood(np.zeros(count), np.ones(count), np.ones(count, bool), np.zeros(count, bool))
    known = models or {"G1": SensorModel(FITTED)}
    wanted = dict.fromkeys(known, FITTED)
    return UnitState(tuple(known), known, np.array(real), likelihood or usual, values, wanted, independent)


def drawn(count: int, seed: int = 1, rows: int = REPLICATES) -> Floats:
    return np.random.default_rng(seed).normal(size=(rows, count))
