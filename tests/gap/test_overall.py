"""What is left to the same side everywhere, on statistics made by hand."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest

from imuarray.gap.inference.assessment import LEAST, GroupResidual, group_residuals
from imuarray.gap.statistics.catalogue import Key
from imuarray.gap.statistics.synthetic_likelihood import FORM, likelihood_of

Floats = npt.NDArray[np.float64]

PHASES, REPLICATES = 40, 32
KEYS = [
    Key(0, sensor, axis, "static", phase, "distribution", probe)
    for sensor in ("G1", "G2")
    for probe in ("skewness", "kurtosis")
    for axis in "xyz"
    for phase in range(PHASES)
]


def chance(rows: int, seed: int) -> Floats:
    return np.random.default_rng(seed).normal(size=(rows, len(KEYS)))


def of(sensor: str, probe: str, axis: str = "") -> npt.NDArray[np.bool_]:
    return np.array([(key.sensor, key.probe) == (sensor, probe) and axis in ("", key.axis) for key in KEYS])


def told(real: Floats, replicates: Floats, moved_from: float = 0.0) -> list[GroupResidual]:
    floor = np.zeros(len(KEYS))
    before = likelihood_of(replicates - moved_from, floor)
    return group_residuals(KEYS, before, likelihood_of(replicates, floor), real, replicates)


def test_where_nothing_is_left_it_goes_no_further_than_chance() -> None:
    """Of 60 recordings like their own replicates, the worst is the furthest of all 33 in 1 of 33: none to 7 of them
    with a probability of 0.999 (binomial), and beyond that by a quarter hardly ever.
    """
    scores = []
    for seed in range(60):
        drawn = chance(REPLICATES + 1, seed)
        worst = told(drawn[0], drawn[1:])[0]
        scores.append(abs(worst.score) / worst.furthest)
    assert sum(score > 1 for score in scores) <= 7
    assert sum(score > 1.25 for score in scores) <= 1


def test_one_standard_deviation_everywhere_is_far() -> None:
    """The mean of 120 independent ones scatters by 0.091, which 32 replicates tell to 13 %."""
    real = chance(1, 1)[0]
    real[of("G1", "skewness")] += 1.0
    found = told(real, chance(REPLICATES, 2))
    assert (found[0].sensor, found[0].axis, found[0].probe) == ("G1", "", "skewness")
    assert found[0].score == pytest.approx(120**0.5, rel=0.35)
    np.testing.assert_array_equal(found[0].places, np.flatnonzero(of("G1", "skewness")))
    own = {one.axis: one.score for one in found if (one.sensor, one.probe) == ("G1", "skewness")}
    assert min(own.values()) > 3.5  # 40^0.5 = 6.3 of each axis
    assert max(abs(one.score) for one in found if (one.sensor, one.probe) != ("G1", "skewness")) < found[0].furthest


def test_rare_spikes_of_either_sign_are_no_one_sided_noise() -> None:
    """A model that makes skewness scatter to 5 takes each of 5 for likely, and all of one sign for none of its own."""
    own = of("G1", "skewness")
    replicates, real = chance(REPLICATES, 3), chance(1, 4)[0]
    replicates[:, own] *= 5.0
    real[own] = np.abs(real[own] * 5.0)
    found = told(real, replicates)
    assert (found[0].sensor, found[0].probe) == ("G1", "skewness")
    assert found[0].score > 1.25 * found[0].furthest


def test_the_causes_may_miss_a_twentieth_of_what_they_move() -> None:
    """Moved by 20 and 1 too far, as much as is excused: at most one standard deviation of that."""
    real = chance(1, 5)[0] + 20 * FORM
    found = told(real, chance(REPLICATES, 6), moved_from=20.0)
    assert max(abs(one.score) for one in found) < 1.5
    assert max(abs(one.score) for one in told(real, chance(REPLICATES, 6))) > 5.0


def test_one_wild_statistic_stands_for_one() -> None:
    real = chance(1, 7)[0]
    real[np.flatnonzero(of("G2", "kurtosis", "y"))[0]] = 1e6
    assert max(abs(one.score) for one in told(real, chance(REPLICATES, 8))) < 5.0


def test_few_statistics_say_nothing_together() -> None:
    real, replicates = chance(1, 9)[0], chance(REPLICATES, 10)
    few = LEAST - 1
    before = likelihood_of(replicates[:, :few], np.zeros(few))
    assert group_residuals(KEYS[:few], before, before, real[:few], replicates[:, :few]) == []


def test_how_axes_hang_together_is_left_aside() -> None:
    keys = [key._replace(domain="cross_sensor", probe="slow_own_axes") for key in KEYS]
    real, replicates = chance(1, 11)[0] + 5.0, chance(REPLICATES, 12)
    before = likelihood_of(replicates, np.zeros(len(KEYS)))
    assert group_residuals(keys, before, before, real, replicates) == []
