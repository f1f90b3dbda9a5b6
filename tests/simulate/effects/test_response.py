"""The response of a sensor: axis_error, misalignment, nonlinearity, scale, g_sensitivity, bias."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from imuarray.simulate.effects.bias import Bias
from imuarray.simulate.effects.response import AxisError, GSensitivity, Misalignment, Nonlinearity, Scale

PAIRS = ((0, 1), (0, 2), (1, 0), (1, 2), (2, 0), (2, 1))
"""Order of the six angles: xy, xz, yx, yz, zx, zy."""


class TestAxisError:
    @pytest.mark.parametrize(
        ("axes", "read"),
        [("+Y-X+Z", (2, -1, 3)), ("+X+Y-Z", (1, 2, -3)), ("-Z-Y-X", (-3, -2, -1)), ("+Z+X+Y", (3, 1, 2))],
    )
    def test_each_sensor_axis_reads_the_given_box_axis(self, place, analog, axes: str, read: tuple[float, ...]) -> None:
        before = analog(0, 2, value=(1, 2, 3), noise=(7, 8, 9), force_g=np.array([[1.0, 2.0, 3.0]] * 2))
        after = AxisError(axes).analog(before, place())
        assert after.value.tolist() == after.force_g.tolist() == [list(read)] * 2
        assert after.noise.tolist() == [[7, 8, 9]] * 2

    def test_all_48_signed_permutations_are_accepted(self, place, analog) -> None:
        """Signed permutations: each reads the three numbers once, no two alike, half of them left-handed."""
        read = [
            AxisError("".join(map("".join, zip(signs, axes, strict=True))))
            .analog(analog(0, 1, value=(1, 2, 3)), place())
            .value[0]
            for signs in itertools.product("+-", repeat=3)
            for axes in itertools.permutations("XYZ")
        ]
        assert len({tuple(row) for row in read}) == 48
        assert {tuple(sorted(np.abs(row))) for row in read} == {(1, 2, 3)}


class TestMisalignment:
    def test_one_degree_gives_the_cross_axis_figure_of_the_data_sheet(self, place, analog) -> None:
        """BMA-119 states 1 degree, BMA-118 1.75 %: the same figure."""
        read = Misalignment((1, 0, 0, 0, 0, 0)).analog(analog(0, 1, value=(0, 1, 0)), place()).value[0]
        assert read == pytest.approx([math.sin(math.radians(1)), 1, 0], abs=1e-15)
        assert round(100 * read[0], 2) == 1.75

    @pytest.mark.parametrize("index", range(6))
    def test_each_angle_tilts_its_axis_towards_another(self, index: int) -> None:
        angles = [0.0] * 6
        angles[index] = 30.0
        expected = np.eye(3)
        axis, towards = PAIRS[index]
        expected[axis, axis], expected[axis, towards] = math.cos(math.pi / 6), 0.5
        assert Misalignment(tuple(angles)).directions == pytest.approx(expected)

    def test_two_angles_of_one_axis_add_as_tangents(self) -> None:
        """Tangents of 45 degrees: the axis is the diagonal of the cube."""
        row = Misalignment((0, 0, 45, 45, 0, 0)).directions[1]
        assert row == pytest.approx([1 / math.sqrt(3)] * 3)

    @given(st.lists(st.floats(-1, 1), min_size=3, max_size=3))
    def test_opposite_angles_turn_the_triad(self, turn_deg: list[float]) -> None:
        """To second order in the angles (1 degree squared: 3e-4) it is a rotation vector."""
        x, y, z = turn_deg
        turned = Misalignment((z, -y, -z, x, y, -x)).directions
        rotation = Rotation.from_rotvec(np.radians(turn_deg)).as_matrix()
        assert turned == pytest.approx(rotation.T, abs=2 * math.radians(1) ** 2)

    @given(st.lists(st.floats(-80, 80), min_size=6, max_size=6))
    def test_directions_are_of_unit_length(self, angles: list[float]) -> None:
        assert np.linalg.norm(Misalignment(tuple(angles)).directions, axis=1) == pytest.approx(1)


class TestNonlinearity:
    def test_the_polynomial_is_added(self, place, analog) -> None:
        effect = Nonlinearity((0.01, 0.0, -0.01), (0.001, 0.002, 0.0))
        after = effect.analog(analog(0, 1, value=(2, -3, 10)), place())
        assert after.value[0] == pytest.approx([2 + 0.04 + 0.008, -3 - 0.054, 10 - 1])

    def test_vibration_shifts_the_mean(self, place, analog) -> None:
        """Quadratic q and a sine of amplitude A: q A^2 / 2; the cubic term moves the sine, not its mean."""
        sine = 3 * np.sin(2 * np.pi * np.arange(1000) / 100)[:, None]
        after = Nonlinearity(0.02, 0.01).analog(analog(0, 1000, value=sine), place())
        assert after.value.mean(axis=0) == pytest.approx([0.02 * 9 / 2] * 3)


def test_scale_and_bias_give_the_faces_of_table_10(place, analog) -> None:
    """ADXL1 x points along the box's -X (Table 1): 269.075 LSB with x down, -253.497 with x up, at 256 LSB/g nominal
    (ADX-40): half their difference is its scale, half their sum its bias.
    """
    half_difference, half_sum = 261.286, 7.789
    scale, bias = Scale((half_difference / 256 - 1, 0, 0)), Bias((half_sum / 256, 0, 0))
    faces = analog(0, 2, value=np.array([[1.0, 0, 0], [-1.0, 0, 0]]))
    after = bias.analog(scale.analog(faces, place()), place())
    assert after.value[:, 0] * 256 == pytest.approx([269.075, -253.497])
    assert not after.value[:, 1:].any()


def test_scale_is_a_relative_error(place, analog) -> None:
    after = Scale((0.01, -0.02, 0.5)).analog(analog(0, 1, value=(100, 100, -2)), place())
    assert after.value[0] == pytest.approx([101, 98, -3])


def test_the_bias_of_table_3_is_added(place, analog) -> None:
    after = Bias((-0.1806, -0.2495, 0.0225)).analog(analog(0, 1, value=(0, 0, 1)), place())
    assert after.value[0] == pytest.approx([-0.1806, -0.2495, 1.0225])


class TestGSensitivity:
    def test_the_differences_between_faces_of_table_4_are_reproduced(self, place, analog) -> None:
        """Gyro1 x: 0.000, -0.038 and -0.005 dps between the faces of each box axis, 2 g apart; x leads the row."""
        effect = GSensitivity((0.0, -0.019, -0.0025, 0, 0, 0, 0, 0, 0))
        force = np.concatenate([np.eye(3), -np.eye(3)])
        after = effect.analog(analog(0, 6, force_g=force, value=0.5), place())
        difference = after.value[:3] - after.value[3:]
        assert difference[:, 0] == pytest.approx([0.0, -0.038, -0.005])
        assert not difference[:, 1:].any()

    def test_the_response_is_in_row_major_order(self, place, analog) -> None:
        """Entry ij: the effect of force along j on axis i."""
        force = np.array([[1.0, 10.0, 100.0]])
        after = GSensitivity(tuple(range(1, 10))).analog(analog(0, 1, force_g=force), place())
        assert after.value[0].tolist() == [1 + 20 + 300, 4 + 50 + 600, 7 + 80 + 900]

    def test_g_sensitivity_is_zero_in_free_fall(self, place, analog) -> None:
        after = GSensitivity(tuple(range(1, 10))).analog(analog(0, 1, force_g=np.zeros((1, 3)), value=2), place())
        assert after.value[0].tolist() == [2, 2, 2]


REFUSED: list[tuple[Callable[[], object], str]] = [
    (lambda: AxisError("+X+X+Z"), "axes: '\\+X\\+X\\+Z'; each of X, Y, Z once"),
    (lambda: AxisError("XYZ"), "axes: 'XYZ'"),
    (lambda: AxisError(""), "axes: ''"),
    (lambda: Misalignment((1.0,)), "angles_deg: \\(1.0,\\); 6 finite numbers"),
    (lambda: Misalignment((0, 0, 0, 0, 0, 90)), "angles_deg: 90.0; allowed is -80 to 80"),
    (lambda: GSensitivity((0.0,) * 8), "response: .*; 9 finite numbers"),
    (lambda: GSensitivity((math.nan,) * 9), "response: .*; 9 finite numbers"),
    (lambda: Bias((1, 2)), "offset: "),
    (lambda: Scale(math.nan), "error: "),
    (lambda: Nonlinearity(cubic=(1, 2, math.nan)), "cubic: "),
]


@pytest.mark.parametrize(("make", "message"), REFUSED)
def test_invalid_parameters_are_refused(make: Callable[[], object], message: str) -> None:
    with pytest.raises(ValueError, match="^" + message):
        make()
