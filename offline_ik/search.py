"""Searches for postures where the analytic start and a few steps of Newton's method do not do.

Levenberg and Marquardt's method from several starts, the likely ones first; then, for a few in a million, patient
searches around a singularity and along the valley in which it lies. Source of the damping: Nielsen (1999), Damping
parameter in Marquardt's method.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from kinematics.screws import log_so3
from offline_ik.arm import Conditions, nominal_arm
from offline_ik.kernels import CONVERGED, Kernel, forward_kernel
from offline_ik.ortho import SIGNS

if TYPE_CHECKING:
    from offline_ik.solver import Solver

__all__ = ["Search", "Solved", "poses_of", "wrapped"]

Array = npt.NDArray[np.float64]
Bools = npt.NDArray[np.bool_]
Rows = npt.NDArray[np.intp]

WISHED = 1e-11  # what rounding allows, and what a start is improved to
AROUND = 3e-3  # m: what calibrated arms differ from nominal ones by
AROUNDS = (1e-3, 3e-3, 1e-2)  # m, for what is left after everything else
ALONG, ALONG_STEPS = 0.05, 250  # rad: twice round, if a joint turns as fast as the step
STARTS = 40  # of an arm without an analytic solution
LM_STEPS = 80
LONG_STEPS = 1500
FIRST = 3  # starts, after which the loads' change is let in
NEAR = 1e-3  # m and rad: what is further off after a search lies in another valley
STEP = 1e-6  # rad, of central differences: exact to 1e-10


@dataclass(frozen=True)
class Solved:
    """Solutions of a block of poses.

    Attributes
    ----------
    q
        ``(N, n)``, rad: the controller's joint values.
    error
        ``(N, 6)``: what is left at q, position m and rotation vector rad.
    pressing
        ``(N, n)``, Nm: its sign is the flank.
    """

    q: Array
    error: Array
    pressing: Array

    @property
    def reached(self) -> Bools:
        """``(N,)``."""
        return np.asarray(np.abs(self.error).max(axis=1) <= CONVERGED)


class Search:
    """Searches on one arm with one frame mounted on its flange.

    Parameters
    ----------
    solver
        Whose kernels they use.
    """

    def __init__(self, solver: Solver) -> None:
        self.solver = solver

    def solve(self, poses: Array, near: Array, signs: Array, conditions: Conditions, first: Array) -> Solved:
        """Several starts for each pose; the best end counts, those near the asked branch first."""
        best = Solved(near.copy(), np.full((len(poses), 6), np.inf), np.zeros_like(near))

        def attempt(start: Array, steps: int = LM_STEPS, exact: bool = False) -> bool:
            cost = np.abs(best.error).max(axis=1)
            rows = np.flatnonzero(~(cost <= 0.1 * CONVERGED) & (~np.bool_(exact) | (cost < NEAR)))
            if len(rows):
                found = self.refine(poses[rows], start[rows], conditions, exact, steps)
                better = np.abs(found.error).max(axis=1) < cost[rows]
                chosen = rows[better]
                best.q[chosen], best.error[chosen] = found.q[better], found.error[better]
                best.pressing[chosen] = found.pressing[better]
            return bool(len(rows))

        for k, start in enumerate(self._starts(poses, near, signs, conditions, first)):
            if not attempt(start):
                break
            if k == FIRST:
                attempt(best.q, exact=True)
        attempt(best.q, LONG_STEPS, exact=True)  # within 1e-4 rad of a fold Newton's steps are short
        cost = np.abs(best.error).max(axis=1)
        rows = np.flatnonzero((cost > CONVERGED) & (cost < NEAR))
        if self.solver.ortho is not None and len(rows):  # a few in a million
            self._last(best, rows, poses, near, signs, conditions)
        q = near + wrapped(best.q - near)
        if np.abs(q - best.q).max(initial=0.0) > 1e-6:  # what counts turns (a wrong ratio) wants the last word
            last = self.refine(poses, q, conditions)
            ok = np.abs(last.error).max(axis=1) <= np.maximum(np.abs(best.error).max(axis=1), 0.1 * CONVERGED)
            best.q[ok], best.error[ok], best.pressing[ok] = last.q[ok], last.error[ok], last.pressing[ok]
        return best

    def _last(self, best: Solved, rows: Rows, poses: Array, near: Array, signs: Array, conditions: Conditions) -> None:
        """Improve the rows that nothing else solved: patient searches around, then along valleys."""

        def keep(found: Solved) -> None:
            better = np.abs(found.error).max(axis=1) < np.abs(best.error[rows]).max(axis=1)
            best.q[rows[better]], best.error[rows[better]] = found.q[better], found.error[better]
            best.pressing[rows[better]] = found.pressing[better]

        for radius in AROUNDS:
            for turn in np.linspace(0, 2 * np.pi, 8, endpoint=False):
                start = self._seed(self._aside(poses[rows], radius, turn), signs[rows], near[rows])
                keep(self.refine(poses[rows], start, conditions, True, LM_STEPS))
        keep(self.refine(poses[rows], best.q[rows], conditions, True, LONG_STEPS))
        for row in rows[np.abs(best.error[rows]).max(axis=1) > CONVERGED]:
            # The other way to hold the wrist has a valley of its own.
            other = np.r_[best.q[row, :3], self._flipped(best.q[row, 3:])]
            starts = np.vstack([self._along(poses[row], q, conditions) for q in (best.q[row], other)])
            if len(starts):
                ends = self.refine(np.tile(poses[row], (len(starts), 1, 1)), starts, conditions, True, LONG_STEPS)
                far = np.abs(wrapped(ends.q - near[row])).max(axis=1)
                k = np.lexsort([far, ~ends.reached])[0]
                if ends.reached[k]:
                    best.q[row], best.error[row], best.pressing[row] = ends.q[k], ends.error[k], ends.pressing[k]

    def _flipped(self, wrist: Array) -> Array:
        """Joints 4 to 6 ``(3,)`` of a spherical wrist that hold it the other way round, rad."""
        assert self.solver.ortho is not None
        return np.array([wrist[0] + np.pi, -2.0 * self.solver.ortho.psi - wrist[1], wrist[2] + np.pi])

    def _along(self, pose: Array, start: Array, conditions: Conditions) -> Array:
        """Postures ``(K, n)`` along the valley of a pose at which what is left changes sign or comes nearest to zero.

        At a singular posture one direction hardly moves the pose. The valley is the curve along it on which the error
        in all other directions is zero; the one that is left is a function along the curve, and its zeros are the
        solutions, however far from the start.
        """
        found = []
        for way in (1.0, -1.0):
            q, height = self._traced(pose, start, conditions, way)
            size = np.abs(height)
            crossed = np.flatnonzero(height[:-1] * height[1:] <= 0)
            lowest = 1 + np.flatnonzero((size[1:-1] < size[:-2]) & (size[1:-1] <= size[2:]))
            found.append(q[np.unique(np.r_[crossed, crossed + 1, lowest])])
        return np.vstack(found)

    def _traced(self, pose: Array, start: Array, conditions: Conditions, way: float) -> tuple[Array, Array]:
        """Postures ``(K, n)`` along a valley, and the error that is left in its direction ``(K,)``."""
        q = start.copy()
        passed, height = np.empty((ALONG_STEPS, len(q))), np.empty(ALONG_STEPS)
        ahead = left = np.zeros(0)
        for k in range(ALONG_STEPS):
            error, J, _ = self.errors(pose[None], q[None], conditions.vector[None], True)
            U, size, Vt = np.linalg.svd(J[0])
            # Neither singular vector may turn round from one step to the next.
            ahead = way * Vt[-1] if k == 0 else np.copysign(1.0, Vt[-1] @ ahead) * Vt[-1]
            left = U[:, -1] if k == 0 else np.copysign(1.0, U[:, -1] @ left) * U[:, -1]
            passed[k], height[k] = q, left @ error[0]
            aside = Vt[:-1].T @ ((U[:, :-1].T @ error[0]) / size[:-1])
            q = q + np.clip(aside, -ALONG, ALONG) + ALONG * ahead
        return passed, height

    def _starts(self, poses: Array, near: Array, signs: Array, conditions: Conditions, first: Array) -> Iterator[Array]:
        """Starts of a search, the likely ones first, each made only when it is its turn."""
        sane = np.isfinite(first).all(axis=1, keepdims=True) & (np.abs(first - near).max(axis=1, keepdims=True) < 7.0)
        yield near if self.solver.ortho is None else np.where(sane, first, near)
        if self.solver.ortho is None:
            rng = np.random.default_rng(0)
            low, high = (np.clip(v, -np.pi, np.pi) for v in (self.solver.arm.robot.lower, self.solver.arm.robot.upper))
            yield np.where(sane, first, near)
            for _ in range(STARTS):
                yield np.tile(rng.uniform(low, high), (len(poses), 1))
            return
        seed = self._seed(poses, signs, near)
        yield seed
        # The nominal arm's posture for a pose that is off by what the identified arm does there.
        off = self._nominal(seed) @ np.linalg.inv(self.solver.pose(seed, conditions))
        yield self._seed(off @ poses, signs, near)
        for turn in np.linspace(0, 2 * np.pi, 12, endpoint=False)[1:]:
            # At a singular wrist joints 4 and 6 trade places: any share may be the real arm's.
            start = seed.copy()
            start[:, 3] += turn
            start[:, 5] -= (
                turn * np.sign(self.solver.ortho.axes[3] @ self.solver.ortho.axes[5]) * np.sign(np.cos(seed[:, 4]))
            )
            start[:, 4] += 0.01 * np.sign(np.sin(seed[:, 4] + self.solver.ortho.psi) + 1e-30)
            yield start
        for turn in np.linspace(0, 2 * np.pi, 16, endpoint=False):
            # The wrist on axis 1: joint 1 is as good as free. Postures for places around give all its values.
            yield self._seed(self._aside(poses, AROUND, turn), signs, near)
        for other in SIGNS:  # near a border branches meet
            yield self._seed(poses, np.tile(other, (len(poses), 1)), near)

    def _aside(self, poses: Array, radius: float, turn: float) -> Array:
        """The poses moved across axis 1."""
        moved = poses.copy()
        moved[:, :3, 3] += radius * (np.cos(turn) * self._across[0] + np.sin(turn) * self._across[1])
        return moved

    def _seed(self, poses: Array, signs: Array, near: Array) -> Array:
        q, _ = self.solver.branches(poses)
        branch = np.argmax((signs[:, None, :] == SIGNS).all(axis=2), axis=1)
        return np.asarray(near + wrapped(q[np.arange(len(q)), branch] - near))

    @cached_property
    def _across(self) -> Array:
        """Two directions ``(2, 3)`` across axis 1."""
        axis = self.solver.arm.robot.joints[0].axis
        return np.linalg.svd(np.asarray(axis)[None, :])[2][1:]

    @cached_property
    def _ideal(self) -> Kernel:
        return forward_kernel(nominal_arm(self.solver.arm.robot), self.solver.mount)

    def _nominal(self, q: Array) -> Array:
        still = Conditions.still(self.solver.arm.n).vector
        p, R, _, _ = self._ideal.many(q, np.tile(still, (len(q), 1)))
        return poses_of(R, p)

    def refine(
        self, poses: Array, start: Array, conditions: Conditions, exact: bool = False, steps: int = LM_STEPS
    ) -> Solved:
        """Levenberg and Marquardt's method from starts ``(N, n)``, each row with its own damping.

        ``exact``: with the loads' change with the posture in the Jacobian, which near a singularity is all that is
        left of it.
        """
        given = np.tile(conditions.vector, (len(poses), 1))
        q = np.asarray(start, dtype=float).copy()
        error, J, pressing = self.errors(poses, q, given, exact)
        cost = np.sum(error**2, axis=1)
        damping, growth = np.full(len(q), 1e-3), np.full(len(q), 2.0)
        active = np.ones(len(q), dtype=bool)
        for _ in range(steps):
            active &= (np.abs(error).max(axis=1) > WISHED) & (damping < 1e8)
            rows = np.flatnonzero(active)
            if not len(rows):
                break
            JT = np.swapaxes(J[rows], 1, 2)
            A = JT @ J[rows] + damping[rows, None, None] * np.eye(q.shape[1])
            step = np.linalg.solve(A, JT @ error[rows, :, None])[:, :, 0]
            trial = q[rows] + np.clip(step, -0.5, 0.5)
            new_error, new_J, new_pressing = self.errors(poses[rows], trial, given[rows], exact)
            new_cost = np.sum(new_error**2, axis=1)
            good = new_cost < cost[rows]
            take, leave = rows[good], rows[~good]
            q[take], error[take], J[take], cost[take] = trial[good], new_error[good], new_J[good], new_cost[good]
            pressing[take] = new_pressing[good]
            damping[take], growth[take] = np.maximum(damping[take] * 0.1, 1e-15), 2.0
            damping[leave] = np.maximum(damping[leave], 1e-13) * growth[leave] * 2
            growth[leave] *= 2
        return Solved(q, error, pressing)

    def errors(self, poses: Array, q: Array, given: Array, exact: bool) -> tuple[Array, Array, Array]:
        """What is left to poses ``(N, 4, 4)`` at ``q`` ``(N, n)``: errors, derivative by q, and what presses.

        ``(N, 6)`` position m and rotation vector rad, ``(N, 6, n)``, ``(N, n)`` Nm; ``given`` ``(N, 3n + 1)``:
        conditions; ``exact``: see :meth:`refine`.
        """
        p, R, J, pressing = self.solver.forward.many(q, given)
        error = np.empty((len(q), 6))
        error[:, :3] = poses[:, :3, 3] - p
        error[:, 3:] = log_so3(poses[:, :3, :3] @ np.swapaxes(R.reshape(-1, 3, 3), 1, 2))
        J = J.reshape(len(q), 6, -1)
        if exact:
            J = J.copy()
            for k in range(q.shape[1]):
                (p1, R1), (p0, R0) = (
                    self.solver.forward.many(q + side * _axis(k, q.shape[1]), given)[:2] for side in (1, -1)
                )
                J[:, :3, k] = (p1 - p0) / (2 * STEP)
                J[:, 3:, k] = log_so3(R1.reshape(-1, 3, 3) @ np.swapaxes(R0.reshape(-1, 3, 3), 1, 2)) / (2 * STEP)
        return error, J, pressing


def poses_of(R: Array, p: Array) -> Array:
    """Poses ``(N, 4, 4)`` of rotations by rows ``(N, 9)`` and positions ``(N, 3)``, m."""
    out = np.zeros((len(p), 4, 4))
    out[:, :3, :3], out[:, :3, 3], out[:, 3, 3] = R.reshape(-1, 3, 3), p, 1.0
    return out


def _axis(k: int, n: int) -> Array:
    return np.asarray(STEP * np.eye(n)[k])


def wrapped(angle: Array) -> Array:
    """The same angles within ±pi, rad."""
    return np.asarray(angle - 2 * np.pi * np.floor(angle / (2 * np.pi) + 0.5))
