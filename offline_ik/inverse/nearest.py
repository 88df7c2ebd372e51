"""The posture nearest to the present one, with its whole answer, by one call of the compiled kernel."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from offline_ik.cell.cell import Cell
from offline_ik.inverse.answer import Solution
from offline_ik.inverse.branches import status_and_turn
from offline_ik.inverse.kernels import locate_kernel
from offline_ik.inverse.ortho import OrthoArm
from offline_ik.inverse.postures import Direction, PostureSearch
from offline_ik.inverse.uncertainty import Propagation

__all__ = ["Nearest"]

Array = npt.NDArray[np.float64]


class Nearest:
    """Locates the nearest posture of one detector.

    Views of the kernel's memory and the place for a product are made once: a request does little else than to
    call the kernel and to multiply by the covariance.

    Parameters
    ----------
    ortho
        The arm's closed form.
    search, propagation, cell
        Of the same detector.
    """

    def __init__(self, ortho: OrthoArm, search: PostureSearch, propagation: Propagation, cell: Cell) -> None:
        solver, covariance = search.solver, propagation.covariance
        uncertain = np.asarray(covariance.any(axis=0))
        nothing = np.zeros(0, dtype=np.int64)
        doubted = nothing if propagation.outside is None else propagation.outside.empirical.parameter
        uncertain[doubted] = True
        kernel, counting = locate_kernel(
            solver.arm, ortho, solver.mount, search.lower, search.upper, cell.convention, propagation.mount, uncertain
        )
        n = solver.arm.n
        self.ortho, self.search, self.propagation, self.n = ortho, search, propagation, n
        self.linkage = None if (solver.linkage == np.eye(n)).all() else solver.linkage
        self.kernel, self.covariance = kernel, np.ascontiguousarray(covariance[np.ix_(counting, counting)])
        self.jacobian, self.half = kernel.out[1].reshape(6, -1), kernel.out[2].reshape(n, 6)
        self.product = np.zeros((6, len(counting)))
        self.counted = np.isin(doubted, counting)
        self.doubted = np.searchsorted(counting, doubted[self.counted])

    def locate(
        self, asked: tuple[float, float, float, float], here: Array, direction: Direction, still: Array
    ) -> tuple[Array, Solution] | None:
        """Target ``(4, 4)`` in the convention's frame and its solution; None if a search is needed.

        Parameters
        ----------
        asked
            gamma, delta, r, roll.
        here
            ``(n,)``, rad.
        still
            The conditions as a vector ``(3 n + 1,)``; the directions in it hold where ``direction`` is None.
        """
        kernel, n = self.kernel, self.n
        row = kernel.row
        row[:5] = (*asked, isinstance(direction, str))
        row[5 : 5 + n] = here
        row[5 + n :] = still
        if direction is not None and not isinstance(direction, str):
            row[5 + n : 5 + 2 * n] = np.sign(direction)
        kernel.trigger()
        first = kernel.out[0].copy()
        *_, position_error, angle_error, branch, wrist, shoulder, elbow, moved = said = first.tolist()
        if branch < 0:
            return None
        q, approach = first[16 : 16 + n], slice(16 + 2 * n, 16 + 3 * n)
        chain = q if self.linkage is None else np.asarray(self.linkage @ q)
        model = np.dot(np.dot(self.jacobian, self.covariance, out=self.product), self.jacobian.T)
        half = self.half if 0.0 in said[approach] else None
        return first[:16].reshape(4, 4), Solution(
            q,
            first[16 + n : 16 + 2 * n],
            position_error,
            angle_error,
            self.propagation.combined(model, half),
            asked[3],
            self.search.names(wrist, elbow, -shoulder),
            *status_and_turn(self.ortho, chain, int(branch)),
            moved,
            first[approach],
        )

    def by_doubted(self) -> Array:
        """``(6, E)``: how the pose last located depends on the amplitudes of empirical effects; axes of its answer."""
        out = np.zeros((6, len(self.counted)))
        out[:, self.counted] = self.jacobian[:, self.doubted]
        return out
