"""
Rotations, rigid transforms and screws, batched over leading dimensions.

Twists and screws are 6-vectors (omega, v), as in Lynch & Park, *Modern Robotics*, chapter 3: a screw S turned by q
moves every point of space, written in the base frame, by exp([S] q). Nothing here divides by an angle, so that
nothing has to be switched at zero: sin x / x is `numpy.sinc`, and the one function that is not expressible by it has
a short series.
"""

import numpy as np
import numpy.typing as npt

from kinematics.typing_ import Array

__all__ = [
    "adjoint",
    "cayley",
    "cayley_left_jacobian",
    "exp_se3",
    "exp_so3",
    "hat3",
    "inverse",
    "log_se3",
    "log_so3",
    "nearest_rotation",
    "prismatic_screw",
    "screw",
    "transform",
    "vee3",
]


_SMALL_ANGLE = 0.1  # below it, four terms of a series are exact to 3e-16; above it, the closed form is


def hat3(w: npt.ArrayLike) -> Array:
    """
    Build the matrix of the cross product, hat(w) x = w × x.

    Parameters
    ----------
    w
        Vectors (..., 3).

    Returns
    -------
    Array
        Skew-symmetric matrices (..., 3, 3). Source: Lynch & Park, Modern Robotics, definition 3.7.
    """
    w = np.asarray(w)
    out = np.zeros((*w.shape, 3), dtype=w.dtype if w.dtype.kind == "c" else np.float64)
    out[..., 0, 1], out[..., 0, 2], out[..., 1, 2] = -w[..., 2], w[..., 1], -w[..., 0]
    out[..., 1, 0], out[..., 2, 0], out[..., 2, 1] = w[..., 2], -w[..., 1], w[..., 0]
    return out


def vee3(W: npt.ArrayLike) -> Array:
    """
    Undo `hat3`; the symmetric part of the argument is ignored.

    Parameters
    ----------
    W
        Matrices (..., 3, 3).

    Returns
    -------
    Array
        Vectors (..., 3). Source: Lynch & Park, Modern Robotics, section 3.2.2.
    """
    W = np.asarray(W)
    pairs = [W[..., 2, 1] - W[..., 1, 2], W[..., 0, 2] - W[..., 2, 0], W[..., 1, 0] - W[..., 0, 1]]
    return np.asarray(0.5 * np.stack(pairs, axis=-1))


def exponential_coefficients(angle: Array) -> tuple[Array, Array, Array]:
    """
    Give sin x / x, (1 − cos x) / x² and (x − sin x) / x³, smooth through zero.

    Parameters
    ----------
    angle
        Angles of any shape [rad].

    Returns
    -------
    tuple of Array
        The three coefficients, each of the shape of `angle`. They multiply I, hat(w), hat(w)² in Rodrigues' formula and
        its integral. Source: Lynch & Park, Modern Robotics, eq. 3.51 and proposition 3.25.
    """
    a = np.sinc(angle / np.pi)
    b = 0.5 * np.sinc(angle / (2 * np.pi)) ** 2
    x2 = angle * angle
    series = (1 / 6) - x2 / 120 * (1 - x2 / 42 * (1 - x2 / 72))
    small = np.abs(angle) < _SMALL_ANGLE
    c = np.where(small, series, (1 - a) / np.where(small, 1.0, x2))
    return a, b, c


def exp_so3(w: npt.ArrayLike) -> Array:
    """
    Turn a rotation vector into a rotation matrix.

    Parameters
    ----------
    w
        Rotation vectors (..., 3) [rad].

    Returns
    -------
    Array
        Rotations (..., 3, 3). Source: Rodrigues' formula; Lynch & Park, Modern Robotics, eq. 3.51.
    """
    w = np.asarray(w, dtype=np.float64)
    a, b, _ = exponential_coefficients(np.linalg.norm(w, axis=-1))
    W = hat3(w)
    return np.asarray(np.eye(3) + a[..., None, None] * W + b[..., None, None] * (W @ W))


def _quaternion(R: Array) -> tuple[Array, Array]:
    """Give scalar ≥ 0 (...,) and vector (..., 3) parts; by the largest of four components, so accurate near pi."""
    d = np.diagonal(R, axis1=-2, axis2=-1)
    trace = d.sum(axis=-1)
    # Four times the outer product of the quaternion (w, x, y, z) with itself: the column of its largest entry is safe.
    Q = np.empty((*R.shape[:-2], 4, 4))
    Q[..., 0, 0] = 1 + trace
    Q[..., 0, 1:] = Q[..., 1:, 0] = 2 * vee3(R)
    Q[..., 1:, 1:] = R + np.swapaxes(R, -1, -2)
    for i in range(3):
        Q[..., i + 1, i + 1] = 1 + 2 * d[..., i] - trace
    best = np.argmax(np.diagonal(Q, axis1=-2, axis2=-1), axis=-1)
    column = np.take_along_axis(Q, best[..., None, None], axis=-1)[..., 0]
    column = column / np.linalg.norm(column, axis=-1, keepdims=True)
    column = np.where(column[..., :1] < 0, -column, column)
    return column[..., 0], column[..., 1:]


