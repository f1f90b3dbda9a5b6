"""Single outlying readings in a motion of several sensors."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from imuarray.gap.recording.outliers import OutlierTally, outliers_in_motion
from imuarray.log import Log, open_log
from imuarray.log.format import Phase
from imuarray.simulate.effects.readings import Glitches
from imuarray.simulate.motion.hand_shake import HandShake
from imuarray.simulate.record import write_log
from tests.gap.small_campaign import SECOND, simulation

HIT_S = (8.004, 13.004, 21.004)
JUMP_G = 128 / 2048
"""Two of the high byte at 4 g (BMA-60)."""


@pytest.fixture(scope="module")
def shaken(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Log]:
    """Shaken by hand; three readings of A1's x have errors smaller than the change by the motion from row to row."""
    path: Path = tmp_path_factory.mktemp("shaken") / "log.h5"
    hit = Glitches(runs=(0.0,) * 3, moments_s=HIT_S, jumps=(JUMP_G, 0.0, 0.0) * 3)
    write_log(simulation(HandShake(peak_g=3.0, peak_dps=100.0, still_s=5, motion_s=20), {"A1": (hit,)}, seed=3), path)
    with open_log(path) as log:
        yield log


MOVING = Phase(6 * SECOND, 24 * SECOND, "motion", "")


def test_wrong_readings_have_the_largest_deviations(shaken: Log) -> None:
    """Each reading is at the next hundredth of a second; an error of 128 counts, with a noise of 8 and half of that of
    each neighbour, of both sensors: 14.
    """
    found = outliers_in_motion(shaken["A1"], [shaken["A2"]], MOVING)
    own = found.axis == 0
    order = np.argsort(-np.abs(found.deviation[own]))[:3]
    times_s = np.sort(found.time_ns[own][order]) * 1e-9
    np.testing.assert_allclose(times_s, [8.01, 13.01, 21.01], atol=0.002)
    np.testing.assert_allclose(found.deviation[own][order], 128.0, atol=4 * 14)


def test_the_motion_is_removed(shaken: Log) -> None:
    """On an axis without wrong readings the largest deviation is noise, without the other sensor a third more."""
    tally, span = OutlierTally(), shaken["A1"].between(MOVING.start_ns, MOVING.end_ns)
    tally.update(np.asarray(shaken["A1"].time[span]), np.asarray(shaken["A1"].counts[span], float).T)
    alone, beside = tally.result(), outliers_in_motion(shaken["A1"], [shaken["A2"]], MOVING)
    furthest = [np.abs(found.deviation[found.axis == 1]).max() for found in (alone, beside)]
    assert furthest[0] > 1.3 * furthest[1]


def test_without_another_sensor_there_are_no_outliers(shaken: Log) -> None:
    assert len(outliers_in_motion(shaken["A1"], [], MOVING).deviation) == 0
