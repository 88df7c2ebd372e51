"""Effects on the angle of one joint that few visits show, tested by exchanges of the poses.

Signs of n visits give no p below 2^-n, whatever their errors are. But if few of many visits show an effect, it is
unlikely that the large errors of the joint's angle are there by chance. The null is that the errors of the poses are
exchangeable. Poses with the same number of visits are permuted at random; the visits of each keep their errors and
their order, so that a pose with an error of its own counts once. The statistic is what the candidate's columns explain
of the errors. Columns are not made orthogonal to what the fit absorbs: the permuted errors then explain more than the
observed ones, which makes the test a careful one. p is multiplied by the number of candidates that are tested in this
way (Bonferroni). Source: Fisher, The Design of Experiments, 1935.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from clampid.effect import Effect
from clampid.evidence.candidates import Candidate
from clampid.evidence.joint_errors import JointErrors, joint_levers
from clampid.evidence.score import Scored
from clampid.evidence.space import Space
from clampid.fitting.solve import Estimate
from clampid.slots import number_of
from clampid.stages.rows import Array, Integers

__all__ = ["Visits", "by_exchanges"]

EXCHANGES = 20_000  # random permutations: p is at least 5e-5
FEW_VISITS = 16.0  # 2^-16 = 1.5e-5: about the p that one of some hundred candidates needs in the test of signs
AT_ONCE = 2_000_000  # poses in the permutations that are drawn together, for memory
ROUNDING = 1e-9  # of a sum of squares, or of the longest of several columns


@dataclass(frozen=True)
class Visits:
    """The visits of poses that see a joint's angle.

    Attributes
    ----------
    seen
        Errors of the angle by visit.
    pose, number
        ``(V,)``: each visit's pose, from 0, and its number among the visits of that pose.
    """

    seen: JointErrors
    pose: Integers
    number: Integers

    @staticmethod
    def of(space: Space, lever: Array, visit: Integers, pose: Integers) -> Visits:
        """``visit`` ``(M,)``: of each entry, in the order of their poses; ``pose``: of each visit."""
        seen = JointErrors.of(space, lever, visit)
        _, mine = np.unique(pose[seen.group], return_inverse=True)
        first = np.searchsorted(mine, np.arange(int(mine.max(initial=-1)) + 1))
        return Visits(seen, mine.astype(np.int64), np.arange(len(mine)) - first[mine])

    @cached_property
    def count(self) -> Integers:
        """``(P,)``: how many visits each pose has."""
        return np.bincount(self.pose).astype(np.int64)

    def shape(self, candidate: Candidate, entries: int) -> Array:
        """An orthonormal basis ``(V, k)`` of a candidate's columns, as each visit sees them."""
        seen_as = np.asarray(self.seen.sums @ candidate.columns.dense(entries))
        left, size, _ = np.linalg.svd(seen_as, full_matrices=False)
        return np.asarray(left[:, size > max(ROUNDING * float(size.max(initial=0.0)), 1e-300)])

    def products(self, shape: Array) -> Array:
        """``(k, P, P)``: a shape at the visits of each pose times the errors of each pose."""
        of_pose = np.zeros((shape.shape[1] + 1, len(self.count), int(self.count.max(initial=0))))
        of_pose[:, self.pose, self.number] = np.vstack([shape.T, self.seen.error])
        return np.asarray(of_pose[:-1] @ of_pose[-1].T)

    def log_p(self, shapes: Sequence[Array], seed: int) -> Array:
        """Natural logarithms of the p of each shape."""
        products = [self.products(shape) for shape in shapes]
        observed = [float(np.sum(np.trace(G, axis1=1, axis2=2) ** 2)) for G in products]
        rng, own, poses = np.random.default_rng(seed), np.arange(len(self.count)), len(self.count)
        alike = [np.flatnonzero(self.count == n) for n in np.unique(self.count)]
        as_large, drawn = np.ones(len(shapes)), 0
        while drawn < EXCHANGES:
            some = min(max(AT_ONCE // poses, 1), EXCHANGES - drawn)
            order = np.tile(own, (some, 1))
            for same in alike:
                order[:, same] = same[np.argsort(rng.random((some, len(same))), axis=1)]
            for k, (G, large) in enumerate(zip(products, observed, strict=True)):
                explained = np.sum(G[:, own, order].sum(axis=-1) ** 2, axis=0)
                as_large[k] += np.count_nonzero(explained >= (1.0 - ROUNDING) * large)
            drawn += some
        return np.asarray(np.log(as_large / (EXCHANGES + 1)))


def by_exchanges(
    estimate: Estimate, space: Space, scored: Sequence[Scored], effects: Mapping[str, Effect], seed: int
) -> dict[int, Scored]:
    """The candidates that few visits show, with the p-value of this test; by their number among those ``scored``.

    Parameters
    ----------
    estimate, space
        A fit, and its residual with the span that it absorbs. Of other stages than poses nothing is tested.
    scored
        Candidates with their scores by flips of signs.
    effects
        All known effects, by name.
    seed
        Of the permutations.
    """
    rows = estimate.problem.rows
    chosen = [k for k, s in enumerate(scored) if s.freedom and _acts_at_one_joint(s.candidate, effects)]
    if not estimate.problem.kind.points or not chosen:
        return {}
    levers = joint_levers(estimate)
    visits, visit = np.unique(np.c_[rows.fold, rows.unit], axis=0, return_inverse=True)
    found = dict[int, Scored]()
    for j in sorted({number_of(scored[k].candidate.places[0]) for k in chosen}):
        own = Visits.of(space, levers.values[:, j], visit.ravel()[levers.entry], visits[:, 0])
        mine = [k for k in chosen if number_of(scored[k].candidate.places[0]) == j]
        shapes = {k: own.shape(scored[k].candidate, space.rows) for k in mine}
        few = [k for k in mine if 0.0 < _visits_of(shapes[k]) <= FEW_VISITS]
        if few:
            log_p = own.log_p([shapes[k] for k in few], seed)
            found |= {k: replace(scored[k], log_p=float(p)) for k, p in zip(few, log_p, strict=True)}
    return {k: replace(s, log_p=min(s.log_p + float(np.log(len(found))), 0.0)) for k, s in found.items()}


def _visits_of(shape: Array) -> float:
    """How many visits show it, each counted by its part (inverse participation ratio); 0 if none does."""
    part = np.sum(shape**2, axis=1)
    return float(part.sum() ** 2 / max(float(part @ part), 1e-300))


def _acts_at_one_joint(candidate: Candidate, effects: Mapping[str, Effect]) -> bool:
    """Whether it changes the angle of one joint, and nothing else."""
    effect = effects[candidate.name]
    return len(candidate.places) == 1 and effect.per == "joint" and set(effect.acts) == {"joint_angle"}
