"""
Forward kinematics by the product of exponentials, T(q) = exp([S1] q1) ⋯ exp([Sn] qn)·M.

Fast on many rows: each joint's matrices are built by elementwise formulas over all rows at once.
"""

import numpy as np
import numpy.typing as npt

from kinematics.screws import exponential_coefficients, hat3
from kinematics.typing_ import Array

__all__ = ["forward", "joint_transforms", "space_jacobian"]


def _exponential(S: Array, q: Array) -> Array:
    """Give exp([S] q) (..., 4, 4) for one screw (6,) and many q (...); the screw need not be of unit length."""
    w, v = S[:3], S[3:]
    W = hat3(w)
    a, b, c = exponential_coefficients(np.linalg.norm(w) * q)
    a, b, c = a * q, b * q * q, c * q * q * q
    W2 = W @ W
    out = np.zeros((*q.shape, 4, 4))
    out[..., :3, :3] = np.eye(3) + a[..., None, None] * W + b[..., None, None] * W2
    out[..., :3, 3] = q[..., None] * v + b[..., None] * (W @ v) + c[..., None] * (W2 @ v)
    out[..., 3, 3] = 1.0
    return out


def _checked(screws: npt.ArrayLike, q: npt.ArrayLike) -> tuple[Array, Array]:
    S, q = np.asarray(screws, dtype=np.float64), np.asarray(q, dtype=np.float64)
    if S.ndim != 2 or S.shape[1] != 6:
        raise ValueError(f"screws: expected shape (n, 6), found {S.shape}")
    if q.ndim < 1 or q.shape[-1] != S.shape[0]:
        raise ValueError(f"q: expected shape (..., {S.shape[0]}), one value per screw, found {q.shape}")
    return S, q


def joint_transforms(screws: npt.ArrayLike, q: npt.ArrayLike) -> Array:
    """
    Give the motion of every link from the zero pose, as cumulative products of exponentials.

    Parameters
    ----------
    screws
        Screws (n, 6) in the base frame at the zero pose, (omega, v) [1, m].
    q
        Joint values (..., n) [rad, or m].

    Returns
    -------
    Array
        Transforms (..., n+1, 4, 4): the first is the identity, number i moves a point that is fixed to link i from where
        it is at the zero pose to where it is at q, both in the base frame.
        Source: Lynch & Park, Modern Robotics, eq. 4.6.

    Raises
    ------
    ValueError
        If the shapes do not fit.
    """
    S, q = _checked(screws, q)
    n = S.shape[0]
    out = np.empty((*q.shape[:-1], n + 1, 4, 4))
    out[..., 0, :, :] = np.eye(4)
    for i in range(n):
        out[..., i + 1, :, :] = out[..., i, :, :] @ _exponential(S[i], q[..., i])
    return out


def forward(screws: npt.ArrayLike, home: npt.ArrayLike, q: npt.ArrayLike) -> Array:
    """
    Give the pose of the flange (or of whatever `home` is the pose of at zero).

    Parameters
    ----------
    screws
        Screws (n, 6) in the base frame at the zero pose, (omega, v) [1, m].
    home
        Pose at the zero pose in the base frame (4, 4) [m].
    q
        Joint values (..., n) [rad, or m].

    Returns
    -------
    Array
        Poses in the base frame (..., 4, 4) [m]. Source: Lynch & Park, Modern Robotics, eq. 4.14.

    Raises
    ------
    ValueError
        If the shapes do not fit.
    """
    return np.asarray(joint_transforms(screws, q)[..., -1, :, :] @ np.asarray(home, dtype=np.float64))


def space_jacobian(screws: npt.ArrayLike, q: npt.ArrayLike) -> Array:
    """
    Give the Jacobian whose column i is the twist of everything behind joint i per unit speed of it.

    Parameters
    ----------
    screws
        Screws (n, 6) in the base frame at the zero pose, (omega, v) [1, m].
    q
        Joint values (..., n) [rad, or m].

    Returns
    -------
    Array
        Jacobians (..., 6, n) in the base frame; rows omega, then v (of the point at the base's origin) [1, m].
        Source: Lynch & Park, Modern Robotics, eq. 5.11.

    Raises
    ------
    ValueError
        If the shapes do not fit.
    """
    S, q = _checked(screws, q)
    return _space_jacobian(S, joint_transforms(S, q))


def _space_jacobian(S: Array, transforms: Array) -> Array:
    """Move the screws (n, 6) along with the links before them, by the transforms (..., n+1, 4, 4)."""
    R, p = transforms[..., :-1, :3, :3], transforms[..., :-1, :3, 3]
    w = np.einsum("...nij,nj->...ni", R, S[:, :3])
    v = np.einsum("...nij,nj->...ni", R, S[:, 3:]) + np.cross(p, w)
    return np.swapaxes(np.concatenate([w, v], axis=-1), -1, -2)
