"""`turn_on_bias`, `bistable_bias`: once a boot, and for all of it; `bias` that begins with a boot."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt
import pytest

from imuarray.simulate.effect import Effect
from imuarray.simulate.effects.bias import Bias, BistableBias, TurnOnBias
from imuarray.simulate.signal import Analog
from tests.simulate.conftest import MakePlace, furthest, header

MakeAnalog = Callable[..., Analog]
GYRO3 = (-13.0, 6.0, -2.0)
"""From (0, 69, 2) to (-13, 75, 0) LSB: the paper's Section 5.2.4."""


def test_turn_on_bias_is_normal_from_boot_to_boot(place: MakePlace, analog: MakeAnalog) -> None:
    effect = TurnOnBias((0.1, 0.2, 0.5))
    runs = np.stack([effect.analog(analog(0, 1, value=3.0), place(boot=boot)).value[0] - 3 for boot in range(1000)])
    assert furthest(runs, np.diag([0.01, 0.04, 0.25])) < 5  # 9 numbers: 5e-6


def test_a_bias_begins_with_its_boot(place: MakePlace, analog: MakeAnalog) -> None:
    runs = [Bias(0.5, from_boot=2).analog(analog(0, 1), place(boot=boot)).value[0, 0] for boot in range(4)]
    assert runs == [0.0, 0.0, 0.5, 0.5]


def test_bistable_bias_has_its_probability_on_all_axes(place: MakePlace, analog: MakeAnalog) -> None:
    effect = BistableBias(GYRO3, 7 / 15)
    runs = np.stack([effect.analog(analog(0, 1, value=(0, 69, 2)), place(boot=boot)).value[0] for boot in range(1000)])
    flipped = (runs == (-13, 75, 0)).all(axis=1)
    assert (flipped | (runs == (0, 69, 2)).all(axis=1)).all()
    # 5 standard errors of a binomial share: 6e-7
    assert flipped.mean() == pytest.approx(7 / 15, abs=5 * np.sqrt(7 * 8 / 15**2 / 1000))


@pytest.mark.parametrize(("probability", "offset"), [(0.0, 0.0), (1.0, 2.0)])
def test_probabilities_0_and_1_give_never_and_always(
    place: MakePlace, analog: MakeAnalog, probability: float, offset: float
) -> None:
    for boot in range(50):
        rows = BistableBias((2.0, 2.0, 2.0), probability).analog(analog(0, 1), place(boot=boot))
        assert (rows.value == offset).all()


@pytest.mark.parametrize("effect", [TurnOnBias(0.1), BistableBias(0.1, 0.5)], ids=lambda effect: effect.name)  # type: ignore[arg-type]
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_the_bias_is_constant_within_a_run(
    place: MakePlace, analog: MakeAnalog, effect: Effect, dtype: npt.DTypeLike
) -> None:
    seen = set()
    for boot in range(20):
        early, late = (
            effect.analog(analog(first, first + 100, dtype=dtype), place(boot=boot, dtype=dtype)).value
            for first in (0, 10**6)
        )
        assert early.dtype == dtype
        assert (early == early[0]).all()
        np.testing.assert_array_equal(early, late)
        seen.add(early[0].tobytes())
    assert len(seen) == (20 if effect.name == "turn_on_bias" else 2)  # 20 equal coins: 2e-6


def test_turn_on_biases_of_sensors_seeds_and_boots_differ(place: MakePlace, analog: MakeAnalog) -> None:
    places = [place(), place(header(name="S2")), place(seed=2), place(boot=1)]
    biases = [TurnOnBias(0.1).analog(analog(0, 1), at).value[0, 0] for at in places]  # type: ignore[arg-type]
    assert len(set(biases)) == 4


def test_defaults_do_nothing_and_invalid_parameters_are_refused(place: MakePlace, analog: MakeAnalog) -> None:
    rows = analog(0, 10)
    assert TurnOnBias().analog(rows, place()) is rows
    assert BistableBias().analog(rows, place()) is rows
    with pytest.raises(ValueError, match=r"rms: -1(\.0)?; allowed is 0 to inf"):
        TurnOnBias(-1.0)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match=r"probability: 1\.5; allowed is 0 to 1"):
        BistableBias(1.0, 1.5)  # type: ignore[arg-type]
