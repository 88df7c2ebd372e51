"""Effects that act over a few degrees of one joint, such as a bump, tried at every angle of the poses.

The column of an angle is the derivative of the measurement by the joint's angle, times the effect's shape about that
angle. So the effect is evaluated once, and each angle costs a product. The best angle of each joint becomes a
candidate. If it is nearly significant, its shape is refined between the angles tried; each shape parameter is charged
like an amplitude. An angle needs several poses near it: the error of a single pose may have a cause of its own, which
returns with each visit.

Such an effect moves only a few poses. Sign flips are no valid null for it: with a dozen poses that are all far off,
flipped signs reach sums as large as the observed one far too often. The null is therefore that the poses' errors are
exchangeable: each pose's error of a joint's angle, in standard deviations and clipped at three, is permuted at random
among the poses. The maximum over all angles of a joint follows Gumbel's law of extremes, fitted to the permutations
by its mean and variance. The p-value of a candidate is that of this maximum, times the number of joints tried
(Bonferroni): one joint may have larger maxima than another, because few poses show its angles. Sources: Fisher, The
Design of Experiments, 1935, for the permutations; Gumbel, Statistics of Extremes, 1958.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from itertools import product
from types import SimpleNamespace
from typing import Any

import casadi as ca
import numpy as np
from scipy import optimize, sparse

from clampid.effect import Effect
from clampid.evidence.candidates import Candidate, is_sought
from clampid.evidence.columns import Columns, Levers, channel_starts
from clampid.evidence.joint_errors import JointErrors, joint_levers
from clampid.evidence.score import WEAK_BELOW, Scored, score
from clampid.evidence.space import Space, space_of
from clampid.fitting.solve import Estimate
from clampid.fitting.wander import Filters
from clampid.slots import Slot, Term
from clampid.stages.fit_problem import parameter_of
from clampid.stages.rows import Array, Integers
from clampid.stages.stage_kind import kind_of

__all__ = ["FEWEST_POSES", "place_of", "scan"]

FEWEST_POSES = 4  # near an angle: three determine height, middle and width of a bump, one more may contradict them
MIN_SHARE_OF_HEIGHT = 0.1  # of a bump, at a pose that counts as near
ANGLES_PER_TURN = 3600  # at which a shape is tabulated
FADED = 1e-9  # of a column's largest number: a smaller one is rounding
REFINED_BELOW = 0.1  # p: the shape of what is not nearly significant is left at the best angle tried
SCAN_STEP = 2.0 / 3.0  # distance of the angles tried, in widths at half height: at most a tenth of the height is missed


@dataclass(frozen=True)
class _Tried:
    """An effect at each of C angles of one joint.

    Attributes
    ----------
    joint
        From 0.
    shapes
        Values of the effect's shape parameters, the angle among them (rad).
    explained
        ``(C,)``: sum of squares explained, in units of the residual's variance.
    weight
        ``(V, C)``, columns of unit length: the shape as each pose sees it.
    error
        ``(V,)``: error of the joint's angle at each pose, as :class:`clampid.evidence.joint_errors.JointErrors` has it.
    levers
        Derivatives by the joints' angles.
    """

    effect: Effect
    joint: int
    shapes: tuple[Mapping[str, float], ...]
    explained: Array
    weight: Array | sparse.csc_matrix
    error: Array
    levers: Levers

    @property
    def best(self) -> Mapping[str, float]:
        """The shapes that explain most."""
        return self.shapes[int(np.argmax(self.explained))]

    def statistic(self, error: Array) -> Array:
        """What each angle explains of the poses' errors ``(..., V)``: ``(..., C)``, of mean 1 under the null."""
        return np.asarray(error @ self.weight) ** 2

    def log_p(self, order: Integers) -> float:
        """Natural logarithm of the p of the maximum over all angles; ``order`` ``(exchanges, V)``: permutations."""
        maxima = self.statistic(self.error[order]).max(axis=1)
        spread = max(float(np.std(maxima)) * np.sqrt(6.0) / np.pi, 1e-9)
        off = (float(self.statistic(self.error).max()) - float(np.mean(maxima))) / spread + np.euler_gamma
        return float(np.log(-np.expm1(-np.exp(-off)))) if off < 30.0 else -off


def scan(estimate: Estimate, space: Space, effects: Mapping[str, Effect], exchanges: int, seed: int) -> list[Scored]:
    """Each scanned effect at the best angle of each joint that lacks it; p-values allow for all angles tried.

    Parameters
    ----------
    estimate, space
        A fit of poses, and its residual with the span that it absorbs.
    effects
        All known effects, by name.
    exchanges, seed
        Number of random permutations of the poses, and their seed.
    """
    tried = _all_places(estimate, space, effects)
    if not tried:
        return []
    rng, found = np.random.default_rng(seed), []
    for t in tried:
        log_p = t.log_p(np.argsort(rng.random((exchanges, len(t.error))), axis=1)) + float(np.log(len(tried)))
        best = _refined(estimate, space, t) if log_p < np.log(REFINED_BELOW) else _candidate(estimate, t, t.best)
        chosen = len(best.shapes) * float(np.log(max(space.rows, 2)))
        found.append(score(space, [best])[0].of_many(log_p, chosen))
    return found


