"""The compiled functions of the inverse kinematics: all branches at once, and one calibrated solution.

Each is one casadi function of one row, so that the same source runs compiled (see :mod:`clampid.chain.compiled`), over
whole blocks of rows, or, without a compiler, in casadi's own machine.
"""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import numpy.typing as npt

from offline_ik.arm.identified import IdentifiedArm
from offline_ik.arm.iterations import CHORDS, CONVERGED, damped, newton, whole_jacobian
from offline_ik.arm.kernel import Kernel
from offline_ik.cell.coordinates import Convention, pose_sx
from offline_ik.inverse.ortho import OrthoArm, branches_sx, posture_sx, wrapped

__all__ = [
    "branch_kernel",
    "forward_kernel",
    "locate_kernel",
    "looking_kernel",
    "refine_kernel",
    "sensitivity_kernel",
    "solve_kernel",
    "whole_kernel",
]

Array = npt.NDArray[np.float64]


def branch_kernel(ortho: OrthoArm) -> Kernel:
    """Rows (rotation by rows, position, q4) of a flange pose to postures ``(6 x 8, by columns)`` and quality."""
    row = ca.SX.sym("row", 13)
    q, quality = branches_sx(ortho, ca.reshape(row[:9], 3, 3).T, row[9:12], row[12])
    return Kernel(ca.Function("branches", [row], ca.cse([ca.vec(q), ca.vec(quality)])))


def forward_kernel(arm: IdentifiedArm, mount: Array) -> Kernel:
    """Rows (q, conditions) to position, rotation by rows, Jacobian by rows and what presses on the flanks."""
    n = arm.n
    row = ca.SX.sym("row", 4 * n + 1)
    position, rotation, jacobian, pressing = arm.expression(row[:n], row[n:], mount)
    presses = ca.SX.ones(n) if pressing is None else pressing
    return Kernel(ca.Function("forward", [row], ca.cse([position, ca.vec(rotation.T), ca.vec(jacobian.T), presses])))


def solve_kernel(arm: IdentifiedArm, ortho: OrthoArm | None, mount: Array) -> Kernel:
    """One calibrated solution: from the analytic posture of a branch (or from a given one) by Newton's method.

    Rows are (rotation by rows, position) of the detector as wanted in the calibrated base's frame, near ``(n,)``,
    signs of (shoulder, elbow, wrist), conditions. The start is the branch's analytic posture, with every joint in the
    turn nearest to ``near``; without an ortho-parallel arm it is ``near`` itself. Outputs are q ``(n,)``, the remaining
    error ``(6,)`` (position m, rotation vector rad) at q, and what presses on the flanks there ``(n,)``.
    """
    n = arm.n
    row = ca.SX.sym("row", 12 + n + 3 + 3 * n + 1)
    R, p, q, signs, conditions = ca.reshape(row[:9], 3, 3).T, row[9:12], row[12 : 12 + n], *_rest(row, n)
    if ortho is not None:
        unmounted = R @ ca.DM(mount[:3, :3].T)
        linkage = np.asarray(arm.robot.linkage)
        chain_q4 = (ca.DM(linkage) @ q)[3]
        chain, _ = posture_sx(ortho, unmounted, p - unmounted @ ca.DM(mount[:3, 3]), chain_q4, signs)
        chain = ca.DM(linkage) @ q + wrapped(chain - ca.DM(linkage) @ q)
        q = ca.DM(np.linalg.inv(linkage)) @ chain
    return Kernel(ca.Function("solve", [row], ca.cse(list(newton(arm, mount, q, R, p, conditions, CHORDS)))))


def whole_kernel(arm: IdentifiedArm, mount: Array) -> Kernel:
    """Rows (rotation by rows, position, q, conditions) to the outputs of :func:`whole_jacobian`, J by rows."""
    n = arm.n
    row = ca.SX.sym("row", 12 + n + 3 * n + 1)
    given = ca.vertcat(row[:12], row[12 + n :])
    error, J, presses = whole_jacobian(arm, mount).call([row[12 : 12 + n], given], True, False)
    return Kernel(ca.Function("whole", [row], [error, ca.vec(J.T), presses]))


