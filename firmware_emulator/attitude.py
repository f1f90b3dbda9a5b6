"""Attitude of the box: which way is up, and how turns change what the box sees. Vectors are in the box frame."""

from __future__ import annotations

import math

from firmware_emulator.chip import Triple

UP: dict[str, Triple] = {
    "+X": (1.0, 0.0, 0.0),
    "-X": (-1.0, 0.0, 0.0),
    "+Y": (0.0, 1.0, 0.0),
    "-Y": (0.0, -1.0, 0.0),
    "+Z": (0.0, 0.0, 1.0),
    "-Z": (0.0, 0.0, -1.0),
}
"""Upwards, seen from a box of which this axis points up."""


def cross(a: Triple, b: Triple) -> Triple:
    """Vector product."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def scaled(vector: Triple, factor: float) -> Triple:
    """`factor` times `vector`."""
    return vector[0] * factor, vector[1] * factor, vector[2] * factor


def seen_after_turn(vector: Triple, axis: Triple, cosine: float, sine: float) -> Triple:
    """A vector fixed to the earth, seen from a box that has turned about its unit `axis` by an angle (Rodrigues)."""
    along = (axis[0] * vector[0] + axis[1] * vector[1] + axis[2] * vector[2]) * (1.0 - cosine)
    aside = cross(vector, axis)
    x, y, z = (vector[i] * cosine + aside[i] * sine + axis[i] * along for i in range(3))
    return x, y, z


def turn_between(up_before: str, up_after: str) -> tuple[Triple, float]:
    """Axis in the box and angle (rad) of the shortest turn that brings `up_after` up; half a turn goes about X or Y."""
    before, after = UP[up_before], UP[up_after]
    axis = cross(after, before)
    if any(axis):
        return axis, math.pi / 2
    return UP["+Y" if up_before[1] == "X" else "+X"], 0.0 if before == after else math.pi
