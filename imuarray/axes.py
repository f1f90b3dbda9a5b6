"""Signed axes: the box axis along which each axis of a sensor points, as text ("+Y+X-Z") and as a rotation matrix.

Frames: ``box`` is the cuboid box, ``sensor`` the chip's own; ``vector_box = orientation @ vector_sensor``.
"""

from __future__ import annotations

import re
from functools import cache

Matrix = tuple[tuple[float, float, float], tuple[float, float, float], tuple[float, float, float]]

UP_AXES = ("+X", "-X", "+Y", "-Y", "+Z", "-Z")
"""The six orientations of a box on a table: the box axis that points up."""

AXES = re.compile(r"([+-])([XYZ])" * 3)
_MOST_SHOWN = 40
"""Longest text of a file that an error repeats in full."""


@cache
def orientation_of(axes: str) -> Matrix:
    """Return the rotation of an axes text: column k is the box axis along which the sensor's axis k points. ValueError
    if the text is not three signed axes, if an axis occurs twice, or if the triad is left-handed, which no chip is.
    """
    match = AXES.fullmatch(axes)
    if match is None:
        shown = axes if len(axes) <= _MOST_SHOWN else f"{axes[:_MOST_SHOWN]}..."
        raise ValueError(
            f"axes {shown!r}: write the box axes along which the sensor's x, y and z point, such as '+Y+X-Z'"
        )
    signs = [1.0 if sign == "+" else -1.0 for sign in match.groups()[0::2]]
    rows = ["XYZ".index(axis) for axis in match.groups()[1::2]]
    if len(set(rows)) < 3:
        raise ValueError(f"axes {axes!r}: use each of X, Y and Z once")
    if _parity(rows) * signs[0] * signs[1] * signs[2] < 0:
        raise ValueError(f"axes {axes!r}: this triad is left-handed, but all chips are right-handed; one sign is wrong")
    columns = [[sign if row == axis else 0.0 for axis in range(3)] for row, sign in zip(rows, signs, strict=True)]
    first, second, third = zip(*columns, strict=True)
    return (first, second, third)


def up_vector(up: str) -> tuple[float, float, float]:
    """Return the unit vector, in the box frame, of the box axis that points up; ValueError unless one of `UP_AXES`."""
    if up not in UP_AXES:
        raise ValueError(f"up {up!r}: allowed are {', '.join(UP_AXES)}")
    sign = 1.0 if up[0] == "+" else -1.0
    x, y, z = (sign if axis == up[1] else 0.0 for axis in "XYZ")
    return (x, y, z)


CHECK = "_check"
"""End of the name of a face that is read again."""


def face_up(phase: str) -> str:
    """Return the box axis that points up in a phase named after a face: "-X" for "x_down" and "x_down_check",
    else "".
    """
    axis, _, way = phase.removesuffix(CHECK).partition("_")
    if axis in ("x", "y", "z") and way in ("up", "down"):
        return ("+" if way == "up" else "-") + axis.upper()
    return ""


def _parity(permutation: list[int]) -> int:
    """Return +1 for an even permutation of 0, 1, 2, -1 for an odd one."""
    swaps = sum(permutation[i] > permutation[j] for i in range(3) for j in range(i + 1, 3))
    return -1 if swaps % 2 else 1
