"""Configurations of the nominal robot that bring a point of the tool to a place, facing a given way."""

from __future__ import annotations

import numpy as np

from clampid.stages.rows import Array
from kinematics.description import RobotDescription
from kinematics.poe import forward, space_jacobian

__all__ = ["reaching"]

ITERATIONS = 60
REACHED_WITHIN = 1e-6  # m, and of a unit vector
LONGEST_STEP = 0.5  # rad: the most that a joint moves in one iteration
DAMPING = 1e-3


def reaching(robot: RobotDescription, place: Array, way: Array, starts: Array, *, point: Array, normal: Array) -> Array:
    """Configurations ``(k, n)``, rad, found from ``starts`` ``(K, n)``, that reach a place; none: ``(0, n)``.

    Damped least squares on the nominal robot (Nakamura and Hanafusa, Inverse kinematic solutions with singularity
    robustness, J. Dyn. Sys. Meas. Control 108, 1986). Joint limits are not regarded.

    Parameters
    ----------
    place
        ``(3,)`` m, base frame: where ``point`` ``(3,)``, m in the flange frame, shall be.
    way
        ``(3,)`` unit, base frame: where ``normal`` ``(3,)``, unit in the flange frame, shall look. The turn about it
        is free.
    """
    q = np.array(starts, dtype=float)
    linkage = np.asarray(robot.linkage)
    for _ in range(ITERATIONS):
        error, jacobian = _error(robot, q, linkage, place, way, point, normal)
        if np.all(np.linalg.norm(error, axis=1) < REACHED_WITHIN):
            break
        square = np.swapaxes(jacobian, 1, 2) @ jacobian + DAMPING**2 * np.eye(q.shape[1])
        step = np.linalg.solve(square, np.einsum("kij,ki->kj", jacobian, error)[..., None])[..., 0]
        q += step * np.minimum(1.0, LONGEST_STEP / np.maximum(np.abs(step).max(axis=1, keepdims=True), 1e-12))
    error, _ = _error(robot, q, linkage, place, way, point, normal)
    q = q[np.linalg.norm(error, axis=1) < REACHED_WITHIN]
    turning = np.linalg.norm(np.asarray(robot.screws)[:, :3], axis=1) > 0
    lower, upper = np.asarray(robot.lower), np.asarray(robot.upper)
    # A whole turn less may be inside the limits.
    middle = np.where(np.isfinite(lower + upper), (lower + upper) / 2, 0.0)
    turned = middle + np.remainder(q - middle + np.pi, 2 * np.pi) - np.pi
    return np.asarray(np.where(turning, turned, q))


def _error(
    robot: RobotDescription, q: Array, linkage: Array, place: Array, way: Array, point: Array, normal: Array
) -> tuple[Array, Array]:
    """Error ``(K, 6)`` of position and direction, and the derivative ``(K, 6, n)`` of what is there."""
    chain = q @ linkage.T
    pose = forward(robot.screws, robot.flange, chain)
    R, p = pose[:, :3, :3], pose[:, :3, :3] @ point + pose[:, :3, 3]
    looks = R @ normal
    J = space_jacobian(robot.screws, chain) @ linkage
    turn, shift = J[:, :3], J[:, 3:]
    at_point = shift + np.cross(turn, p[:, :, None], axis=1)
    of_normal = np.cross(turn, looks[:, :, None], axis=1)
    return np.hstack([place - p, way - looks]), np.concatenate([at_point, of_normal], axis=1)
