"""No suggestion without rows, even with large scores of a sensor."""

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
from tests.gap.small_campaign import block, gaussian, header, summary

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
    """Every probe has the value 0, and all scores are `odd`."""
    nothing, scores = (dict.fromkeys(PROBES, np.full((1, 3), value)) for value in (0.0, odd))
    fitted = FittedParameters((1.0,) * 3, (0.0,) * 3, (0.0,) * 3)
    return Evidence(header(), fitted, seen, nothing, nothing, scores, ())


@pytest.mark.parametrize("name", [*OF_ROWS, *STATISTICS_ALONE])
def test_scores_of_zero_suggest_nothing(name: str) -> None:
    rows = summary(block(gaussian(rows=500)))
    assert not list(CANDIDATES[name].guesses(evidence(0.0, PhaseEvidence(0, "static", True, rows, rows, None))))


@pytest.mark.parametrize("name", OF_ROWS)
def test_no_phase_suggests_nothing(name: str) -> None:
    assert not list(CANDIDATES[name].guesses(evidence(50.0)))


@pytest.mark.parametrize("name", [*OF_ROWS, *STATISTICS_ALONE])
@pytest.mark.parametrize("rows", [0, 1])
def test_a_single_row_suggests_nothing(name: str, rows: int) -> None:
    """A phase of a sensor that has stopped."""
    phase = Phase(0, 10**9, "static", "+Z")
    tally = Tally(header(), phase, Grid.of(100))
    if rows:
        tally.update(block(np.full((1, 3), 7)))
    few = tally.result(lambda time_ns: np.full(len(time_ns), 25.0))
    found = list(CANDIDATES[name].guesses(evidence(50.0, PhaseEvidence(0, "static", True, few, few, None))))
    assert not found or name in STATISTICS_ALONE


class Asked(dict[str, np.ndarray]):
    """Scores that accept only names of probes."""

    def __contains__(self, name: object) -> bool:
        assert name in PROBES, name
        return super().__contains__(name)


@pytest.mark.parametrize("name", CANDIDATES)
def test_candidates_read_only_existing_probes(name: str) -> None:
    """An unknown name would be ignored without an error."""
    rows = summary(block(gaussian(rows=500)))
    told = evidence(0.0, PhaseEvidence(0, "static", True, rows, rows, None))
    list(CANDIDATES[name].guesses(replace(told, scores=Asked(told.scores))))
