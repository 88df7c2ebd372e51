"""The pose prediction of one row as a casadi function: product of exponentials with a small motion after each joint.

The one place where the stations of the pose stage meet the arm's kinematics; see `clampid.stages.poses`.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np

from clampid.chain.compiled import Blocks, compile_rows
from clampid.chain.lanes import Lanes
from clampid.stages.rows import Array
from kinematics.symbolic import cayley_left_jacobian_sx, cayley_sx, exponential_sx, hat_sx

__all__ = ["kernel", "link_points", "pose_function"]


def link_points(robot: Any) -> Array:
    """Far end of each link at the zero pose ``(n, 3)``: the next joint's point; for the last link the flange."""
    return np.array([*(joint.point for joint in robot.joints[1:]), robot.flange[:3, 3]])


def kernel(robot: Any) -> Blocks | Lanes:
    """Position, rotation and sensitivity of rows (q, base reference, target, deviations) of this robot.

    Returns
    -------
    Blocks or Lanes
        With inputs ``q (N, n)``, base reference ``(N, 12)`` (rotation by rows, position), target ``(N, 3)``, deviations
        ``(N, S)`` at joint angles, base, links, target and measurement; outputs position ``(N, 3)``, rotation by rows
        ``(N, 9)``, sensitivity by rows ``(N, 6 S)``, m and rad, instrument frame.
    """
    arm = (robot.linkage, robot.screws, link_points(robot), robot.flange)
    return _kernel(robot.n, *(np.ascontiguousarray(a, dtype=float).tobytes() for a in arm))


@lru_cache(maxsize=64)
def _kernel(n: int, linkage: bytes, screws: bytes, points: bytes, flange: bytes) -> Blocks | Lanes:
    shapes = ((n, n), (n, 6), (n, 3), (4, 4))
    arm = [np.frombuffer(b).reshape(shape) for b, shape in zip((linkage, screws, points, flange), shapes, strict=True)]
    return compile_rows(pose_function(*arm))


def pose_function(linkage: Array, screws: Array, points: Array, flange: Array) -> Any:
    """The casadi function of :func:`kernel`, of an empty vector and one row, for use in larger expressions.

    Parameters
    ----------
    linkage, screws, points, flange
        ``(n, n)``, ``(n, 6)``, ``(n, 3)`` m and ``(4, 4)`` of the nominal robot, base frame, zero pose.
    """
    n = len(screws)
    row = {name: ca.SX.sym(name, size) for name, size in (("q", n), ("X", 12), ("target", 3), ("d", 7 * n + 12))}
    d = row["d"]
    base, links = d[n : n + 6], [d[n + 6 + 6 * i : n + 12 + 6 * i] for i in range(n)]
    # Drives and encoders sit on the controller's side of a linkage: what they are off by passes through it.
    q = ca.DM(linkage) @ (row["q"] + d[:n])
    R, p = ca.reshape(row["X"][:9], 3, 3).T, row["X"][9:]
    # Forward, remembering what every deviation's frame is.
    before, (R, p) = R, _moved(R, p, ca.DM.zeros(3), base)
    frames, joints = [(before, p, base)], []
    for i in range(n):
        joints.append((R, p))
        E = exponential_sx(screws[i], q[i])
        p = p + R @ E[:3, 3]
        before = R @ E[:3, :3]
        R, p = _moved(before, p, ca.DM(points[i]), links[i])
        frames.append((before, p + R @ ca.DM(points[i]), links[i]))
    at_flange = ca.DM(flange[:3, :3]) @ (row["target"] + d[7 * n + 6 : 7 * n + 9]) + ca.DM(flange[:3, 3])
    position, rotation = p + R @ at_flange, R @ ca.DM(flange[:3, :3])
    by_chain = ca.horzcat(*(_joint_column(*pose, screw, position) for pose, screw in zip(joints, screws, strict=True)))
    columns = [by_chain @ ca.sparsify(ca.DM(linkage))]
    columns += [_twist_columns(*frame, position) for frame in frames]
    columns += [ca.vertcat(rotation, ca.SX(3, 3)), ca.vertcat(ca.SX.eye(3), ca.SX(3, 3))]
    sensitivity = ca.densify(ca.horzcat(*columns))
    out = [position + d[7 * n + 9 :], ca.vec(ca.densify(rotation).T), ca.vec(sensitivity.T)]
    return ca.Function("poses", [ca.SX(0, 1), ca.vertcat(*row.values())], out)


def _moved(R: Any, p: Any, pivot: Any, twist: Any) -> tuple[Any, Any]:
    """(R, p) followed by a small motion about ``pivot``: x -> pivot + v + C(w)(x - pivot)."""
    C = cayley_sx(twist[:3])
    return R @ C, p + R @ (pivot + twist[3:] - C @ pivot)


def _joint_column(R: Any, p: Any, screw: Array, position: Any) -> Any:
    w, v = R @ ca.DM(screw[:3]), R @ ca.DM(screw[3:])
    return ca.vertcat(ca.cross(w, position - p) + v, w)


def _twist_columns(R: Any, pivot: Any, twist: Any, position: Any) -> Any:
    turn = R @ cayley_left_jacobian_sx(twist[:3])
    return ca.horzcat(ca.vertcat(-hat_sx(position - pivot) @ turn, turn), ca.vertcat(R, ca.SX(3, 3)))
