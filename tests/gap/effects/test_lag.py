"""How far a sensor is behind the others, by moments of their readings."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from imuarray.gap.inference.effects import glitches
from imuarray.gap.inference.effects.lag import lags
from imuarray.gap.statistics.cross import Cross
from imuarray.simulate.effects.glitches import Glitches
from imuarray.simulate.effects.skew import Skew
from tests.gap.effects.evidence_of import evidence_of
from tests.selection import some

WINDOW_S = 0.05


def behind(cross: Cross, late_s: float, pace: float) -> Cross:
    """A1 that much behind A2 in sines of one angular frequency along all axes of the box, which are independent."""
    turned = np.array(cross.header("A1").orientation).T @ np.array(cross.header("A2").orientation)
    change, lag = np.sin(pace * WINDOW_S), pace * late_s
    own, other = cross.columns("A1"), cross.columns("A2")
    fast, turning, changes = np.zeros((3, *cross.fast.shape))
    for moments, same, across in (
        (fast, 0.5, 0.5 * np.cos(lag)),
        (changes, change**2 / 2, change**2 / 2 * np.cos(lag)),
    ):
        moments[own, own] = moments[other, other] = same * np.eye(3)
        moments[own, other], moments[other, own] = across * turned, across * turned.T
    turning[own, other] = -change * np.sin(lag) / 2 * turned  # sin(w t - w d) cos(w t) in the mean
    turning[other, own] = change * np.sin(lag) / 2 * turned.T
    return replace(cross, window_s=WINDOW_S, fast=fast, turning=turning, changes=changes)


@pytest.mark.parametrize("late_s", some([0.003, -0.02], 1))
@pytest.mark.parametrize("frequency_hz", [0.5, 2.0, 4.5])
def test_a_sine_of_any_frequency(frequency_hz: float, late_s: float) -> None:
    """Below a quarter of the windows' rate, 5 Hz: a fast motion changes less from window to window than it goes."""
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


def test_torn_readings_are_a_row_late_in_the_mean() -> None:
    """So many that none stands alone: a third of 60 % on each axis. A sensor that is a tenth of a second late is more
    than a row behind, and not torn.
    """
    evidence = evidence_of("motion", "G1", {"G1": (Glitches(0.6, kind="torn"),)})
    found = [trial.effects[0] for trial in glitches.guesses(evidence) if trial.free == ("probability",)]
    assert any(
        isinstance(one, Glitches) and one.kind == "torn" and one.probability == pytest.approx(0.6, rel=0.3)
        for one in found
    )
    late = evidence_of("motion", "A1", {"A1": (Skew(0.1),)})
    assert not [trial for trial in glitches.guesses(late) if trial.free == ("probability",)]
