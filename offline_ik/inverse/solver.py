"""Inverse kinematics on the identified arm, for one pose or a million.

The analytic posture of the nominal arm starts Newton's method on the identified one (`inverse.kernels`). What
that leaves (the wrist singular, the arm stretched, a triangle that the nominal arm cannot close and the real one can)
goes to Levenberg and Marquardt's method from several starts (:mod:`offline_ik.inverse.search`).
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from offline_ik.arm.identified import Conditions, IdentifiedArm
from offline_ik.arm.iterations import CONVERGED
from offline_ik.inverse.mounted import MountedArm
from offline_ik.inverse.search import Search, Solved, Wanted

__all__ = ["CONVERGED", "NEARLY", "Solved", "Solver"]

Array = npt.NDArray[np.float64]

NEARLY = 0.02  # m by which the nominal arm may fall short and the real one still be tried


class Solver(MountedArm):
    """Inverse kinematics of one arm with one frame mounted on its flange; parameters as for :class:`MountedArm`."""

    def __init__(self, arm: IdentifiedArm, mount: Array) -> None:
        super().__init__(arm, mount)
        self.search = Search(self)

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
            ``(N, 3)``: see :data:`offline_ik.inverse.ortho.SIGNS`.
        """
        count = len(poses)
        R, p = poses[:, :3, :3].reshape(count, 9), poses[:, :3, 3]
        given = np.tile(conditions.vector, (count, 1))
        q, error, pressing = self.newton.many(R, p, near, signs, given)
        # The kernel's error is exact only for small rotations: what it calls solved it must have solved nearly.
        left = ~(np.abs(error).max(axis=1) <= 0.1 * CONVERGED)
        rows = np.flatnonzero(left)
        found = Solved(q, error, pressing)
        if len(rows):
            wanted = Wanted(poses, near, signs, q, conditions).of(rows)
            found.put(rows, self.search.solve(wanted), np.ones(len(rows), dtype=bool))
        return found
