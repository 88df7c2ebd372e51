"""Short tours through poses by moves that are clear of obstacles."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import pairwise

import numpy as np

from clampid.planning.scene import Scene
from clampid.planning.tour import short_tour
from clampid.stages.rows import Array, Integers
from experiments.plans.errors import PlanError
from experiments.plans.limits import Limits, course_of
from experiments.plans.model import Cell, Visit
from experiments.plans.validate import visit_course

__all__ = ["ClearTours"]

FORBIDDEN_TIME = 1e4  # s: cost of a move that touches something

Ends = frozenset[tuple[float, ...]]
"""The two configurations, rad, between which a move leads, in either direction."""


class ClearTours:
    """Search for tours through configurations; results of collision checks are kept."""

    def __init__(self, cell: Cell, limits: Limits, scene: Scene) -> None:
        self.cell, self.limits, self.scene = cell, limits, scene
        self._clear_moves: dict[Ends, bool] = {}

    def order(self, q: Array, before: Array | None) -> tuple[Integers, tuple[str, ...]]:
        """A short tour through configurations by clear moves.

        Parameters
        ----------
        q
            ``(N, n)``, rad.
        before
            Configuration ``(n,)`` from which the tour starts; None: at the best of ``q``.

        Returns
        -------
        order, said
            Indices of the configurations that can be reached, in the order of the tour; a sentence for people if some
            cannot be reached.

        Raises
        ------
        PlanError
            More than half of the configurations cannot be reached by clear moves.
        """
        places = q if before is None else np.vstack([before, q])
        cost, first = self._times(places), before is not None
        kept = np.arange(len(places))
        while len(kept) > 1:
            order = kept[short_tour(cost[np.ix_(kept, kept)], 0, fixed=first)]
            legs = [(a, b) for a, b in pairwise(order.tolist()) if not self._is_clear(places[a], places[b])]
            if not legs:
                break
            stuck = [b for a, b in legs if cost[a, b] >= FORBIDDEN_TIME]  # in the tour though known to be blocked
            if stuck:
                kept = np.setdiff1d(kept, max(stuck, key=lambda k: int((cost[k] >= FORBIDDEN_TIME).sum())))
            for a, b in legs:
                cost[a, b] = cost[b, a] = FORBIDDEN_TIME
        lost = len(places) - len(kept)
        if len(kept) - first < (len(q) + 1) // 2:
            raise PlanError(
                f"expected a way through {len(q)} poses clear of floor, arm and obstacles, found none through more "
                f"than {len(kept) - first}; expected fewer obstacles or a smaller region"
            )
        said = (f"{lost} of {len(q)} poses have no clear way to them, and are left out",) if lost else ()
        return np.asarray(order[1:] - 1 if first else order), said

    def touching(self, visits: Sequence[Visit]) -> tuple[Ends, ...]:
        """The moves between consecutive visits that touch something as they are driven, with the last short moves."""
        found, before = [], None
        for visit in visits:
            knots = visit_course(visit, before).knots
            if not all(self.scene.way_clear(a, b) for a, b in pairwise(knots)):
                found.append(_ends(visit.via if before is None else before, visit.q))
            before = visit.q
        return tuple(found)

    def forbid(self, moves: Iterable[Ends]) -> None:
        """Treat some moves as touching something from now on."""
        self._clear_moves |= dict.fromkeys(moves, False)

    def _is_clear(self, a: Array, b: Array) -> bool:
        """Whether the move between two configurations ``(n,)``, rad, is clear; each move is checked once."""
        ends = _ends(a, b)
        if ends not in self._clear_moves:
            self._clear_moves[ends] = self.scene.way_clear(a, b)
        return self._clear_moves[ends]

    def _times(self, q: Array) -> Array:
        """Times ``(N, N)``, s, of the moves between configurations ``q`` ``(N, n)``, rad."""
        N = len(q)
        out = np.zeros((N, N))
        for i in range(N - 1):
            knots = np.empty((2 * (N - 1 - i), q.shape[1]))
            knots[0::2], knots[1::2] = q[i], q[i + 1 :]
            course = course_of(self.cell.robot, self.limits, knots)
            out[i, i + 1 :] = out[i + 1 :, i] = course.duration[0::2]
        return out


def _ends(a: Array, b: Array) -> Ends:
    """The key of the move between two configurations ``(n,)``, in either direction."""
    return frozenset((tuple(a.tolist()), tuple(b.tolist())))
