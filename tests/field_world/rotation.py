"""Quaternions (w, x, y, z) and rotation matrices."""

from __future__ import annotations

import numpy as np


def product(a, b):
    """Return the product of two quaternions, or of two rows of them."""
    aw, ax, ay, az = np.moveaxis(np.asarray(a, float), -1, 0)
    bw, bx, by, bz = np.moveaxis(np.asarray(b, float), -1, 0)
    return np.stack(
        [
            aw * bw - ax * bx - ay * by - az * bz,
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
        ],
        -1,
    )


def about(axis, angle):
    """Return the quaternions of turns by `angle` (rad) about an axis."""
    axis = np.asarray(axis, float)
    axis = axis / np.linalg.norm(axis)
    angle = np.asarray(angle, float)
    return np.concatenate([np.cos(angle / 2)[..., None], np.sin(angle / 2)[..., None] * axis], -1)


def of_vectors(v):
    """Return the quaternions of rotation vectors (n, 3)."""
    v = np.asarray(v, float)
    a = np.linalg.norm(v, axis=-1, keepdims=True)
    s = 0.5 * np.sinc(a / (2 * np.pi))
    return np.concatenate([np.cos(a / 2), s * v], -1)


def to_box(q, v):
    """Return vectors of the world in the frame of the box, whose attitudes are `q`, row by row."""
    w, u = q[..., :1], -q[..., 1:]
    t = 2 * np.cross(u, v)
    return v + w * t + np.cross(u, t)


def rotation_matrix(v):
    """Return the matrix of a rotation vector."""
    v = np.asarray(v, float)
    a = np.linalg.norm(v)
    if a < 1e-12:
        return np.eye(3)
    k = v / a
    K = np.array([[0, -k[2], k[1]], [k[2], 0, -k[0]], [-k[1], k[0], 0]])
    return np.eye(3) + np.sin(a) * K + (1 - np.cos(a)) * K @ K
