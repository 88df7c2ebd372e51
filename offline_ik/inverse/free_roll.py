"""The roll about the detector's normal that moves the joints least, where the roll is free.

Least is the effort: the largest joint move from the posture at hand, and a tenth of the root of the sum of squares of
all moves. The latter decides where the largest move is the same for many rolls: a detector square on axis 6 turns that
joint alone. All postures count that the limits and the asked branch allow. Along the roll the effort is, branch by
branch, a continuous function with kinks and gaps. All branches have closed forms: a grid finds the valleys, narrow gaps
between limits included, since beyond a limit the function goes on with how far beyond. Each valley is then narrowed
down, and those that come near the best once more on the identified arm. There the effort jumps by the joints' play
where one changes its flank: so far, and no further, another roll may be better.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from offline_ik.arm.iterations import CONVERGED
from offline_ik.cell.coordinates import detector_pose
from offline_ik.inverse.branches import Choice
from offline_ik.inverse.ortho import SIGNS
from offline_ik.inverse.postures import ROLLS, Direction, directions_of

if TYPE_CHECKING:
    from offline_ik.inverse.detector import Detector

__all__ = ["effort", "rolls_to_try"]

Array = npt.NDArray[np.float64]

FIRST_ROLLS = 96  # rolls at first: a valley is as wide as a joint's turn, most of a radian
VALLEYS = 6
POINTS, ROUNDS = 9, 9  # each round narrows to a quarter
ROLLS_AROUND = (
    0.2,
    0.01,
)  # rad: the best roll of a calibrated arm is not the nominal one's, the more so the less the roll matters
SAME_EFFORT_WITHIN = 0.05
"""rad: of the effort, and beyond a limit, the same for all joints together and singular wrists."""
ALL_MOVES = 0.1
BARRED = 100.0  # more than any joint moves, rad: beyond a limit or out of reach
NOT_ASKED = 1000.0  # of a branch that was not asked for
SAME_TURN = 1e-12  # of a turn


def effort(q: Array, here: Array) -> Array:
    """How much joints move from ``here`` ``(n,)`` to ``q`` ``(..., n)``, rad ``(...)``."""
    moves = q - here
    return np.asarray(np.abs(moves).max(axis=-1) + ALL_MOVES * np.sqrt(np.sum(moves * moves, axis=-1)))


def rolls_to_try(
    detector: Detector, place: tuple[float, float, float], here: Array, choice: Choice, direction: Direction
) -> Iterator[float]:
    """Rolls, rad from -pi to pi, the best first, until one leads to a posture.

    Parameters
    ----------
    place
        gamma, delta, r.
    here
        ``(n,)``: the posture at hand, rad.
    """
    along = _Along(detector, place, here, choice, direction)
    grid = _grid(ROLLS)
    if detector.solver.analytic is None:
        best = along.from_here(grid)
        if best is not None:
            yield best
        yield from grid.tolist()
        return
    yield from along.best()
    # The identified arm may reach what the nominal arm just misses.
    yield from (float(grid[k]) for k in detector.search.order(along.bases(grid), here))


@dataclass(frozen=True, eq=False)
class _Along:
    """Postures along the roll at one place; parameters as for :func:`rolls_to_try`."""

    detector: Detector
    place: tuple[float, float, float]
    here: Array
    choice: Choice
    direction: Direction

    def bases(self, rolls: Array) -> Array:
        """Poses ``(N, 4, 4)`` in the base's frame."""
        return self.detector.to_base(detector_pose(self.detector.cell.convention, *self.place, rolls))

    def nominal(self, rolls: Array) -> tuple[Array, Array]:
        """Postures ``(N, 8, n)`` of the nominal arm, in the turns nearest to the one at hand, and costs ``(N, 8)``.

        The cost is the effort; beyond limits or reach it is how far beyond, on top of :data:`BARRED`.
        """
        detector, whole = self.detector, 2 * np.pi
        q, quality = detector.solver.branches(self.bases(rolls), self.here)
        bounded = np.isfinite(detector.lower) & np.isfinite(detector.upper)
        lower, upper = np.where(bounded, detector.lower, -1e9), np.where(bounded, detector.upper, 1e9)
        first, last = np.ceil((lower - q) / whole - SAME_TURN), np.floor((upper - q) / whole + SAME_TURN)
        fits = first <= last
        beyond = np.minimum(lower - q - whole * last, q + whole * first - upper)
        q = q + whole * np.where(fits, np.clip(0.0, first, last), 0.0)
        lacks = np.maximum(np.where(fits, 0.0, beyond).max(axis=2), quality[..., :2].max(axis=2))
        cost = np.where(lacks <= 0, effort(q, self.here), BARRED + lacks)
        if self.choice.kind not in ("nearest", "all"):
            for k, b in zip(*np.nonzero(cost < BARRED), strict=True):
                if not self._allowed(q[k, b]):
                    cost[k, b] = NOT_ASKED
        return q, cost

    def valleys(self) -> list[tuple[float, float, int]]:
        """Cost, roll and branch of the nominal arm's best postures, one a valley, the best first."""
        step = 2 * np.pi / FIRST_ROLLS
        grid = _grid(FIRST_ROLLS)
        _, cost = self.nominal(grid)
        before, after = np.roll(cost, 1, axis=0), np.roll(cost, -1, axis=0)
        low = (cost <= before) & (cost <= after) & (cost < NOT_ASKED)
        # Where a limit or another branch bars one side, a valley may end between two rolls of the grid.
        edge = (cost < BARRED) & (np.maximum(before, after) >= BARRED)
        rows, branches = np.nonzero(low | edge)
        best = np.argsort(cost[rows, branches], kind="stable")[:VALLEYS]
        rows, branches = rows[best], branches[best]

        def of_branch(rolls: Array) -> Array:
            costs = self.nominal(rolls.ravel())[1].reshape(*rolls.shape, -1)
            return np.asarray(np.take_along_axis(costs, branches[:, None, None], axis=2)[:, :, 0])

        rolls, costs = _narrowed(of_branch, grid[rows], np.full(len(rows), step))
        order = np.argsort(costs, kind="stable").tolist()
        return [(float(costs[k]), float(rolls[k]), int(branches[k])) for k in order]

    def best(self) -> list[float]:
        """The best rolls of the identified arm, one a valley, the best first."""
        valleys = self.valleys()
        least = valleys[0][0] if valleys else BARRED
        near = [
            v for v in valleys if v[0] <= least + SAME_EFFORT_WITHIN or BARRED <= v[0] <= BARRED + SAME_EFFORT_WITHIN
        ]
        found = sorted(self.on_identified(roll, branch) for _, roll, branch in near)
        others = [roll for cost, roll, _ in valleys if least + SAME_EFFORT_WITHIN < cost < BARRED]
        return [roll for cost, roll in found if math.isfinite(cost)] + others

    def on_identified(self, roll: float, branch: int) -> tuple[float, float]:
        """The least effort of the identified arm near the nominal one's best roll, and at which roll."""
        start = self.nominal(np.array([roll]))[0][0, branch]

        def costs(rolls: Array) -> Array:
            return self.identified(rolls.ravel(), start, SIGNS[branch])[1].reshape(rolls.shape)

        rolls, found = _narrowed(costs, np.full(len(ROLLS_AROUND), roll), np.array(ROLLS_AROUND))
        k = int(np.argmin(found))
        return float(found[k]), _wrapped(float(rolls[k]))

    def from_here(self, grid: Array) -> float | None:
        """The best roll by postures searched for from the one at hand; None if there is none."""
        q, cost = self.identified(grid, self.here, np.ones(3), search=True)
        k = int(np.argmin(cost))
        if not math.isfinite(cost[k]):
            return None

        def costs(rolls: Array) -> Array:
            return self.identified(rolls.ravel(), q[k], np.ones(3))[1].reshape(rolls.shape)

        return _wrapped(float(_narrowed(costs, grid[k : k + 1], grid[1:2] - grid[:1])[0][0]))

    def identified(self, rolls: Array, start: Array, signs: Array, search: bool = False) -> tuple[Array, Array]:
        """Postures ``(N, n)`` of the identified arm near one, and costs ``(N,)``, infinite where there is none.

        Without a search by Newton's method alone: where that fails, a valley ends.
        """
        detector, count = self.detector, len(rolls)
        conditions = replace(detector.still, direction=directions_of(self.direction, start, self.here))
        bases, starts, branch = self.bases(rolls), np.tile(start, (count, 1)), np.tile(signs, (count, 1))
        if search:
            solved = detector.solver.solve(bases, starts, branch, conditions)
            q, reached = solved.q, solved.reached
        else:
            R, p, given = bases[:, :3, :3].reshape(count, 9), bases[:, :3, 3], np.tile(conditions.vector, (count, 1))
            q, error, _ = detector.solver.newton.many(R, p, starts, branch, given)
            reached = np.abs(error).max(axis=1) <= CONVERGED
        kept = reached & ((q >= detector.lower) & (q <= detector.upper)).all(axis=1)
        cost = np.where(kept, effort(q, self.here), np.inf)
        for k in np.flatnonzero(kept & (self.choice.kind not in ("nearest", "all"))).tolist():
            cost[k] = cost[k] if self._allowed(q[k]) else np.inf
        return q, cost

    def _allowed(self, q: Array) -> bool:
        return self.choice.allows(self.detector.solver.ortho, self.detector.solver.linkage @ q)


def _narrowed(cost: Callable[[Array], Array], middle: Array, half: Array) -> tuple[Array, Array]:
    """The lowest places ``(V,)`` within ``half`` of given ones, and their costs: each round a quarter as wide."""
    at = np.linspace(-1.0, 1.0, POINTS)
    best, found, rows = middle.copy(), np.full(len(middle), np.inf), np.arange(len(middle))
    for _ in range(ROUNDS if len(middle) else 0):
        rolls = best[:, None] + half[:, None] * at
        costs = cost(rolls)
        k = np.argmin(costs, axis=1)
        better = costs[rows, k] < found
        best, found = np.where(better, rolls[rows, k], best), np.where(better, costs[rows, k], found)
        half = half * (2.0 / (POINTS - 1))
    return best, found


def _grid(count: int) -> Array:
    return np.asarray(np.arange(count) * (2 * np.pi / count) - np.pi, dtype=np.float64)


def _wrapped(roll: float) -> float:
    return (roll + math.pi) % (2 * math.pi) - math.pi
