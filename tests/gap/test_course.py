"""Stretches of windows whose statistics differ from those of the rest."""

from __future__ import annotations

import numpy as np

from imuarray.gap.recording.course import changes


def test_a_sensor_that_is_stuck_for_most_windows_has_no_stretch() -> None:
    """Without scatter nothing tells how clear a difference is; the other statistic still does."""
    statistics = np.zeros((40, 2))
    statistics[:5, 0] = 0.1
    assert not list(changes(statistics, np.zeros(2)))
    statistics[:, 1] = np.random.default_rng(3).normal(0, 1, 40)
    statistics[10:20, 1] += 30
    (change,) = changes(statistics, np.zeros(2))
    assert np.flatnonzero(change.inside).tolist() == list(range(10, 20))


def test_a_hole_in_a_stretch_is_none_of_it() -> None:
    """Windows 10 to 19 and 23 to 34 of 40 lie higher: the clearest stretch is from 10 to 34, with three in it that are
    as the rest.
    """
    statistics = np.random.default_rng(3).normal(0, 1, (40, 1))
    statistics[10:35] += 20
    statistics[20:23] -= 20
    first, *_ = changes(statistics, np.zeros(1))
    assert np.flatnonzero(first.inside).tolist() == [*range(10, 20), *range(23, 35)]
