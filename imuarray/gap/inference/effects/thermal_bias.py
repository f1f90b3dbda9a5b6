"""`thermal_bias`: levels that follow the square of the temperature, beside the straight line that is fitted."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from imuarray.gap.inference.effects.candidate import Candidate, Hypothesis
from imuarray.gap.inference.effects.levels import Levels, levels
from imuarray.gap.inference.effects.thermal import BEYOND, LEAST_DEGC, TRACES, fitted, is_warmed, warmth
from imuarray.gap.inference.evidence import Evidence
from imuarray.simulate.effects.temperature import ThermalBias

_CLEAR = 2.0
"""A coefficient so many standard errors from 0 is one."""


def guesses(evidence: Evidence) -> Iterator[Hypothesis]:
    """Suggest the quadratic term by least squares; a linear one where only the levels of several logs tell it, which
    the base model doesn't fit.
    """
    table = levels(evidence)
    if not len(table.degc) or not evidence.is_odd(*TRACES, beyond=BEYOND):
        return
    if is_warmed(table):
        yield from _squares(table)
        if not evidence.is_refitted:
            yield from _since(evidence)
    elif np.ptp(table.degc) >= LEAST_DEGC:
        yield from _between_logs(table)


def _squares(table: Levels) -> Iterator[Hypothesis]:
    """Suggest quadratic terms with the slope that belongs to them: the fitted straight line follows the curve where the
    sensor was warm, and would deviate from it there if the square were only added.
    """
    warm = warmth(table)
    fit = fitted(np.stack([warm, warm**2], axis=1), table.mean, table.group)
    clear = np.abs(fit.coefficient[1]) > _CLEAR * fit.error[1]
    if clear.any():
        slope, quadratic = np.where(clear, fit.coefficient, 0.0).tolist()
        yield Hypothesis((ThermalBias(tuple(slope), tuple(quadratic)),), ("quadratic",))


def _since(evidence: Evidence) -> Iterator[Hypothesis]:
    """Suggest a slope that has changed since an earlier recording, to which the base model was fitted."""
    odd = np.abs(evidence.score("thermal_slope")) > BEYOND
    x, y, z = np.where(odd, np.nan_to_num(evidence.typical("thermal_slope")), 0.0).tolist()
    if any((x, y, z)):
        yield Hypothesis((ThermalBias(slope=(x, y, z)),), ("slope",))


def _between_logs(table: Levels) -> Iterator[Hypothesis]:
    """Suggest a slope from levels on one face at several temperatures."""
    faces = np.unique(np.nan_to_num(table.felt_g.round(3), nan=9.0), axis=0, return_inverse=True)[1].reshape(-1)
    fit = fitted(warmth(table)[:, None], table.mean, faces)
    if fit.coefficient.any():
        x, y, z = fit.coefficient[0].tolist()
        yield Hypothesis((ThermalBias(slope=(x, y, z)),), ("slope",))


THERMAL_BIAS = Candidate(
    ThermalBias.name, guesses, {"heating": "heat by 20 degC and let cool, twice, on one face, 10 minutes each way"}
)
