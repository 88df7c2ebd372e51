"""
The same forward kinematics as casadi expressions, for models whose derivatives are not written by hand.

The pin wheel has no casadi binding, so this is ours; it is checked against `kinematics.poe` and pinocchio to 1e-12.
"""

from typing import Any

import casadi as ca
import numpy as np
import numpy.typing as npt

from kinematics.screws import hat3

__all__ = ["exponential_sx", "forward_sx"]


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
    if length == 0.0:
        return ca.DM(np.eye(4)) + q * ca.DM(M)
    angle = length * q
    second, third = (1 - ca.cos(angle)) / length**2, (angle - ca.sin(angle)) / length**3
    return ca.DM(np.eye(4)) + q * ca.DM(M) + second * ca.DM(M @ M) + third * ca.DM(M @ M @ M)


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
