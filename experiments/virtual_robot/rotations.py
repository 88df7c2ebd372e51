"""Rotation matrices for whole columns of rotation vectors."""

from __future__ import annotations

import numpy as np

from experiments.virtual_robot.description import Array


def rotation_matrix(vector: Array) -> Array:
    """Return the rotations exp(v×), (..., 3, 3), of rotation vectors in rad, (..., 3)."""
    angle = np.linalg.norm(vector, axis=-1)[..., None, None]
    x, y, z = np.moveaxis(vector, -1, 0)
    o = np.zeros_like(x)
    cross = np.stack([np.stack([o, -z, y], -1), np.stack([z, o, -x], -1), np.stack([-y, x, o], -1)], -2)
    a = np.sinc(angle / np.pi)
    b = 0.5 * np.sinc(angle / 2 / np.pi) ** 2
    return np.asarray(np.eye(3) + a * cross + b * (cross @ cross), dtype=float)