def refine_kernel(arm: IdentifiedArm, mount: Array, steps: int) -> Kernel:
    """Steps of Levenberg and Marquardt's method from a given posture; rows that are done stay where they are.

    Rows are (rotation by rows, position) of the detector as wanted in the calibrated base's frame, q ``(n,)``,
    (damping, growth), conditions. Outputs are those of :func:`solve_kernel`, and (damping, growth) to go on with.
    """
    n = arm.n
    row = ca.MX.sym("row", 12 + n + 2 + 3 * n + 1)
    given = ca.vertcat(row[:12], row[14 + n :])
    outputs = damped(arm, mount, steps).call([row[12 : 12 + n], row[12 + n : 14 + n], given])
    return Kernel(ca.Function("refine", [row], outputs))


def sensitivity_kernel(arm: IdentifiedArm, mount: Array) -> Kernel:
    """Rows (q, conditions) to what the detector's pose depends on, axes of the calibrated base at these parameters.

    Outputs: rotation by rows ``(9,)``; d (position, rotation vector) / d parameters by rows ``(6 P,)``; by rows
    ``(n 6,)``, the change of the same from one direction of each joint's approach to the other.
    """
    n = arm.n
    row = ca.SX.sym("row", 4 * n + 1)
    rotation, J, spread = _sensitivity(arm, mount, row[:n], row[n:])
    outputs = [ca.vec(ca.densify(o)) for o in (rotation.T, J.T, spread)]
    return Kernel(ca.Function("sensitivity", [row], ca.cse(outputs)))


def _sensitivity(arm: IdentifiedArm, mount: Array, q: Any, conditions: Any) -> tuple[Any, Any, Any]:
    """Rotation ``(3, 3)``, derivative by the parameters ``(6, P)``, and spread of the approaches ``(6, n)``."""
    n = arm.n
    theta = ca.SX.sym("theta", len(arm.slots))
    _, rotation, S, values, _ = arm.stations(q, conditions, mount, theta)
    known = ca.SX(ca.DM(arm.theta))
    J = ca.substitute(S @ ca.jacobian(values, theta), theta, known)
    S = ca.substitute(S, theta, known)
    spread = []
    for i in range(n):
        sides = []
        for side in (1.0, -1.0):
            there = ca.vertcat(conditions[:i], side, conditions[i + 1 :])
            sides.append(arm.stations(q, there, mount)[3])
        spread.append(S @ (sides[0] - sides[1]))
    return ca.substitute(rotation, theta, known), J, ca.horzcat(*spread)


def looking_kernel(arm: IdentifiedArm, mount: Array, convention: Convention) -> Kernel:
    """Position of the detector at a posture, and by how much its normal misses the sample, with derivatives.

    Rows are (q, roll, conditions). Outputs: the position ``(3,)`` in the convention's frame, m; its derivative by q
    ``(3 n,)`` by rows; the sample's direction along the detector's x and y and the sine by which the roll is another
    ``(3,)``, all zero where it looks there; their derivatives ``(3 n,)`` by rows.
    """
    n = arm.n
    row = ca.SX.sym("row", n + 1 + 3 * n + 1)
    q, conditions = row[:n], row[n + 1 :]
    position, rotation, S, values, _ = arm.stations(q, conditions, mount)
    J = S[:, :n] + S @ ca.jacobian(values, q)  # the first by the joints before a linkage, as the others
    frame = np.eye(4) if convention.frame == "base" else arm.base
    A = ca.DM(frame[:3, :3])
    p, R, roll = ca.SX.sym("p", 3), ca.SX.sym("R", 3, 3), ca.SX.sym("roll")
    off = p - ca.DM(convention.sample)
    r = ca.norm_2(off)
    x, y, z = ca.vertsplit(ca.DM(convention.lab).T @ off)
    if convention.order == "gamma_outer":
        gamma, delta = ca.atan2(-x, z), ca.atan2(y, ca.sqrt(x * x + z * z))
    else:
        gamma, delta = ca.atan2(-x, ca.sqrt(y * y + z * z)), ca.atan2(y, z)
    wanted, _ = pose_sx(convention, convention.gamma_sign * gamma, convention.delta_sign * delta, r, roll)
    misses = ca.vertcat(-(R[:, :2].T @ off) / r, ca.dot(wanted[:, 1], R[:, 0]))
    turned = ca.vertcat(*(-ca.skew(R[:, k]) for k in range(3)))  # d vec R by a rotation vector
    looks = ca.Function(
        "looks", [p, R, roll], [misses, ca.jacobian(misses, p), ca.jacobian(misses, ca.vec(R)) @ turned]
    )
    at = A @ position + ca.DM(frame[:3, 3])
    missed, by_place, by_turn = looks.call([at, A @ rotation, row[n]], True, False)
    slope = by_place @ (A @ J[:3, :]) + by_turn @ (A @ J[3:, :])
    outputs = [at, ca.vec((A @ J[:3, :]).T), missed, ca.vec(slope.T)]
    return Kernel(ca.Function("looking", [row], ca.cse([ca.densify(o) for o in outputs])))


