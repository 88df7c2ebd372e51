"""Errors of one joint's angle over groups of rows of poses, such as visits, for tests that permute them.

Where errors are permuted, they are clipped: one wrong group must not look like several large errors.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from clampid.evidence.columns import Levers
from clampid.evidence.space import Space
from clampid.fitting.noise import MAD_TO_STD
from clampid.fitting.solve import Estimate
from clampid.stages import poses
from clampid.stages.rows import Array, Integers

__all__ = ["JointErrors", "joint_levers"]

LARGEST_ERROR = 3.0  # robust standard deviations at which errors are clipped
UNSEEN = 1e-9  # of the longest lever: a group with less sees nothing of the joint's angle


@dataclass(frozen=True)
class JointErrors:
    """What V groups of rows that see a joint's angle say of its error.

    Attributes
    ----------
    group
        ``(V,)``: their numbers, ascending.
    sums
        ``(V, M)``: sums over the entries of each group, weighted by the joint's lever of unit length.
    error
        ``(V,)``: error of the angle, in robust standard deviations over the groups, clipped at :data:`LARGEST_ERROR`.
    """

    group: Integers
    sums: sparse.csr_matrix
    error: Array

    @staticmethod
    def of(space: Space, lever: Array, group: Integers) -> JointErrors:
        """Errors in a residual; ``lever``, ``group`` ``(M,)``: each entry's derivative by the angle, and its group."""
        count = int(group.max(initial=-1)) + 1
        sees = np.sqrt(np.bincount(group, lever**2, minlength=count))
        able = np.flatnonzero(sees > UNSEEN * sees.max(initial=0.0))
        member = sparse.csr_matrix((lever, (group, np.arange(len(group)))), shape=(count, len(group)))
        sums = (sparse.diags(1.0 / sees[able]) @ member[able]).tocsr()
        error = sums @ space.residual[: space.rows]
        error = error / max(MAD_TO_STD * float(np.median(np.abs(error))) if len(error) else 0.0, 1e-300)
        return JointErrors(able, sums, np.asarray(np.clip(error, -LARGEST_ERROR, LARGEST_ERROR)))


def joint_levers(estimate: Estimate) -> Levers:
    """Derivatives of a fit of poses by the joints' angles."""
    rows, chain = estimate.problem.rows, estimate.problem.chain
    evaluated = poses.evaluate(rows, chain, estimate.theta[: len(estimate.slots)])
    _, sensitivity = poses.by_station(rows, evaluated)
    return Levers.of(estimate, sensitivity[:, :, chain.offsets["joint_angle"]])
