"""The loads of :mod:`clampid.stages.loads` as casadi expressions of the posture, for kernels that need them there.

Torques of weight are those of :mod:`kinematics.symbolic_dynamics`; the moments and forces on base, bearings and links
are built here from the same screws. Nothing here knows a parameter of its own. Tests hold every signal against the
numerical one to 1e-12.
"""

from __future__ import annotations

from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np
import numpy.typing as npt

from clampid.stages.loads import flange_to_base
from kinematics.gravity import gravity_parameters
from kinematics.masses import links_of
from kinematics.robot import RobotDescription
from kinematics.symbolic import exponential_sx
from kinematics.symbolic_dynamics import symbolic_torques

__all__ = ["Loads"]

Array = npt.NDArray[np.float64]


class Loads:
    """Gravity's loads in a symbolic posture, each built when it is first read.

    Parameters
    ----------
    robot
        The nominal robot.
    gravity
        ``(3,)``, base frame, m/s².
    tool
        ``(4,)``: (m, m c) of the declared tool in the flange frame, kg and kg m.
    q
        ``(n,)`` expression: the controller's joint values, rad.
    """

    def __init__(self, robot: RobotDescription, gravity: Array, tool: Array, q: Any) -> None:
        self.robot, self.g, self.n = robot, ca.DM(gravity), robot.n
        self.linkage = ca.DM(robot.linkage)
        self.chain = self.linkage @ q
        flange = np.asarray(robot.flange)
        self.to_base = flange_to_base(robot)
        self.tool = self.to_base @ tool
        self.tool_mass = float(tool[0])
        self.tool_at = flange[:3, :3] @ (tool[1:] / tool[0] if tool[0] else np.zeros(3)) + flange[:3, 3]
        self.masses = np.asarray(gravity_parameters(links_of(robot)), dtype=float).copy()
        self.points = np.array([*(joint.point for joint in robot.joints), flange[:3, 3]])

    def signal(self, name: str) -> Any:
        """The signal of that name, rows flattened; :func:`gravity_signals` and :func:`bearing_signals` tell them."""
        match name:
            case "regressor":
                return _flat(self.regressor)
            case "tool_regressor":
                return _flat(self.regressor[:, -4:] @ ca.DM(self.to_base))
            case "gravity_torque":
                phi = self.masses.copy()
                phi[-4:] += self.tool
                return self.regressor @ ca.DM(phi)
            case _:
                return self._bearing(name)

    @cached_property
    def frames(self) -> list[tuple[Any, Any]]:
        """Motions (rotation, translation in m) of base and links from the zero pose."""
        R, p = ca.SX.eye(3), ca.SX.zeros(3)
        found = [(R, p)]
        for screw, angle in zip(self.robot.screws, ca.vertsplit(self.chain), strict=True):
            E = exponential_sx(screw, angle)
            R, p = R @ E[:3, :3], p + R @ E[:3, 3]
            found.append((R, p))
        return found

    @cached_property
    def regressor(self) -> Any:
        """``(n, 4n)`` of the links' (m, m c), controller's joints: see :mod:`kinematics.symbolic_dynamics`."""
        at_rest = ca.SX(self.n, 1)
        gravity = np.asarray(self.g).ravel()
        torques = symbolic_torques(self.robot.screws, self.points[:-1], gravity, self.chain, at_rest, at_rest)
        return ca.densify(self.linkage.T @ torques.weight)

    @cached_property
    def stiffness(self) -> Any:
        """``(n, n)``, Nm/rad, of all that weighs: see :func:`kinematics.gravity.gravity_stiffness`."""
        phi, screws = self.masses.copy(), np.asarray(self.robot.screws, dtype=float)
        phi[-4:] += self.tool
        follows: list[Any] = []
        presses: list[Any] = []
        hanging, mass = ca.SX.zeros(3), 0.0
        for k in reversed(range(self.n)):
            (R, p), (moved, t) = self.frames[k], self.frames[k + 1]
            mass += phi[4 * k]
            hanging = hanging + moved @ ca.DM(phi[4 * k + 1 : 4 * k + 4]) + phi[4 * k] * t
            axis = R @ ca.DM(screws[k, :3])
            velocity = R @ ca.DM(screws[k, 3:]) + ca.cross(p, axis)
            follows.insert(0, ca.cross(axis, hanging) + mass * velocity)
            presses.insert(0, -ca.cross(self.g, axis))
        out = ca.SX(self.n, self.n)
        for i in range(self.n):
            for k in range(i, self.n):
                out[i, k] = out[k, i] = ca.dot(presses[i], follows[k])
        return self.linkage.T @ out @ self.linkage

    def _about(self, point: Any, first: int) -> Any:
        """Moment regressor ``(3, 4n)`` about a point of links ``first`` and after."""
        out = ca.SX(3, 4 * self.n)
        for k in range(first, self.n):
            R, t = self.frames[k + 1]
            out[:, 4 * k] = ca.cross(t - point, self.g)
            out[:, 4 * k + 1 : 4 * k + 4] = -ca.skew(self.g) @ R
        return out

    def _weighed(self, regressor: Any) -> Any:
        phi = self.masses.copy()
        phi[-4:] += self.tool
        return regressor @ ca.DM(phi)

    def _carried(self, i: int) -> Any:
        """Moment regressor at joint i's point, in the base's axes ``(3, 4n)``."""
        R, p = self.frames[i]
        return self._about(R @ ca.DM(self.points[i]) + p, i)

    def _moment(self, i: int) -> Any:
        """The same in the axes of the link before the joint."""
        return self.frames[i][0].T @ self._carried(i)

    def _transverse(self, i: int) -> Any:
        """The part across the joint's axis, in the axes of the link behind it."""
        local, axis = self.frames[i + 1][0].T @ self._carried(i), ca.DM(self.robot.joints[i].axis)
        return local - axis @ (axis.T @ local)

    def _force(self, i: int) -> Any:
        out = ca.SX(3, 4 * self.n)
        for k in range(i, self.n):
            out[:, 4 * k] = self.frames[i][0].T @ self.g
        return out

    def _bearing(self, name: str) -> Any:
        n, by_mass = self.n, name.endswith("_regressor")
        nothing = ca.SX(3, 4 * n)
        match name.removesuffix("_regressor"):
            case "base_moment":
                parts = [self._about(ca.SX.zeros(3), 0)]
            case "transverse_moment":
                parts = [self._transverse(i) for i in range(n)]
            case "link_moment":
                parts = [*(self._moment(i) for i in range(1, n)), nothing]
            case "link_force":
                parts = [*(self._force(i) for i in range(1, n)), nothing]
            case _:
                raise KeyError(name)
        if by_mass:
            return _flat(ca.vertcat(*parts))
        found = ca.vertcat(*(self._weighed(part) for part in parts))
        if name in ("link_moment", "link_force"):  # the last link's far end carries the tool alone
            R, _ = self.frames[n]
            weight = self.tool_mass * self.g
            lever = R @ ca.DM(self.tool_at - self.points[n])
            found[3 * n - 3 :] = R.T @ (ca.cross(lever, weight) if name == "link_moment" else weight)
        return found


def _flat(matrix: Any) -> Any:
    """Row-major."""
    return ca.vec(ca.densify(matrix).T)
