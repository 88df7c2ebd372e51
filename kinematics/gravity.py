"""
Torques that hold the arm against gravity, linear in its masses and first moments.

τ_joint is what the drive exerts: at rest, the derivative of the potential energy, +dV/dq. With the motion G_k(q) of
link k from the zero pose (rotation R_k, translation t_k) and the screw of joint i moved along, (ω_i, v_i), a point of
link k moves by ω_i × p + v_i per unit of q_i, so

    τ_i = −Σ_{k ≥ i} m_k·(g·v_i + (g × ω_i)·t_k) + (R_kᵀ (g × ω_i))·(m c)_k

which holds for revolute, prismatic and helical joints alike. The centres of mass c_k are in the base frame at the
zero pose, so that no frame of any link has to be chosen. Source: Lynch & Park, Modern Robotics, section 8.1
(potential energy), in the first-moment form that makes it linear.
"""

from collections.abc import Callable, Sequence

import numpy as np
import numpy.typing as npt

from kinematics.poe import _space_jacobian, joint_transforms
from kinematics.robot import DescriptionError, Link, RobotDescription
from kinematics.screws import hat3
from kinematics.typing_ import Array

__all__ = [
    "STANDARD_GRAVITY",
    "add_tool",
    "gravity_parameters",
    "gravity_regressor",
    "gravity_stiffness",
    "gravity_torque",
    "inclination_axes",
    "torque_by_gravity",
]

STANDARD_GRAVITY = (0.0, 0.0, -9.81)  # m/s², base frame of an upright robot; the value of the campaign format
_BLOCK = 1000  # rows whose intermediate results fit the processor's cache: nearly twice as fast as all at once


def gravity_regressor(screws: npt.ArrayLike, q: npt.ArrayLike, gravity: npt.ArrayLike = STANDARD_GRAVITY) -> Array:
    """
    Give the matrix Y with τ_joint = Y·φ.

    Parameters
    ----------
    screws
        Screws (n, 6) in the base frame at the zero pose, (omega, v) [1, m].
    q
        Joint values of the chain (..., n) [rad, or m].
    gravity
        Acceleration of free fall (3,) in the base frame [m/s²]; a hung robot has +9.81 in z.

    Returns
    -------
    Array
        Matrices (..., n, 4n); φ stacks (m, m·cx, m·cy, m·cz) [kg, kg m] per link, with the centre of mass in the base
        frame at the zero pose. Source: the module's docstring.

    Raises
    ------
    ValueError
        If the shapes do not fit.
    """
    S = np.asarray(screws, dtype=np.float64)
    g = np.asarray(gravity, dtype=np.float64)
    if g.shape != (3,):
        raise ValueError(f"gravity: expected shape (3,), found {g.shape}")
    q = np.asarray(q, dtype=np.float64)
    return _in_blocks(lambda rows: _regressor(S, rows, g), q)


def torque_by_gravity(screws: npt.ArrayLike, q: npt.ArrayLike, phi: npt.ArrayLike) -> Array:
    """
    Give the matrix D with τ_joint = D·g: torques of known weights under any gravity, without their regressor.

    Parameters
    ----------
    screws
        Screws (n, 6) in the base frame at the zero pose, (omega, v) [1, m].
    q
        Joint values of the chain (..., n) [rad, or m].
    phi
        (m, m·c) of every link (4n,), as `gravity_regressor` has it [kg, kg m].

    Returns
    -------
    Array
        Matrices (..., n, 3) [kg m]. With what joint i carries, the mass m = Σ m_k and the moment
        a = Σ R_k·(m c)_k + m_k·t_k, row i is −(ω_i × a + m·v_i): the module's formula with g put last.
    """
    S, weights = np.asarray(screws, dtype=np.float64), np.asarray(phi, dtype=np.float64).reshape(-1, 4)
    return _in_blocks(lambda rows: _by_gravity(S, rows, weights), np.asarray(q, dtype=np.float64))


