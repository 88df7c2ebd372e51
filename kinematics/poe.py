"""
Forward kinematics by the product of exponentials, T(q) = exp([S1] q1) ⋯ exp([Sn] qn)·M.

Fast on many rows: each joint's matrices are built by elementwise formulas over all rows at once.
"""

from functools import lru_cache

import numpy as np
import numpy.typing as npt

from kinematics.screws import exponential_coefficients, hat3
from kinematics.typing_ import Array

__all__ = ["forward", "joint_transforms", "space_jacobian"]


_DIRECT = 1e-3  # above it, the closed forms lose nothing in absolute terms by dividing by the screw's length


def _coefficients(S: Array, q: Array) -> Array:
    """
    Give the coefficients (..., n, 4) of exp([S] q) over the powers of `_powers`, of screws (n, 6) at q (..., n).

    The 4×4 matrix [S] satisfies [S]⁴ = −|omega|²·[S]², so that the exponential is I + q[S] + b[S]² + c[S]³ for any
    screw, of unit length or not: one small matrix product for all rows. Source: Lynch & Park, Modern Robotics,
    proposition 3.25, in homogeneous form.
    """
    length = np.sqrt((S[:, :3] ** 2).sum(axis=1))
    direct = length > _DIRECT
    angle, divisor = length * q, np.where(direct, length, 1.0)
    out = np.empty((*q.shape, 4))
    out[..., 0], out[..., 1] = 1.0, q
    out[..., 2] = (1 - np.cos(angle)) / divisor**2
    out[..., 3] = (angle - np.sin(angle)) / divisor**3
    for i in np.flatnonzero(~direct).tolist():
        _, b, c = exponential_coefficients(angle[..., i])
        out[..., i, 2], out[..., i, 3] = b * q[..., i] ** 2, c * q[..., i] ** 3
    return out


@lru_cache(maxsize=64)
def _powers(screws: bytes) -> Array:
    """Give I, [S], [S]², [S]³ (n, 4, 16) of screws (n, 6), given as their bytes: a robot's are asked for often."""
    S = np.frombuffer(screws).reshape(-1, 6)
    powers = np.zeros((len(S), 4, 4, 4))
    powers[:, 0] = np.eye(4)
    powers[:, 1, :3, :3], powers[:, 1, :3, 3] = hat3(S[:, :3]), S[:, 3:]
    powers[:, 2] = powers[:, 1] @ powers[:, 1]
    powers[:, 3] = powers[:, 2] @ powers[:, 1]
    return powers.reshape(len(S), 4, 16)


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
        Transforms (..., n+1, 4, 4): the first is the identity, number i moves a point that is fixed to link i from
        where it is at the zero pose to where it is at q, both in the base frame. Source: Lynch & Park, Modern
        Robotics, eq. 4.6.

    Raises
    ------
    ValueError
        If the shapes do not fit.
    """
    S, q = _checked(screws, q)
    n = S.shape[0]
    out = np.empty((*q.shape[:-1], n + 1, 4, 4))
    out[..., 0, :, :] = np.eye(4)
    coefficients, powers = _coefficients(S, q), _powers(S.tobytes())
    for i in range(n):
        out[..., i + 1, :, :] = out[..., i, :, :] @ (coefficients[..., i, :] @ powers[i]).reshape(*q.shape[:-1], 4, 4)
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
    """Move the screws (n, 6) along with the links before them, by transforms (..., n+1, 4, 4), into (..., 6, n)."""
    out = np.empty((*transforms.shape[:-3], len(S), 6))
    for i, screw in enumerate(S):
        w, v = np.moveaxis(transforms[..., i, :3, :3] @ screw.reshape(2, 3).T, -1, 0)
        p = transforms[..., i, :3, 3]
        out[..., i, :3] = w
        for a, b, c in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):  # numpy's cross product is several times slower
            out[..., i, 3 + a] = v[..., a] + p[..., b] * w[..., c] - p[..., c] * w[..., b]
    return np.swapaxes(out, -1, -2)
