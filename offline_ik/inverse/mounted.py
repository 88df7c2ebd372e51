"""An identified arm with one frame mounted on its flange, and the compiled kernels of the two."""

from __future__ import annotations

from functools import cached_property

import numpy as np
import numpy.typing as npt

from kinematics.screws import log_so3
from offline_ik.arm.identified import Conditions, IdentifiedArm
from offline_ik.arm.kernel import Kernel
from offline_ik.inverse.kernels import (
    branch_kernel,
    forward_kernel,
    refine_kernel,
    sensitivity_kernel,
    solve_kernel,
    whole_kernel,
)
from offline_ik.inverse.ortho import BRANCHES, OrthoArm, ortho_arm, signs_of

__all__ = ["MountedArm", "poses_of", "wrapped"]

Array = npt.NDArray[np.float64]

STEPS_PER_CALL = 8  # of a search, in one call of its kernel


class MountedArm:
    """Kernels of one arm with one frame mounted on its flange, each compiled when it is first needed.

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

    @cached_property
    def forward(self) -> Kernel:
        """Rows (q, conditions) to the detector in the calibrated base's frame."""
        return forward_kernel(self.arm, self.mount)

    @cached_property
    def whole(self) -> Kernel:
        """See :func:`whole_kernel`."""
        return whole_kernel(self.arm, self.mount)

    @cached_property
    def newton(self) -> Kernel:
        """See :func:`solve_kernel`."""
        return solve_kernel(self.arm, self.ortho, self.mount)

    @cached_property
    def refine(self) -> Kernel:
        """See :func:`refine_kernel`."""
        return refine_kernel(self.arm, self.mount, STEPS_PER_CALL)

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
        """Residual ``(6,)`` to a pose ``(4, 4)`` at ``q`` ``(n,)``: position m, rotation vector rad."""
        p, R, _, _ = self.forward.one(np.concatenate([q, conditions.vector]))
        return np.concatenate([pose[:3, 3] - p, log_so3(pose[:3, :3] @ R.reshape(3, 3).T)])

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

    def signs(self, q: Array) -> Array:
        """The branches ``(N, 3)`` that postures ``(N, n)`` are on; ones for an arm without analytic solution."""
        q = np.atleast_2d(q)
        return np.ones((len(q), 3)) if self.ortho is None else signs_of(self.ortho, q @ self.linkage.T)


def poses_of(R: Array, p: Array) -> Array:
    """Poses ``(N, 4, 4)`` of rotations by rows ``(N, 9)`` and positions ``(N, 3)``, m."""
    out = np.zeros((len(p), 4, 4))
    out[:, :3, :3], out[:, :3, 3], out[:, 3, 3] = R.reshape(-1, 3, 3), p, 1.0
    return out


def wrapped(angle: Array) -> Array:
    """The same angles within ±pi, rad."""
    return np.asarray(angle - 2 * np.pi * np.floor(angle / (2 * np.pi) + 0.5))
