"""Newton's and Levenberg and Marquardt's method on the identified arm, as casadi expressions.

Source of the damping: Nielsen (1999), Damping parameter in Marquardt's method.
"""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import numpy.typing as npt

from offline_ik.arm.identified import IdentifiedArm

__all__ = ["CHORDS", "CONVERGED", "GIVEN_UP", "WISHED", "damped", "newton", "whole_jacobian"]

Array = npt.NDArray[np.float64]

FRESH = 2  # steps with a Jacobian of their own
CHORDS = 2  # steps that use the last one again: each gains three digits, as any that leaves the loads' change out
CONVERGED = 1e-9  # m and rad: what counts as reaching a pose
WISHED = 1e-11  # m and rad: what rounding allows, and what a search improves its end to
GIVEN_UP = 1e8  # damping beyond which no step changes anything
LARGEST_STEP = 0.5  # rad of a joint in one damped step
DAMPING = 1e-12  # of J'J, whose entries are of the order of one: keeps a singular step finite, leaves any other alone


def newton(
    arm: IdentifiedArm, mount: Array, q: Any, R: Any, p: Any, conditions: Any, chords: int
) -> tuple[Any, Any, Any]:
    """Newton's method and chord steps from ``q``: the end, its error, and the flanks' torques there."""
    evaluate = _evaluation(arm, mount)
    factor, J = None, ca.SX(0, 0)
    for k in range(FRESH + chords):
        error, jacobian, _ = evaluate(q, R, p, conditions)
        if k < FRESH:
            J = jacobian
            factor = _cholesky(J.T @ J + DAMPING * ca.SX.eye(arm.n))
        q = q + _solve(factor, J.T @ error)
    error, _, pressing = evaluate(q, R, p, conditions)
    return q, error, pressing


def whole_jacobian(arm: IdentifiedArm, mount: Array) -> Any:
    """Residual to a pose and its Jacobian, as a function of q ``(n,)`` and (R by rows, p, conditions).

    Outputs: the error ``(6,)``, position m and rotation vector rad; d (position, rotation vector) / d q ``(6, n)`` with
    the loads' change with the posture in it, which near a singularity is all that is left of it; what presses ``(n,)``.
    """
    n = arm.n
    q, R, p, conditions = (ca.SX.sym("q", n), ca.SX.sym("R", 9), ca.SX.sym("p", 3), ca.SX.sym("c", 3 * n + 1))
    position, rotation, S, values, pressing = arm.stations(q, conditions, mount)
    J = S[:, :n] + S @ ca.jacobian(values, q)  # the first by the joints before a linkage, as the others
    error = ca.vertcat(p - position, _rotation_vector(ca.reshape(R, 3, 3).T, rotation))
    presses = ca.SX.ones(n) if pressing is None else pressing
    outputs = ca.cse([error, ca.densify(J), presses])
    return ca.Function("whole_jacobian", [q, ca.vertcat(R, p, conditions)], outputs)


def damped(arm: IdentifiedArm, mount: Array, steps: int) -> Any:
    """Levenberg and Marquardt's method, as a function of q, (damping, growth), (R by rows, p, conditions).

    Outputs: q ``(n,)``, the error that is left there ``(6,)``, what presses ``(n,)``, and (damping, growth) to go on
    with. Steps are those of :func:`whole_jacobian`.
    """
    n = arm.n
    evaluate = whole_jacobian(arm, mount)
    q, control, given = ca.SX.sym("q", n), ca.SX.sym("control", 2), ca.SX.sym("given", evaluate.nnz_in(1))
    error, J, presses = evaluate.call([q, given], True, False)
    begin = ca.Function("begin", [q, control, given], [ca.vertcat(q, control, error, presses, ca.vec(J))])
    state = ca.SX.sym("state", begin.nnz_out(0))
    step = ca.Function("step", [state, given], [ca.cse(_damped_step(n, state, given, begin))])
    at, kept, wanted = ca.MX.sym("q", n), ca.MX.sym("control", 2), ca.MX.sym("given", given.numel())
    end = step.fold(steps)(begin(at, kept, wanted), ca.repmat(wanted, 1, steps))
    outputs = [end[:n], end[n + 2 : n + 8], end[n + 8 : 2 * n + 8], end[n : n + 2]]
    return ca.Function("damped", [at, kept, wanted], outputs)