def place_of(estimate: Estimate, effect: Effect, place: str) -> dict[Slot, float]:
    """Shape parameters of an absent effect at the likeliest angle of joint ``place``; empty if no angle shows it."""
    space = space_of(estimate)
    tried = _all_places(estimate, space, {effect.name: effect}, (place,))
    return dict(_refined(estimate, space, tried[0]).shapes) if tried else {}


def _all_places(
    estimate: Estimate, space: Space, effects: Mapping[str, Effect], only: Iterable[str] | None = None
) -> list[_Tried]:
    """The scanned effects at every angle of every joint where they are not active, or of the joints ``only``."""
    rows, stage = estimate.problem.rows, estimate.problem.stage
    wanted = [e for e in effects.values() if e.scanned is not None and kind_of(stage).has(e)]
    if not kind_of(stage).points or not wanted:
        return []
    levers = joint_levers(estimate)
    of_basis = (levers.filters or Filters(())).shares(space.basis)
    active = {(slot.effect, slot.place) for slot in estimate.slots}
    found = []
    for effect in wanted:
        tables = _tables(effect)
        for j in range(rows.robot.n):
            place = f"joint{j + 1}"
            if (effect.name, place) in active or (only is not None and place not in only):
                continue
            if is_sought(estimate, effect, place):
                tried = _places(estimate, space, effect, j, levers, tables, of_basis)
                found += [] if tried is None else [tried]
    return found


def _tables(effect: Effect) -> list[tuple[Mapping[str, float], Array]]:
    """Each combination of shapes with the deviation ``(ANGLES_PER_TURN,)`` by a unit amplitude, from the middle on."""
    shapes = [p for p in effect.parameters if p.shape and p.name != effect.scanned]
    amplitude = next(p for p in effect.parameters if not p.shape)
    angle = ca.DM(np.arange(ANGLES_PER_TURN) * 2.0 * np.pi / ANGLES_PER_TURN)
    out: list[tuple[Mapping[str, float], Array]] = []
    for values in product(*(p.grid for p in shapes)):
        chosen = dict(zip((p.name for p in shapes), values, strict=True))
        p: Any = SimpleNamespace(**{amplitude.name: 1.0, str(effect.scanned): 0.0, **chosen})
        deviation = effect.acts["joint_angle"](p, SimpleNamespace(q=angle))
        out.append((chosen, np.asarray(deviation, dtype=float).ravel()))
    return out


def _places(
    estimate: Estimate,
    space: Space,
    effect: Effect,
    j: int,
    levers: Levers,
    tables: list[tuple[Mapping[str, float], Array]],
    of_basis: Array,
) -> _Tried | None:
    """An effect at all angles of one joint; None if no pose shows it at any.

    ``of_basis`` ``(R, r)``: shares of the basis in a level that wanders.
    """
    rows = estimate.problem.rows
    at = np.rint(np.mod(rows.signals["q"][:, j], 2.0 * np.pi) * ANGLES_PER_TURN / (2.0 * np.pi)).astype(np.int64)
    lever = levers.values[:, j]
    seen = np.zeros(len(rows), dtype=bool)
    seen[levers.entry[lever != 0.0]] = True
    _, pose = np.unique(rows.fold, return_inverse=True)
    shapes: list[Mapping[str, float]] = []
    functions = []
    for chosen, table in tables:
        size = np.abs(table) / np.abs(table).max()
        inside = size > MIN_SHARE_OF_HEIGHT
        for k in range(0, ANGLES_PER_TURN, max(1, int(SCAN_STEP * np.count_nonzero(size > 0.5)))):
            near = seen & inside[(at - k) % ANGLES_PER_TURN]
            if len(np.unique(pose[near])) >= FEWEST_POSES:
                middle = float(np.remainder(2.0 * np.pi * k / ANGLES_PER_TURN + np.pi, 2.0 * np.pi) - np.pi)
                shapes.append({str(effect.scanned): middle, **chosen})
                functions.append(table[(at - k) % ANGLES_PER_TURN])
    if not shapes:
        return None
    D = (sparse.diags(lever) @ sparse.csr_matrix(np.array(functions).T)[levers.entry]).tocsr()
    filters = levers.filters or Filters(())
    shares = filters.shares(D).T  # (C, R)
    taken = shares * filters.taken
    gram = np.asarray(D.multiply(D).sum(axis=0)).ravel() - np.sum(taken * (2.0 * shares - taken), axis=1)
    absorbed = np.asarray(D.T @ space.basis[: space.rows]) - taken @ of_basis  # (C, r)
    left = gram - np.sum(absorbed**2, axis=1)
    able = np.flatnonzero(left > WEAK_BELOW * np.maximum(gram, 1e-300))
    if not len(able):
        return None
    along = np.asarray(D.T @ space.residual[: space.rows]) - taken @ filters.shares(space.residual)
    explained = along[able] ** 2 / (space.scale**2 * left[able])
    seen_by = JointErrors.of(space, lever, pose[levers.entry].astype(np.int64))
    products = (seen_by.sums @ D[:, able]).tocsc()
    if levers.filters is None:
        weight = _of_unit_length(products)
    else:  # every pose then has a part in the level that is taken from the others
        weight = _of_unit_length(products.toarray() - filters.summed(seen_by.sums) @ taken[able].T)
    return _Tried(effect, j, tuple(shapes[k] for k in able), explained, weight, seen_by.error, levers)


