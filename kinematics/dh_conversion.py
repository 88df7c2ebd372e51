"""
From screws to Denavit–Hartenberg tables, and back.

A frame F_{i-1} has its z along the axis of joint i (times the row's sign). A row leads from there to a frame on the
next axis: a standard row by the common normal of the two (Denavit & Hartenberg 1955), a Hayati row by the point where
the next axis pierces the plane z = 0 (Hayati 1985), which needs no common normal. The last row leads towards the
flange, and the tool takes the rest, so that the tables are exact whatever the home pose.
"""

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from kinematics import poe
from kinematics.dh import Convention, DHRow, DHTable, forward, row_transform
from kinematics.screws import inverse, prismatic_screw, screw, transform
from kinematics.typing_ import Array

__all__ = ["HAYATI_BELOW", "DHError", "hayati_from_poe", "poe_from_dh", "reconstruction_error", "standard_from_poe"]

HAYATI_BELOW = 0.5  # sine of the angle between two axes under which a Hayati row is taken: both are well behaved there
_PARALLEL = 1e-14  # sine under which axes cannot be separated from parallel ones in double precision
_ACCEPTED_LOSS = 1e-6  # m (and rad): the most that a standard table may lose by cancellation
_ROUNDING = 1e-12  # how far a screw may be from that of a revolute or prismatic joint


class DHError(ValueError):
    """The chain cannot be written as the table that was asked for."""


def poe_from_dh(table: DHTable) -> tuple[Array, Array]:
    """
    Turn a table into screws.

    Parameters
    ----------
    table
        The table of n rows.

    Returns
    -------
    tuple of Array
        Screws (n, 6) in the base frame at the zero pose, (omega, v) [1, m], and the flange's home pose (4, 4) [m].
        Source: Lynch & Park, Modern Robotics, appendix C.
    """
    frame = table.base
    screws = np.empty((len(table.rows), 6))
    for i, row in enumerate(table.rows):
        axis = row.sign * frame[:3, 2]
        screws[i] = prismatic_screw(axis) if row.prismatic else screw(axis, frame[:3, 3])
        frame = frame @ row_transform(row, 0.0)
    return screws, np.asarray(frame @ table.tool)


def hayati_from_poe(screws: npt.ArrayLike, home: npt.ArrayLike, like: DHTable | None = None) -> DHTable:
    """
    Turn screws into a table that is exact however parallel the axes are.

    Rows between axes whose angle has a sine below `HAYATI_BELOW` are Hayati's (d = 0, beta free), the others standard.

    Parameters
    ----------
    screws
        Screws (n, 6) of revolute or prismatic joints in the base frame at the zero pose, (omega, v) [1, m].
    home
        The flange's home pose (4, 4) in the base frame [m].
    like
        A table (the nominal one) whose signs and directions of x axes are taken where there is a choice.

    Returns
    -------
    DHTable
        The table. Its base and tool are rigid transforms. Source: Hayati, Robot arm geometric link parameter
        estimation, 1983 and 1985 (see Hayati1985); Denavit & Hartenberg 1955.

    Raises
    ------
    DHError
        For helical joints and screws that are not of unit length.
    """
    return _table(screws, home, like, "hayati")


def standard_from_poe(screws: npt.ArrayLike, home: npt.ArrayLike, like: DHTable | None = None) -> DHTable:
    """
    Turn screws into a standard table, or refuse where it would lose more than a micrometre.

    Parameters
    ----------
    screws
        Screws (n, 6) of revolute or prismatic joints in the base frame at the zero pose, (omega, v) [1, m].
    home
        The flange's home pose (4, 4) in the base frame [m].
    like
        A table (the nominal one) whose signs and directions of x axes are taken where there is a choice.

    Returns
    -------
    DHTable
        The table. Source: Denavit & Hartenberg, A kinematic notation for lower-pair mechanisms based on matrices, 1955.

    Raises
    ------
    DHError
        For helical joints, screws that are not of unit length, and axes so nearly parallel that the offsets d, which
        grow like one over their angle, cancel at the cost of more than 1 µm.
    """
    table = _table(screws, home, like, "standard")
    loss = reconstruction_error(table, screws, home)
    if loss > _ACCEPTED_LOSS:
        sines = np.abs(np.sin([row.alpha for row in table.rows]))
        i = int(np.argmin(np.where(sines > _PARALLEL, sines, np.inf)))
        raise DHError(
            f"a standard table would lose {loss:.2g} m by cancellation, more than {_ACCEPTED_LOSS:g} m: axes {i + 1} "
            f"and {i + 2} are {sines[i]:.2g} rad from parallel, so that d of row {i + 1} is {table.rows[i].d:.3g} m; "
            "use Hayati's rows"
        )
    return table


