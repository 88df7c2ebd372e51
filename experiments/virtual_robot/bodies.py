"""The arm as rigid bodies: ``pin`` does the dynamics on a model built here from true screws and masses."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin

from experiments.virtual_robot.description import Array
from experiments.virtual_robot.plant import Geometry, Masses


@dataclass(frozen=True)
class Wrenches:
    """Static load that each joint's bearing carries, in the frame of the link before the joint.

    ``force`` and ``moment`` are what the distal bodies exert (weight hangs down), about the joint's point, (N, n, 3).
    """

    force: Array
    moment: Array


class Bodies:
    """A chain of rigid bodies; joint frames are parallel to the base at the zero pose."""

    def __init__(self, geometry: Geometry, masses: Masses) -> None:
        self._model: Any = pin.Model()
        self._model.gravity.linear = np.asarray(masses.gravity)
        self._linkage = geometry.linkage
        parent, before = 0, np.zeros(3)
        for i, kind in enumerate(geometry.kinds):
            placement = pin.SE3(np.eye(3), geometry.points[i] - before)
            parent = self._model.addJoint(parent, _joint(kind, geometry.axes[i], geometry.pitch[i]), placement, f"j{i}")
            before = geometry.points[i]
            if masses.link[i] > 0:
                body = _rod(masses.link[i], masses.com[i] - before, geometry.link_vectors[i])
                self._model.appendBodyToJoint(parent, body, pin.SE3.Identity())
        self.flange: Array = geometry.flange.copy()  # in the last joint's frame
        self.flange[:3, 3] -= before
        if masses.known and masses.tool > 0:
            mount = pin.SE3(self.flange[:3, :3].copy(), self.flange[:3, 3].copy())
            tool = pin.Inertia(masses.tool, np.asarray(masses.tool_com), 0.02 * np.eye(3))
            self._model.appendBodyToJoint(parent, tool, mount)
        self._data: Any = self._model.createData()

    def _each(self, function: Callable[..., Any], *columns: Array) -> Array:
        rows = [np.array(function(*row)) for row in zip(*columns, strict=True)]
        return np.array(rows, dtype=float).reshape(len(columns[0]), -1)

    def gravity(self, q: Array) -> Array:
        """Return the torques that hold the arm still, +dV/dq, Nm, (N, n), at joint angles q, rad, (N, n)."""
        chain = q @ self._linkage.T
        torque = self._each(lambda a: pin.computeGeneralizedGravity(self._model, self._data, a), chain)
        return np.asarray(torque @ self._linkage, dtype=float)

    def torque(self, q: Array, qd: Array, qdd: Array) -> Array:
        """Return the joint torques of a motion, Nm, (N, n): gravity, inertia and what goes with speed squared."""
        L = self._linkage
        rows = self._each(lambda *a: pin.rnea(self._model, self._data, *a), q @ L.T, qd @ L.T, qdd @ L.T)
        return np.asarray(rows @ L, dtype=float)

    def steps(self, q: Array) -> Array:
        """Return the pose of each joint's frame in the frame before it, (N, n, 4, 4)."""

        def one(chain: Array) -> list[Array]:
            pin.forwardKinematics(self._model, self._data, chain)
            return [self._data.liMi[i].homogeneous for i in range(1, self._model.njoints)]

        n = self._model.njoints - 1
        return self._each(one, q @ self._linkage.T).reshape(len(q), n, 4, 4)

    def wrenches(self, q: Array) -> Wrenches:
        """Return the static loads on the bearings at joint angles q, rad, (N, n)."""
        still = np.zeros(self._model.nv)

        def one(chain: Array) -> list[Array]:
            pin.rnea(self._model, self._data, chain, still, still)
            out = []
            for i in range(1, self._model.njoints):
                rotation = self._data.liMi[i].rotation
                out.append(-np.concatenate([rotation @ self._data.f[i].linear, rotation @ self._data.f[i].angular]))
            return out

        rows = self._each(one, q @ self._linkage.T).reshape(len(q), -1, 6)
        return Wrenches(rows[..., :3], rows[..., 3:])

    def jacobian(self, q: Array) -> Array:
        """Return the flange Jacobian (linear, angular) along the base axes, (6, n), at joint angles q, rad, (n,)."""
        chain = self._linkage @ q
        J = np.array(pin.computeJointJacobians(self._model, self._data, chain))
        here = self._data.oMi[self._model.njoints - 1].act(
            pin.SE3(self.flange[:3, :3].copy(), self.flange[:3, 3].copy())
        )
        lever = here.translation
        # Spatial Jacobian at the base origin; move its linear part to the flange.
        return np.vstack([J[:3] + np.cross(J[3:].T, lever).T, J[3:]]) @ self._linkage


def _joint(kind: str, axis: Array, pitch: float) -> Any:
    if kind == "revolute":
        return pin.JointModelRevoluteUnaligned(np.asarray(axis))
    if kind == "prismatic":
        return pin.JointModelPrismaticUnaligned(np.asarray(axis))
    if kind == "helical":
        return pin.JointModelHelicalUnaligned(np.asarray(axis), float(pitch))
    raise ValueError(f"joint kind {kind!r}: expected revolute, prismatic or helical")


def _rod(mass: float, com: Array, vector: Array) -> Any:
    """Return the inertia of a rod along the link, 0.1 m thick in radius of gyration."""
    gyration = (vector @ vector * np.eye(3) - np.outer(vector, vector)) / 12 + 0.01 * np.eye(3)
    return pin.Inertia(float(mass), np.asarray(com), mass * gyration)
