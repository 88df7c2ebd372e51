"""Plans of poses to measure: visible, informative, with balanced approach directions, in a short tour.

Candidates are configurations in the region, in sight of the instrument and clear of obstacles. Some poses are chosen
far apart in joint space, so that effects outside the wanted set become visible. The others maximise the determinant of
the information (D-optimal). Every pose is approached by a short move. The signs of these moves are balanced, so that
backlash is not confounded with posture.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Literal

import numpy as np

from clampid.planning.choose import choose
from clampid.planning.clear_tours import ClearTours
from clampid.planning.directions import balanced, covariates_of
from clampid.planning.expected import expected_of
from clampid.planning.pose_bench import PoseBench
from clampid.planning.reach import reaching
from clampid.planning.region import Region, SpherePart
from clampid.planning.sampling import DIGITS, configurations, far_apart
from clampid.planning.scene import Scene
from clampid.planning.sight import Sight
from clampid.stages.rows import Array, Bools, Integers
from clampid.threads import single_threaded
from experiments.plans.errors import PlanError
from experiments.plans.limits import Limits, course_of
from experiments.plans.model import Cell, Plan, Visit
from experiments.plans.validate import validate_plan

__all__ = ["PoseWishes", "plan_poses"]


MAX_POSES = 5000  # half a day at 10 s each; their candidates take a gigabyte
CANDIDATES_PER_POSE = 20
MIN_CANDIDATES = 200
SIGNS_TRIED = 32  # patterns of approach signs tried for each pose
IK_STARTS = 80  # configurations from which the inverse kinematics of each verification place is started
MAX_TOURS = 50  # tours tried until every move, with the approaches, is clear
REPLICATE_SIGNS = (-1.0, 1.0, -1.0)  # further visits of a replicate: from the opposite side, the same, the opposite


@dataclass(frozen=True)
class PoseWishes:
    """The wishes for a plan of poses.

    Attributes
    ----------
    poses
        Number of poses to fit.
    replicates
        Number of these that are visited three times more, twice from the opposite side.
    verification
        Number of further poses for verification only.
    effects
        Effects to identify; None: the standard set of the stage.
    region
        Region of all tracked points; None: anywhere.
    sight
        Line of sight of the instrument; None: it sees everything.
    part
        Part of a sphere with the verification poses, the flange's z axis towards its centre; None: like the others.
    spread
        Share of the poses chosen to be far apart in joint space.
    approach
        Angle (travel) of every joint in the last move to a pose, rad (m).
    measure_time
        Time for each tracked point, s.
    """

    poses: int = 60
    replicates: int = 6
    verification: int = 20
    effects: tuple[str, ...] | None = None
    region: Region | None = None
    sight: Sight | None = None
    part: SpherePart | None = None
    spread: float = 0.2
    approach: float = 0.05
    measure_time: float = 3.0


@single_threaded
def plan_poses(
    cell: Cell,
    limits: Limits,
    wishes: PoseWishes | None = None,
    *,
    scene: Scene | None = None,
    seed: int = 0,
    assumed: Sequence[str] = (),
) -> Plan:
    """Plan a campaign of poses.

    Parameters
    ----------
    cell, limits
        The cell and its limits.
    wishes
        Which poses are wanted.
    scene
        Obstacles to the arm and to the line of sight; by default the floor only.
    seed
        Seed of the candidates.
    assumed
        Assumptions made so far, in words, for the plan.

    Raises
    ------
    PlanError
        A number is out of range, or region, sight and scene leave too few configurations.
    EffectError
        An effect is unknown or does not act in poses.
    """
    wanted = wishes or PoseWishes()
    _check(wanted)
    return _Search(cell, limits, wanted, scene or Scene.floor_only(cell), seed).plan(tuple(assumed))


def _check(wishes: PoseWishes) -> None:
    """Raise :class:`PlanError` for numbers that no plan can have."""
    for name, value, least in (
        ("poses", wishes.poses, 2),
        ("replicates", wishes.replicates, 0),
        ("verification poses", wishes.verification, 0),
    ):
        if not least <= value <= MAX_POSES:
            raise PlanError(f"{name}: expected {least} to {MAX_POSES}, found {value}")
    if wishes.replicates > wishes.poses:
        raise PlanError(f"replicates: expected at most the {wishes.poses} poses, found {wishes.replicates}")
    if not 0.0 <= wishes.spread <= 1.0:
        raise PlanError(f"spread: expected a share from 0 to 1, found {wishes.spread:g}")
    if not 0.0 < wishes.approach < 1.0:
        raise PlanError(f"approach: expected rad above 0 and below 1, found {wishes.approach:g}")
    if not wishes.measure_time >= 0.0:
        raise PlanError(f"measuring time: expected seconds from 0, found {wishes.measure_time:g}")


class _Search:
    """Search for poses, then for their order and their approaches."""

    def __init__(self, cell: Cell, limits: Limits, wishes: PoseWishes, scene: Scene, seed: int) -> None:
        self.cell, self.limits, self.wishes, self.scene, self.seed = cell, limits, wishes, scene, seed
        self.rng = np.random.default_rng(seed)
        station = np.zeros(3) if wishes.sight is None else wishes.sight.station
        self.said: tuple[str, ...] = ()
        self.tours = ClearTours(cell, limits, scene)
        self.bench = PoseBench(cell, wishes.effects, station)
        margin = 1.5 * wishes.approach  # leaves room to approach every pose from either side
        # One turn of a joint that can turn more than once is as informative as all, and the moves are shorter.
        turning = np.linalg.norm(np.asarray(cell.robot.screws)[:, :3], axis=1) > 0
        middle = (limits.lower + limits.upper) / 2
        half = np.where(turning, np.minimum((limits.upper - limits.lower) / 2, np.pi), np.inf)
        self.inner = replace(
            limits,
            lower=np.maximum(limits.lower, middle - half) + margin,
            upper=np.minimum(limits.upper, middle + half) - margin,
        )
        if np.any(self.inner.lower >= self.inner.upper):
            j = int(np.argmax(self.inner.lower >= self.inner.upper))
            raise PlanError(f"approach: joint {j + 1} has no room to be approached from both sides by {margin:g} rad")

    def plan(self, assumed: tuple[str, ...]) -> Plan:
        """The plan; tours are searched until every move, with the approaches, is clear."""
        pool = self._pool()
        picked = self._choose(pool)
        for _ in range(MAX_TOURS):
            visits, words = self._ordered(pool, picked)
            touching = self.tours.touching(visits)
            if not touching:
                return self._finished(visits, (*assumed, *self.scene.assumed, *words))
            self.tours.forbid(touching)
        raise PlanError(
            f"expected moves clear of floor, arm and obstacles by way of the approaches, found none in {MAX_TOURS} "
            "orders of the poses; expected fewer obstacles or a shorter approach"
        )

    def _ordered(self, pool: Array, picked: list[int]) -> tuple[list[Visit], tuple[str, ...]]:
        """Visits of the picked poses and of those for verification, and sentences for people."""
        self.said = ()
        q = pool[picked]
        q = q[self._short_tour(q, None)]
        replicated = self._replicates(q)
        signs = self._approach_signs(q, replicated)
        visits = self._visits("poses", q, signs, np.arange(len(q)), [1] * len(q))
        for number, side in enumerate(REPLICATE_SIGNS, 2) if len(replicated) else ():
            order = replicated[::-1] if number % 2 else replicated
            visits += self._visits("poses", q, side * signs, order, [number] * len(order), visits[-1].q)
        words: tuple[str, ...] = ()
        if self.wishes.verification:
            others, words = self._verification(np.delete(pool, picked, axis=0), q)
            others = others[self._short_tour(others, visits[-1].q)]
            own = self._approach_signs(others, np.zeros(0, dtype=np.int64))
            visits += self._visits("verification", others, own, np.arange(len(others)), [1] * len(others), visits[-1].q)
        return visits, (*self.said, *words)

    def allowed(self, q: Array) -> Bools:
        """Whether configurations ``q`` ``(N, n)``, rad, are in the region, in sight and clear ``(N,)``."""
        points, rotation = self.bench.points(q)
        out = np.ones(len(q), dtype=bool)
        if self.wishes.region is not None:
            out &= self.wishes.region.contains(points).all(axis=1)
        return self._visible(q, points, rotation, out)

    def _visible(self, q: Array, points: Array, rotation: Array, out: Bools) -> Bools:
        """Which of the configurations marked by ``out`` ``(N,)`` are in sight, clear and approachable ``(N,)``.

        Quick tests come first. ``points`` ``(N, t, 3)``, m, and ``rotation`` ``(N, 3, 3)`` as of PoseBench.points.
        """
        sight = self.wishes.sight
        if sight is not None:
            out = out & sight.sees(points, rotation)
        index = np.flatnonzero(out)
        out[index] &= self.scene.clear(q[index])
        if sight is not None:
            index = np.flatnonzero(out)
            out[index] &= self.scene.unhidden(q[index], points[index], sight.station)
        for i in np.flatnonzero(out):
            out[i] = self._feasible_signs(q[i]) is not None
        return out

    def _pool(self) -> Array:
        """Candidate configurations ``(c, n)``, rad.

        Raises
        ------
        PlanError
            There are too few.
        """
        wishes = self.wishes
        count = max(CANDIDATES_PER_POSE * wishes.poses, MIN_CANDIDATES) + wishes.verification
        where = [] if wishes.region is None else [f"with all targets in the {wishes.region.words}"]
        where += [] if wishes.sight is None else [f"seen by the {wishes.sight.words}"]
        why = ", ".join([*where, "clear of floor and obstacles"])
        pool = configurations(self.inner, count, self.allowed, self.seed, why=why)
        least = wishes.poses + (0 if wishes.part else wishes.verification)
        if len(pool) < least:
            raise PlanError(f"expected at least {least} configurations that are {why}, found {len(pool)}")
        return pool

    def _choose(self, pool: Array) -> list[int]:
        """Indices of the poses in the pool: some far apart in joint space, the others D-optimal."""
        wishes = self.wishes
        apart = far_apart(self._scaled(pool), round(wishes.spread * wishes.poses))
        signs = self.rng.choice([-1.0, 1.0], pool.shape)
        return choose(self.bench.factors(pool, signs), self.bench.prior, wishes.poses, start=apart, passes=2)

    def _scaled(self, q: Array) -> Array:
        """Joint angles ``q`` as shares of their ranges, 0 … 1."""
        return np.asarray((q - self.limits.lower) / (self.limits.upper - self.limits.lower))

    def _short_tour(self, q: Array, before: Array | None) -> Integers:
        """A short tour through configurations ``(N, n)``, rad: :meth:`ClearTours.order`; its sentences are kept."""
        order, said = self.tours.order(q, before)
        self.said += said
        return order

    def _approach_signs(self, q: Array, replicated: Integers) -> Array:
        """Balanced approach signs ``(N, n)`` of poses ``q`` in the order of the tour, with clear approaches.

        Poses with indices ``replicated`` are visited equally often from both sides. They are balanced in themselves.
        """
        start = [self._feasible_signs(pose) for pose in q]
        found = [np.ones(q.shape[1]) if side is None else side for side in start]  # _visible has left no None
        out, once = np.array(found), np.setdiff1d(np.arange(len(q)), replicated)
        covariates = covariates_of(q)[once]
        out[once] = balanced(out[once], covariates, lambda k, signs: self._approachable(q[once[k]], signs))
        return out

    def _feasible_signs(self, q: Array) -> Array | None:
        """Signs ``(n,)`` with which a pose ``(n,)``, rad, can be approached; None if none is found."""
        n = len(q)
        for number in self.rng.permutation(2 ** (n - 1))[:SIGNS_TRIED]:  # each is tested with its opposite
            signs = np.array([1.0 - 2.0 * (int(number) >> k & 1) for k in range(n)])
            if self._approachable(q, signs):
                return np.asarray(signs * self.rng.choice([-1.0, 1.0]))
        return None

    def _approachable(self, q: Array, signs: Array) -> bool:
        """Whether a clear pose ``(n,)`` can be approached with ``signs`` ``(n,)`` and with the opposite ones."""
        step = self.wishes.approach * signs
        return self.scene.way_clear(q - step, q + step)

    def _replicates(self, q: Array) -> Integers:
        """Indices of the poses to replicate ``(r,)``, spread over the tour, in the order of a short tour.

        If no tour through them is clear, their neighbours in the tour are tried.
        """
        count = min(self.wishes.replicates, len(q))
        spread = ((np.arange(count) + 0.5) * len(q) / max(count, 1)).astype(np.int64)
        if not count:
            return spread
        first: PlanError | None = None
        for shift in sorted(range(-int(spread[0]), len(q) - int(spread[-1])), key=abs):
            near = spread + shift
            try:
                return np.asarray(near[self._short_tour(q[near], q[-1])])
            except PlanError as error:
                first = first or error
        raise PlanError(str(first))

    def _verification(self, left: Array, chosen: Array) -> tuple[Array, tuple[str, ...]]:
        """Poses for verification ``(v, n)``, rad, and sentences for people.

        ``left`` ``(c, n)``: candidates that were not chosen; ``chosen`` ``(N, n)``: poses to fit.
        """
        part, count = self.wishes.part, self.wishes.verification
        if part is None:
            apart = far_apart(self._scaled(np.vstack([chosen, left])), len(chosen) + count, len(chosen))
            return left[np.array(apart[len(chosen) :]) - len(chosen)], ()
        found = [q for place in part.grid(count) for q in self._reaching(place, part)]
        if not found:
            raise PlanError(
                f"verification: expected configurations on the {part.words}, in sight and clear, found none"
            )
        if len(found) == count:
            return np.array(found), ()
        return np.array(found), (f"{count - len(found)} of {count} places of the verification grid are out of reach",)

    def _reaching(self, place: Array, part: SpherePart) -> list[Array]:
        """One configuration, or none, with the targets' mean at ``place`` and the flange's z axis to the centre."""
        inner, n = self.inner, self.cell.robot.n
        point = np.mean(list(self.cell.targets.values()), axis=0)
        axis = (part.centre - place) / np.linalg.norm(part.centre - place)
        starts = inner.lower + (inner.upper - inner.lower) * self.rng.random((IK_STARTS, n))
        q = reaching(self.cell.robot, place, axis, starts, point=point, normal=np.array([0.0, 0.0, 1.0]))
        q = np.round(q, DIGITS)
        q = q[np.all((q >= inner.lower) & (q <= inner.upper), axis=1)]
        if not len(q):
            return []
        points, rotation = self.bench.points(q)
        q = q[self._visible(q, points, rotation, np.ones(len(q), dtype=bool))]
        return [q[int(np.argmin(np.abs(self._scaled(q) - 0.5).max(axis=1)))]] if len(q) else []

    def _visits(
        self, table: Literal["poses", "verification"], q: Array, signs: Array, order: Integers, numbers: list[int],
        before: Array | None = None,
    ) -> list[Visit]:  # fmt: skip
        """Visits of the poses ``q`` in ``order``, with visit ``numbers``; the first starts at ``before``."""
        targets, out = tuple(self.cell.targets), []
        for k, number in zip(order, numbers, strict=True):
            via = np.round(q[k] - self.wishes.approach * signs[k], DIGITS)
            course = course_of(self.cell.robot, self.limits, np.array([via if before is None else before, via, q[k]]))
            out.append(Visit(table, int(k) + 1, number, via, q[k], course.duration, course.ramp, targets))
            before = q[k]
        return out

    def _finished(self, visits: list[Visit], assumed: tuple[str, ...]) -> Plan:
        """The plan of the visits with its expected results, checked against its own limits."""
        wishes, bench = self.wishes, self.bench
        own = [v for v in visits if v.table == "poses"]
        factors = bench.factors(np.array([v.q for v in own]), np.array([v.direction for v in own]))
        information = np.einsum("cpr,cqr->pq", factors, factors) / np.outer(bench.size, bench.size)
        moves = float(sum(v.duration.sum() for v in visits) - visits[0].duration[0])
        waiting = wishes.measure_time * sum(len(v.targets) for v in visits)
        noise = f"points: {self.cell.position_std:.2g} m per axis, independent; what a model lacks comes on top"
        record: dict[str, float | int | str] = {
            "poses": wishes.poses,
            "replicates": wishes.replicates,
            "verification": wishes.verification,
            "effects": ", ".join(bench.effects),
            "spread": wishes.spread,
            "approach_rad": wishes.approach,
            "seed": self.seed,
        }
        for name, part in (("region", wishes.region), ("verification_part", wishes.part), ("sight", wishes.sight)):
            record |= {} if part is None else {name: part.words}
        plan = Plan(
            kind="poses",
            cell=self.cell,
            limits=self.limits,
            duration=moves + waiting,
            visits=tuple(visits),
            measure_time=wishes.measure_time,
            expected=expected_of(bench.problem, information, factors.shape[2] * len(own), noise),
            assumed=assumed,
            wished=MappingProxyType(record),
        )
        validate_plan(plan)
        return plan
