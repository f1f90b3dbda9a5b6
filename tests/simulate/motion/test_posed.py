"""A box put down by hand: gravity's reaction along the up direction, for any poses before and after."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from imuarray.log.format import Phase
from imuarray.simulate.motion.faces import Still, standing_on
from imuarray.simulate.motion.like import SplineColumns
from imuarray.simulate.motion.posed import Movement, PoseAttitude, PoseSequence, upright_from
from imuarray.simulate.motion.stimulus import temperature_at

S = 10**9
G = 9.80665
FIRST = PoseAttitude(Phase(0, 4 * S, "pose 1"), (0.6, 0.0, 0.8), estimated=True)
SECOND = PoseAttitude(Phase(6 * S, 9 * S, "z_down", "-Z"), (0.0, 0.0, -1.0), estimated=False)
TWO = PoseSequence((FIRST, SECOND), Still(seconds=12, temperature_degc=31.0))


def test_force_is_gravity_along_up_and_the_rate_is_zero() -> None:
    stimulus = TWO.stimulus(np.array([0, 3 * S, 7 * S, 20 * S]))
    expected = [[5.88399, 0, 7.84532]] * 2 + [[0, 0, -G]] * 2
    np.testing.assert_allclose(stimulus.force_box, expected, atol=1e-12)
    assert not stimulus.rate_box.any()
    assert not stimulus.angular_acceleration_box.any()
    np.testing.assert_array_equal(stimulus.temperature_degc, 31.0)
    np.testing.assert_array_equal(TWO.stimulus(np.array([3 * S])).force_box, stimulus.force_box[1:2])
    assert len(TWO.stimulus(np.zeros(0, np.int64)).force_box) == 0


def test_the_temperature_is_that_of_the_surroundings() -> None:
    warming = PoseSequence((FIRST, SECOND), Still(seconds=12, temperature_degc=31.0, drift_degc_per_h=3600.0))
    np.testing.assert_allclose(temperature_at(warming, np.array([0, 2 * S, 5 * S])), [31.0, 33.0, 36.0], rtol=1e-12)


def test_the_attitude_changes_half_way_between_the_phases() -> None:
    before, after = TWO.stimulus(np.array([5 * S - 1, 5 * S])).force_box[:, 2]
    assert (before, after) == (pytest.approx(0.8 * G), pytest.approx(-G))


@pytest.mark.parametrize(("step_g", "is_removed"), [(0.1, True), (0.3, False)])
def test_a_movement_begins_and_ends_with_the_force_of_the_attitudes(step_g: float, is_removed: bool) -> None:
    """The sensors that measure the movement have an offset along X, of up to their tolerances; a larger step
    is a box that already moves.
    """
    time_ns = np.arange(4 * S, 6 * S + 1, S // 50)
    way = np.linspace([0.6 * G, 0.0, 0.8 * G], [0.0, 0.0, -G], len(time_ns))
    force = np.add(way, [step_g * G, 0.0, 0.0])
    force[:9], force[-9:] = force[0], force[-1]
    columns = SplineColumns(time_ns, (force, np.zeros_like(force)), "a turn")
    moving = PoseSequence(TWO.attitudes, TWO.surroundings, movements=(Movement(4 * S, 6 * S, columns),))
    begin, end = moving.stimulus(np.array([4 * S, 6 * S - 1])).force_box
    shift = np.zeros(3) if is_removed else [step_g * G, 0.0, 0.0]
    np.testing.assert_allclose(begin, [0.6 * G + shift[0], 0.0, 0.8 * G], atol=1e-6)
    np.testing.assert_allclose(end, [shift[0], 0.0, -G], atol=1e-6)


def test_estimated_phases_are_marked() -> None:
    assert TWO.is_estimated(FIRST.phase)
    assert not TWO.is_estimated(SECOND.phase)
    assert TWO.is_estimated(Phase(2 * S, 4 * S, "second half"))
    assert not TWO.is_estimated(Phase(8 * S, 9 * S, "second half"))
    assert TWO.phases == (FIRST.phase, SECOND.phase)
    assert TWO.seconds == 12


@given(st.tuples(*[st.floats(-1, 1)] * 3).filter(lambda way: np.linalg.norm(way) > 0.1))
@example((5e-324, 5e-324, -1.0))
def test_an_attitude_is_the_shortest_turn_to_up(way: tuple[float, float, float]) -> None:
    """A rotation that brings up to z, by the angle between the two and no more."""
    up = np.array(way) / np.linalg.norm(way)
    (attitude,) = upright_from([tuple(up)])
    np.testing.assert_allclose(attitude @ up, [0, 0, 1], atol=1e-9)
    np.testing.assert_allclose(attitude @ attitude.T, np.eye(3), atol=1e-9)
    assert np.trace(attitude) == pytest.approx(1 + 2 * up[2], abs=1e-9)


@pytest.mark.parametrize("up", ["+X", "-X", "+Y", "-Y", "+Z", "-Z"])
def test_attitudes_of_faces_equal_those_of_a_labelled_box(up: str) -> None:
    way = np.zeros(3)
    way["XYZ".index(up[1])] = 1.0 if up[0] == "+" else -1.0
    np.testing.assert_allclose(upright_from([tuple(way)])[0], standing_on(up), atol=1e-12)


def test_invalid_attitudes_are_refused() -> None:
    with pytest.raises(ValueError, match="at least one"):
        PoseSequence((), Still())
    with pytest.raises(ValueError, match="phase 'pose 1': up_box"):
        PoseSequence((FIRST._replace(up_box=(0.0, 0.0, 0.0)),), Still())