def _in_blocks(of: Callable[[Array], Array], q: Array) -> Array:
    """Values of a function of joint values (..., n), so many rows at once that they fit the processor's cache."""
    if q.ndim < 2 or q.size <= _BLOCK * q.shape[-1]:
        return of(q)
    rows = q.reshape(-1, q.shape[-1])
    parts = [of(rows[start : start + _BLOCK]) for start in range(0, len(rows), _BLOCK)]
    return np.concatenate(parts).reshape(*q.shape[:-1], *parts[0].shape[1:])


def _by_gravity(S: Array, q: Array, weights: Array) -> Array:
    G = joint_transforms(S, q)
    J = _space_jacobian(S, G)
    out = np.empty((*q.shape[:-1], len(S), 3))
    mass, moment = 0.0, np.zeros((*q.shape[:-1], 3))
    for i in reversed(range(len(S))):  # joint i carries the links k ≥ i only
        motion = G[..., i + 1, :3, :]
        mass, moment = mass + weights[i, 0], moment + motion[..., :3] @ weights[i, 1:] + weights[i, 0] * motion[..., 3]
        for a, b, c in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):  # numpy's cross product is several times slower
            out[..., i, a] = J[..., c, i] * moment[..., b] - J[..., b, i] * moment[..., c] - mass * J[..., 3 + a, i]
    return out


def _regressor(S: Array, q: Array, g: Array) -> Array:
    G = joint_transforms(S, q)
    n = len(S)
    lead = G.shape[:-3]
    # Row i of the left factor is −(g × ω_i, g·v_i); times the 4×4 matrix of G_k it is all of the module's formula.
    left = np.swapaxes(_space_jacobian(S, G), -1, -2) @ _left_factor(g)  # (..., n, 4)
    right = np.empty((*lead, 4, n, 4))
    motions = np.moveaxis(G[..., 1:, :, :], -3, -2)
    right[..., 0], right[..., 1:] = motions[..., 3], motions[..., :3]  # mass first, then first moments
    Y = np.asarray(left @ right.reshape(*lead, 4, 4 * n))
    for i in range(1, n):
        Y[..., i, : 4 * i] = 0.0  # joint i carries the links k ≥ i only
    return Y


def _left_factor(g: Array) -> Array:
    """Give the matrix (6, 4) that turns (ω, v) into −(g × ω, g·v)."""
    out = np.zeros((6, 4))
    out[:3, :3] = hat3(g)  # as a row: ωᵀ·hat(g) = −(g × ω)ᵀ
    out[3:, 3] = -g
    return out


def gravity_stiffness(
    screws: npt.ArrayLike, q: npt.ArrayLike, phi: npt.ArrayLike, gravity: npt.ArrayLike = STANDARD_GRAVITY
) -> Array:
    """
    Give how the torques that hold the arm follow its posture, ∂τ/∂q.

    Parameters
    ----------
    screws
        Screws (n, 6) in the base frame at the zero pose, (omega, v) [1, m].
    q
        Joint values of the chain (..., n) [rad, or m].
    phi
        Parameters φ (4n,) [kg, kg m], see `gravity_parameters`.
    gravity
        Acceleration of free fall (3,) in the base frame [m/s²].

    Returns
    -------
    Array
        Symmetric matrices (..., n, n) [Nm/rad]. Source: the module's τ_i, differentiated: with what hangs on joint k
        as one body, (m, m·c)_k, it is −(g × ω_i)·(ω_k × (m c)_k + m_k·v_k) for i ≤ k.
    """
    S, g, q = (np.asarray(a, dtype=np.float64) for a in (screws, gravity, q))
    n = len(S)
    G = joint_transforms(S, q)
    J = np.swapaxes(_space_jacobian(S, G), -1, -2)
    body = np.asarray(phi, dtype=np.float64).reshape(n, 4)
    moved = G[..., 1:, :3, :]
    first = np.einsum("...kij,kj->...ki", moved[..., :3], body[:, 1:]) + moved[..., 3] * body[:, :1]
    hanging = np.cumsum(first[..., ::-1, :], axis=-2)[..., ::-1, :]
    mass = np.cumsum(body[::-1, 0])[::-1]
    follows = np.cross(J[..., :3], hanging) + mass[:, None] * J[..., 3:]
    half = -np.cross(g, J[..., :3]) @ np.swapaxes(follows, -1, -2)
    upper = np.triu(half)
    return np.asarray(upper + np.swapaxes(np.triu(half, 1), -1, -2))


