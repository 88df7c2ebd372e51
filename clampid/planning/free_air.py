"""Plans of free-air logs: a path at several speeds that carries most information on gravity and friction for its time.

Information comes from the moves, so the gain of a configuration depends on the one before it. The path is extended stop
by stop, each time by the candidate with the largest gain of log-determinant per second. Then stops are exchanged for
others while the determinant grows.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from clampid.catalogue import catalogue
from clampid.planning.choose import log_det
from clampid.planning.expected import prior_precision
from clampid.planning.logs import LogBench, TorqueNoise
from clampid.planning.program import LogWishes, plan_of_runs
from clampid.planning.sampling import configurations
from clampid.planning.scene import Scene
from clampid.stages.rows import Array
from clampid.standard_sets import STANDARD
from clampid.threads import single_threaded
from experiments.plans.errors import PlanError
from experiments.plans.limits import Limits, course_of
from experiments.plans.model import Cell, Plan, Run
from experiments.plans.motion import Course

__all__ = ["plan_free_air"]

CANDIDATE_STOPS = 400
STOPS_TRIED = 16  # candidates evaluated for each further stop
EXCHANGES_TRIED = 4  # candidates evaluated in an exchange
EXCHANGE_PASSES = 1
MIN_STOPS = 4


@single_threaded
def plan_free_air(
    cell: Cell,
    limits: Limits,
    noise: TorqueNoise,
    wished: LogWishes | None = None,
    *,
    scene: Scene | None = None,
    assumed: Sequence[str] = (),
) -> Plan:
    """Plan a free-air campaign.

    Parameters
    ----------
    cell, limits, noise
        The cell, its limits, and the noise of the torques.
    wished
        Time, speeds, effects and rate that are wanted.
    scene
        Obstacles; by default the floor only.
    assumed
        Assumptions made so far, in words, for the plan.

    Raises
    ------
    PlanError
        A number is out of range, the time is too short, or the limits allow no move.
    EffectError
        An effect is unknown.
    """
    wished = wished or LogWishes()
    wished.check()
    effects = STANDARD["free_air"] if wished.effects is None else wished.effects
    around = scene or Scene.floor_only(cell)
    bench = LogBench(cell, catalogue(), effects, noise, wished.rate)
    pool = configurations(limits, CANDIDATE_STOPS, around.clear, wished.seed, why="clear of floor and obstacles")
    search = _Search(cell, limits, bench, around, pool, wished)
    search.grow()
    search.improve()
    runs = tuple(Run(course, share) for course, share in zip(search.courses(search.knots), wished.speeds, strict=True))
    record = wished.record(effects)
    return plan_of_runs("free_air", limits, bench, runs, record, assumed=(*assumed, *around.assumed))


class _Search:
    """Search for the path; all its runs go through the same stops."""

    def __init__(
        self, cell: Cell, limits: Limits, bench: LogBench, scene: Scene, pool: Array, wished: LogWishes
    ) -> None:
        self.cell, self.limits, self.bench, self.scene = cell, limits, bench, scene
        self.pool, self.speeds, self.dwell, self.budget = pool, tuple(wished.speeds), wished.dwell, wished.time
        self.rng = np.random.default_rng(wished.seed)
        middle = (limits.lower + limits.upper) / 2
        self.knots: list[Array] = [pool[int(np.argmin(np.linalg.norm(pool - middle, axis=1)))]]
        size = bench.size
        self.information: Array = prior_precision(bench.problem) * np.outer(size, size)
        self.moves: list[Array] = []  # information of each move, scaled
        self.spent = len(self.speeds) * self.dwell

    def courses(self, knots: Sequence[Array]) -> list[Course]:
        """The path through stops ``knots`` ``(n,)``, rad, as a course for each speed."""
        return [
            course_of(self.cell.robot, self.limits, np.array(knots), speed_share=s, dwell=self.dwell)
            for s in self.speeds
        ]

    def _evaluate(self, paths: Sequence[Sequence[Array]]) -> tuple[list[Array], Array]:
        """For each path the scaled information of its moves at all speeds ``(moves, P, P)``, and the time, s."""
        courses = [course for path in paths for course in self.courses(path)]
        informations = self.bench.evaluate(courses)
        size, many = self.bench.size, len(self.speeds)
        out, cost = [], np.zeros(len(paths))
        for p in range(len(paths)):
            mine = slice(p * many, (p + 1) * many)
            out.append(np.sum([t.information for t in informations[mine]], axis=0) * np.outer(size, size))
            cost[p] = sum(c.length - self.dwell for c in courses[mine])  # the first stop is the last one's
        return out, cost

    def _reachable_stops(self, count: int, *neighbours: Array) -> list[Array]:
        """Up to ``count`` random candidates with clear moves to all neighbours ``(n,)``, rad."""
        found = []
        for k in self.rng.permutation(len(self.pool)):
            q = self.pool[k]
            if any(np.array_equal(q, knot) for knot in self.knots):
                continue
            if all(self.scene.way_clear(q, other) for other in neighbours):
                found.append(q)
                if len(found) == count:
                    break
        return found

    def grow(self) -> None:
        """Add stops while there is time.

        Raises
        ------
        PlanError
            There is time for too few stops.
        """
        while True:
            options = self._reachable_stops(STOPS_TRIED, self.knots[-1])
            if not options:
                break
            informations, cost = self._evaluate([[self.knots[-1], q] for q in options])
            fits = cost <= self.budget - self.spent
            if not fits.any():
                break
            base = log_det(self.information)
            gain = np.array(
                [
                    log_det(self.information + t[0]) - base if ok else -np.inf
                    for t, ok in zip(informations, fits, strict=True)
                ]
            )
            best = int(np.argmax(np.where(fits, gain / cost, -np.inf)))
            self.knots.append(options[best])
            self.moves.append(informations[best][0])
            self.information = self.information + informations[best][0]
            self.spent += float(cost[best])
        if len(self.knots) < MIN_STOPS:
            raise PlanError(
                f"time: expected enough for at least {MIN_STOPS} stops at {len(self.speeds)} speeds, found "
                f"{self.budget:g} s, which is enough for {len(self.knots)}"
            )

    def improve(self) -> None:
        """Exchange stops for others while the determinant grows, within the time budget."""
        for _ in range(EXCHANGE_PASSES):
            moved = False
            for k in range(1, len(self.knots)):
                moved |= self._exchange(k)
            if not moved:
                break

    def _exchange(self, k: int) -> bool:
        """Exchange stop ``k`` for the best of a few candidates; whether it was exchanged."""
        before = self.knots[k - 1]
        after = self.knots[k + 1 : k + 2]
        options = self._reachable_stops(EXCHANGES_TRIED, before, *after)
        if not options:
            return False
        informations, cost = self._evaluate([[before, q, *after] for q in (self.knots[k], *options)])
        old = informations[0].sum(axis=0)
        value = np.array([log_det(self.information - old + t.sum(axis=0)) for t in informations])
        value[cost - cost[0] > self.budget - self.spent] = -np.inf
        best = int(np.argmax(value))
        if best == 0 or value[best] <= value[0] + 1e-9:
            return False
        self.information = self.information - old + informations[best].sum(axis=0)
        self.moves[k - 1 : k + 1] = list(informations[best])
        self.spent += float(cost[best] - cost[0])
        self.knots[k] = options[best - 1]
        return True