def locate_kernel(
    arm: IdentifiedArm,
    ortho: OrthoArm,
    mount: Array,
    lower: Array,
    upper: Array,
    convention: Convention,
    of_mount: Array,
    uncertain: npt.NDArray[np.bool_],
) -> tuple[Kernel, npt.NDArray[np.intp]]:
    """From (gamma, delta, r) to everything that an answer says, for the posture nearest to the one at hand.

    Eight branches, their turns within the limits, Newton's method on the nearest, and how it depends on the parameters,
    all in one call. Rows are (gamma, delta, r, roll, moved), near ``(n,)``, conditions; where moved is 1 the directions
    are those of a straight move from near.

    Parameters
    ----------
    of_mount
        ``(6, P)``: see :func:`offline_ik.cell.mount.mount_jacobian`.
    uncertain
        ``(P,)``: which parameters have a variance.

    Returns
    -------
    Kernel
        Outputs: the target ``(16,)`` by rows in the convention's frame, q, motor angles, directions, (remaining error,
        m, and rad, branch or -1 where it is not solved or not within the limits, |sin| of the wrist, lack of the
        shoulder's triangle, joint 3 of the chain, largest move), one after the other; d (position, rotation vector) / d
        counting parameters by rows ``(6 C,)``; half the spread of those approaches that are not known by rows
        ``(n 6,)``. The latter two along across, up and outward.
    counting
        ``(C,)``: which parameters are uncertain and the detector's pose depends on.
    """
    n = arm.n
    row = ca.SX.sym("row", 5 + n + 3 * n + 1)
    moved, near, conditions = row[4], row[5 : 5 + n], row[5 + n :]
    target_R, target_p = pose_sx(convention, row[0], row[1], row[2], row[3])
    R, p = target_R, target_p
    if convention.frame != "base":
        back = np.linalg.inv(arm.base)
        R, p = ca.DM(back[:3, :3]) @ R, ca.DM(back[:3, :3]) @ p + ca.DM(back[:3, 3])
    start, choice = _nearest(ortho, mount, np.asarray(arm.robot.linkage), R, p, near, lower, upper)
    direction = ca.if_else(moved > 0.5, ca.sign(start - near), conditions[:n])
    given = ca.vertcat(direction, conditions[n:])
    q, error = newton(arm, mount, start, R, p, given, CHORDS + 1)[:2]
    motor = ca.DM(np.linalg.inv(np.asarray(arm.robot.transmission)).T) @ q
    # The derivatives are a function of their own: they depend on the solution only, not on the iterations.
    at, there = ca.SX.sym("q", n), ca.SX.sym("c", 3 * n + 1)
    rotation, J, spread = _sensitivity(arm, mount, at, there)
    depends = np.asarray(of_mount.any(axis=0))
    depends[np.unique(J.sparsity().get_col()).astype(int)] = True
    counting = np.flatnonzero(depends & uncertain)
    outputs = [ca.densify(o) for o in (rotation, J[:, counting.tolist()], spread)]
    sensitivity = ca.Function("s", [at, there], outputs)
    rotation, J, spread = sensitivity.call([q, given], True, False)
    flange = rotation @ ca.DM(mount[:3, :3].T)
    J = J + ca.vertcat(flange @ ca.DM(of_mount[:3, counting]), flange @ ca.DM(of_mount[3:, counting]))
    c, s = ca.cos(row[3]), ca.sin(row[3])
    towards = ca.horzcat(-s * R[:, 0] - c * R[:, 1], s * R[:, 1] - c * R[:, 0], -R[:, 2]).T
    J = ca.vertcat(towards @ J[:3, :], towards @ J[3:, :])
    unknown = 0.5 * (direction == 0)
    half = ca.vertcat(towards @ spread[:3, :], towards @ spread[3:, :]) * ca.repmat(unknown.T, 6, 1)
    ok = ca.mmax(ca.fabs(error)) <= 0.1 * CONVERGED  # as in the solver: what is not solved goes to its searches
    for i in range(n):
        ok = ca.logic_and(ok, ca.logic_and(q[i] >= float(lower[i]), q[i] <= float(upper[i])))
    branch = ca.if_else(ok, choice[0], -1)
    chain3 = (ca.DM(np.asarray(arm.robot.linkage)) @ q)[2]
    left = ca.vertcat(ca.norm_2(error[:3]), ca.norm_2(error[3:]))
    choice = ca.vertcat(left, branch, choice[1], choice[2], chain3, ca.mmax(ca.fabs(q - near)))
    target = ca.vertcat(ca.horzcat(target_R, target_p), ca.DM([[0, 0, 0, 1]]))
    first = ca.vertcat(ca.vec(target.T), q, motor, direction, choice)
    outputs = [ca.densify(o) for o in (first, ca.vec(J.T), ca.vec(half))]
    return Kernel(ca.Function("locate", [row], ca.cse(outputs))), counting


