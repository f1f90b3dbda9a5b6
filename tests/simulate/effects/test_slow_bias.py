"""`bias_instability`, `common_mode`, `random_walk`: size, correlation, and sharing between sensors."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest

from imuarray.simulate.effect import Effect
from imuarray.simulate.effects.bias import BiasInstability, CommonMode, RandomWalk
from imuarray.simulate.processes import gauss_markov
from imuarray.simulate.signal import Analog, Place
from tests.selection import some
from tests.simulate.conftest import Floats, MakePlace, furthest, header

MakeAnalog = Callable[..., Analog]
KINDS: list[Effect] = [BiasInstability(0.01), CommonMode(0.01), RandomWalk(0.01)]


def added(effect: Effect, at: Place, analog: MakeAnalog, first: int, stop: int) -> Floats:
    return effect.analog(analog(first, stop), at).value


@pytest.mark.slow
@pytest.mark.parametrize("kind", [BiasInstability, CommonMode])
def test_biases_are_gauss_markov_of_the_given_rms_and_time_constant(
    place: MakePlace, analog: MakeAnalog, kind: type[BiasInstability] | type[CommonMode]
) -> None:
    rms, rows = np.array([0.01, 0.02, 0.05]), np.array([0, 20, 50, 100])
    effect = kind((0.01, 0.02, 0.05), 5.0)
    runs = np.stack([added(effect, place(rows_per_s=10.0, seed=seed), analog, 0, 101)[rows] for seed in range(300)])
    correlation = np.exp(-np.abs(np.subtract.outer(rows, rows)) / 50)
    for axis in range(3):  # 3 x 14 numbers, each beyond 5 standard errors with probability 6e-7: 2e-5
        assert furthest(runs[:, :, axis], correlation * rms[axis] ** 2) < 5


@pytest.mark.slow
def test_a_random_walk_has_the_given_density(place: MakePlace, analog: MakeAnalog) -> None:
    density, rows = np.array([0.01, 0.02, 0.05]), np.array([1, 100, 400])
    effect = RandomWalk((0.01, 0.02, 0.05))
    runs = np.stack([added(effect, place(rows_per_s=10.0, seed=seed), analog, 0, 401)[rows] for seed in range(300)])
    for axis in range(3):  # 3 x 9 numbers: 2e-5
        assert furthest(runs[:, :, axis], np.minimum.outer(rows, rows) / 10 * density[axis] ** 2) < 5


def allan_variance(values: Floats) -> float:
    """Of two adjacent halves, over all axes and runs."""
    first, second = np.array_split(values, 2, axis=1)
    return float(((second.mean(axis=1) - first.mean(axis=1)) ** 2).mean() / 2)


@pytest.mark.slow
def test_allan_deviation_peaks_as_in_the_standard(place: MakePlace, analog: MakeAnalog) -> None:
    """sigma^2(tau) = 2 rms^2 (T / tau) (1 - T / (2 tau) (3 - 4 exp(-tau / T) + exp(-2 tau / T))): IEEE Std 952, with
    rms^2 = q^2 T / 2; 0.618 rms at 1.89 T.
    """
    effect = BiasInstability(1.0, 100.0)
    runs = np.stack([added(effect, place(rows_per_s=1.0, seed=seed), analog, 0, 378) for seed in range(400)])
    # A mean of 1200 squares of normal numbers: relative standard error sqrt(2 / 1200) = 4.1 %, five of them 6e-7.
    assert allan_variance(runs) == pytest.approx(0.618**2, rel=5 * np.sqrt(2 / 1200))


@pytest.mark.slow
@pytest.mark.parametrize("half", some([8, 32], 1, 0))
def test_allan_deviation_of_flicker_noise_is_flat(place: MakePlace, analog: MakeAnalog, half: int) -> None:
    """Power h / f has the Allan variance 2 ln 2 h at all averaging times (IEEE Std 952, B^2 2 ln 2 / pi). Processes of
    variance rms^2 / n, a factor r apart in time constant, have h = rms^2 / (n ln r): rms^2 / n for r = 4. Here those
    of 0.0625 to 4096 s, n = 9, of which the ends leave out 4 % at 8 s and at 32 s.
    """
    effect = BiasInstability(1.0, 4096.0, 0.0625)
    assert len(effect.time_constants_s) == 9
    runs = np.stack([added(effect, place(rows_per_s=4.0, seed=seed), analog, 0, 8 * half) for seed in range(400)])
    assert allan_variance(runs) == pytest.approx(1 / 9, rel=0.04 + 5 * np.sqrt(2 / 1200))


def test_flicker_noise_is_a_sum_of_processes_of_equal_variance(place: MakePlace, analog: MakeAnalog) -> None:
    """Rows are those of independent processes with half of the rms, one for each time constant."""
    at = place(rows_per_s=10.0)
    flicker = added(BiasInstability((0.02, 0.0, 0.04), 64.0, 1.0), at, analog, 0, 200)
    single = [
        gauss_markov(time_s, at, "bias_instability", scale=(0.01, 0.0, 0.02), number=number).rows(0, 200)
        for number, time_s in ((1, 64.0), (2, 16.0), (3, 4.0), (4, 1.0))
    ]
    np.testing.assert_allclose(flicker, np.sum(single, axis=0), rtol=1e-12, atol=1e-15)
    assert BiasInstability(1.0, 64.0, 0.9).time_constants_s == (64.0, 16.0, 4.0, 1.0)
    assert BiasInstability(1.0, 5.0, 7.0).time_constants_s == (5.0,)


@pytest.mark.slow
def test_allan_deviation_of_a_random_walk_is_that_of_the_standard(place: MakePlace, analog: MakeAnalog) -> None:
    """density sqrt(tau / 3): IEEE Std 952."""
    runs = np.stack([added(RandomWalk(1.0), place(rows_per_s=1.0, seed=seed), analog, 0, 400) for seed in range(400)])
    assert allan_variance(runs) == pytest.approx(200 / 3, rel=5 * np.sqrt(2 / 1200))


def test_only_common_mode_is_shared_by_sensors_of_a_design(place: MakePlace, analog: MakeAnalog) -> None:
    sensors = [header("bma180", "A"), header("bma180", "B", axes="-X-Y+Z"), header("l3g4200d", "C")]
    for effect in KINDS:
        first, twin, other = (added(effect, place(sensor), analog, 0, 500) for sensor in sensors)
        assert np.array_equal(first, twin) == (effect.name == "common_mode")
        assert not np.array_equal(first, other)


TWO = ((1, 10.0), (2, 1000.0))


@pytest.mark.slow
def test_two_of_an_effect_in_a_chain_are_drawn_independently(place: MakePlace, analog: MakeAnalog) -> None:
    """Correlation of 900 pairs: standard error 1 / 30; five of them 6e-7."""
    pairs = [
        [added(BiasInstability(1.0, tau), replace(place(seed=seed), copy=copy), analog, 0, 1)[0] for copy, tau in TWO]
        for seed in range(300)
    ]
    first, second = np.array(pairs).swapaxes(0, 1).reshape(2, -1)
    assert abs((first * second).mean()) < 5 / 30


@pytest.mark.parametrize("effect", KINDS, ids=lambda effect: effect.name)
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_any_block_alone_equals_that_of_the_whole(
    place: MakePlace, analog: MakeAnalog, effect: Effect, dtype: npt.DTypeLike
) -> None:
    whole = effect.analog(analog(0, 40_000, dtype=dtype), place(dtype=dtype)).value
    alone = effect.analog(analog(16_383, 33_000, dtype=dtype), place(dtype=dtype)).value
    assert alone.dtype == dtype
    np.testing.assert_array_equal(alone, whole[16_383:33_000])


@pytest.mark.parametrize("kind", [BiasInstability, CommonMode, RandomWalk])
def test_defaults_do_nothing_and_invalid_parameters_are_refused(
    place: MakePlace, analog: MakeAnalog, kind: type[Effect]
) -> None:
    rows = analog(0, 10)
    assert kind().analog(rows, place()) is rows
    with pytest.raises(ValueError, match=r"(rms|density): -1(\.0)?; allowed"):
        kind(-1.0)  # type: ignore[call-arg]


def test_time_constants_must_be_positive() -> None:
    for kind in (BiasInstability, CommonMode):
        with pytest.raises(ValueError, match=r"time_constant_s: 0(\.0)?; allowed is 0\.001 to 1e\+09"):
            kind(1.0, 0.0)  # type: ignore[arg-type]
