"""Analytic inverse kinematics, all eight branches, of ortho-parallel arms with a spherical wrist.

An arm is of this kind if axis 2 is perpendicular to axis 1, axis 3 parallel to axis 2, and axes 4, 5, 6 meet in one
point with neighbours perpendicular. Offsets of shoulder, elbow and to the side are free, and so is the zero pose: all
is done on the screws. With w the wrist's centre at the zero pose and g = T M^-1 the wanted motion of the flange::

    shoulder  the component of E_1^-1 g w along axis 2 is that of w             two solutions for q1
    elbow     a triangle in the plane across axis 2                             two solutions for q3, then q2
    wrist     R_4 R_5 R_6 = (R_1 R_2 R_3)^T R                                   two solutions for q5, then q4, q6

Branch b = 4 shoulder + 2 elbow + wrist. Every angle comes from atan2, so that accuracy does not fail near the borders.
Where a triangle does not close the nearest posture is given, and its lack: a length. Source: Brandstötter, Angerer,
Hofbaur (2014), An analytical solution of the inverse kinematics problem of industrial serial manipulators with an
ortho-parallel basis and a spherical wrist; in the form of Paden-Kahan subproblems, Murray, Li, Sastry (1994), 3.3.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np
import numpy.typing as npt

from kinematics.robot import RobotDescription

__all__ = ["BRANCHES", "SIGNS", "OrthoArm", "branches_sx", "ortho_arm", "posture_sx", "signs_of", "wrapped"]

Array = npt.NDArray[np.float64]

BRANCHES = 8
SIGNS = np.array([(a, b, c) for a in (1.0, -1.0) for b in (1.0, -1.0) for c in (1.0, -1.0)])
"""``(8, 3)``: signs of shoulder, elbow and wrist of each branch."""
_SQUARE = 1e-9  # how far axes may be from parallel or perpendicular, and from meeting (m)


@dataclass(frozen=True, eq=False)
class OrthoArm:
    """The geometry that the analytic solution uses; base frame at the zero pose, m.

    Attributes
    ----------
    axes
        ``(6, 3)``.
    shoulder, elbow, wrist
        ``(3,)``: points on axes 2 and 3, and the wrist's centre.
    foot
        ``(3,)``: a point on axis 1.
    home
        ``(4, 4)``: the flange.
    psi
        Angle about axis 5 from axis 4 to axis 6 at the zero pose, rad.
    stretched
        q3 at which shoulder, elbow and wrist lie on one line, rad.
    """

    axes: Array
    foot: Array
    shoulder: Array
    elbow: Array
    wrist: Array
    home: Array
    psi: float
    stretched: float
    lengths: tuple[float, float]

    @cached_property
    def front(self) -> float:
        """The shoulder's sign of the zero pose, where the arm reaches forward."""
        return float(signs_of(self, np.zeros(6))[0])

    @property
    def side(self) -> float:
        """The wrist's distance from the plane of axis 1, along axis 2, m."""
        return float(self.axes[1] @ (self.wrist - self.foot))


def ortho_arm(robot: RobotDescription) -> OrthoArm | None:
    """The arm as the analytic solution sees it, or None if it is not ortho-parallel with a spherical wrist."""
    if robot.n != 6 or any(j.kind != "revolute" for j in robot.joints):
        return None
    a = np.array([j.axis for j in robot.joints])
    points = np.array([j.point for j in robot.joints])
    square = [a[0] @ a[1], a[3] @ a[4], a[4] @ a[5], 1.0 - abs(a[1] @ a[2])]
    if max(abs(v) for v in square) > _SQUARE:
        return None
    wrist = _meeting(a[3:], points[3:])
    if wrist is None:
        return None
    # The forearm may be turned about axis 3 at will, but axis 4 must stay in a plane across it or the wrist's centre
    # is all that matters: it is what the triangle uses, so that axis 4 may point anywhere.
    n, m = a[3], np.cross(a[4], a[3])
    psi = float(np.arctan2(a[5] @ m, a[5] @ n))
    side = a[1]
    upper = _across(points[2] - points[1], side)
    fore = _across(wrist - points[2], side)
    lengths = float(np.linalg.norm(upper)), float(np.linalg.norm(fore))
    if min(lengths) < 1e-6:
        return None
    # Angle about axis 3 from the upper arm's line to the forearm's at the zero pose; q3 takes it to zero.
    bent = float(np.arctan2(a[2] @ np.cross(upper, fore), upper @ fore))
    home = np.asarray(robot.flange, dtype=float)
    return OrthoArm(a, points[0], points[1], points[2], wrist, home, psi, -bent, lengths)


