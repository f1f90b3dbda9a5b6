"""Constants chosen for imports: a change must be made here, too, so that none changes unnoticed. Whether a value is a
good one is the claim of other tests.
"""

from __future__ import annotations

import pytest

from imuarray.calibrate import gravity
from imuarray.characterise import codes, lines, processing, result, stretch
from imuarray.importers import (
    arrays,
    cells,
    code_errors,
    guess,
    plausibility,
    proposal,
    resolution,
    table,
    triad_behaviour,
)

CHOSEN = {
    (plausibility, "WINDOW_S"): 0.5,
    (plausibility, "FEWEST_ROWS"): 32,
    (plausibility, "GRAVITY_OFF"): 0.12,
    (plausibility, "NEAR_FACTOR"): 0.1,
    (plausibility, "OVER_RANGE"): 1.05,
    (plausibility, "STILL"): 2.5,
    (plausibility, "TURNED"): 0.02,
    (plausibility, "FEWEST_TURNS"): 20,
    (plausibility, "FOLLOWS"): 0.8,
    (plausibility, "SAME_SCALE"): 1.4,
    (plausibility, "STALE_SHARE"): 0.015,
    (plausibility, "LISTED"): 3,
    (codes, "LEAST_PILE"): 5,
    (codes, "BEFORE"): 8,
    (codes, "SURE"): 1e-6,
    (codes, "NOMINAL"): 2,
    (codes, "NEAR_RANGE"): 0.1,
    (codes, "MOVING_STEPS"): 20,
    (resolution, "NEAR"): 3e-4,
    (resolution, "SAMPLE_ROWS"): 20_000,
    (table, "VANISHED"): 0.3,
    (arrays, "MOST_COLUMNS"): 64,
    (result, "HARMONICS"): 8,
    (result, "CHANCE"): 0.02,
    (plausibility, "TURN_WINDOW_S"): 0.125,
    (triad_behaviour, "SPANS_DIRECTIONS"): 0.1,
    (triad_behaviour, "ON_SPHERE"): 0.03,
    (guess, "_OPENED"): 0.25,
    (cells, "MOST_RESTARTS"): 1000,
    (codes, "TURNING"): 1 / 3,
    (processing, "SCATTER"): 6.0,
    (processing, "LEAST_SHARE"): 0.3,
    (stretch, "PIECE_ROWS"): 64,
    (stretch, "CHANGED"): 1.25,
    (gravity, "FACE_COSINE"): 0.97,
    (lines, "RISES"): 1.35,
    (lines, "SLACK"): 1.08,
    (plausibility, "RATES_HZ"): (0.5, 20_000.0),
    (plausibility, "LATE_S"): 0.1,
    (plausibility, "LATE_WINDOWS"): 16,
    (plausibility, "OTHER_CODES"): 5,
    (code_errors, "FEWEST_JUMPS"): 8,
    (code_errors, "MOST_JUMPS"): 0.1,
    (code_errors, "FEWEST_OVERFLOWS"): 4,
    (code_errors, "_STANDS_OUT"): 6.0,
    (code_errors, "_SAME_AMOUNT"): 0.15,
    (code_errors, "_OVERFLOW"): 0.75,
    (code_errors, "_GOES_ON"): 0.125,
    (code_errors, "_MOSTLY"): 0.75,
    (code_errors, "_LEAST_BIT"): 64.0,
    (code_errors, "_NEAR_BIT"): 0.08,
    (resolution, "BEYOND_RANGE"): 1.002,
    (proposal, "_REGULAR_COUNTER"): 0.75,
    (plausibility, "_VANISHING"): 0.5,
    (plausibility, "_CENTRED"): 0.3,
    (plausibility, "_IN_TIME"): 0.97,
    (plausibility, "_LATER_FIT"): 0.05,
}


def test_no_constant_changes_unnoticed() -> None:
    for (module, name), value in CHOSEN.items():
        assert getattr(module, name) == pytest.approx(value), name
