"""Populations: draws from a table of mean, sigma, limit and shared, and their independence of everything else."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import kstest, norm, truncnorm

from imuarray.errors import ConfigError
from imuarray.log.format import SensorHeader
from imuarray.simulate.effect import spelled
from imuarray.simulate.effects.noise import WhiteNoise
from imuarray.simulate.population import Figure, Spread, at_ends, drawn, figure_of, table_of
from imuarray.simulate.streams import Streams

MakeSensor = Callable[..., SensorHeader]
KEYS = spelled(WhiteNoise, "g")


def values(figure: Figure, sensor: SensorHeader, seed: int = 0) -> list[float]:
    """The draws of a sensor for a figure of three axes."""
    result = drawn({"rms_g": figure}, KEYS, "white_noise", sensor, Streams(seed))["rms_g"]
    return list(result)


@given(
    mean=st.floats(-10, 10),
    sigma=st.floats(1e-3, 10),
    cut=st.floats(0.01, 6),
    deviate=st.floats(-5, 5),
)
def test_a_unit_is_at_the_quantile_of_the_truncated_normal(
    mean: float, sigma: float, cut: float, deviate: float
) -> None:
    """A normal redrawn until it lies within the limit is the truncated normal, by definition of the latter."""
    population = truncnorm(-cut, cut, loc=mean, scale=sigma)
    result = Spread(mean=mean, sigma=sigma, limit=cut * sigma).at(deviate)
    assert result == pytest.approx(population.ppf(norm.cdf(deviate)), abs=1e-6 * sigma)


def test_without_a_limit_draws_end_at_three_sigma() -> None:
    spread = Spread(mean=1.0, sigma=2.0)
    assert spread.reach == 6.0
    assert spread.at(9.0) == pytest.approx(7.0, abs=1e-4)
    assert spread.at(-40.0) == -5.0
    assert spread.at(0.0) == 1.0


@pytest.mark.parametrize("spread", [Spread(mean=4.0, sigma=0.0, limit=1.0), Spread(mean=4.0, sigma=1.0, limit=0.0)])
def test_a_population_without_spread_gives_the_mean(spread: Spread) -> None:
    assert spread.at(2.5) == 4.0
    assert spread.reach == 0.0


def test_draws_are_those_of_repeated_normals(sensor: MakeSensor) -> None:
    """Kolmogorov-Smirnov on 6000 draws at a fixed seed; one seed of a thousand would fail."""
    spread = Spread(mean=-1.0, sigma=0.5, limit=1.0)
    result = np.array([values(spread, sensor(name=f"S{number}"), seed=5) for number in range(2000)])
    again = np.random.default_rng(8).normal(-1.0, 0.5, 200_000)
    again = again[np.abs(again + 1.0) <= 1.0]
    assert kstest(result.ravel(), again).pvalue > 1e-3
    assert np.abs(result + 1.0).max() <= 1.0
    axes = np.corrcoef(result.T)[~np.eye(3, dtype=bool)]
    assert np.abs(axes).max() < 4.4 / np.sqrt(2000)  # 4.4 sigma: three pairs, one false alarm in 30 000 seeds


@pytest.mark.slow
def test_the_shared_part_is_common_to_sensors_of_a_chip_only(sensor: MakeSensor) -> None:
    """Correlation over 3 x 1500 arrays at 4.4 sigma: one false alarm in 30 000 sets of seeds."""
    spread = Spread(sigma=1.0, limit=8.0, shared=0.7)
    first, second, other = (
        np.concatenate([values(spread, header, seed) for seed in range(1500)])
        for header in (
            sensor("l3g4200d", "Gyro1", 2000.0),
            sensor("l3g4200d", "Gyro2", 250.0),
            sensor("bma180", "BMA1"),
        )
    )
    spread_of_r = 4.4 / np.sqrt(4500)
    assert np.corrcoef(first, second)[0, 1] == pytest.approx(0.7, abs=(1 - 0.7**2) * spread_of_r)
    assert np.corrcoef(first, other)[0, 1] == pytest.approx(0.0, abs=spread_of_r)
    assert kstest(first, "norm").pvalue > 1e-3


def test_a_fully_shared_figure_is_the_same_for_all_sensors(sensor: MakeSensor) -> None:
    spread = Spread(sigma=1.0, shared=1.0)
    assert values(spread, sensor(name="A")) == values(spread, sensor(name="B"))
    assert len(set(values(spread, sensor(name="A")))) == 3


def test_the_draws_of_a_sensor_do_not_depend_on_the_range(sensor: MakeSensor) -> None:
    spread = Spread(sigma=1.0)
    assert values(spread, sensor("bma180", "A", 16.0)) == values(spread, sensor("bma180", "A", 1.5))
    assert values(spread, sensor(name="A")) != values(spread, sensor(name="B"))
    assert values(spread, sensor(name="A")) != values(spread, sensor(name="A"), seed=1)


def test_a_list_draws_axis_by_axis(sensor: MakeSensor) -> None:
    """An axis with a given value changes no other axis, and each has its own population."""
    alone = values(Spread(sigma=1.0), sensor())
    mixed = values((Spread(sigma=1.0), 0.5, Spread(sigma=10.0, mean=3.0)), sensor())
    assert mixed == pytest.approx([alone[0], 0.5, 3.0 + 10.0 * alone[2]])


def test_ends_are_the_extreme_draws() -> None:
    recipe = {"rms_g": (Spread(mean=1.0, sigma=0.1), 7.0, Spread(sigma=1.0, limit=2.0))}
    assert at_ends(recipe, KEYS, 0) == {"rms_g": [1.0, 7.0, 0.0]}
    assert at_ends(recipe, KEYS, -1)["rms_g"] == pytest.approx([0.7, 7.0, -2.0])
    assert at_ends(recipe, KEYS, 1)["rms_g"] == pytest.approx([1.3, 7.0, 2.0])
    assert at_ends({"rms_g": Spread(mean=1.0, sigma=0.1)}, KEYS, 1)["rms_g"] == pytest.approx([1.3, 1.3, 1.3])


@pytest.mark.parametrize(
    ("value", "complaint"),
    [
        ({"mean": 1.0}, "K: sigma: is missing"),
        ({"sigm": 1.0, "sigma": 1}, r"K: sigm: unknown key \(did you mean 'sigma'\?\); allowed are mean, sigma, limit"),
        ({"sigma": -1.0}, "K: sigma: .*: allowed is 0 or more"),
        ({"sigma": 1.0, "limit": -1.0}, "K: limit: .*: allowed is 0 or more"),
        ({"sigma": 1.0, "shared": 1.5}, r"K: shared: 1\.5: allowed is 1 or less"),
        ({"sigma": float("nan")}, "K: sigma: .* finite"),
        ({"sigma": float("inf")}, "K: sigma: .* finite"),
        ({"sigma": 10**400}, "K: sigma: "),
        ({"sigma": "1"}, "K: sigma: '1': a number without quotes is required"),
        ({"sigma": True}, "K: sigma: True: a number"),
        ([1.0, {"sigm": 1.0}], "K, number 2: sigma: is missing"),
        ([[1.0], 2.0], r"K, number 1: \[1.0\]; a number, a text or a table"),
        (True, "K: True; a number, a text or a table with mean and sigma is required"),
        (10**400, r"K: a number beyond 1e\+12"),
        (-1e300, r"K: a number beyond 1e\+12"),
    ],
)
def test_an_invalid_figure_is_refused(value: object, complaint: str) -> None:
    with pytest.raises(ConfigError, match=f"^{complaint}") as refused:
        figure_of(value, "K")
    assert "\n" not in str(refused.value)


def test_a_table_of_many_mistakes_names_twelve_of_them() -> None:
    with pytest.raises(ConfigError) as refused:
        figure_of({"mean": 1.0, "sigma": 1.0, **{f"key_{number}": 1 for number in range(1000)}}, "K")
    assert str(refused.value).count("unknown key") == 12
    assert str(refused.value).endswith("; and 988 more")


@pytest.mark.parametrize("value", [1.5, float("inf"), "spike", [1, 2.0, 3], [{"sigma": 1.0}, 2.0, 3.0]])
def test_a_figure_round_trips(value: object) -> None:
    assert table_of(figure_of(value, "")) == value


def test_a_population_is_written_without_defaults() -> None:
    assert table_of(Spread(mean=0.0, sigma=1.0)) == {"sigma": 1.0}
    full = {"mean": 1.0, "sigma": 2.0, "limit": 3.0, "shared": 0.5}
    assert table_of(figure_of(full, "")) == full