def gravity_parameters(links: Sequence[Link]) -> Array:
    """
    Stack the parameters φ of the gravity regressor.

    Parameters
    ----------
    links
        The n moving links, with centres of mass in the base frame at the zero pose.

    Returns
    -------
    Array
        φ (4n,), per link (m, m·cx, m·cy, m·cz) [kg, kg m]. Source: the module's docstring.
    """
    return np.concatenate([[link.mass, *(link.mass * link.com)] for link in links]) if links else np.zeros(0)


def inclination_axes(gravity: npt.ArrayLike) -> Array:
    """
    Give the two horizontal axes about which a base may be off level.

    They are the two base axes nearest to the horizontal, made horizontal: x and y of a robot that stands or hangs
    upright.

    Parameters
    ----------
    gravity
        Acceleration of free fall (3,) in the base frame [m/s²].

    Returns
    -------
    Array
        Unit vectors (2, 3) in the base frame, in the order of the axes.

    Raises
    ------
    ValueError
        If there is no gravity.
    """
    g = np.asarray(gravity, dtype=np.float64)
    size = float(np.linalg.norm(g))
    if not size > 0:
        raise ValueError("gravity: expected a vector that is not zero")
    down = g / size
    level = np.delete(np.eye(3), int(np.argmax(np.abs(down))), axis=0)
    level = level - np.outer(level @ down, down)
    return np.asarray(level / np.linalg.norm(level, axis=1, keepdims=True))


def add_tool(phi: npt.ArrayLike, flange: npt.ArrayLike, mass: float, com_in_flange: npt.ArrayLike) -> Array:
    """
    Add a tool to the parameters of the last link.

    Parameters
    ----------
    phi
        Parameters φ (4n,) [kg, kg m].
    flange
        Pose of the flange at the zero pose in the base frame (4, 4) [m].
    mass
        Mass of the tool [kg].
    com_in_flange
        Its centre of mass in the flange frame (3,) [m].

    Returns
    -------
    Array
        New parameters φ (4n,). Source: masses and first moments add.
    """
    phi = np.array(phi, dtype=np.float64)
    flange = np.asarray(flange, dtype=np.float64)
    com = flange[:3, :3] @ np.asarray(com_in_flange, dtype=np.float64) + flange[:3, 3]
    phi[-4] += mass
    phi[-3:] += mass * com
    return phi


def gravity_torque(
    robot: RobotDescription,
    q: npt.ArrayLike,
    gravity: npt.ArrayLike = STANDARD_GRAVITY,
    tool_mass: float = 0.0,
    tool_com: npt.ArrayLike = (0.0, 0.0, 0.0),
) -> Array:
    """
    Give the joint torques that hold the robot, and a tool, at rest.

    Parameters
    ----------
    robot
        A description with masses.
    q
        Joint values of the chain (..., n) [rad, or m].
    gravity
        Acceleration of free fall (3,) in the base frame [m/s²].
    tool_mass
        Mass of the tool [kg].
    tool_com
        Its centre of mass in the flange frame (3,) [m].

    Returns
    -------
    Array
        Joint torques (..., n) [Nm, or N]. Source: the module's docstring.

    Raises
    ------
    DescriptionError
        If the description has no masses.
    """
    if not robot.has_masses:
        raise DescriptionError(f"{robot.name}: gravity needs the masses of the links, and the description has none")
    phi = add_tool(gravity_parameters(robot.links), robot.flange, tool_mass, tool_com)
    return np.asarray(torque_by_gravity(robot.screws, q, phi) @ np.asarray(gravity, dtype=np.float64))
