"""Pooled scores of the statistics of a sensor in a log, on drawn normal numbers."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest

from imuarray.gap.inference.assessment import localise, p_value
from imuarray.gap.statistics.catalogue import Key
from imuarray.gap.statistics.pooled import BEYOND, FEWEST_PLACES, PooledScores, equal_shares, pooled_scores
from imuarray.gap.statistics.probes import PROBES
from imuarray.log.format import SensorHeader
from tests.selection import some

Floats = npt.NDArray[np.float64]

PHASES = 7


def keys(probe: str, sensor: str = "A1", axes: str = "xyz", phases: int = PHASES) -> list[Key]:
    return [
        Key(0, sensor, axis, "pose", phase, PROBES[probe].domain, probe) for phase in range(phases) for axis in axes
    ]


ALL = [*keys("absent_codes"), *keys("odd_codes"), *keys("mean"), *keys("noise")]
MOVING = [*ALL, *keys("motion_delay"), *keys("motion_residual")]


def normal(random: np.random.Generator, *, shared: float = 0.0, count: int = len(ALL)) -> Floats:
    """Scores of 41 campaigns; a share of their variance is common to all places of a campaign."""
    common = random.standard_normal((41, 1))
    return np.sqrt(1 - shared) * random.standard_normal((41, count)) + np.sqrt(shared) * common


def p_of(scores: PooledScores) -> float:
    largest = np.nan_to_num(np.abs(scores.scores)).max(axis=1)
    return p_value(largest[0], largest[1:])


@pytest.mark.slow
@pytest.mark.parametrize("shared", some([0.5, 0.0], 1))
def test_rate_of_false_alarms(shared: float) -> None:
    """False alarms at 5 % (2 of 41): 400 campaigns without a gap, whose places may depend on each other, have between
    8 and 34 of them with a probability of 0.997.
    """
    random = np.random.default_rng(4)
    count = len(MOVING)
    alarms = sum(p_of(pooled_scores(normal(random, shared=shared, count=count), MOVING)) <= 0.05 for _ in range(400))
    assert 8 <= alarms <= 34


def test_deviations_in_many_places_are_detected() -> None:
    """2.6 standard deviations in each of 21 of 84 places: chance gives as much in one of 107 places, not in 21."""
    scores = normal(np.random.default_rng(5))
    scores[0, :21] = 2.6
    pooled = pooled_scores(scores, ALL)
    assert p_value(float(np.abs(scores[0]).max()), np.abs(scores[1:]).max(axis=1)) > 0.1
    assert p_of(pooled) == pytest.approx(1 / 41)


def test_a_slight_shift_of_every_place_is_not_a_gap() -> None:
    """A fit that is slightly wrong shifts all places alike, by less than a standard deviation."""
    scores = normal(np.random.default_rng(7))
    scores[0] = 0.95 * BEYOND
    assert BEYOND == 1.0
    assert p_of(pooled_scores(scores, ALL)) == 1.0


def test_each_log_is_pooled_and_all_logs_together() -> None:
    """Of three logs of two sensors, one deviates: its pool is the furthest, and leads to its strongest place."""
    several = [key._replace(log=log, sensor=sensor) for sensor in ("A1", "A2") for log in range(3) for key in ALL]
    scores = np.random.default_rng(6).standard_normal((41, len(several)))
    of_log = [at for at, key in enumerate(several) if (key.sensor, key.log) == ("A2", 1)]
    scores[0, of_log[:21]] = np.where(np.arange(21) == 5, -4.0, 2.6)
    pooled = pooled_scores(scores, several)
    assert pooled.scores.shape == (41, 2 * (3 + 1))
    furthest = int(pooled.scores[0].argmax())
    assert pooled.places[furthest] == of_log[5]
    assert p_of(pooled) == pytest.approx(1 / 41)


def test_axes_with_the_same_response_to_a_motion_are_summed() -> None:
    """A delay of 2.8 standard deviations on each of three axes is 2.8 sqrt(3) = 4.8 for the sensor; with another sign
    on one axis it is 1.6, which chance exceeds.
    """
    moving = keys("motion_delay", phases=4)
    scores = np.random.default_rng(9).standard_normal((41, len(moving)))
    scores[0] = [2.8 if key.phase_number == 2 else 0.0 for key in moving]
    pooled = pooled_scores(scores, moving)
    assert pooled.scores.shape == (41, 1 + 4)
    assert int(pooled.scores[0, 1:].argmax()) == 2
    assert moving[pooled.places[3]].phase_number == 2
    assert p_of(pooled) == pytest.approx(1 / 41)
    scores[0, [at for at, key in enumerate(moving) if key.axis == "y"]] *= -1
    assert p_value(*_largest_sum(pooled_scores(scores, moving))) > 0.1


def _largest_sum(pooled: PooledScores) -> tuple[float, Floats]:
    largest = np.abs(pooled.scores[:, 1:]).max(axis=1)
    return float(largest[0]), largest[1:]


def test_few_places_are_not_pooled() -> None:
    few = keys("absent_codes", phases=1, axes="xyz")
    assert len(few) < FEWEST_PLACES
    assert pooled_scores(np.ones((41, len(few))), few).scores.shape == (41, 0)


def test_places_without_a_value_have_no_weight() -> None:
    scores = normal(np.random.default_rng(8))
    scores[:, 5:21] = np.nan
    pooled = pooled_scores(scores, ALL)
    assert np.isfinite(pooled.scores).all()
    assert p_of(pooled) > 0.05


def test_each_domain_has_the_same_share_of_the_level() -> None:
    """Half of the statistics are of codes, a quarter of levels and a quarter of noise: 3 in a quarter is as rare as the
    root of 9 + 2 ln 4. Statistics without a value do not count.
    """
    scores = np.full((2, len(ALL)), -3.0)
    shares = equal_shares(scores, ALL)
    np.testing.assert_allclose(shares[:, [0, 21, 42, 63]], [[3.2228, 3.2228, 3.4311, 3.4311]] * 2, rtol=1e-4)
    scores[:, :21] = np.nan
    np.testing.assert_allclose(equal_shares(scores, ALL)[:, 21:], np.sqrt(9 + 2 * np.log(3)))


def test_the_largest_pooled_scores_have_a_share_of_the_level_of_single_statistics() -> None:
    """Median and 90 % quantile of a campaign's largest score, for any number and tails of pools: z of a pool is as rare
    as the root of z^2 + 2.408 of a single score, whose share is 1 / 0.3 times as large.
    """
    heavy = np.random.default_rng(9).standard_t(4, size=(41, len(ALL)))
    pooled = np.abs(pooled_scores(heavy, ALL).scores).max(axis=1)
    single = equal_shares(heavy, ALL).max(axis=1)
    quantiles = np.quantile(pooled, [0.5, 0.9])
    np.testing.assert_allclose(np.sqrt(quantiles**2 + 2.408), np.quantile(single, [0.5, 0.9]), rtol=1e-4)


def test_a_slow_change_of_all_axes_is_summed() -> None:
    """2.5 in the mean of each half on three axes is 4.3 together; in the noise, whose axes are independent, 2.5."""
    slow = [*keys("noise", phases=60), *keys("mean_halves", phases=1)]
    scores = np.random.default_rng(4).standard_normal((41, len(slow)))
    scores[0] = 0.0
    scores[0, :3] = 2.5
    assert p_of(pooled_scores(scores, slow)) > 0.2
    scores[0] = np.roll(scores[0], -3)
    assert p_of(pooled_scores(scores, slow)) == pytest.approx(1 / 41)


def test_the_tree_names_the_strongest_place() -> None:
    headers = {"A1": SensorHeader("A1", "adxl345", "specific_force", "g", 2.0, 256.0)}
    scores = normal(np.random.default_rng(5))
    scores[0, :21] = 2.6
    scores[0, 4] = 2.61
    single = localise(ALL, headers, scores[0], scores[1:])
    pooled = localise(ALL, headers, scores[0], scores[1:], pooled_scores(scores, ALL))
    assert (single.is_gap, pooled.is_gap) == (False, True)
    assert single.limit == pooled.limit
    assert 4 in pooled.p_by_place
    assert {ALL[place].probe for place in pooled.p_by_place} == {"absent_codes"}
