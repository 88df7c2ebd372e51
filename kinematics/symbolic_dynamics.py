"""
The torques of weight and motion as casadi expressions, to be compiled.

They are the matrices that `kinematics.gravity` and `kinematics.dynamics` give, for one row.

Weight is the torque of a base that accelerates upwards, so that one recursion gives both. What the screws' zeros make
zero is absent from the expressions and costs nothing. Source: Lynch & Park, Modern Robotics, section 8.3.
"""

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
import numpy.typing as npt

from kinematics.dynamics import inertia_about
from kinematics.symbolic import exponential_sx, hat_sx

__all__ = ["SymbolicTorques", "symbolic_torques"]

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class SymbolicTorques:
    """
    Matrices of one posture, linear in the links' parameters; joints of the chain.

    Attributes
    ----------
    weight
        casadi expression (n, 4n), of (m, m·cx, m·cy, m·cz) per link: `kinematics.gravity.gravity_regressor`.
    motion
        casadi expression (n, 10n): `kinematics.dynamics.inertial_regressor`.
    """

    weight: Any
    motion: Any


def symbolic_torques(
    screws: npt.ArrayLike, points: npt.ArrayLike, gravity: npt.ArrayLike, q: Any, qd: Any, qdd: Any
) -> SymbolicTorques:
    """
    Give the matrices Y with τ_joint = Y·φ for symbolic joint values.

    Parameters
    ----------
    screws
        Screws (n, 6) in the base frame at the zero pose, (omega, v) [1, m].
    points
        Points (n, 3) about which each link's inertia counts, base frame at the zero pose [m].
    gravity
        Acceleration of free fall (3,) in the base frame [m/s²].
    q, qd, qdd
        Columns of n casadi expressions of the chain's joints [rad, rad/s, rad/s²; m, … if prismatic].

    Returns
    -------
    SymbolicTorques
        Both matrices. Source: the module's docstring.

    Raises
    ------
    ValueError
        If there is not one joint value per screw.
    """
    S, P = np.asarray(screws, dtype=np.float64), np.asarray(points, dtype=np.float64)
    n = len(S)
    if q.numel() != n:
        raise ValueError(f"q: expected {n} expressions, one per screw, found {q.numel()}")
    V, A = ca.SX(6, 1), ca.SX(6, 1)
    # A base that accelerates against the fall: what rests in it weighs as it does.
    fall = ca.SX(ca.sparsify(ca.DM(np.r_[np.zeros(3), -np.asarray(gravity, dtype=np.float64)])))
    J: list[Any] = []  # the screws of joints 1 … k, seen from link k
    weight, motion = ca.SX(n, 4 * n), ca.SX(n, 10 * n)
    for k in range(n):
        screw = ca.SX(ca.sparsify(ca.DM(S[k])))
        back = exponential_sx(S[k], -q[k])
        J = [*(_carried(back, column) for column in J), screw]
        V = _carried(back, V) + screw * qd[k]
        A = _carried(back, A) + _bracket(V, screw) * qd[k] + screw * qdd[k]
        fall = _carried(back, fall)
        moving = _momentum(V)
        wrench = _momentum(A) + ca.vertcat(
            hat_sx(V[:3]) @ moving[:3, :] + hat_sx(V[3:]) @ moving[3:, :], hat_sx(V[:3]) @ moving[3:, :]
        )
        wrench = wrench @ ca.sparsify(ca.DM(inertia_about(P[k])))
        falling = _momentum(fall)[:, :4]
        for j, column in enumerate(J):
            weight[j, 4 * k : 4 * k + 4] = column.T @ falling
            motion[j, 10 * k : 10 * k + 10] = column.T @ wrench
    return SymbolicTorques(weight, motion)


def _carried(motion: Any, twist: Any) -> Any:
    """Ad(motion)·twist."""
    turned = motion[:3, :3] @ twist[:3]
    return ca.vertcat(turned, ca.cross(motion[:3, 3], turned) + motion[:3, :3] @ twist[3:])


def _bracket(V: Any, screw: Any) -> Any:
    """ad(V)·S."""
    return ca.vertcat(ca.cross(V[:3], screw[:3]), ca.cross(V[3:], screw[:3]) + ca.cross(V[:3], screw[3:]))


def _momentum(X: Any) -> Any:
    """The matrix (6, 10) that turns φ about the base's origin into G·X, moment first."""
    w, v = X[:3], X[3:]
    top = ca.horzcat(
        ca.SX(3, 1),
        -hat_sx(v),
        ca.vertcat(ca.horzcat(w[0], 0, 0, w[1], w[2], 0), ca.horzcat(0, w[1], 0, w[0], 0, w[2]),
                   ca.horzcat(0, 0, w[2], 0, w[0], w[1])),
    )  # fmt: skip
    return ca.sparsify(ca.vertcat(top, ca.horzcat(v, hat_sx(w), ca.SX(3, 6))))
