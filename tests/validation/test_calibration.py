"""Rates of right causes, from causes that were drawn with known rates, and from a folder of a run."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from imuarray.validation.calibration import CauseClaim, claims_in, confusable_pairs, cross_validate, fit_rates, program
from imuarray.validation.score_answers import read_run
from tests.validation.run_folder import RunFolder, cause, gap_diagnosis, put


@pytest.mark.slow
def test_known_rates_are_estimated() -> None:
    """800 causes each that close none, a half and all of the gap, half of them with odds of 27 to 1 against a rival,
    half without a rival (10000 to 1): by the third root worth 3 and 21.5 to 1. Drawn from 0.25 and 0.9 and squares;
    shares of 400 are within 0.08 except for one in a thousand.
    """
    random = np.random.default_rng(2)
    claims = [
        CauseClaim(share, closed, bool(random.random() < worth * (0.25 + 0.65 * closed**2)))
        for closed in (0.0, 0.5, 1.0)
        for share, worth in ((1.0, 21.5 / 22.5), (27 / 28, 0.75))
        for _ in range(400)
    ]
    rates = fit_rates(claims)
    assert (rates.least, rates.most) == pytest.approx((0.25, 0.9), abs=0.08)
    assert rates.least + (rates.most - rates.least) * 0.5**rates.steep == pytest.approx(0.4125, abs=0.08)
    assert 27**rates.rivals / (1 + 27**rates.rivals) == pytest.approx(0.75, abs=0.08)
    assert all(map(math.isnan, fit_rates([])))


def test_causes_of_a_run_are_counted_as_right_or_wrong(tmp_path: Path) -> None:
    """A right cause, a cause at another sensor, and a cause without a share; a pair is counted, an effect to remove is
    not.
    """
    run = RunFolder(tmp_path)
    right, other = (cause("tone", 0.7, sensor, share=0.95, all_closed=0.9) for sensor in ("Gyro1", "Gyro3"))
    run.both("single", gap_diagnosis(right, other, cause("axis_error", 0.9, share=None)), put("mains_ripple"))
    run.both(
        "pair", gap_diagnosis(cause("scale", 0.7, share=0.4, all_closed=None)), put("mains_ripple"), put("torn_reads")
    )
    run.both("removal", gap_diagnosis(right), extra={"effect": "tone", "sensor": "Gyro1"})
    claims = claims_in(read_run(tmp_path).answers)
    assert claims == [CauseClaim(0.95, 0.9, True), CauseClaim(0.95, 0.9, False), CauseClaim(0.4, 0.0, False)]
    printed = CliRunner().invoke(program, [str(tmp_path)]).output
    assert printed.startswith("3 causes, 1 right; without a rival 2:\n")
    assert "0.90 to 0.95 closed: 0.50 of 2" in printed


def test_confusions_are_counted(tmp_path: Path) -> None:
    """Three of four ripples: one is named a scale, two a tone, one a jitter; a case without a cause is
    not a confusion.
    """
    run = RunFolder(tmp_path)
    for first in ("scale", "scale", "tone", "tone", "tone", "jitter"):
        run.both("single", gap_diagnosis(cause(first)), put("mains_ripple"))
    run.both("single", gap_diagnosis(verdict="unexplained"), put("mains_ripple"))
    (pair,) = confusable_pairs(read_run(tmp_path).answers)
    assert pair == ("tone", "scale", 2, 6)


@pytest.mark.slow
def test_probabilities_are_scored_by_rates_of_other_worlds(tmp_path: Path) -> None:
    """Where every cause with a share of 0.95 that closes nine tenths is right in half of the cases, rates fitted to
    some predict about a half for the others; for a second kind of world in which they are never right the prediction is
    far off.
    """
    run = RunFolder(tmp_path)
    diagnosis = gap_diagnosis(cause("tone", 0.9, share=0.95, all_closed=0.9))
    for number in range(60):
        run.both("single", diagnosis, put("mains_ripple" if number % 2 else "torn_reads"))
    other = RunFolder(tmp_path / "other")
    for _ in range(20):
        other.both("single", diagnosis, put("torn_reads"))
    answers = read_run(tmp_path).answers
    strange = [replace(answer, case=replace(answer.case, world="foreign")) for answer in read_run(other.folder).answers]
    own, *moved = cross_validate([*answers, *strange])
    assert own.part == "other worlds"
    assert own.causes == 80
    (there,) = [answer for answer in moved if answer.part == "foreign, fitted to fixed plans"]
    assert there.error == pytest.approx(0.5, abs=0.05)
