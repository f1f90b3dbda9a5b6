"""Rotation matrices, vectors and quaternions. A matrix `level_box` turns vectors of the box into those of the level
frame, whose z points up.
"""

from __future__ import annotations

from math import sqrt

import numpy as np

from tests.bench_world.chips import Array

RADIANS = np.pi / 180
"""rad per degree."""
DIRECTIONS = {
    "+Z": (0, 0, 1),
    "-Z": (0, 0, -1),
    "+X": (1, 0, 0),
    "-X": (-1, 0, 0),
    "+Y": (0, 1, 0),
    "-Y": (0, -1, 0),
}
"""Of the box, by the names of phases."""
HEADING_ERROR_DEG = 3
"""How well a box is laid along the edge of a table."""

Quaternion = tuple[float, float, float, float]


def cross_matrix(vector: Array) -> Array:
    """Return the (3, 3) matrix whose product with another vector is the cross product."""
    x, y, z = vector
    return np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])


def matrix_of(vector: Array) -> Array:
    """Return the rotation by `vector` (3,) rad, after Rodrigues."""
    angle = np.linalg.norm(vector)
    if angle < 1e-12:
        return np.eye(3)
    cross = cross_matrix(vector / angle)
    return np.asarray(np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross)


def vector_of(matrix: Array) -> Array:
    """Return the rotation vector (3,) rad of a matrix."""
    angle = np.arccos(np.clip((np.trace(matrix) - 1) / 2, -1, 1))
    if angle < 1e-9:
        return np.zeros(3)
    if angle > np.pi - 1e-4:
        _, vectors = np.linalg.eigh((matrix + matrix.T) / 2)
        return np.asarray(vectors[:, -1] * angle)
    return np.asarray(angle / (2 * np.sin(angle)) * _skew_part(matrix))


def quaternion_of(matrix: Array) -> Quaternion:
    """Return the unit quaternion of a matrix, its real part first."""
    real = sqrt(max(0, 1 + np.trace(matrix))) / 2
    if real > 0.1:
        x, y, z = _skew_part(matrix) / 4 / real
        return real, x, y, z
    first = int(np.argmax(np.diag(matrix)))
    second, third = (first + 1) % 3, (first + 2) % 3
    size = sqrt(1 + matrix[first, first] - matrix[second, second] - matrix[third, third]) * 2
    imaginary = [0.0, 0.0, 0.0]
    imaginary[first] = size / 4
    imaginary[second] = (matrix[second, first] + matrix[first, second]) / size
    imaginary[third] = (matrix[third, first] + matrix[first, third]) / size
    x, y, z = imaginary
    return (matrix[third, second] - matrix[second, third]) / size, x, y, z


def product(left: Quaternion, right: Quaternion) -> Quaternion:
    """Return the rotation `right`, followed by `left`."""
    a, b, c, d = left
    real, x, y, z = right
    return (
        a * real - b * x - c * y - d * z,
        a * x + b * real + c * z - d * y,
        a * y - b * z + c * real + d * x,
        a * z + b * y - c * x + d * real,
    )


def matrices_of(quaternions: Array) -> Array:
    """Return the matrices (3, 3, n) of unit quaternions (n, 4)."""
    a, b, c, d = quaternions.T
    return np.array(
        [
            [1 - 2 * (c * c + d * d), 2 * (b * c - a * d), 2 * (b * d + a * c)],
            [2 * (b * c + a * d), 1 - 2 * (b * b + d * d), 2 * (c * d - a * b)],
            [2 * (b * d - a * c), 2 * (c * d + a * b), 1 - 2 * (b * b + c * c)],
        ]
    )


def draw_attitude(up: str, stream: np.random.Generator, tilt_deg: float = 0.4) -> Array:
    """Return `level_box` of a box that lies along the edge of a table with this axis up; `tilt_deg` is the standard
    deviation of its tilt about each level axis.
    """
    axis_box = np.array(DIRECTIONS[up], float)
    side = np.cross(axis_box, [0, 0, 1.0])
    if np.linalg.norm(side) < 1e-9:
        upright = np.eye(3) if axis_box[2] > 0 else np.diag([1, -1, -1.0])
    else:
        upright = matrix_of(side / np.linalg.norm(side) * np.pi / 2)
    heading = matrix_of(np.array([0, 0, stream.normal(0, HEADING_ERROR_DEG) * RADIANS]))
    tilt = matrix_of(np.array([*(stream.normal(0, tilt_deg, 2) * RADIANS), 0]))
    return tilt @ heading @ upright


def _skew_part(matrix: Array) -> Array:
    return np.array([matrix[2, 1] - matrix[1, 2], matrix[0, 2] - matrix[2, 0], matrix[1, 0] - matrix[0, 1]])