def _nearest(
    ortho: OrthoArm, mount: Array, linkage: Array, R: Any, p: Any, near: Any, lower: Array, upper: Array
) -> tuple[Any, Any]:
    """The analytic posture nearest to ``near`` within the limits, and (branch or -1, sine, lack of the shoulder)."""
    flange_R = R @ ca.DM(mount[:3, :3].T)
    flange_p = p - flange_R @ ca.DM(mount[:3, 3])
    postures, quality = branches_sx(ortho, flange_R, flange_p, (ca.DM(linkage) @ near)[3])
    start, best, choice = near, ca.SX(1e9), ca.vertcat(-1, 0, 0)
    for b in range(postures.shape[1]):
        q = ca.DM(np.linalg.inv(linkage)) @ postures[:, b]
        q, fits = _turned_within(q, near, lower, upper)
        cost = ca.mmax(ca.fabs(q - near)) + ca.if_else(ca.logic_and(fits, ca.mmax(quality[:2, b]) <= 0), 0, 1e6)
        better = cost < best - 1e-9
        start = ca.if_else(better, q, start)
        choice = ca.if_else(better, ca.vertcat(ca.if_else(cost < 1e6, b, -1), quality[2, b], quality[0, b]), choice)
        best = ca.fmin(cost, best)
    return start, choice


def _turned_within(q: Any, near: Any, lower: Array, upper: Array) -> tuple[Any, Any]:
    """Every joint in the turn within its limits that is nearest to ``near``, and whether there is one for each."""
    whole = 2 * np.pi
    out, fits = [], ca.SX(1)
    for i in range(len(lower)):
        wished = ca.floor((near[i] - q[i]) / whole + 0.5)
        if np.isfinite(lower[i]) and np.isfinite(upper[i]):
            first, last = ca.ceil((lower[i] - q[i]) / whole), ca.floor((upper[i] - q[i]) / whole)
            fits = ca.logic_and(fits, first <= last)
            wished = ca.fmin(ca.fmax(wished, first), last)
        out.append(q[i] + whole * wished)
    return ca.vertcat(*out), fits


def _rest(row: Any, n: int) -> tuple[Any, Any]:
    return row[12 + n : 15 + n], row[15 + n :]
