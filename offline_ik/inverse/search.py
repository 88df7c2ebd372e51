"""Searches for postures where the analytic start and a few steps of Newton's method do not do.

Levenberg and Marquardt's method from several starts, the likely ones first; then, for a few in a million, patient
searches around a singularity and along the valley in which it lies. Source of the damping: Nielsen (1999), Damping
parameter in Marquardt's method.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np
import numpy.typing as npt

from offline_ik.arm.identified import Conditions, nominal_arm
from offline_ik.arm.iterations import CONVERGED, GIVEN_UP, WISHED
from offline_ik.arm.kernel import Kernel
from offline_ik.inverse.kernels import forward_kernel
from offline_ik.inverse.mounted import STEPS_PER_CALL, MountedArm, poses_of, wrapped
from offline_ik.inverse.ortho import SIGNS

__all__ = ["Search", "Solved", "Wanted"]

Array = npt.NDArray[np.float64]
Bools = npt.NDArray[np.bool_]
Rows = npt.NDArray[np.intp]

CALIBRATION_SHIFT = 3e-3  # m: what calibrated arms differ from nominal ones by
AROUNDS = (1e-3, 3e-3, 1e-2)  # m, for what nothing else has solved
ALONG, ALONG_STEPS = 0.05, 250  # rad: twice round, if a joint turns as fast as the step
STARTS = 40  # of an arm without an analytic solution
LM_STEPS = 80
LONG_STEPS = 1500
MAX_JOINT_CHANGE = np.pi + 0.1  # rad: if Newton's method moves a joint further, it has failed
DAMPING, GROWTH = 1e-3, 2.0  # at first
SAME_VALLEY_COST = 1e-3  # m and rad: a search that ends further off is in another valley


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
    def cost(self) -> Array:
        """``(N,)``: the largest entry of the residual."""
        return np.asarray(np.abs(self.error).max(axis=1))

    @property
    def reached(self) -> Bools:
        """``(N,)``."""
        return np.asarray(self.cost <= CONVERGED)

    def keep(self, rows: Rows, found: Solved) -> None:
        """Take over other solutions of some rows where they are better."""
        self.put(rows, found, found.cost < self.cost[rows])

    def put(self, rows: Rows, found: Solved, which: Bools) -> None:
        """Take those of other solutions of some rows that are marked."""
        chosen = rows[which]
        self.q[chosen], self.error[chosen], self.pressing[chosen] = (
            found.q[which], found.error[which], found.pressing[which]
        )  # fmt: skip


@dataclass(frozen=True)
class Wanted:
    """What a search is to find.

    Attributes
    ----------
    poses
        ``(N, 4, 4)``: the detector in the calibrated base's frame, m.
    near
        ``(N, n)``: decides the turns, rad.
    signs
        ``(N, 3)``: the branches, see :data:`offline_ik.inverse.ortho.SIGNS`.
    first
        ``(N, n)``: where Newton's method ended, rad; may be far off or no number at all.
    """

    poses: Array
    near: Array
    signs: Array
    first: Array
    conditions: Conditions

    def of(self, rows: Rows | Bools) -> Wanted:
        """Some of it."""
        return Wanted(self.poses[rows], self.near[rows], self.signs[rows], self.first[rows], self.conditions)


Start = Callable[[Wanted], Array]
"""Gives the postures ``(N, n)`` at which a search begins, rad."""


class Search:
    """Searches on one arm with one frame mounted on its flange.

    Parameters
    ----------
    mounted
        Whose kernels they use.
    """

    def __init__(self, mounted: MountedArm) -> None:
        self.mounted = mounted

    def solve(self, wanted: Wanted) -> Solved:
        """Several starts for each pose; the best end counts, those near the asked branch first."""
        best = Solved(wanted.near.copy(), np.full((len(wanted.poses), 6), np.inf), np.zeros_like(wanted.near))

        for start in self._starts():
            rows = np.flatnonzero(~(best.cost <= 0.1 * CONVERGED))
            if not len(rows):
                break
            some = wanted.of(rows)
            best.keep(rows, self.refine(some.poses, start(some), wanted.conditions))
        rows = np.flatnonzero((best.cost > 0.1 * CONVERGED) & (best.cost < SAME_VALLEY_COST))
        if len(rows):  # within 1e-4 rad of a fold Newton's steps are short
            best.keep(rows, self.refine(wanted.poses[rows], best.q[rows], wanted.conditions, LONG_STEPS))
        rows = np.flatnonzero((best.cost > CONVERGED) & (best.cost < SAME_VALLEY_COST))
        if self.mounted.ortho is not None and len(rows):  # a few in a million
            self._last(best, rows, wanted)
        q = wanted.near + wrapped(best.q - wanted.near)
        rows = np.flatnonzero(np.abs(q - best.q).max(axis=1) > 1e-6)
        if len(rows):  # effects that count turns (a wrong ratio) need a last refinement
            last = self.refine(wanted.poses[rows], q[rows], wanted.conditions)
            best.put(rows, last, last.cost <= np.maximum(best.cost[rows], 0.1 * CONVERGED))
        return best

    def _last(self, best: Solved, rows: Rows, wanted: Wanted) -> None:
        """Improve the rows that nothing else solved: patient searches around, then along valleys."""
        some, conditions = wanted.of(rows), wanted.conditions
        for radius in AROUNDS:
            for turn in np.linspace(0, 2 * np.pi, 8, endpoint=False):
                best.keep(rows, self.refine(some.poses, self._beside(radius, turn, some), conditions))
        best.keep(rows, self.refine(some.poses, best.q[rows], conditions, LONG_STEPS))
        for row in rows[best.cost[rows] > CONVERGED]:
            pose = wanted.poses[row]
            # The other way to hold the wrist has a valley of its own.
            other = np.r_[best.q[row, :3], self._flipped(best.q[row, 3:])]
            starts = np.vstack([self._along(pose, q, conditions) for q in (best.q[row], other)])
            if len(starts):
                ends = self.refine(np.tile(pose, (len(starts), 1, 1)), starts, conditions, LONG_STEPS)
                far = np.abs(wrapped(ends.q - wanted.near[row])).max(axis=1)
                k = np.lexsort([far, ~ends.reached])[0]
                if ends.reached[k]:
                    best.q[row], best.error[row], best.pressing[row] = ends.q[k], ends.error[k], ends.pressing[k]

    def _flipped(self, wrist: Array) -> Array:
        """Joints 4 to 6 ``(3,)`` of a spherical wrist that hold it the other way round, rad."""
        assert self.mounted.ortho is not None
        return np.array([wrist[0] + np.pi, -2.0 * self.mounted.ortho.psi - wrist[1], wrist[2] + np.pi])

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
        wanted = np.concatenate([pose[:3, :3].ravel(), pose[:3, 3]])
        for k in range(ALONG_STEPS):
            error, J, _ = self.mounted.whole.one(np.concatenate([wanted, q, conditions.vector]))
            U, size, Vt = np.linalg.svd(J.reshape(6, -1))
            # Neither singular vector may turn round from one step to the next.
            ahead = way * Vt[-1] if k == 0 else np.copysign(1.0, Vt[-1] @ ahead) * Vt[-1]
            left = U[:, -1] if k == 0 else np.copysign(1.0, U[:, -1] @ left) * U[:, -1]
            passed[k], height[k] = q, left @ error
            aside = Vt[:-1].T @ ((U[:, :-1].T @ error) / size[:-1])
            q = q + np.clip(aside, -ALONG, ALONG) + ALONG * ahead
        return passed, height

    def _starts(self) -> Iterator[Start]:
        """Starts of a search, the likely ones first."""
        yield _where_newton_ended
        ortho = self.mounted.ortho
        if ortho is None:
            rng = np.random.default_rng(0)
            robot = self.mounted.arm.robot
            low, high = (np.clip(v, -np.pi, np.pi) for v in (robot.lower, robot.upper))
            for drawn in rng.uniform(low, high, (STARTS, robot.n)):
                yield partial(_all_at, drawn)
            return
        yield _where_the_arm_is
        yield self._seed
        yield self._corrected
        for turn in np.linspace(0, 2 * np.pi, 12, endpoint=False)[1:]:
            yield partial(self._traded, turn)
        for turn in np.linspace(0, 2 * np.pi, 16, endpoint=False):
            # The wrist is on axis 1: joint 1 is nearly free. Postures for places around it cover its values.
            yield partial(self._beside, CALIBRATION_SHIFT, turn)
        for other in SIGNS:  # near a border branches meet
            yield partial(self._on, other)

    def _corrected(self, some: Wanted) -> Array:
        """The nominal arm's posture for a pose that is corrected by the identified arm's error there."""
        seed = self._seed(some)
        off = self._nominal(seed) @ np.linalg.inv(self.mounted.pose(seed, some.conditions))
        return self._seed(replace(some, poses=off @ some.poses))

    def _traded(self, turn: float, some: Wanted) -> Array:
        """At a singular wrist joints 4 and 6 trade places: any share may be the real arm's."""
        ortho = self.mounted.ortho
        assert ortho is not None
        start = self._seed(some)
        opposed = np.sign(ortho.axes[3] @ ortho.axes[5]) * np.sign(np.cos(start[:, 4]))
        start[:, 3] += turn
        start[:, 5] -= turn * opposed
        start[:, 4] += 0.01 * np.sign(np.sin(start[:, 4] + ortho.psi) + 1e-30)
        return start

    def _beside(self, radius: float, turn: float, some: Wanted) -> Array:
        """The analytic postures for poses that are moved across axis 1."""
        moved = some.poses.copy()
        moved[:, :3, 3] += radius * (np.cos(turn) * self._across[0] + np.sin(turn) * self._across[1])
        return self._seed(replace(some, poses=moved))

    def _on(self, branch: Array, some: Wanted) -> Array:
        """The analytic postures on a given branch ``(3,)``."""
        return self._seed(replace(some, signs=np.tile(branch, (len(some.poses), 1))))

    def _seed(self, some: Wanted) -> Array:
        """The analytic postures of the nominal arm on the asked branches."""
        q, _ = self.mounted.branches(some.poses)
        branch = np.argmax((some.signs[:, None, :] == SIGNS).all(axis=2), axis=1)
        return np.asarray(some.near + wrapped(q[np.arange(len(q)), branch] - some.near))

    @cached_property
    def _across(self) -> Array:
        """Two directions ``(2, 3)`` across axis 1."""
        axis = self.mounted.arm.robot.joints[0].axis
        return np.linalg.svd(np.asarray(axis)[None, :])[2][1:]

    @cached_property
    def _ideal(self) -> Kernel:
        return forward_kernel(nominal_arm(self.mounted.arm.robot), self.mounted.mount)

    def _nominal(self, q: Array) -> Array:
        still = Conditions.still(self.mounted.arm.n).vector
        p, R, _, _ = self._ideal.many(q, np.tile(still, (len(q), 1)))
        return poses_of(R, p)

    def refine(self, poses: Array, start: Array, conditions: Conditions, steps: int = LM_STEPS) -> Solved:
        """Levenberg and Marquardt's method from starts ``(N, n)``, each row with its own damping."""
        count, n = len(poses), self.mounted.arm.n
        R, p = poses[:, :3, :3].reshape(count, 9), poses[:, :3, 3]
        given = np.tile(conditions.vector, (count, 1))
        q, error, pressing = np.array(start, dtype=float), np.zeros((count, 6)), np.zeros((count, n))
        control = np.tile([DAMPING, GROWTH], (count, 1))
        rows = np.arange(count)
        for _ in range(0, steps, STEPS_PER_CALL):
            columns = (R[rows], p[rows], q[rows], control[rows], given[rows])
            q[rows], error[rows], pressing[rows], control[rows] = self.mounted.refine.many(*columns)
            rows = rows[(np.abs(error[rows]).max(axis=1) > WISHED) & (control[rows, 0] < GIVEN_UP)]
            if not len(rows):
                break
        return Solved(q, error, pressing)


def _where_the_arm_is(some: Wanted) -> Array:
    """The postures at hand."""
    return some.near


def _all_at(at: Array, some: Wanted) -> Array:
    """The same posture ``(n,)`` for all."""
    return np.tile(at, (len(some.poses), 1))


def _where_newton_ended(some: Wanted) -> Array:
    """The ends of Newton's method, unless they strayed: then the posture at hand."""
    far = np.abs(some.first - some.near).max(axis=1, keepdims=True)
    return np.where(far < MAX_JOINT_CHANGE, some.first, some.near)