def log_so3(R: npt.ArrayLike) -> Array:
    """
    Turn a rotation matrix into its rotation vector, of length at most pi.

    Parameters
    ----------
    R
        Rotations (..., 3, 3).

    Returns
    -------
    Array
        Rotation vectors (..., 3) [rad]; at exactly pi, one of the two. Accurate to rounding at 0 and at pi, because it
        goes by a quaternion. Source: Lynch & Park, Modern Robotics, section 3.2.3.3 and appendix B.
    """
    scalar, vector = _quaternion(np.asarray(R, dtype=np.float64))
    length = np.linalg.norm(vector, axis=-1)
    tiny = length < 1e-150
    factor = np.where(tiny, 2.0, 2 * np.arctan2(length, scalar) / np.where(tiny, 1.0, length))
    return np.asarray(factor[..., None] * vector)


def nearest_rotation(a: Array, b: Array) -> Array:
    """
    Rotate points about their common origin nearest to others (least squares).

    Parameters
    ----------
    a, b
        Points and where they are to come to, (N, 3) [m], each about its own mean.

    Returns
    -------
    Array
        R (3, 3), proper, that makes the sum of |R a - b|^2 least.

    Notes
    -----
    Source: Kabsch, A solution for the best rotation to relate two sets of vectors, Acta Cryst. A 32, 1976.
    """
    U, _, Vt = np.linalg.svd(a.T @ b)
    return np.asarray(Vt.T @ np.diag([1.0, 1.0, np.sign(np.linalg.det(Vt.T @ U.T))]) @ U.T)


def transform(R: npt.ArrayLike, p: npt.ArrayLike) -> Array:
    """
    Assemble a rigid transform from rotation and translation.

    Parameters
    ----------
    R
        Rotations (..., 3, 3).
    p
        Translations (..., 3) [m]; leading dimensions broadcast with those of `R`.

    Returns
    -------
    Array
        Homogeneous matrices (..., 4, 4). Source: Lynch & Park, Modern Robotics, definition 3.13.
    """
    R, p = np.asarray(R), np.asarray(p)
    lead = np.broadcast_shapes(R.shape[:-2], p.shape[:-1])
    out = np.zeros((*lead, 4, 4))
    out[..., :3, :3], out[..., :3, 3], out[..., 3, 3] = R, p, 1.0
    return out


def inverse(T: npt.ArrayLike) -> Array:
    """
    Invert rigid transforms without solving anything.

    Parameters
    ----------
    T
        Homogeneous matrices (..., 4, 4).

    Returns
    -------
    Array
        Their inverses (..., 4, 4). Source: Lynch & Park, Modern Robotics, proposition 3.15.
    """
    T = np.asarray(T, dtype=np.float64)
    Rt = np.swapaxes(T[..., :3, :3], -1, -2)
    return transform(Rt, -(Rt @ T[..., :3, 3:])[..., 0])


def exp_se3(twist: npt.ArrayLike) -> Array:
    """
    Turn exponential coordinates into a rigid transform.

    Parameters
    ----------
    twist
        Vectors (..., 6), (omega [rad], v [m]).

    Returns
    -------
    Array
        Homogeneous matrices (..., 4, 4). Source: Lynch & Park, Modern Robotics, proposition 3.25.
    """
    twist = np.asarray(twist, dtype=np.float64)
    w, v = twist[..., :3], twist[..., 3:]
    a, b, c = (x[..., None, None] for x in exponential_coefficients(np.linalg.norm(w, axis=-1)))
    W = hat3(w)
    W2 = W @ W
    R = np.eye(3) + a * W + b * W2
    V = np.eye(3) + b * W + c * W2
    return transform(R, (V @ v[..., None])[..., 0])


