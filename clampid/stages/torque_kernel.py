"""The torque prediction of one row and its derivative as one compiled function.

It is the chain's own function with the loads' regressors put in as expressions of the posture, so that they are never
stored: of a motor's row only the parameters that can touch it are left. See `clampid.stages.torques`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import casadi as ca
import numpy as np

from clampid.chain.chain import Chain, recorded
from clampid.chain.compiled import Blocks, compile_rows
from clampid.chain.lanes import Lanes
from clampid.stages.loads import declared_weight, flange_to_base, inertial_bodies, weight_behind_tilts, with_tilts
from clampid.stages.rows import Array, Integers
from experiments.campaign import Campaign
from kinematics.gravity import inclination_axes
from kinematics.symbolic_dynamics import symbolic_torques

__all__ = ["TorqueKernel", "torque_kernel"]

COMPUTED = (
    "regressor", "tool_regressor", "link_inertia_regressor", "gravity_torque", "inclination_torque", "inertia_torque",
    "torque_rate", "axis_torque",
)  # fmt: skip
POSTURE = ("q", "joint_speed", "joint_acceleration")


@dataclass(frozen=True)
class TorqueKernel:
    """Torques of one session's rows, and their derivative by the parameters.

    Attributes
    ----------
    signals
        Names and widths of the signals that the function reads, in order.
    touched
        Per motor the parameters ``(p,)`` that can change its torque.
    linear
        Whether the torques are linear in the parameters.
    """

    signals: tuple[tuple[str, int], ...]
    touched: tuple[Integers, ...]
    linear: bool
    function: Blocks | Lanes

    def stacked(self, signals: Mapping[str, Array], chosen: Integers) -> Array:
        """Of some rows ``(N,)`` the signals that the function reads, each ``(w, …)``, beside each other ``(N, s)``."""
        columns = [column for name, width in self.signals for column in recorded(signals, name).reshape(-1, width).T]
        out = np.empty((len(columns), len(chosen)))  # column by column, as signals are in memory
        for column, place in zip(columns, out, strict=True):
            np.take(column, chosen, out=place)
        return out.T

    def evaluate(self, theta: Array, rows: Array) -> tuple[Array, list[Array]]:
        """Motor torques of inertia ``(N, n)``, Nm; per motor ``(N, p + 1)``: derivatives, and the torque predicted.

        ``theta``: the parameters ``(P,)``; where the torques are linear in them, they are predicted at zero. ``rows``
        ``(N, s)``: signals as :meth:`stacked` gives them.
        """
        n = len(self.touched)
        values = self.function(theta[: 0 if self.linear else None], rows)[0]
        ends = n + np.cumsum([0, *(len(t) + 1 for t in self.touched)])
        return values[:, :n], [values[:, a:b] for a, b in pairwise(ends)]


def torque_kernel(campaign: Campaign, chain: Chain) -> TorqueKernel:
    """The kernel of a session.

    Parameters
    ----------
    campaign
        Robot, gravity (base frame, m/s²) and declared tool (kg, m).
    chain
        The chain of the stage ``free_air``.
    """
    robot, n = campaign.robot, campaign.robot.n
    inputs = {name: ca.SX.sym(name, n) for name in POSTURE}
    computed = _computed(campaign, inputs)
    if any(name == "axis_torque" for name, _ in chain.signals):
        computed["axis_torque"] = _axis_torque(campaign, inputs["q"])
    theta = ca.SX.sym("theta", len(chain.slots))
    flats = []
    for name, width in chain.signals:
        if name in COMPUTED:
            flats.append(ca.vec(ca.densify(computed[name]).T))
        else:
            flats.append(inputs.setdefault(name, ca.SX.sym(name, width)))
    stacked, _ = chain.function.function(theta, ca.vertcat(*flats))
    T = ca.sparsify(ca.DM(np.asarray(robot.transmission)))
    inertia = T @ computed["inertia_torque"]
    deviation = T @ stacked[chain.offsets["joint_torque"]] + stacked[chain.offsets["motor_torque"]]
    jacobian = ca.jacobian(deviation, theta)
    linear = not ca.depends_on(jacobian, theta)
    if linear:
        deviation, theta = ca.substitute(deviation, theta, ca.DM.zeros(len(chain.slots))), ca.SX(0, 1)
    predicted = deviation + T @ computed["gravity_torque"]
    rows, touched = [], []
    for motor in range(n):
        row = jacobian[motor, :]
        columns = np.array(row.sparsity().get_triplet()[1], dtype=np.int64)
        touched.append(columns)
        derivative = row[[int(c) for c in columns]].T if len(columns) else ca.SX(0, 1)
        rows += [derivative, predicted[motor] + inertia[motor]]
    output = ca.densify(ca.vertcat(inertia, *rows))
    function = ca.Function("torques", [theta, ca.vertcat(*inputs.values())], [ca.cse(output)])
    widths = tuple((name, symbol.shape[0]) for name, symbol in inputs.items())
    return TorqueKernel(widths, tuple(touched), linear, compile_rows(function))


def _axis_torque(campaign: Campaign, q: Any) -> Any:
    """Expression ``(n, 2n)`` of :func:`clampid.stages.loads.axis_torque`: the weight's torques, differentiated."""
    robot, n = campaign.robot, campaign.robot.n
    linkage, points = ca.sparsify(ca.DM(np.asarray(robot.linkage))), np.array([j.point for j in robot.joints])
    angles, tilts, chain = ca.SX(3 * n, 1), ca.SX.sym("tilts", 2 * n), linkage @ q
    for i in range(n):
        angles[3 * i : 3 * i + 2] = tilts[2 * i : 2 * i + 2] if i else ca.SX(2, 1)
        angles[3 * i + 2] = chain[i]
    no_motion = (ca.SX(3 * n, 1), ca.SX(3 * n, 1))
    found = symbolic_torques(with_tilts(robot), points.repeat(3, axis=0), campaign.gravity, angles, *no_motion)
    joints = [3 * i + 2 for i in range(n)]
    torque = linkage.T @ (found.weight[joints, :] @ ca.DM(weight_behind_tilts(campaign)))
    return ca.substitute(ca.jacobian(torque, tilts), tilts, ca.DM.zeros(2 * n))


