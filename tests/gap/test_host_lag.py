"""The lag of all sensors of a log behind its track."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from imuarray.arrays import Integers
from imuarray.gap.recording.host_lag import HostLag, host_lags
from imuarray.log import open_log
from imuarray.simulate.effect import Effect
from imuarray.simulate.effects.timing import ClockError, Skew
from imuarray.simulate.motion.faces import Still
from imuarray.simulate.motion.hand_shake import HandShake
from imuarray.simulate.motion.stimulus import BoxStimulus
from imuarray.simulate.record import write_log
from tests.gap.small_campaign import simulation
from tests.selection import some

SHAKEN = HandShake(peak_g=0.5, peak_dps=150.0, still_s=5, motion_s=20)
SENSORS = ("A1", "A2", "G1", "G2")


def lags(folder: Path, *effects: Effect) -> tuple[HostLag, ...]:
    """The lags of sensors that all have these effects."""
    path = folder / "log.h5"
    write_log(simulation(SHAKEN, dict.fromkeys(SENSORS, effects), seed=2), path)
    with open_log(path) as log:
        return host_lags([log[name] for name in SENSORS], SHAKEN)


@pytest.mark.parametrize(
    ("effect", "late_s", "rate"),
    some([(ClockError(-4000.0), 0.0, 4e-3), (ClockError(9000.0), 0.0, -9e-3), (Skew(0.03), 0.03, 0)], 1),
)
def test_the_lag_by_a_clock_error(tmp_path: Path, effect: Effect, late_s: float, rate: float) -> None:
    """A clock that is fast by 4000 ppm is 4 ms ahead after a second."""
    at_s, lag_s, error_s = np.array(lags(tmp_path, effect)).T
    assert len(at_s) >= 4
    assert ((at_s > 4) & (at_s < 26)).all()
    np.testing.assert_allclose(lag_s, late_s + rate * at_s, atol=2e-3)
    assert (error_s < 2e-3).all()


def test_no_lag_is_estimated_without_motion(tmp_path: Path) -> None:
    path = tmp_path / "log.h5"
    write_log(simulation(Still(seconds=20), {}, seed=2), path)
    with open_log(path) as log:
        assert not host_lags([log[name] for name in SENSORS], Still(seconds=20))
        assert not host_lags([], Still(seconds=20))


@dataclass(frozen=True)
class Swing(Still):
    """Turns to and fro about the box's x axis at a rate of 100 dps, 1.2 times a second, all the time."""

    def stimulus(self, time_ns: Integers) -> BoxStimulus:
        """The stimulus of the box."""
        rate = np.zeros((len(time_ns), 3))
        rate[:, 0] = math.radians(100) * np.sin(2 * math.pi * 1.2 * np.asarray(time_ns) * 1e-9)
        return replace(super().stimulus(time_ns), rate_box=rate)


@pytest.mark.parametrize("late_s", some([0.0, 0.004, 0.013], 1))
def test_the_lag_of_a_periodic_motion_is_not_determined(tmp_path: Path, late_s: float) -> None:
    """For any lag between two rows of the grid: the lags of a periodic motion are known up to its period."""
    path, motion = tmp_path / "log.h5", Swing(seconds=20)
    write_log(simulation(motion, {"G1": (Skew(late_s),)}, seed=2), path)
    with open_log(path) as log:
        assert not host_lags([log["G1"]], motion)
