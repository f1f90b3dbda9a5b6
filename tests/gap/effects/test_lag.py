"""The lag of a sensor behind the others, by moments of their readings."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest

from imuarray.gap.inference.effects import CANDIDATES
from imuarray.gap.inference.effects.timing import lags
from imuarray.gap.statistics.cross import Cross
from imuarray.simulate.effects.readings import Glitches
from imuarray.simulate.effects.timing import Skew
from tests.gap.effects.evidence_of import evidence_of
from tests.selection import some

Floats = npt.NDArray[np.float64]

WINDOW_S = 0.05


ALL_AXES, ONE_AXIS = np.eye(3), np.outer([0.8, 0.6, 0.0], [0.8, 0.6, 0.0])
"""Second moments of the motion along the box's axes: of independent ones, and about a single axis."""


def behind(cross: Cross, late_s: float, pace: float, motion_box: Floats = ALL_AXES, noise: float = 0.0) -> Cross:
    """A1 with this lag behind A2 in sines of one angular frequency with these moments, and noise."""
    turns = {name: np.array(cross.header(name).orientation) for name in ("A1", "A2")}
    change, lag = np.sin(pace * WINDOW_S), pace * late_s
    own, other = cross.columns("A1"), cross.columns("A2")
    seen = {(a, b): turns[a].T @ motion_box @ turns[b] for a in turns for b in turns}
    fast, turning, changes = np.zeros((3, *cross.fast.shape))
    for moments, same, across in (
        (fast, 0.5, 0.5 * np.cos(lag)),
        (changes, change**2 / 2, change**2 / 2 * np.cos(lag)),
    ):
        moments[own, own] = same * seen["A1", "A1"] + noise * np.eye(3)
        moments[other, other] = same * seen["A2", "A2"] + noise * np.eye(3)
        moments[own, other], moments[other, own] = across * seen["A1", "A2"], across * seen["A2", "A1"]
    turning[own, other] = -change * np.sin(lag) / 2 * seen["A1", "A2"]  # mean of sin(w t - w d) cos(w t)
    turning[other, own] = change * np.sin(lag) / 2 * seen["A2", "A1"]
    return replace(cross, window_s=WINDOW_S, fast=fast, turning=turning, changes=changes)


@pytest.mark.parametrize("late_s", some([0.003, -0.02], 1))
@pytest.mark.parametrize("frequency_hz", some([4.5, 2.0, 0.5], 1))
def test_the_lag_of_a_sine_of_any_frequency(frequency_hz: float, late_s: float) -> None:
    """Below a quarter of the rate of windows, 5 Hz: differences between windows underestimate a fast motion."""
    evidence = evidence_of("motion", "A1")
    pace = 2 * np.pi * frequency_hz
    seen = tuple(
        one if one.cross is None else replace(one, cross=behind(one.cross, late_s, pace)) for one in evidence.phases
    )
    found = list(lags(replace(evidence, phases=seen, expected={})))
    assert found
    for one in found:
        assert one.lag_s == pytest.approx(late_s, rel=1e-6)
        assert one.pace == pytest.approx(pace, rel=1e-6)


def test_the_lag_in_a_rotation_about_a_single_axis() -> None:
    """Readings along all axes are proportional, and a regression on three axes cannot separate them."""
    evidence, pace = evidence_of("motion", "A1"), 2 * np.pi
    seen = tuple(
        each if each.cross is None else replace(each, cross=behind(each.cross, 0.006, pace, ONE_AXIS, 1e-6))
        for each in evidence.phases
    )
    for lag in lags(replace(evidence, phases=seen, expected={})):
        assert lag.lag_s == pytest.approx(0.006, rel=1e-3)


@pytest.mark.slow
def test_torn_readings_are_suggested_from_their_mean_lag() -> None:
    """Too many for single outliers: a third of 60 % on each axis. A sensor with a lag of a tenth of a second is more
    than a row late, and not torn.
    """
    evidence = evidence_of("motion", "G1", {"G1": (Glitches(0.6, kind="torn"),)})
    found = [trial.effects[0] for trial in CANDIDATES["glitches"].guesses(evidence) if trial.free == ("probability",)]
    assert any(
        isinstance(one, Glitches) and one.kind == "torn" and one.probability == pytest.approx(0.6, rel=0.3)
        for one in found
    )
    late = evidence_of("motion", "A1", {"A1": (Skew(0.1),)})
    assert not [trial for trial in CANDIDATES["glitches"].guesses(late) if trial.free == ("probability",)]
