"""Table 1 against Table 10, and the determinant against numpy's."""

from __future__ import annotations

from itertools import permutations, product

import numpy as np

from imuarray.studies.paper.systematic import determinant, mirrored, table1
from imuarray.studies.paper.tables import tally

SIGNED = [
    dict(zip("xyz", (s + a for s, a in zip(signs, axes, strict=True)), strict=True))
    for axes in permutations("XYZ")
    for signs in product("+-", repeat=3)
]


def test_determinant_of_all_signed_permutations() -> None:
    for axes in SIGNED:
        matrix = np.zeros((3, 3))
        for column, axis in enumerate("xyz"):
            matrix["XYZ".index(axes[axis][1]), column] = 1.0 if axes[axis][0] == "+" else -1.0
        assert determinant(axes) == round(np.linalg.det(matrix)), axes


def test_two_triads_of_table_1_are_mirrored() -> None:
    assert [row.row["sensor"] for row in mirrored()] == ["BMA2", "BMA3"]
    assert tally(table1()) == {"box_plus_x": [4, 6], "box_plus_y": [6, 6], "box_plus_z": [6, 6]}


def test_every_corrected_triad_is_right_handed() -> None:
    rows = {row.row["sensor"]: row.as_json() for row in table1()}
    assert {name: row["axes"] for name, row in rows.items()} == {
        "ADXL1": "-X-Y+Z",
        "ADXL2": "-X-Y+Z",
        "BMA1": "-Y+X+Z",
        "BMA2": "+Y+X-Z",
        "BMA3": "-Y-X-Z",
        "BMA4": "+Y-X+Z",
        "Gyro1": "+X+Y+Z",
        "Gyro2": "+X-Y-Z",
        "Gyro3": "-X-Y+Z",
    }
    assert all(row["determinant"] == 1 for row in rows.values())
    assert (rows["BMA2"]["box_plus_x"], rows["BMA2"]["printed_box_plus_x"]) == ("+Y", "-Y")
    assert (rows["BMA3"]["box_plus_x"], rows["BMA3"]["printed_box_plus_x"]) == ("-Y", "+Y")
