"""Smooth steps and stretches."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.polynomial import Polynomial

from imuarray.simulate.motion.hand_shake import HandShake
from imuarray.simulate.motion.timeline import consecutive, smooth_step, smooth_step_area

STEP = Polynomial([0, 0, 0, 0, 35, -84, 70, -20])


def test_smooth_step_is_the_polynomial_and_its_derivatives() -> None:
    share = np.linspace(0, 1, 101)
    for order, values in enumerate(smooth_step(share)):
        assert values == pytest.approx(STEP.deriv(order)(share) if order else STEP(share), abs=1e-12)
    assert smooth_step_area(share) == pytest.approx(STEP.integ()(share), abs=1e-12)


def test_smooth_step_beyond_its_ends() -> None:
    beyond = np.array([-3.0, 0.0, 1.0, 4.0])
    step, *derivatives = smooth_step(beyond)
    assert step.tolist() == [0.0, 0.0, 1.0, 1.0]
    assert not np.any(derivatives)
    assert smooth_step_area(beyond) == pytest.approx([0.0, 0.0, 0.5, 3.5])  # symmetric: half of its length


def test_consecutive_phases_and_motion_times_are_computed() -> None:
    assert [tuple(p) for p in consecutive(("a", 5, "+X"), ("b", 7, ""))] == [(0, 5, "a", "+X"), (5, 12, "b", "")]
    shake = HandShake(still_s=2.0, motion_s=3.0)
    assert shake.seconds == 7.0
    times = np.array([-1, 0, 2, 3, 5, 9]) * 10**9
    assert shake.moved_s(times) == pytest.approx([0, 0, 0, 1, 3, 3])
