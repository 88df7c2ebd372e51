"""Places as a KUKA controller writes them: X Y Z in mm, A B C in degrees, in the robot's base (ROBROOT).

A turns about z, B about the new y, C about the new x: R = Rz(A) Ry(B) Rx(C). Two frames go beside joint angles:

* ``flange`` and ``detector``: where the identified arm has them;
* ``controller_flange``: what the controller itself computes from the same joint angles, by the nominal arm. That is
  what its display shows.

Source: KUKA.EthernetKRL 2.2, type FRAME.
"""

from __future__ import annotations

import math
from typing import Any

import casadi as ca
import numpy as np
import numpy.typing as npt

from kinematics.robot import RobotDescription

__all__ = ["Frame", "Framing", "kuka_frame"]

Array = npt.NDArray[np.float64]
Frame = dict[str, float]

NAMES = ("X_mm", "Y_mm", "Z_mm", "A_deg", "B_deg", "C_deg")
POLE = 1e-9  # of cos B, below which A and C turn about one axis


def kuka_frame(pose: Array) -> Frame:
    """A pose ``(4, 4)``, m, as X, Y, Z in mm and A, B, C in degrees; at B = ±90° A is 0."""
    return dict(zip(NAMES, np.asarray(_kuka_sx(ca.DM(np.asarray(pose)))).ravel().tolist(), strict=True))


class Framing:
    """The frames that go beside joint angles, in one call of a casadi function.

    A posture's are asked for with every answer: by numpy they would cost more than the posture.

    Parameters
    ----------
    robot
        The nominal arm, which the controller computes with.
    mount
        ``(4, 4)``: the detector in the flange's frame, as identified.
    """

    def __init__(self, robot: RobotDescription, mount: Array) -> None:
        n = robot.n
        row = ca.SX.sym("row", n + 12)
        pose = ca.vertcat(ca.reshape(row[n:], 4, 3).T, ca.DM([[0, 0, 0, 1]]))
        carried = pose @ ca.DM(np.linalg.inv(mount))
        out = ca.vertcat(*map(_kuka_sx, (pose, carried, nominal_flange(robot, row[:n]))))
        self._function = ca.Function("frames", [row], [ca.cse(out)])
        self._n, self._row, self._out = n, np.zeros(n + 12), np.zeros(18)
        buffer: Any
        buffer, self._trigger = self._function.buffer()
        buffer.set_arg(0, self._row.data)
        buffer.set_res(0, self._out.data)
        self._kept = buffer

    def __call__(self, base: Array, q: Array) -> dict[str, Frame]:
        """Of joint angles ``(n,)``, rad, that put the detector at ``base`` ``(4, 4)`` in the robot's base, m."""
        self._row[: self._n], self._row[self._n :] = q, base[:3].ravel()
        self._trigger()
        found = self._out.tolist()
        return {
            "detector": dict(zip(NAMES, found[:6], strict=True)),
            "flange": dict(zip(NAMES, found[6:12], strict=True)),
            "controller_flange": dict(zip(NAMES, found[12:], strict=True)),
        }


def nominal_flange(robot: RobotDescription, q: Any) -> Any:
    """Pose ``(4, 4)`` of the flange by the nominal arm at joint angles ``(n,)``, rad, as a casadi expression.

    All joints are revolute: for a unit screw without pitch exp([S] q) = 1 + sin q [S] + (1 - cos q) [S]².
    """
    angles, out = ca.DM(np.asarray(robot.linkage)) @ q, ca.DM.eye(4)
    for k, (x, y, z, *v) in enumerate(np.asarray(robot.screws).tolist()):
        S = ca.DM([[0, -z, y, v[0]], [z, 0, -x, v[1]], [-y, x, 0, v[2]], [0, 0, 0, 0]])
        out = out @ (ca.DM.eye(4) + ca.sin(angles[k]) * S + (1 - ca.cos(angles[k])) * (S @ S))
    return out @ ca.DM(np.asarray(robot.flange))


def _kuka_sx(pose: Any) -> Any:
    level = ca.hypot(pose[0, 0], pose[1, 0])
    free = level < POLE
    a = ca.if_else(free, 0, ca.atan2(pose[1, 0], pose[0, 0]))
    b = ca.atan2(-pose[2, 0], level)
    c = ca.if_else(free, ca.atan2(-ca.sign(pose[2, 0]) * pose[0, 1], pose[1, 1]), ca.atan2(pose[2, 1], pose[2, 2]))
    return ca.vertcat(1e3 * pose[:3, 3], math.degrees(1.0) * ca.vertcat(a, b, c))