def _computed(campaign: Campaign, row: dict[str, Any]) -> dict[str, Any]:
    """Expressions of the signals that `clampid.stages.loads` gives as arrays; joints of the controller."""
    robot, n = campaign.robot, campaign.robot.n
    linkage, points = ca.sparsify(ca.DM(np.asarray(robot.linkage))), np.array([j.point for j in robot.joints])
    chain = [linkage @ row[name] for name in POSTURE]
    no_motion = (ca.SX(n, 1), ca.SX(n, 1))
    torques = symbolic_torques(robot.screws, points, campaign.gravity, *chain)
    weight, motion = linkage.T @ torques.weight, linkage.T @ torques.motion
    by_mass = [10 * k + i for k in range(n) for i in range(4)]
    by_inertia = [10 * k + i for k in range(n) for i in range(4, 10)]
    to_base = ca.sparsify(ca.DM(flange_to_base(robot)))
    phi = ca.DM(declared_weight(campaign))
    gravity = weight @ phi
    turned = (np.cross(campaign.gravity, axis) for axis in inclination_axes(campaign.gravity))
    inclined = [
        linkage.T @ symbolic_torques(robot.screws, points, g, chain[0], *no_motion).weight @ phi for g in turned
    ]
    inertia = motion @ ca.DM(inertial_bodies(campaign))
    regressor = weight + motion[:, by_mass]
    return {
        "regressor": regressor,
        "tool_regressor": regressor[:, 4 * n - 4 :] @ to_base,
        "link_inertia_regressor": motion[:, by_inertia],
        "gravity_torque": gravity,
        "inclination_torque": ca.horzcat(*inclined),
        "inertia_torque": inertia,
        "torque_rate": ca.sparsify(ca.DM(np.asarray(robot.transmission)))
        @ ca.jtimes(gravity, row["q"], row["joint_speed"]),
    }
