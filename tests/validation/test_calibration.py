"""Rates of being right, from causes that were drawn with known ones, and from a run's folder."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from imuarray.validation.calibration import Told, program, rates_of, told_in
from imuarray.validation.score_answers import read_run
from tests.validation.made_run import Made, cause, put, said


def test_rates_are_found_again() -> None:
    """400 causes without a rival that close nothing, a quarter of them right, 400 that close all, 0.9 of them; a rival
    of equal odds takes half of either. Rates of 400 come within 0.08 but for one in a thousand.
    """
    random = np.random.default_rng(2)
    told = [
        Told(share, closed, bool(random.random() < share * chance))
        for closed, chance in ((0.0, 0.25), (1.0, 0.9))
        for share in (1.0, 0.5)
        for _ in range(400)
    ]
    assert rates_of(told) == pytest.approx((0.25, 0.9), abs=0.08)
    assert all(map(math.isnan, rates_of([])))


def test_a_run(tmp_path: Path) -> None:
    """Right, of another sensor, and one that has no share; a pair counts, what has to go doesn't."""
    made = Made(tmp_path)
    right, other = (cause("tone", 0.7, sensor, share=0.95, all_closed=0.9) for sensor in ("Gyro1", "Gyro3"))
    made.both("single", said(right, other, cause("axis_error", 0.9, share=None)), put("mains_ripple"))
    made.both("pair", said(cause("scale", 0.7, share=0.4, all_closed=None)), put("mains_ripple"), put("torn_reads"))
    made.both("removal", said(right), extra={"effect": "tone", "sensor": "Gyro1"})
    told = list(told_in(read_run(tmp_path).answers))
    assert told == [Told(0.95, 0.9, True), Told(0.95, 0.9, False), Told(0.4, 0.0, False)]
    printed = CliRunner().invoke(program, [str(tmp_path)]).output
    assert printed.startswith("3 causes, 1 right; without a rival 2:\n")
    assert "0.90 to 0.95 closed: 0.50 of 2" in printed
