"""Inverse kinematics of the nominal robot for a point and an axis of the tool."""

from __future__ import annotations

import numpy as np

from clampid.stages.rows import Array
from kinematics.description import RobotDescription
from kinematics.poe import forward, space_jacobian

__all__ = ["reaching"]

ITERATIONS = 60
REACHED_WITHIN = 1e-6  # m of the position, and 1 of the unit vector: together
LARGEST_STEP = 0.5  # rad (m): of any joint in one iteration
DAMPING = 1e-3  # m (per rad) of the damped least squares


def reaching(
    robot: RobotDescription, place: Array, axis: Array, starts: Array, *, point: Array, normal: Array
) -> Array:
    """Configurations ``(k, n)``, rad, that bring a tool point to a place and a tool axis to a direction; maybe none.

    Damped least squares on the nominal robot (Nakamura and Hanafusa, Inverse kinematic solutions with singularity
    robustness, J. Dyn. Sys. Meas. Control 108, 1986). Joint limits are not enforced.

    Parameters
    ----------
    robot
        The robot.
    place, point
        Wanted position ``(3,)``, m, base frame, of the point ``(3,)``, m, flange frame.
    axis, normal
        Wanted direction ``(3,)``, unit vector, base frame, of the axis ``(3,)``, unit vector, flange frame. The
        rotation about it is free.
    starts
        Initial configurations ``(K, n)``, rad; each gives one configuration or none.
    """
    q = np.array(starts, dtype=float)
    linkage = np.asarray(robot.linkage)
    for _ in range(ITERATIONS):
        error, jacobian = _error(robot, q, linkage, place, axis, point, normal)
        if np.all(np.linalg.norm(error, axis=1) < REACHED_WITHIN):
            break
        square = np.swapaxes(jacobian, 1, 2) @ jacobian + DAMPING**2 * np.eye(q.shape[1])
        step = np.linalg.solve(square, np.einsum("kij,ki->kj", jacobian, error)[..., None])[..., 0]
        q += step * np.minimum(1.0, LARGEST_STEP / np.maximum(np.abs(step).max(axis=1, keepdims=True), 1e-12))
    error, _ = _error(robot, q, linkage, place, axis, point, normal)
    q = q[np.linalg.norm(error, axis=1) < REACHED_WITHIN]
    turning = np.linalg.norm(np.asarray(robot.screws)[:, :3], axis=1) > 0
    lower, upper = np.asarray(robot.lower), np.asarray(robot.upper)
    # The configuration one turn away may be inside the limits: angles are wrapped about the middle of the range.
    middle = np.where(np.isfinite(lower + upper), (lower + upper) / 2, 0.0)
    turned = middle + np.remainder(q - middle + np.pi, 2 * np.pi) - np.pi
    return np.asarray(np.where(turning, turned, q))


def _error(
    robot: RobotDescription, q: Array, linkage: Array, place: Array, axis: Array, point: Array, normal: Array
) -> tuple[Array, Array]:
    """Error ``(K, 6)`` of position, m, and direction, and the Jacobian ``(K, 6, n)`` of both."""
    chain = q @ linkage.T
    pose = forward(robot.screws, robot.flange, chain)
    R, p = pose[:, :3, :3], pose[:, :3, :3] @ point + pose[:, :3, 3]
    looks = R @ normal
    J = space_jacobian(robot.screws, chain) @ linkage
    turn, shift = J[:, :3], J[:, 3:]
    at_point = shift + np.cross(turn, p[:, :, None], axis=1)
    of_normal = np.cross(turn, looks[:, :, None], axis=1)
    return np.hstack([place - p, axis - looks]), np.concatenate([at_point, of_normal], axis=1)