def reconstruction_error(table: DHTable, screws: npt.ArrayLike, home: npt.ArrayLike) -> float:
    """
    Say by how much a table and the screws that it came from disagree, in ordinary double precision.

    Parameters
    ----------
    table
        The table.
    screws
        The screws (n, 6), (omega, v) [1, m].
    home
        The flange's home pose (4, 4) [m].

    Returns
    -------
    float
        The larger of two numbers: the difference of the poses that is seen at 200 random q (any entry, rad and m
        alike), and four times the spacing of floating-point numbers at the largest offset of the table, because the
        seen difference can be small by luck.
    """
    n = len(table.rows)
    q = np.random.default_rng(0).uniform(-np.pi, np.pi, (200, n))
    seen = float(np.abs(forward(table, q) - poe.forward(screws, home, q)).max())
    largest = max(max(abs(row.d), abs(row.a)) for row in table.rows)
    return max(seen, 4 * float(np.spacing(largest)))


def _table(screws: npt.ArrayLike, home: npt.ArrayLike, like: DHTable | None, convention: Convention) -> DHTable:
    S, home = np.asarray(screws, dtype=np.float64), np.asarray(home, dtype=np.float64)
    if like is not None and len(like.rows) != len(S):
        raise DHError(f"the table to be like: expected {len(S)} rows, found {len(like.rows)}")
    prismatic = [_is_prismatic(i, screw_) for i, screw_ in enumerate(S)]
    axes = np.where(np.array(prismatic)[:, None], S[:, 3:], S[:, :3])
    signs = _signs(axes, like)
    frame = base = _base_frame(S[0], axes[0], signs[0], prismatic[0], like)
    rows = []
    for i in range(len(S)):
        hint = None if like is None else like.rows[i]
        if i + 1 == len(S):
            row = _last_row(inverse(frame) @ home, hint)
        else:
            # A prismatic axis may lie anywhere: through the origin of the frame before, which makes its row short.
            point = frame[:3, 3] if prismatic[i + 1] else np.cross(S[i + 1, :3], S[i + 1, 3:])
            u = frame[:3, :3].T @ (signs[i + 1] * axes[i + 1])
            p = frame[:3, :3].T @ (point - frame[:3, 3])
            near = np.hypot(u[0], u[1]) < HAYATI_BELOW
            row = _hayati_row(u, p, hint) if near and convention == "hayati" else _standard_row(u, p, hint)
        row = replace(row, sign=signs[i], prismatic=prismatic[i])
        rows.append(row)
        frame = frame @ row_transform(row, 0.0)
    return DHTable(tuple(rows), base=base, tool=inverse(frame) @ home, convention=convention)


def _is_prismatic(i: int, S: Array) -> bool:
    length, speed = float(np.linalg.norm(S[:3])), float(np.linalg.norm(S[3:]))
    prismatic = length == 0.0
    if abs((speed if prismatic else length) - 1) > _ROUNDING:
        raise DHError(f"joint {i + 1}: expected a screw of unit length, found {S.tolist()}")
    pitch = float(S[:3] @ S[3:])
    if abs(pitch) > _ROUNDING * (1 + speed):
        raise DHError(f"joint {i + 1}: a DH row cannot describe a helical joint, found a pitch of {pitch:.3g} m/rad")
    return prismatic


def _signs(axes: Array, like: DHTable | None) -> list[int]:
    """Give +1 everywhere but for a first axis that points down: the base frame stays upright, as tables are printed."""
    if like is not None:
        return [row.sign for row in like.rows]
    return [-1 if axes[0, 2] < -np.sqrt(0.5) else 1] + [1] * (len(axes) - 1)


