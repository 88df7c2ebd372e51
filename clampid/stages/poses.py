"""The pose experiment: the arm stands still, and a point of it, or the whole flange, is measured.

Product of exponentials with a small motion of each link's far end between the joints (universal model, eqs. 5-11)::

    x = X_0 M_0 prod_i exp([xi_i] (q_i + dq_i)) M_i  (flange target)

X_0 is a constant guess of where the instrument sees the base; M_0 and M_i come from the chain.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from clampid.chain import Chain, Deviations
from clampid.stages.rows import Array, Rows
from kinematics.screws import cayley, cayley_left_jacobian, exp_se3, hat3, log_so3

__all__ = ["evaluate", "flanks", "link_points", "link_vectors", "predict", "residual"]


def link_points(robot: Any) -> Array:
    """Where each link's far end is at the zero pose ``(n, 3)``: the next joint's point; at last the flange."""
    return np.array([*(joint.point for joint in robot.joints[1:]), robot.flange[:3, 3]])


def link_vectors(robot: Any) -> Array:
    """From each joint's point to its link's far end ``(n, 3)``, base axes at the zero pose, m."""
    return np.asarray(link_points(robot) - np.array([joint.point for joint in robot.joints]))


def predict(rows: Rows, deviations: Deviations, offsets: Mapping[str, slice]) -> tuple[Array, Array, Array]:
    """Positions and orientations, and what a deviation at each station does to them.

    Returns
    -------
    position
        ``(N, 3)``, instrument frame, m.
    rotation
        ``(N, 3, 3)``, flange to instrument frame.
    sensitivity
        ``(N, 6, S)``: d (position, rotation vector) / d station entries, instrument frame.
    """
    robot, s = rows.robot, deviations.values
    count, n = len(rows), robot.n
    screws, points = np.asarray(robot.screws), link_points(robot)
    q = rows.signals["q"] @ np.asarray(robot.linkage).T + s[:, offsets["joint_angle"]]
    base = s[:, offsets["base_twist"]]
    links = s[:, offsets["link_twist"]].reshape(count, n, 6)
    target = rows.constants["target"] + s[:, offsets["target_shift"]]
    # Forward, remembering what every deviation's frame is.
    R, p = _compose(*_split(rows.constants["base_reference"]), np.zeros(3), base)
    frames = [(_split(rows.constants["base_reference"])[0], p, base)]
    joints = []
    for i in range(n):
        joints.append((R, p))
        E = exp_se3(screws[i] * q[:, i, None])
        R, p = R @ E[:, :3, :3], p + np.einsum("nij,nj->ni", R, E[:, :3, 3])
        before = R
        R, p = _compose(R, p, points[i], links[:, i])
        frames.append((before, p + np.einsum("nij,j->ni", R, points[i]), links[:, i]))
    end = robot.flange[:3, :3] @ target[:, :, None]
    position = p + np.einsum("nij,nj->ni", R, end[:, :, 0] + robot.flange[:3, 3])
    rotation = R @ robot.flange[:3, :3]
    sensitivity = np.zeros((count, 6, s.shape[1]))
    for i, (Rj, pj) in enumerate(joints):
        w = np.einsum("nij,j->ni", Rj, screws[i, :3])
        v = np.einsum("nij,j->ni", Rj, screws[i, 3:])
        column = offsets["joint_angle"].start + i
        sensitivity[:, :3, column] = np.cross(w, position - pj) + v
        sensitivity[:, 3:, column] = w
    starts = [offsets["base_twist"].start, *(offsets["link_twist"].start + 6 * i for i in range(n))]
    for start, (before, pivot, twist) in zip(starts, frames, strict=True):
        turn = before @ cayley_left_jacobian(twist[:, :3])
        sensitivity[:, :3, start : start + 3] = -hat3(position - pivot) @ turn
        sensitivity[:, 3:, start : start + 3] = turn
        sensitivity[:, :3, start + 3 : start + 6] = before
    sensitivity[:, :3, offsets["target_shift"]] = rotation
    sensitivity[:, :3, offsets["measurement"]] = np.eye(3)
    return position + s[:, offsets["measurement"]], rotation, sensitivity


def flanks(rows: Rows, chain: Chain, theta: Array) -> Array | None:
    """Sides on which the torques press at these parameters ``(N, n)``, or None if no effect asks."""
    if not chain.reads_flanks:
        return None
    open_ = {**rows.signals, "flank": np.zeros((len(rows), rows.robot.n))}
    pressing = chain.evaluate(theta, open_).pressing
    return None if pressing is None else np.sign(pressing)


def evaluate(rows: Rows, chain: Chain, theta: Array) -> Deviations:
    """Deviations at the flanks that the rows come with, or else at those that these parameters give."""
    if chain.reads_flanks and "flank" not in rows.signals:
        found = flanks(rows, chain, theta)
        return chain.evaluate(theta, {**rows.signals, "flank": found} if found is not None else rows.signals)
    return chain.evaluate(theta, rows.signals)


def residual(rows: Rows, chain: Chain, theta: Array) -> tuple[Array, Array]:
    """Measured less predicted ``(N, m)``, and the prediction's derivative ``(N, m, P)``; m = 6 with rotations."""
    deviations = evaluate(rows, chain, theta)
    position, rotation, sensitivity = predict(rows, deviations, chain.offsets)
    width = rows.measured.shape[1]
    error = np.empty((len(rows), width))
    error[:, :3] = rows.measured[:, :3] - position
    if width == 6:
        error[:, 3:] = log_so3(rows.constants["rotation"] @ np.swapaxes(rotation, 1, 2))
    jacobian = np.zeros((len(rows), width, len(chain.slots)))
    for k, (station, parameter) in enumerate(zip(deviations.station, deviations.parameter, strict=True)):
        jacobian[:, :, parameter] += sensitivity[:, :width, station] * deviations.partials[:, k, None]
    return error, jacobian


def _split(transform: Array) -> tuple[Array, Array]:
    return transform[:, :3, :3], transform[:, :3, 3]


def _compose(R: Array, p: Array, pivot: Array, twist: Array) -> tuple[Array, Array]:
    """(R, p) followed by a small motion about ``pivot``: x -> pivot + v + C(w)(x - pivot)."""
    C = cayley(twist[:, :3])
    moved = pivot + twist[:, 3:] - np.einsum("nij,j->ni", C, pivot)
    return R @ C, p + np.einsum("nij,nj->ni", R, moved)
