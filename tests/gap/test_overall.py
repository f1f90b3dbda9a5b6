"""Common remainders of one sign, on statistics made by hand."""

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


def test_without_a_remainder_the_result_is_that_of_chance() -> None:
    """Of 60 recordings like their own replicates, the recording is the largest of all 33 in 1 of 33: none to 7 of them
    with a probability of 0.999 (binomial), and very rarely by more than a quarter.
    """
    scores = []
    for seed in range(60):
        drawn = chance(REPLICATES + 1, seed)
        worst = told(drawn[0], drawn[1:])[0]
        scores.append(abs(worst.score) / worst.furthest)
    assert sum(score > 1 for score in scores) <= 7
    assert sum(score > 1.25 for score in scores) <= 1


def test_one_standard_deviation_everywhere_is_significant() -> None:
    """The mean of 120 independent statistics scatters by 0.091, which 32 replicates determine to 13 %."""
    real = chance(1, 1)[0]
    real[of("G1", "skewness")] += 1.0
    found = told(real, chance(REPLICATES, 2))
    assert (found[0].sensor, found[0].axis, found[0].probe) == ("G1", "", "skewness")
    assert found[0].score == pytest.approx(120**0.5, rel=0.35)
    np.testing.assert_array_equal(found[0].places, np.flatnonzero(of("G1", "skewness")))
    own = {one.axis: one.score for one in found if (one.sensor, one.probe) == ("G1", "skewness")}
    assert min(own.values()) > 3.5  # 40^0.5 = 6.3 for each axis
    assert max(abs(one.score) for one in found if (one.sensor, one.probe) != ("G1", "skewness")) < found[0].furthest


def test_rare_spikes_of_either_sign_are_not_a_common_remainder() -> None:
    """With a model that scatters skewness to 5 each value of 5 is likely, but not all of one sign."""
    own = of("G1", "skewness")
    replicates, real = chance(REPLICATES, 3), chance(1, 4)[0]
    replicates[:, own] *= 5.0
    real[own] = np.abs(real[own] * 5.0)
    found = told(real, replicates)
    assert (found[0].sensor, found[0].probe) == ("G1", "skewness")
    assert found[0].score > 1.25 * found[0].furthest


def test_causes_may_have_an_error_of_a_twentieth_of_their_shift() -> None:
    """Moved by 20 and 1 too far, which is allowed: at most one standard deviation of that."""
    real = chance(1, 5)[0] + 20 * FORM
    found = told(real, chance(REPLICATES, 6), moved_from=20.0)
    assert max(abs(one.score) for one in found) < 1.5
    assert max(abs(one.score) for one in told(real, chance(REPLICATES, 6))) > 5.0


def test_one_outlying_statistic_has_the_weight_of_one() -> None:
    real = chance(1, 7)[0]
    real[np.flatnonzero(of("G2", "kurtosis", "y"))[0]] = 1e6
    assert max(abs(one.score) for one in told(real, chance(REPLICATES, 8))) < 5.0


def test_few_statistics_are_not_combined() -> None:
    real, replicates = chance(1, 9)[0], chance(REPLICATES, 10)
    few = LEAST - 1
    before = likelihood_of(replicates[:, :few], np.zeros(few))
    assert group_residuals(KEYS[:few], before, before, real[:few], replicates[:, :few]) == []


def test_statistics_between_axes_are_not_combined() -> None:
    keys = [key._replace(domain="cross_sensor", probe="slow_own_axes") for key in KEYS]
    real, replicates = chance(1, 11)[0] + 5.0, chance(REPLICATES, 12)
    before = likelihood_of(replicates, np.zeros(len(KEYS)))
    assert group_residuals(keys, before, before, real, replicates) == []
