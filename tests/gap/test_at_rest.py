"""The noise to combine with an effect, from the noise of two simulations."""

from __future__ import annotations

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from imuarray.gap.model.rest import FittedParameters

PLAIN = FittedParameters((1.0, 1.0, 1.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))


def of(rms: float) -> FittedParameters:
    return replace(PLAIN, rms=(rms, rms, rms))


@given(
    added=st.floats(0.0, 3.0),
    scaled=st.floats(0.2, 4.0),
    truth=st.floats(0.05, 2.0),
    guesses=st.lists(st.floats(0.05, 3.0), min_size=2, max_size=2, unique=True).filter(
        lambda x: abs(x[0] - x[1]) > 0.1
    ),
)
def test_two_simulations_determine_scaled_and_added_noise(
    added: float, scaled: float, truth: float, guesses: list[float]
) -> None:
    """A simulation turns the variance s^2 into `scaled` s^2 + `added`: two simulations determine both."""

    def made(rms: float) -> FittedParameters:
        return of((scaled * rms**2 + added) ** 0.5)

    first, second = map(of, guesses)
    found = second.between(made(truth), [made(guesses[1])], first, [made(guesses[0])])
    assert found.rms == pytest.approx((truth,) * 3, rel=0.02, abs=guesses[1] / 60)


def test_two_equal_simulations_fall_back_to_added_noise() -> None:
    """Then the missing variance is added, as after one simulation."""
    now = of(1.0)
    assert now.between(of(1.2), [of(1.1)], of(1.001), [of(1.3)]).rms == now.moved(of(1.2), [of(1.1)]).rms
