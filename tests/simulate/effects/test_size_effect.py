"""`size_effect`: the force at a place away from the origin of a turning box."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm

from imuarray.simulate.effects.response import SizeEffect
from imuarray.simulate.signal import BoxStimulus
from tests.selection import examples
from tests.simulate.conftest import Constant, G, MakePlace, times

COMPONENT = st.floats(-5, 5)
TRIPLE = st.tuples(COMPONENT, COMPONENT, COMPONENT)


def stimulus(rate: tuple[float, ...], acceleration: tuple[float, ...], rows: int = 2) -> BoxStimulus:
    return Constant(rate_box=rate, angular_acceleration_box=acceleration).stimulus(times(0, rows))


def test_rotation_about_z_adds_centripetal_and_tangential_force(place: MakePlace) -> None:
    """A tenth of a metre out on x at 10 rad/s and 3 rad/s2: 10 m/s2 inwards, 0.3 m/s2 along y."""
    after = SizeEffect((100.0, 0.0, 0.0)).stimulus(stimulus((0, 0, 10), (0, 0, 3)), place())
    np.testing.assert_allclose(after.force_box, [[-10, 0.3, G]] * 2, atol=1e-12)


@settings(max_examples=examples(40))
@given(TRIPLE, st.floats(-3, 3), st.floats(-3, 3), TRIPLE)
def test_the_added_force_is_the_second_derivative_of_the_position(
    axis: tuple[float, float, float], rate: float, acceleration: float, place_mm: tuple[float, float, float]
) -> None:
    """Turned by the angle rate t + acceleration t^2 / 2 about an axis, r is at exp(angle [axis]x) r: differenced twice,
    in the box's axes at t = 0, where they are the fixed ones.
    """
    x, y, z = axis
    turn = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    r = np.array(place_mm) * 1e-3
    h = 1e-3
    at = [expm((rate * t + acceleration * t**2 / 2) * turn) @ r for t in (-h, 0.0, h)]
    motion = Constant(rate_box=np.array(axis) * rate, angular_acceleration_box=np.array(axis) * acceleration)
    after = SizeEffect(place_mm).stimulus(motion.stimulus(times(0, 1)), None)  # type: ignore[arg-type]
    added = after.force_box[0] - (0, 0, G)
    np.testing.assert_allclose(added, (at[0] - 2 * at[1] + at[2]) / h**2, rtol=0, atol=5e-3)


def test_each_row_has_its_own_rate(place: MakePlace) -> None:
    """On y, turning faster and faster about x: each row by its own square."""
    motion = Constant(rate_box=lambda s: np.stack([s, 0 * s, 0 * s], axis=1))
    after = SizeEffect((0.0, 1000.0, 0.0)).stimulus(motion.stimulus(times(0, 400)), place())
    seconds = np.arange(400) / 100
    np.testing.assert_allclose(after.force_box, np.stack([0 * seconds, -(seconds**2), G + 0 * seconds], axis=1))


def test_rows_can_differ_in_angular_acceleration_alone(place: MakePlace) -> None:
    motion = Constant(angular_acceleration_box=lambda s: np.stack([0 * s, 0 * s, s], axis=1))
    after = SizeEffect((1000.0, 0.0, 0.0)).stimulus(motion.stimulus(times(0, 400)), place())
    np.testing.assert_allclose(after.force_box[:, 1], np.arange(400) / 100, atol=1e-12)


def test_a_constant_input_stays_one_row(place: MakePlace) -> None:
    after = SizeEffect((100.0, 0.0, 0.0)).stimulus(stimulus((0, 0, 10), (0, 0, 0), 50), place())
    assert after.force_box.shape == (50, 3)
    assert (after.force_box == after.force_box[0]).all()


@pytest.mark.parametrize(
    ("place_mm", "rate", "acceleration"), [((0, 0, 0), (1, 2, 3), (4, 5, 6)), ((10, 20, 30), (0, 0, 0), (0, 0, 0))]
)
def test_nothing_is_added_at_the_origin_or_at_rest(
    place: MakePlace,
    place_mm: tuple[float, float, float],
    rate: tuple[float, float, float],
    acceleration: tuple[float, float, float],
) -> None:
    before = stimulus(rate, acceleration)
    assert SizeEffect(place_mm).stimulus(before, place()) is before


def test_the_default_place_is_the_origin(place: MakePlace) -> None:
    before = stimulus((1, 2, 3), (4, 5, 6))
    assert SizeEffect().stimulus(before, place()) is before