def _of_unit_length(columns: Array | sparse.csc_matrix) -> Array | sparse.csc_matrix:
    """Columns ``(V, C)``, each over its length."""
    if isinstance(columns, np.ndarray):
        return columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    length = np.sqrt(np.asarray(columns.multiply(columns).sum(axis=0)).ravel())
    return (columns @ sparse.diags(1.0 / np.maximum(length, 1e-300))).tocsc()


def _refined(estimate: Estimate, space: Space, tried: _Tried) -> Candidate:
    """The candidate with the shapes, within their bounds, that explain most, searched from the best angle tried."""
    at = dict(tried.best)
    bounds = {name: tried.effect.by_name[name].bounds for name in at}
    step = {name: 0.25 * tried.effect.by_name[name].size for name in at} | {str(tried.effect.scanned): 0.02}

    def worse(x: Array) -> float:
        shapes = dict(zip(at, map(float, x), strict=True))
        if any(not bounds[name][0] <= value <= bounds[name][1] for name, value in shapes.items()):
            return 0.0
        c = _column(estimate, tried, shapes)
        some = np.flatnonzero(np.abs(c) > FADED * np.abs(c).max(initial=0.0))  # the entries of a few poses
        own = c[some] @ space.basis[some]
        left = float(c @ c - own @ own)
        return -(float(c[some] @ space.residual[some]) ** 2) / left if left > WEAK_BELOW * float(c @ c) > 0.0 else 0.0

    start = np.array(list(at.values()))
    simplex = np.vstack([start, *(start + step[name] * np.eye(len(at))[k] for k, name in enumerate(at))])
    options = {"initial_simplex": simplex, "maxfev": 30 * len(at), "xatol": 1e-4, "fatol": 0.1}
    best = optimize.minimize(worse, start, method="Nelder-Mead", options=options)
    found = best.x if best.fun <= worse(start) else start
    return _candidate(estimate, tried, dict(zip(at, map(float, found), strict=True)))


def _column(estimate: Estimate, tried: _Tried, shapes: Mapping[str, float]) -> Array:
    """The whitened column ``(M,)`` of a joint's effect with the given shape parameters."""
    q = ca.DM(estimate.problem.rows.signals["q"][:, tried.joint])
    amplitude = next(p.name for p in tried.effect.parameters if not p.shape)
    p: Any = SimpleNamespace(**{amplitude: 1.0, **shapes})
    values = np.asarray(tried.effect.acts["joint_angle"](p, SimpleNamespace(q=q)), dtype=float).ravel()
    column = np.asarray(tried.levers.values[:, tried.joint] * values[tried.levers.entry])
    return column if tried.levers.filters is None else tried.levers.filters(column[:, None])[:, 0]


def _candidate(estimate: Estimate, tried: _Tried, shapes: Mapping[str, float]) -> Candidate:
    """A joint's effect with the given shape parameters as a candidate."""
    effect, place, white = tried.effect, f"joint{tried.joint + 1}", estimate.whitened
    amplitude = next(p for p in effect.parameters if not p.shape)
    slot = Slot(effect.name, amplitude.name, place)
    parameter = parameter_of(slot, {effect.name: effect}, estimate.problem.rows.robot)
    column = _column(estimate, tried, shapes)[:, None]
    pieces = tuple((start, column[start:stop]) for start, stop in channel_starts(white))
    return Candidate(
        name=effect.name,
        family=effect.family,
        terms=(Term(effect.name, place),),
        slots=(slot,),
        shapes={Slot(effect.name, name, place): value for name, value in shapes.items()},
        columns=Columns(pieces, 1),
        depends_on=(),
        places=(place,),
        reasonable=np.array([parameter.size]),
        units=(parameter.unit,),
    )
