"""Signed axes as rotations: every text that can be written is either one of the 24 rotations of a cube or refused."""

from __future__ import annotations

from itertools import permutations, product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from imuarray.axes import UP_AXES, orientation_of, up_vector

UNIT = {"X": (1.0, 0.0, 0.0), "Y": (0.0, 1.0, 0.0), "Z": (0.0, 0.0, 1.0)}

SIGNED_PERMUTATIONS = [
    "".join(sign + axis for sign, axis in zip(signs, axes, strict=True))
    for axes in permutations("XYZ")
    for signs in product("+-", repeat=3)
]


def pointed(text: str) -> np.ndarray:
    """Row k: the unit vector that the k-th signed axis of the text names."""
    return np.array([float(text[2 * k] + "1") * np.array(UNIT[text[2 * k + 1]]) for k in range(3)])


def is_right_handed(text: str) -> bool:
    x, y, z = pointed(text)
    return bool(np.dot(np.cross(x, y), z) > 0)


@given(st.sampled_from(SIGNED_PERMUTATIONS))
def test_axes_are_accepted_only_if_right_handed_and_give_a_rotation(axes: str) -> None:
    if not is_right_handed(axes):
        with pytest.raises(ValueError, match="left-handed"):
            orientation_of(axes)
        return
    matrix = np.array(orientation_of(axes))
    np.testing.assert_array_equal(matrix @ matrix.T, np.eye(3))
    assert np.linalg.det(matrix) == pytest.approx(1.0)
    np.testing.assert_array_equal(matrix.T, pointed(axes))  # column k is where the sensor's axis k points


def test_half_of_the_48_signed_permutations_are_rotations() -> None:
    assert len(SIGNED_PERMUTATIONS) == 48
    assert sum(map(is_right_handed, SIGNED_PERMUTATIONS)) == 24


def test_one_matrix_equals_its_literal() -> None:
    # Sensor x along box +Y, sensor y along box +X, sensor z along box -Z: BMA2 of the paper's array.
    assert orientation_of("+Y+X-Z") == ((0, 1, 0), (1, 0, 0), (0, 0, -1))


def test_the_printed_axes_of_two_sensors_are_refused_as_left_handed() -> None:
    # Table 1 prints BMA2 and BMA3 with one sign wrong; a mirrored triad is no chip.
    for printed in ("-Y+X-Z", "+Y-X-Z"):
        with pytest.raises(ValueError, match="left-handed"):
            orientation_of(printed)


@given(st.text(alphabet="+-XYZxyzW 0", max_size=8))
def test_any_other_text_is_refused_in_one_line_that_quotes_it(text: str) -> None:
    if text in SIGNED_PERMUTATIONS and is_right_handed(text):
        return
    with pytest.raises(ValueError, match="axes ") as refused:
        orientation_of(text)
    message = str(refused.value)
    assert repr(text) in message
    assert "\n" not in message


def test_an_axis_named_twice_is_refused() -> None:
    with pytest.raises(ValueError, match="once"):
        orientation_of("+X+X+Z")


def test_a_final_newline_is_refused() -> None:
    with pytest.raises(ValueError, match="axes"):
        orientation_of("+X+Y+Z\n")


@pytest.mark.parametrize(
    ("up", "vector"),
    [
        ("+X", (1, 0, 0)),
        ("-X", (-1, 0, 0)),
        ("+Y", (0, 1, 0)),
        ("-Y", (0, -1, 0)),
        ("+Z", (0, 0, 1)),
        ("-Z", (0, 0, -1)),
    ],
)
def test_up_axes_have_their_unit_vectors(up: str, vector: tuple[int, int, int]) -> None:
    assert up in UP_AXES
    assert up_vector(up) == vector


@pytest.mark.parametrize("up", ["", "Z", "+z", "+Z ", "+W", "++", "Z+"])
def test_other_up_axes_are_refused_with_the_allowed_six(up: str) -> None:
    with pytest.raises(ValueError, match=r"\+X, -X, \+Y, -Y, \+Z, -Z"):
        up_vector(up)
