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


def test_bias_from_a_boot_on(place: MakePlace, analog: MakeAnalog) -> None:
    runs = [Bias(0.5, from_boot=2).analog(analog(0, 1), place(boot=boot)).value[0, 0] for boot in range(4)]
    assert runs == [0.0, 0.0, 0.5, 0.5]


def test_bistable_bias_comes_with_its_probability_and_on_all_axes(place: MakePlace, analog: MakeAnalog) -> None:
    effect = BistableBias(GYRO3, 7 / 15)
    runs = np.stack([effect.analog(analog(0, 1, value=(0, 69, 2)), place(boot=boot)).value[0] for boot in range(1000)])
    flipped = (runs == (-13, 75, 0)).all(axis=1)
    assert (flipped | (runs == (0, 69, 2)).all(axis=1)).all()
    # 5 standard errors of a binomial share: 6e-7
    assert flipped.mean() == pytest.approx(7 / 15, abs=5 * np.sqrt(7 * 8 / 15**2 / 1000))


@pytest.mark.parametrize(("probability", "offset"), [(0.0, 0.0), (1.0, 2.0)])
def test_never_and_always(place: MakePlace, analog: MakeAnalog, probability: float, offset: float) -> None:
    for boot in range(50):
        rows = BistableBias((2.0, 2.0, 2.0), probability).analog(analog(0, 1), place(boot=boot))
        assert (rows.value == offset).all()


@pytest.mark.parametrize("effect", [TurnOnBias(0.1), BistableBias(0.1, 0.5)], ids=lambda effect: effect.name)  # type: ignore[arg-type]
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_the_same_in_all_of_a_run(place: MakePlace, analog: MakeAnalog, effect: Effect, dtype: npt.DTypeLike) -> None:
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


def test_sensors_and_seeds_are_switched_on_independently(place: MakePlace, analog: MakeAnalog) -> None:
    places = [place(), place(header(name="S2")), place(seed=2), place(boot=1)]
    biases = [TurnOnBias(0.1).analog(analog(0, 1), at).value[0, 0] for at in places]  # type: ignore[arg-type]
    assert len(set(biases)) == 4


def test_nothing_by_default_and_no_nonsense(place: MakePlace, analog: MakeAnalog) -> None:
    rows = analog(0, 10)
    assert TurnOnBias().analog(rows, place()) is rows
    assert BistableBias().analog(rows, place()) is rows
    with pytest.raises(ValueError, match=r"rms: -1(\.0)?; allowed is 0 to inf"):
        TurnOnBias(-1.0)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match=r"probability: 1\.5; allowed is 0 to 1"):
        BistableBias(1.0, 1.5)  # type: ignore[arg-type]
