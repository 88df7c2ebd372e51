"""Inverse kinematics on the identified arm, for one pose or a million.

The analytic posture of the nominal arm starts Newton's method on the identified one (:mod:`offline_ik.kernels`). What
that leaves (the wrist singular, the arm stretched, a triangle that the nominal arm cannot close and the real one can)
goes to Levenberg and Marquardt's method from several starts. Source of the damping: Nielsen (1999), Damping parameter
in Marquardt's method.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np
import numpy.typing as npt

from offline_ik.arm import Conditions, IdentifiedArm
from offline_ik.kernels import CONVERGED, Kernel, branch_kernel, forward_kernel, sensitivity_kernel, solve_kernel
from offline_ik.ortho import BRANCHES, OrthoArm, ortho_arm, signs_of
from offline_ik.search import Search, Solved, poses_of, wrapped

__all__ = ["CONVERGED", "NEARLY", "Solved", "Solver"]

Array = npt.NDArray[np.float64]

NEARLY = 0.02  # m by which the nominal arm may fall short and the real one still be tried
MANY = 64  # poses, for which a kernel of its own is worth compiling
FURTHER = 3  # chords of that kernel
ROUNDS = 3  # of it: each leaves a tenth of its poses


class Solver:
    """Kernels of one arm with one frame mounted on its flange.

    Parameters
    ----------
    mount
        ``(4, 4)``: the detector in the flange's frame.
    """

    def __init__(self, arm: IdentifiedArm, mount: Array) -> None:
        self.arm, self.mount = arm, np.asarray(mount, dtype=float)
        self.ortho: OrthoArm | None = ortho_arm(arm.robot)
        self.linkage = np.asarray(arm.robot.linkage)
        self.unlinked = np.linalg.inv(self.linkage)
        self.search = Search(self)

    @cached_property
    def forward(self) -> Kernel:
        """Rows (q, conditions) to the detector in the calibrated base's frame."""
        return forward_kernel(self.arm, self.mount)

    @cached_property
    def newton(self) -> Kernel:
        """See :func:`solve_kernel`."""
        return solve_kernel(self.arm, self.ortho, self.mount)

    @cached_property
    def further(self) -> Kernel:
        """The same from a given posture, whatever its branch."""
        return solve_kernel(self.arm, None, self.mount, FURTHER)

    @cached_property
    def sensitivity(self) -> Kernel:
        """See :func:`sensitivity_kernel`."""
        return sensitivity_kernel(self.arm, self.mount)

    @cached_property
    def analytic(self) -> Kernel | None:
        """See :func:`branch_kernel`."""
        return None if self.ortho is None else branch_kernel(self.ortho)

    def pose(self, q: Array, conditions: Conditions) -> Array:
        """Poses ``(N, 4, 4)`` of the detector in the calibrated base's frame at ``q`` ``(N, n)``."""
        q = np.atleast_2d(q)
        p, R, _, _ = self.forward.many(q, np.tile(conditions.vector, (len(q), 1)))
        return poses_of(R, p)

    def residual(self, pose: Array, q: Array, conditions: Conditions) -> Array:
        """What is left ``(6,)`` to a pose ``(4, 4)`` at ``q`` ``(n,)``: position m, rotation vector rad."""
        return np.asarray(self.search.errors(pose[None], q[None], conditions.vector[None], False)[0][0])

    def branches(self, poses: Array, near: Array | None = None) -> tuple[Array, Array]:
        """Analytic postures of the nominal arm.

        Parameters
        ----------
        poses
            ``(N, 4, 4)`` of the detector in the base frame.
        near
            ``(n,)``: decides joint 4 where the wrist is singular, and the turns.

        Returns
        -------
        q
            ``(N, 8, n)``, rad.
        quality
            ``(N, 8, 3)``: lack of the shoulder's and the elbow's triangle (m), |sin| of the wrist's angle.

        Raises
        ------
        ValueError
            The arm has no analytic solution.
        """
        if self.analytic is None:
            raise ValueError(f"{self.arm.robot.name} is no ortho-parallel arm with a spherical wrist")
        flange = poses @ np.linalg.inv(self.mount)
        near = np.zeros(self.arm.n) if near is None else np.asarray(near)
        chain_near = self.linkage @ near
        q4 = np.full((len(poses), 1), chain_near[3])
        flat, quality = self.analytic.many(flange[:, :3, :3].reshape(-1, 9), flange[:, :3, 3], q4)
        chain = flat.reshape(-1, BRANCHES, 6)
        chain = chain_near + wrapped(chain - chain_near)
        return chain @ self.unlinked.T, quality.reshape(-1, BRANCHES, 3)

    def solve(self, poses: Array, near: Array, signs: Array, conditions: Conditions) -> Solved:
        """Solutions on the identified arm, one per pose, on given branches.

        Parameters
        ----------
        poses
            ``(N, 4, 4)`` of the detector in the calibrated base's frame.
        near
            ``(N, n)``: decides the turns, and where the wrist is singular joint 4; the start of an arm without an
            analytic solution.
        signs
            ``(N, 3)``: see :data:`offline_ik.ortho.SIGNS`.
        """
        count = len(poses)
        R, p = poses[:, :3, :3].reshape(count, 9), poses[:, :3, 3]
        given = np.tile(conditions.vector, (count, 1))
        q, error, pressing = self.newton.many(R, p, near, signs, given)
        # The kernel's error is exact only for small rotations: what it calls solved it must have solved nearly.
        left = ~(np.abs(error).max(axis=1) <= 0.1 * CONVERGED)
        if left.sum() >= MANY:  # most of them only want a few steps more
            at = q.copy()  # a search that follows starts from the first end, not from where these stray
            for _ in range(ROUNDS):
                rows = np.flatnonzero(left)
                if not len(rows):
                    break
                further = self.further.many(R[rows], p[rows], at[rows], signs[rows], given[rows])
                ok = np.abs(further[1]).max(axis=1) <= 0.1 * CONVERGED
                ok &= np.abs(further[0] - near[rows]).max(axis=1) < np.pi + 0.1
                at[rows] = further[0]
                q[rows[ok]], error[rows[ok]], pressing[rows[ok]] = (v[ok] for v in further)
                left[rows[ok]] = False
        if left.any():
            rows = np.flatnonzero(left)
            again = self.search.solve(poses[rows], near[rows], signs[rows], conditions, q[rows])
            q[rows], error[rows], pressing[rows] = again.q, again.error, again.pressing
        return Solved(q, error, pressing)

    def signs(self, q: Array) -> Array:
        """The branches ``(N, 3)`` that postures ``(N, n)`` are on; ones for an arm without analytic solution."""
        q = np.atleast_2d(q)
        return np.ones((len(q), 3)) if self.ortho is None else signs_of(self.ortho, q @ self.linkage.T)
