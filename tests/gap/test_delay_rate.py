"""The growth of a sensor's delay behind a track, on moments of a sine with an increasing delay."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from imuarray.gap.statistics.campaign import Layout, LogSummary, PhaseSummary
from imuarray.gap.statistics.cross import CUBES, KINEMATIC, Cross
from imuarray.gap.statistics.probes import PROBES, ArrayProbe
from imuarray.log.format import Phase
from tests.gap.small_campaign import header

WINDOW_S, PACE = 0.05, 3.0
SENSOR = header()


def turn(at_s: float, late_s: float, tracked: bool = True) -> PhaseSummary:
    """A turn of 4 s about all three axes, by an instrument and by a sensor with this delay."""
    phase = Phase(round(1e9 * (at_s - 2)), round(1e9 * (at_s + 2)), "turn", "")
    change, lag = np.sin(PACE * WINDOW_S), PACE * late_s
    own, track = slice(0, 3), slice(3, 6)
    fast, turning, changes = np.zeros((3, 6 + KINEMATIC + CUBES, 6 + KINEMATIC + CUBES))
    for moments, size in ((fast, 0.5), (changes, change**2 / 2)):
        moments[own, own] = moments[track, track] = size * np.eye(3)
        moments[own, track] = moments[track, own] = size * np.cos(lag) * np.eye(3)
    turning[own, track] = -change * np.sin(lag) / 2 * np.eye(3)  # mean of sin(w t - w d) cos(w t)
    turning[track, own] = change * np.sin(lag) / 2 * np.eye(3)
    slow = np.zeros((0, len(fast)))
    cross = Cross((SENSOR,), phase, WINDOW_S, 80, slow, fast, turning, changes, (SENSOR.name,) if tracked else ())
    return PhaseSummary(phase, 0, Layout({}, 0), {}, cross)


def rate(turns: Sequence[PhaseSummary]) -> float:
    probe = PROBES["motion_delay_rate"]
    assert isinstance(probe, ArrayProbe)
    return float(probe.statistic(LogSummary("tumble", tuple(turns)), SENSOR.name))


@pytest.mark.parametrize("each_s", [3e-4, -4e-4])
def test_the_growth_of_the_delay_by_a_fast_clock(each_s: float) -> None:
    """A delay of 5 ms, and a clock error that increases it: the constant part has no influence."""
    assert rate([turn(at_s, 0.005 + each_s * at_s) for at_s in (10.0, 22.0, 41.0, 80.0)]) == pytest.approx(
        each_s, rel=0.02
    )


def test_a_constant_delay_has_no_growth() -> None:
    assert rate([turn(at_s, 0.005) for at_s in (10.0, 30.0, 50.0)]) == pytest.approx(0.0, abs=1e-9)


def test_two_turns_or_no_track_give_no_growth() -> None:
    assert np.isnan(rate([turn(at_s, 1e-3 * at_s) for at_s in (10.0, 30.0)]))
    assert np.isnan(rate([turn(at_s, 1e-3 * at_s, tracked=False) for at_s in (10.0, 30.0, 50.0)]))
