"""
The same forward kinematics as casadi expressions, for models whose derivatives are not written by hand.

The pin wheel has no casadi binding, so this is ours; it is checked against `kinematics.poe` and pinocchio to 1e-12.
"""

from typing import Any

import casadi as ca
import numpy as np
import numpy.typing as npt

from kinematics.screws import hat3

__all__ = ["cayley_left_jacobian_sx", "cayley_sx", "exponential_sx", "forward_sx", "hat_sx"]


def hat_sx(w: Any) -> Any:
    """
    Give the matrix of the cross product with a symbolic vector.

    Parameters
    ----------
    w
        Column of 3 casadi expressions.

    Returns
    -------
    casadi expression
        Matrix (3, 3), sparse on its diagonal. Source: Lynch & Park, Modern Robotics, definition 3.7.
    """
    return ca.vertcat(ca.horzcat(0, -w[2], w[1]), ca.horzcat(w[2], 0, -w[0]), ca.horzcat(-w[1], w[0], 0))


def cayley_sx(w: Any) -> Any:
    """
    Give `kinematics.screws.cayley` of a symbolic vector.

    Parameters
    ----------
    w
        Column of 3 casadi expressions [rad, for small angles].

    Returns
    -------
    casadi expression
        Rotation (3, 3). Source: Cayley's formula; Lynch & Park, Modern Robotics, appendix B.
    """
    r = w / 2
    H = hat_sx(r)
    return ca.SX.eye(3) + 2 / (1 + ca.dot(r, r)) * (H + H @ H)


def cayley_left_jacobian_sx(w: Any) -> Any:
    """
    Give `kinematics.screws.cayley_left_jacobian` of a symbolic vector.

    Parameters
    ----------
    w
        Column of 3 casadi expressions [rad, for small angles].

    Returns
    -------
    casadi expression
        Matrix (3, 3). Source: as `kinematics.screws.cayley_left_jacobian`.
    """
    r = w / 2
    return (ca.SX.eye(3) + hat_sx(r)) / (1 + ca.dot(r, r))


def exponential_sx(screw: npt.ArrayLike, q: Any) -> Any:
    """
    Give exp([S] q) for one numeric screw and a symbolic joint value.

    Parameters
    ----------
    screw
        Screw (6,), (omega, v) [1, m]; omega of any length, or zero.
    q
        Scalar casadi expression (SX, MX) [rad, or m].

    Returns
    -------
    casadi expression
        Transform (4, 4). Source: Lynch & Park, Modern Robotics, proposition 3.25, in homogeneous form: see
        `kinematics.poe`.
    """
    S = np.asarray(screw, dtype=np.float64)
    M = np.zeros((4, 4))
    M[:3, :3], M[:3, 3] = hat3(S[:3]), S[3:]
    length = float(np.linalg.norm(S[:3]))
    # Sparse where a screw has zeros, so that they cost nothing in the compiled expression.
    powers = [ca.sparsify(ca.DM(np.linalg.matrix_power(M, k))) for k in range(4)]
    if length == 0.0:
        return powers[0] + q * powers[1]
    angle = length * q
    second, third = (1 - ca.cos(angle)) / length**2, (angle - ca.sin(angle)) / length**3
    return powers[0] + q * powers[1] + second * powers[2] + third * powers[3]


def forward_sx(screws: npt.ArrayLike, home: npt.ArrayLike, q: Any) -> Any:
    """
    Give the pose of the flange as a casadi expression of the joint values.

    Parameters
    ----------
    screws
        Screws (n, 6) in the base frame at the zero pose, (omega, v) [1, m].
    home
        The flange's home pose (4, 4) in the base frame [m].
    q
        Column of n casadi expressions (SX, MX) [rad, or m].

    Returns
    -------
    casadi expression
        Pose (4, 4) in the base frame [m]. Source: Lynch & Park, Modern Robotics, eq. 4.14.

    Raises
    ------
    ValueError
        If there is not one joint value per screw.
    """
    S = np.asarray(screws, dtype=np.float64)
    if q.numel() != len(S):
        raise ValueError(f"q: expected {len(S)} expressions, one per screw, found {q.numel()}")
    T = ca.DM(np.eye(4))
    for i, screw in enumerate(S):
        T = T @ exponential_sx(screw, q[i])
    return T @ ca.DM(np.asarray(home, dtype=np.float64))
