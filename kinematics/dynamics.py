"""
The torques of acceleration as a linear function of the links' masses, first moments and inertias.

With the spatial velocity V and acceleration A of link k, in axes that the link carries and that are the base's at the
zero pose, and its momentum G·V, Newton and Euler say that the joints must bring the wrench F = G·A − ad(V)ᵀ·G·V; it is
linear in the ten numbers of G, and τ_j = S_jᵀ·F for every joint j that carries the link.
Source: Lynch & Park, Modern Robotics, section 8.3 and eqs. 8.40-8.41 (recursion); the regressor is its derivative.
"""

import numpy as np
import numpy.typing as npt

from kinematics.screws import hat3

__all__ = ["inertia_about", "inertial_parameters", "inertial_regressor"]

Array = npt.NDArray[np.float64]

_BLOCK = 500  # rows whose intermediate results fit the processor's cache


def inertial_regressor(
    screws: npt.ArrayLike, points: npt.ArrayLike, q: npt.ArrayLike, qd: npt.ArrayLike, qdd: npt.ArrayLike
) -> Array:
    """
    Give the matrix Y with τ_joint = Y·φ for the torques of motion alone, gravity left out.

    Parameters
    ----------
    screws
        Screws (n, 6) in the base frame at the zero pose, (omega, v) [1, m].
    points
        Points (n, 3) about which each link's inertia counts, base frame at the zero pose [m].
    q, qd, qdd
        Joint values (N, n) of the chain, their speeds and accelerations [rad, rad/s, rad/s²; m, … if prismatic].

    Returns
    -------
    Array
        Matrices (N, n, 10 n); φ stacks per link (m, m·cx, m·cy, m·cz, Ixx, Iyy, Izz, Ixy, Ixz, Iyz) [kg, kg m, kg m²],
        base axes at the zero pose, c from the base's origin, I about the link's point. Source: the module's docstring.

    Raises
    ------
    ValueError
        If the shapes do not fit.
    """
    S, P = np.asarray(screws, dtype=np.float64), np.asarray(points, dtype=np.float64)
    q, qd, qdd = (np.asarray(a, dtype=np.float64) for a in (q, qd, qdd))
    n = len(S)
    if P.shape != (n, 3):
        raise ValueError(f"points: expected shape ({n}, 3), found {P.shape}")
    for name, a in (("q", q), ("qd", qd), ("qdd", qdd)):
        if a.ndim != 2 or a.shape != (len(q), n):
            raise ValueError(f"{name}: expected shape ({len(q)}, {n}), found {a.shape}")
    Y = np.empty((len(q), n, 10 * n))
    for start in range(0, len(q), _BLOCK):
        chosen = slice(start, start + _BLOCK)
        Y[chosen] = _regressor(S, P, q[chosen], qd[chosen], qdd[chosen])
    return Y


def inertial_parameters(mass: float, com: npt.ArrayLike, inertia: npt.ArrayLike | None, point: npt.ArrayLike) -> Array:
    """
    Stack the ten parameters of one body.

    Parameters
    ----------
    mass
        Mass [kg].
    com
        Centre of mass (3,) in the base frame at the zero pose [m].
    inertia
        Inertia (3, 3) about the centre of mass, base axes at the zero pose [kg m²]; None for a point mass.
    point
        Point (3,) about which the inertia is to count [m].

    Returns
    -------
    Array
        φ (10,) as in `inertial_regressor`. Source: Lynch & Park, Modern Robotics, theorem 8.2 (Steiner).
    """
    c = np.asarray(com, dtype=np.float64)
    d = hat3(c - np.asarray(point, dtype=np.float64))
    own = np.zeros((3, 3)) if inertia is None else np.asarray(inertia, dtype=np.float64)
    about = own - mass * (d @ d)
    return np.array([mass, *(mass * c), *np.diag(about), about[0, 1], about[0, 2], about[1, 2]])