def log_se3(T: npt.ArrayLike) -> Array:
    """
    Turn a rigid transform into exponential coordinates.

    Parameters
    ----------
    T
        Homogeneous matrices (..., 4, 4).

    Returns
    -------
    Array
        Vectors (..., 6), (omega [rad], v [m]), rotation at most pi. Source: Lynch & Park, Modern Robotics, section
        3.3.3.2.
    """
    T = np.asarray(T, dtype=np.float64)
    w = log_so3(T[..., :3, :3])
    angle = np.linalg.norm(w, axis=-1)
    a, b, _ = exponential_coefficients(angle)
    x2 = angle * angle
    small = angle < _SMALL_ANGLE
    series = 1 / 12 + x2 / 720 * (1 + x2 / 42 * (1 + x2 / 40))
    d = np.where(small, series, (1 - a / (2 * b)) / np.where(small, 1.0, x2))
    W = hat3(w)
    V_inverse = np.eye(3) - 0.5 * W + d[..., None, None] * (W @ W)
    return np.concatenate([w, (V_inverse @ T[..., :3, 3:])[..., 0]], axis=-1)


def adjoint(T: npt.ArrayLike) -> Array:
    """
    Build the matrix that re-expresses a twist (omega, v) in another frame, V_a = Ad(T_ab) V_b.

    Parameters
    ----------
    T
        Homogeneous matrices (..., 4, 4).

    Returns
    -------
    Array
        Matrices (..., 6, 6). Source: Lynch & Park, Modern Robotics, definition 3.20.
    """
    T = np.asarray(T, dtype=np.float64)
    R = T[..., :3, :3]
    out = np.zeros((*T.shape[:-2], 6, 6))
    out[..., :3, :3] = out[..., 3:, 3:] = R
    out[..., 3:, :3] = hat3(T[..., :3, 3]) @ R
    return out


def screw(axis: npt.ArrayLike, point: npt.ArrayLike, pitch: npt.ArrayLike = 0.0) -> Array:
    """
    Build the screw of an axis through a point.

    Parameters
    ----------
    axis
        Directions (..., 3), of unit length (not checked: a calibrated axis may be anything).
    point
        Any point on the axis (..., 3) [m].
    pitch
        Advance per turn angle (...,) [m/rad]; zero for a revolute joint.

    Returns
    -------
    Array
        Screws (..., 6), (omega, point × omega + pitch·omega). Source: Lynch & Park, Modern Robotics, definition 3.24.
    """
    w = np.asarray(axis, dtype=np.float64)
    v = np.cross(np.asarray(point, dtype=np.float64), w) + np.asarray(pitch, dtype=np.float64)[..., None] * w
    return np.concatenate([np.broadcast_to(w, v.shape), v], axis=-1)


def prismatic_screw(axis: npt.ArrayLike) -> Array:
    """
    Build the screw of a joint that slides along an axis.

    Parameters
    ----------
    axis
        Directions (..., 3), of unit length.

    Returns
    -------
    Array
        Screws (..., 6), (0, axis). Source: Lynch & Park, Modern Robotics, definition 3.24.
    """
    v = np.asarray(axis, dtype=np.float64)
    return np.concatenate([np.zeros_like(v), v], axis=-1)


def cayley(w: npt.ArrayLike) -> Array:
    """
    Turn a small rotation, given as a vector, into an exact rotation by Cayley's rational map.

    It agrees with `exp_so3` to second order and needs no sine: with r = w/2,
    R = I + 2/(1 + |r|²)·(hat(r) + hat(r)²).

    Parameters
    ----------
    w
        Vectors (..., 3) [rad, for small angles]; the rotation is by 2·atan(|w|/2). Complex values are let through, so
        that derivatives can be checked by a complex step.

    Returns
    -------
    Array
        Rotations (..., 3, 3). Source: Cayley's formula for orthogonal matrices; Lynch & Park, Modern Robotics,
        appendix B.
    """
    r = 0.5 * np.asarray(w)
    H = hat3(r)
    factor = 2 / (1 + np.sum(r * r, axis=-1))
    return np.asarray(np.eye(3) + factor[..., None, None] * (H + H @ H))


def cayley_left_jacobian(w: npt.ArrayLike) -> Array:
    """
    Give the matrix J by which a change of the vector turns the rotation: dR·Rᵀ = hat(J·dw) for R = cayley(w).

    Parameters
    ----------
    w
        Vectors (..., 3), as for `cayley`.

    Returns
    -------
    Array
        Matrices (..., 3, 3), (I + hat(w/2)) / (1 + |w/2|²). Source: derived from Cayley's formula (Lynch & Park, Modern
        Robotics, appendix B); checked against differences.
    """
    r = 0.5 * np.asarray(w, dtype=np.float64)
    factor = 1 / (1 + np.sum(r * r, axis=-1))
    return np.asarray(factor[..., None, None] * (np.eye(3) + hat3(r)))