def _meeting(axes: Array, points: Array) -> Array | None:
    """Where three axes meet ``(3,)``, or None."""
    A, b = np.zeros((3, 3)), np.zeros(3)
    for axis, point in zip(axes, points, strict=True):
        P = np.eye(3) - np.outer(axis, axis)
        A, b = A + P, b + P @ point
    meeting: Array = np.linalg.solve(A, b).astype(np.float64)
    miss = max(float(np.linalg.norm(_across(meeting - p, a))) for a, p in zip(axes, points, strict=True))
    return meeting if miss < _SQUARE else None


def _across(v: Array, axis: Array) -> Array:
    return np.asarray(v - (v @ axis) * axis)


def branches_sx(arm: OrthoArm, R: Any, p: Any, q4: Any) -> tuple[Any, Any]:
    """The eight postures of a flange pose as casadi expressions.

    Parameters
    ----------
    R, p
        Rotation ``(3, 3)`` and position ``(3,)`` of the flange in the base frame, m.
    q4
        What joint 4 is to be where the wrist is singular and any value would do, rad.

    Returns
    -------
    q
        ``(6, 8)``, joint values of the chain, rad, each within ±pi of zero.
    quality
        ``(3, 8)``: lack of the shoulder's and of the elbow's triangle (m; positive: does not close by that much) and
        |sin| of the wrist's angle.
    """
    found = [posture_sx(arm, R, p, q4, SIGNS[b]) for b in range(BRANCHES)]
    return ca.horzcat(*(q for q, _ in found)), ca.horzcat(*(quality for _, quality in found))


def posture_sx(arm: OrthoArm, R: Any, p: Any, q4: Any, signs: Any) -> tuple[Any, Any]:
    """One posture ``(6,)`` and its quality ``(3,)``, see :func:`branches_sx`, by its signs (shoulder, elbow, wrist)."""
    home = arm.home
    g_R = R @ ca.DM(home[:3, :3].T)
    g_p = p - g_R @ ca.DM(home[:3, 3])
    w = g_R @ ca.DM(arm.wrist) + g_p - ca.DM(arm.foot)  # the wrist's centre as wanted, from a point on axis 1
    plane = _plane(arm)
    x, y, z = ca.dot(w, ca.DM(plane[0])), ca.dot(w, ca.DM(arm.axes[1])), ca.dot(w, ca.DM(plane[1]))
    radius2 = x * x + y * y
    lack_shoulder = abs(arm.side) - ca.sqrt(radius2)
    forward = signs[0] * ca.sqrt(ca.fmax(radius2 - arm.side**2, 0.0))
    # Turned back by q1 the wrist is (side, forward) in (axis 2, across), which is right-handed about axis 1.
    q1 = ca.atan2(x, y) - ca.atan2(forward, arm.side)
    shoulder = plane @ (arm.shoulder - arm.foot)
    q2, q3, lack = _triangle(arm, ca.vertcat(forward - shoulder[0], z - shoulder[1]), signs[1])
    R3 = _turn(arm.axes[0], q1) @ _turn(arm.axes[1], q2) @ _turn(arm.axes[2], q3)
    angles, sine = _wrist(arm, R3.T @ g_R, signs[2], q4)
    return ca.vertcat(*(wrapped(v) for v in (q1, q2, q3, *angles))), ca.vertcat(lack_shoulder, lack, sine)