def _base_frame(S: Array, axis: Array, sign: int, prismatic: bool, like: DHTable | None) -> Array:
    """Put z on the first axis and keep the rest as near as possible to the base frame (or that of `like`)."""
    wanted = np.eye(4) if like is None else like.base
    z = sign * axis
    point = wanted[:3, 3] if prismatic else np.cross(S[:3], S[3:])
    point = point + z * (z @ (wanted[:3, 3] - point))
    # Of the wanted axes take the one that is farthest from z's direction, so that the projection is never small.
    k = 0 if abs(wanted[:3, 0] @ z) < 0.9 else 1
    x = wanted[:3, k] - z * (z @ wanted[:3, k])
    x /= np.linalg.norm(x)
    if k == 1:
        x = np.cross(x, z)
    return transform(np.stack([x, np.cross(z, x), z], axis=-1), point)


def _turned(theta: float, a: float, hint: DHRow | None) -> bool:
    """Say whether x should point the other way: as in the hint; else a > 0 if theta is sideways, else theta small."""
    if hint is not None:
        return abs(_wrap(theta - hint.theta_offset)) > np.pi / 2
    if np.pi / 4 < abs(theta) < 3 * np.pi / 4 and abs(a) > 1e-9:
        return a < 0
    return abs(theta) > np.pi / 2 + 1e-9


def _wrap(angle: float) -> float:
    """Bring an angle to (−pi, pi]."""
    return float(np.pi - np.remainder(np.pi - angle, 2 * np.pi))


def _standard_row(u: Array, p: Array, hint: DHRow | None) -> DHRow:
    """Go to the line through p along u by the common normal; all in the frame of the row."""
    sine = float(np.hypot(u[0], u[1]))
    if sine < _PARALLEL:
        # Any normal serves: the one at d = 0 is the Hayati point as well.
        theta, d, a = float(np.arctan2(p[1], p[0])), 0.0, float(np.hypot(p[0], p[1]))
        if a < _PARALLEL:
            theta, a = (0.0 if hint is None else hint.theta_offset), 0.0
        alpha = 0.0 if u[2] > 0 else np.pi
    else:
        theta = float(np.arctan2(u[0], -u[1]))  # x = z × u
        d = float(p[2] - u[2] * (p[0] * u[0] + p[1] * u[1]) / sine**2)
        a = float((p[1] * u[0] - p[0] * u[1]) / sine)
        alpha = float(np.arctan2(sine, u[2]))
    if _turned(theta, a, hint):
        theta, a, alpha = _wrap(theta + np.pi), -a, (-alpha if sine >= _PARALLEL else alpha)
    return DHRow(1, theta, d, a, alpha)


def _hayati_row(u: Array, p: Array, hint: DHRow | None) -> DHRow:
    """Go to the point where the line through p along u pierces z = 0, then tilt by alpha and beta."""
    x, y = p[:2] - p[2] / u[2] * u[:2]
    theta, a = float(np.arctan2(y, x)), float(np.hypot(x, y))
    if a < _PARALLEL:
        theta, a = 0.0, 0.0
    if _turned(theta, a, hint):
        theta, a = _wrap(theta + np.pi), -a
    c, s = np.cos(theta), np.sin(theta)
    ux, uy = c * u[0] + s * u[1], c * u[1] - s * u[0]
    return DHRow(1, theta, 0.0, a, float(np.arctan2(-uy, u[2])), float(np.arcsin(ux)))


def _last_row(flange: Array, hint: DHRow | None) -> DHRow:
    """Go to the flange (its pose in the last frame) as far as theta, d and a half turn in alpha can."""
    z = flange[:3, 2]
    if abs(z[2]) < np.sqrt(0.5):
        return _standard_row(z, flange[:3, 3], hint)
    # The flange looks along the axis, as on every real arm. What is left over (nothing, nominally) is the tool's.
    x = flange[:3, 0]
    return DHRow(1, _wrap(float(np.arctan2(x[1], x[0]))), float(flange[2, 3]), 0.0, 0.0 if z[2] > 0 else np.pi)