def inertia_about(point: npt.ArrayLike) -> Array:
    """
    Give the matrix from φ with the inertia about a point to φ with it about the base's origin.

    Parameters
    ----------
    point
        Point (3,), base frame at the zero pose [m].

    Returns
    -------
    Array
        Matrix (10, 10). Source: Lynch & Park, Modern Robotics, theorem 8.2 (Steiner), in first moments.
    """
    point = np.asarray(point, dtype=np.float64)
    out = np.eye(10)
    places = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
    p, E = point, np.eye(3)
    for row, (i, j) in enumerate(places, start=4):
        out[row, 0] = -((p @ p) * E[i, j] - p[i] * p[j])
        for axis in range(3):
            out[row, 1 + axis] = 2 * p[axis] * E[i, j] - p[i] * E[axis, j] - E[axis, i] * p[j]
    return out


def _regressor(S: Array, P: Array, q: Array, qd: Array, qdd: Array) -> Array:
    count, n = q.shape
    Y = np.zeros((count, n, 10 * n))
    V, A = np.zeros((count, 6)), np.zeros((count, 6))
    J = np.zeros((count, 6, n))  # the screws of joints 1 … k, seen from link k
    for k in range(n):
        back = _adjoint_of_inverse(S[k], q[:, k])
        J[:, :, :k] = back @ J[:, :, :k]
        J[:, :, k] = S[k]
        before = np.einsum("nij,nj->ni", back, V)
        V = before + S[k] * qd[:, k, None]
        A = np.einsum("nij,nj->ni", back, A) + _bracket(V, S[k]) * qd[:, k, None] + S[k] * qdd[:, k, None]
        wrench = _wrench_by_parameters(V, A) @ inertia_about(P[k])
        Y[:, : k + 1, 10 * k : 10 * k + 10] = np.swapaxes(J[:, :, : k + 1], 1, 2) @ wrench
    return Y


def _adjoint_of_inverse(screw: Array, q: Array) -> Array:
    """Ad(exp(−[S] q)) ``(N, 6, 6)``, a polynomial in ad(S)."""
    ad = np.zeros((6, 6))
    ad[:3, :3] = ad[3:, 3:] = hat3(screw[:3])
    ad[3:, :3] = hat3(screw[3:])
    length = float(np.linalg.norm(screw[:3]))
    x = -q[:, None, None]
    if length == 0.0:
        return np.asarray(np.eye(6) + x * ad)
    # Minimal polynomial λ (λ² + |ω|²)²; with a = |ω| x: Selig, Geometric Fundamentals of Robotics, section 4.4.
    a, s, c = length * x, np.sin(length * x), np.cos(length * x)
    unit = ad / length
    powers = [np.linalg.matrix_power(unit, k) for k in range(5)]
    return np.asarray(
        powers[0]
        + 0.5 * (3 * s - a * c) * powers[1]
        + 0.5 * (4 - 4 * c - a * s) * powers[2]
        + 0.5 * (s - a * c) * powers[3]
        + 0.5 * (2 - 2 * c - a * s) * powers[4]
    )


def _bracket(V: Array, screw: Array) -> Array:
    """ad(V)·S of velocities ``(N, 6)`` and one screw."""
    w, v = V[:, :3], V[:, 3:]
    return np.concatenate([np.cross(w, screw[:3]), np.cross(v, screw[:3]) + np.cross(w, screw[3:])], axis=1)


def _momentum(X: Array) -> Array:
    """The matrix ``(N, 6, 10)`` that turns φ about the base's origin into G·X, moment first."""
    w, v = X[:, :3], X[:, 3:]
    out = np.zeros((len(X), 6, 10))
    out[:, :3, 1:4] = -hat3(v)
    for row, columns in enumerate(((4, 7, 8), (7, 5, 9), (8, 9, 6))):  # Ixx Iyy Izz Ixy Ixz Iyz
        for axis, column in enumerate(columns):
            out[:, row, column] = w[:, axis]
    out[:, 3:, 0] = v
    out[:, 3:, 1:4] = hat3(w)
    return out


def _wrench_by_parameters(V: Array, A: Array) -> Array:
    """Give d (G·A − ad(V)ᵀ·G·V) / dφ ``(N, 6, 10)``."""
    moving = _momentum(V)
    w, v = hat3(V[:, :3]), hat3(V[:, 3:])
    out = _momentum(A)
    out[:, :3] += w @ moving[:, :3] + v @ moving[:, 3:]
    out[:, 3:] += w @ moving[:, 3:]
    return out