def signs_of(arm: OrthoArm, q: Array) -> Array:
    """The branch that postures of the chain ``(..., 6)`` are on: signs ``(..., 3)`` of shoulder, elbow and wrist."""
    q = np.asarray(q, dtype=float)
    plane = _plane(arm)
    turn = float(np.sign(arm.axes[1] @ np.cross(plane[0], plane[1])))
    sense = turn * float(np.sign(arm.axes[1] @ arm.axes[2]))
    upper = plane @ _across(arm.elbow - arm.shoulder, arm.axes[1])
    at2 = turn * q[..., 1] + np.arctan2(upper[1], upper[0])
    bend = q[..., 2] - arm.stretched
    at3 = at2 + sense * bend
    shoulder = float(plane[0] @ (arm.shoulder - arm.foot))
    forward = shoulder + arm.lengths[0] * np.cos(at2) + arm.lengths[1] * np.cos(at3)
    values = np.stack([forward, np.sin(bend), np.sin(q[..., 4] + arm.psi)], axis=-1)
    return np.where(values < 0, -1.0, 1.0)


def _plane(arm: OrthoArm) -> Array:
    """The two directions ``(2, 3)`` that span the plane across axis 2: radial at q1 = 0, and along axis 1."""
    return np.array([np.cross(arm.axes[0], arm.axes[1]), arm.axes[0]])


def _triangle(arm: OrthoArm, d: Any, elbow: Any) -> tuple[Any, Any, Any]:
    """q2 and q3 that put the wrist at ``d`` from the shoulder, and by how much it is out of reach, m."""
    L1, L2 = arm.lengths
    plane = _plane(arm)
    # About axis 2 the plane (across, axis 1) turns from `across` to `axis 1` negatively or positively:
    turn = float(np.sign(arm.axes[1] @ np.cross(plane[0], plane[1])))
    sense = float(np.sign(arm.axes[1] @ arm.axes[2]))
    D2 = ca.sumsqr(d)
    D = ca.sqrt(D2)
    c = (D2 - L1 * L1 - L2 * L2) / (2 * L1 * L2)
    s = elbow * ca.sqrt(ca.fmax(1 - c * c, 0.0))
    # Beyond the border the forearm is stretched or folded.
    bend = ca.atan2(s, ca.fmin(ca.fmax(c, -1.0), 1.0))  # about axis 3
    about2 = sense * bend
    upper = plane @ _across(arm.elbow - arm.shoulder, arm.axes[1])
    upper_at = turn * float(np.arctan2(upper[1], upper[0]))
    target_at = turn * ca.atan2(d[1], d[0])
    ahead = ca.atan2(L2 * ca.sin(about2), L1 + L2 * ca.cos(about2))
    lack = ca.fmax(D - (L1 + L2), abs(L1 - L2) - D)
    return target_at - ahead - upper_at, bend + arm.stretched, lack


def _wrist(arm: OrthoArm, W: Any, side: Any, q4: Any) -> tuple[tuple[Any, Any, Any], Any]:
    """q4, q5, q6 of the wrist's rotation ``W`` and |sin| of its angle."""
    a4, a5, a6 = arm.axes[3:]
    n = np.cross(a5, a4)
    d = W @ ca.DM(a6)
    along, first, second = ca.dot(ca.DM(a4), d), ca.dot(ca.DM(n), d), ca.dot(ca.DM(a5), d)
    # Turning a4 about a5 by theta: cos a4 + sin (a5 × a4); about a4 that sine's direction n goes to a4 × n = a5.
    sine = ca.sqrt(first * first + second * second)
    singular = sine < 1e-11
    theta5 = ca.atan2(side * sine, along)
    found = ca.atan2(side * second, side * first)
    theta4 = ca.if_else(singular, q4, found)
    theta5 = ca.if_else(singular, ca.atan2(0.0 * sine, along), theta5)
    q5 = theta5 - arm.psi
    rest = (_turn(a4, theta4) @ _turn(a5, q5)).T @ (W @ ca.DM(a5))
    q6 = ca.atan2(ca.dot(ca.DM(np.cross(a6, a5)), rest), ca.dot(ca.DM(a5), rest))
    return (theta4, q5, q6), sine


def _turn(axis: Array, angle: Any) -> Any:
    """Rodrigues' rotation about a constant unit vector."""
    K = ca.skew(ca.DM(axis))
    return ca.DM.eye(3) + ca.sin(angle) * K + (1 - ca.cos(angle)) * (K @ K)


def wrapped(angle: Any) -> Any:
    """The same angle within ±pi."""
    return angle - 2 * np.pi * ca.floor(angle / (2 * np.pi) + 0.5)
