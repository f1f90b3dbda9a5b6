"""No guess without any rows to guess from, however odd a sensor is said to be."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from imuarray.gap.inference.effects import CANDIDATES
from imuarray.gap.inference.evidence import Evidence, PhaseEvidence
from imuarray.gap.model.base_model import FittedParameters
from imuarray.gap.statistics.probes import PROBES
from imuarray.gap.statistics.summary import Grid, Tally
from imuarray.log.format import Phase
from tests.gap.made import block, gaussian, header, summary

STATISTICS_ALONE = ("scale", "misalignment", "axis_error", "odr_error")
"""What needs no rows, only the values of probes."""

OF_ROWS = (
    "bias",
    "clock_error",
    "dropped_samples",
    "glitches",
    "jitter",
    "quantisation",
    "saturation",
    "skew",
    "stale_samples",
    "stuck",
)


def evidence(odd: float, *seen: PhaseEvidence) -> Evidence:
    """Every probe says 0, as far from what the model makes as that."""
    nothing, scores = (dict.fromkeys(PROBES, np.full((1, 3), value)) for value in (0.0, odd))
    fitted = FittedParameters((1.0,) * 3, (0.0,) * 3, (0.0,) * 3)
    return Evidence(header(), fitted, seen, nothing, nothing, scores, ())


@pytest.mark.parametrize("name", [*OF_ROWS, *STATISTICS_ALONE])
def test_nothing_odd(name: str) -> None:
    rows = summary(block(gaussian(rows=500)))
    assert not list(CANDIDATES[name].guesses(evidence(0.0, PhaseEvidence(0, "static", True, rows, rows, None))))


@pytest.mark.parametrize("name", OF_ROWS)
def test_no_phase(name: str) -> None:
    assert not list(CANDIDATES[name].guesses(evidence(50.0)))


@pytest.mark.parametrize("name", [*OF_ROWS, *STATISTICS_ALONE])
@pytest.mark.parametrize("rows", [0, 1])
def test_hardly_a_row(name: str, rows: int) -> None:
    """A phase of a sensor that had stopped."""
    phase = Phase(0, 10**9, "static", "+Z")
    tally = Tally(header(), phase, Grid.of(100))
    if rows:
        tally.update(block(np.full((1, 3), 7)))
    few = tally.result(lambda time_ns: np.full(len(time_ns), 25.0))
    found = list(CANDIDATES[name].guesses(evidence(50.0, PhaseEvidence(0, "static", True, few, few, None))))
    assert not found or name in STATISTICS_ALONE


class Asked(dict[str, np.ndarray]):
    """Scores that are asked for by the names of probes alone."""

    def __contains__(self, name: object) -> bool:
        assert name in PROBES, name
        return super().__contains__(name)


@pytest.mark.parametrize("name", CANDIDATES)
def test_what_is_looked_at_are_probes(name: str) -> None:
    """A name that is none would be passed over in silence."""
    rows = summary(block(gaussian(rows=500)))
    told = evidence(0.0, PhaseEvidence(0, "static", True, rows, rows, None))
    list(CANDIDATES[name].guesses(replace(told, scores=Asked(told.scores))))