def _damped_step(n: int, state: Any, given: Any, begin: Any) -> Any:
    """The state after one step: moved if that is better, or with more damping; as it is where there is no need."""
    q, damping, growth, error, J = (
        state[:n], state[n], state[n + 1], state[n + 2 : n + 8], ca.reshape(state[2 * n + 8 :], 6, n)
    )  # fmt: skip
    step = _solve(_cholesky(J.T @ J + damping * ca.SX.eye(n)), J.T @ error)
    trial = q + ca.fmin(ca.fmax(step, -LARGEST_STEP), LARGEST_STEP)
    better = begin.call([trial, ca.vertcat(ca.fmax(0.1 * damping, 1e-15), 2.0), given], True, False)[0]
    worse = ca.vertcat(q, 2.0 * growth * ca.fmax(damping, 1e-13), 2.0 * growth, state[n + 2 :])
    wanted = ca.logic_and(ca.mmax(ca.fabs(error)) > WISHED, damping < GIVEN_UP)
    taken = ca.sumsqr(better[n + 2 : n + 8]) < ca.sumsqr(error)
    return ca.if_else(wanted, ca.if_else(taken, better, worse), state)


def _evaluation(arm: IdentifiedArm, mount: Array) -> Any:
    """Residual to the wanted pose, its Jacobian, and the flanks' torques, as a function of expressions."""
    n = arm.n
    q, R, p, conditions = (ca.SX.sym("q", n), ca.SX.sym("R", 3, 3), ca.SX.sym("p", 3), ca.SX.sym("c", 3 * n + 1))
    position, rotation, J, pressing = arm.expression(q, conditions, mount)
    error = ca.vertcat(p - position, _turned(R, rotation))
    presses = ca.SX.ones(n) if pressing is None else pressing
    function = ca.Function("evaluation", [q, R, p, conditions], [error, J, presses])
    return lambda *x: function.call(list(x), True, False)


def _turned(wanted: Any, now: Any) -> Any:
    """Rotation vector from ``now`` to ``wanted``, exact to the third order."""
    E = wanted @ now.T
    return 0.5 * ca.vertcat(E[2, 1] - E[1, 2], E[0, 2] - E[2, 0], E[1, 0] - E[0, 1])


def _rotation_vector(wanted: Any, now: Any) -> Any:
    """Rotation vector from ``now`` to ``wanted``, exact but at half a turn, where it may have any axis."""
    E = wanted @ now.T
    v = _turned(wanted, now)
    sine, cosine = ca.sqrt(ca.sumsqr(v)), 0.5 * (E[0, 0] + E[1, 1] + E[2, 2] - 1)
    small = sine < 1e-12
    factor = ca.if_else(small, 1.0, ca.atan2(sine, cosine) / ca.fmax(sine, 1e-12))
    return ca.if_else(ca.logic_and(small, cosine < 0), ca.DM([np.pi, 0, 0]), factor * v)


def _cholesky(A: Any) -> Any:
    """Factor of a positive definite matrix, without branches: rows of L, and the inverse of its diagonal."""
    n = A.shape[0]
    L = [[ca.SX(0)] * n for _ in range(n)]
    inverse = []
    for j in range(n):
        d = A[j, j]
        for k in range(j):
            d = d - L[j][k] * L[j][k]
        inverse.append(1 / ca.sqrt(ca.fmax(d, 1e-30)))
        for i in range(j + 1, n):
            s = A[i, j]
            for k in range(j):
                s = s - L[i][k] * L[j][k]
            L[i][j] = s * inverse[j]
    return L, inverse


def _solve(factor: Any, b: Any) -> Any:
    """X with L L' x = b."""
    L, inverse = factor
    n = len(inverse)
    y: list[Any] = []
    for i in range(n):
        y.append((b[i] - sum((L[i][k] * y[k] for k in range(i)), ca.SX(0))) * inverse[i])
    x: list[Any] = [ca.SX(0)] * n
    for i in reversed(range(n)):
        x[i] = (y[i] - sum((L[k][i] * x[k] for k in range(i + 1, n)), ca.SX(0))) * inverse[i]
    return ca.vertcat(*x)
