"""Dry friction of joints from poses alone: by the flanks on which joints rest after a stop.

Friction F and load decide the flank together, s = sign(load + F dir), and F also winds up the joint's spring. A search
with frozen flanks sees only the spring's part, moves F by it, and then meets other flanks than those it froze: it need
not converge. So such a friction is fixed while all else is searched, and is searched for separately: every value at
which the flank of another visit changes is tried, each with the clearance and all other parameters as they then fit
best, to first order.

The cost of these fits over F is the friction's profile likelihood. It has steps and may have several minima, so that
the normal equations do not give the standard error. It is taken from the distribution over F, with the other parameters
that change with F. Their second moment about the estimate is added to the covariance. Source: profile likelihood, as in
Venzon, Moolgavkar, Applied Statistics 37, 1988, taken for a posterior with the prior that the friction has.

Loads have to be known for this, from torque logs; without, a fit only begins well: `fitting.friction_start`.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import linalg

from clampid.fitting.noise import NORMAL, initial_noise
from clampid.fitting.repeatability import sums_over
from clampid.fitting.solve import Estimate, prior_of, solve, start_of
from clampid.fitting.visits import variance_along
from clampid.role_slots import has_role
from clampid.roles import WEIGHTS
from clampid.slots import Prior, Slot
from clampid.stages import poses
from clampid.stages.fit_problem import FIXED_STD, FitProblem
from clampid.stages.pose_rows import REST_FRICTION
from clampid.stages.rows import Array, Integers

__all__ = ["RestFriction", "with_open_friction", "with_rest_friction"]

ROUNDS_OF_JOINTS = 6  # of all joints, at most
CELLS, LEAST = 2000, 33  # values tried, at most and at least
VARIES = 0.1  # of the heaviest load
TAIL_NODES, TAIL_DEVIATIONS = (
    16,
    3.0,
)  # frictions that no load exceeds: so many, to as many standard deviations of the prior
LIP, RATED = 0.1, 100.0  # Nm: what a seal's lip rubs on a shaft of 40 mm, that of a joint of such a rated torque
LIPS = 3.0  # of it: how far seals may be from what they are taken for
MISSES = 3.0  # of the noise's squares
BETTER = 0.1  # of chi-square


@dataclass(frozen=True)
class RestFriction:
    """Where a pose fit begins, and the frictions that it fixes there.

    Attributes
    ----------
    start
        Slot -> value.
    fixed
        None where no friction has to be sought apart.
    """

    start: Mapping[Slot, float]
    fixed: Prior | None

    @property
    def priors(self) -> tuple[Prior, ...]:
        """For a fit."""
        return () if self.fixed is None else (self.fixed,)


def with_rest_friction(
    problem: FitProblem,
    priors: Sequence[Prior],
    start: Mapping[Slot, float],
    *,
    before: Collection[Slot] | None = None,
    anew: bool = False,
) -> RestFriction:
    """Search for the frictions that select flanks and that only the poses determine.

    Where ``start`` has all of the model they are fixed there, unless they are to be sought ``anew``. Where it lacks an
    effect that has just been added, or a fit ``before`` lacked a clearance, they are sought from what it has: without
    that effect flanks may have explained what it does, and without a clearance no flank mattered, so that friction was
    only what winds up a spring. None is fixed if the model leaves more than noise: flanks would explain what else it
    lacks.

    Parameters
    ----------
    before
        The slots of an earlier fit of these rows, if ``start`` has further ones.

    Raises
    ------
    clampid.fitting.solve.FitError
        The model gives no finite prediction.
    """
    open_ = _open(problem, priors)
    if not open_:
        return RestFriction(start, None)
    theta = start_of(problem, start, priors)
    fitted = set(start if before is None else before)
    play = [slot for slot in problem.slots if has_role(slot, "clearance", effects=problem.effects)]
    anew |= not fitted.issuperset(play)
    if not anew and all(slot in start for slot in problem.slots):
        free = _misses(problem, problem.error(theta))
        return RestFriction(start, None if free else _fixed_prior(problem, open_, theta))
    estimate = _solved(problem, priors, open_, theta)
    for _ in range(ROUNDS_OF_JOINTS):
        last = estimate
        for k in open_:
            value = _Profile.of(estimate, k).likeliest
            if value == estimate.theta[k]:
                continue
            at = estimate.theta.copy()
            at[k] = value
            found = _solved(problem, priors, open_, at)
            if _cost(found) < _cost(estimate) - BETTER:
                estimate = found
        if estimate is last:
            break
    fixed = _fixed_prior(problem, open_, estimate.theta)
    return RestFriction(estimate.values(), None if _misses(problem, estimate.residual) else fixed)


def _misses(problem: FitProblem, residual: Array) -> bool:
    """Whether two thirds of the squares left ``(N, m)`` are not the instrument's noise, lost points not counted."""
    white = (problem.rows.in_noise_axes(residual) / problem.rows.sigma)[problem.rows.used]
    return float(NORMAL * np.median(np.abs(white))) ** 2 > MISSES


def with_open_friction(estimate: Estimate, fixed: Prior | None) -> Estimate:
    """The same fit, with what the flanks leave open of the frictions that it fixed in its covariance."""
    if fixed is None:
        return estimate
    covariance = estimate.covariance.copy()
    for slot in fixed.slots:
        k = estimate.slots.index(slot)
        profile = _Profile.of(estimate, k)
        off = profile.theta - estimate.theta
        covariance += (profile.weight * off.T) @ off
        # Flanks determine friction only relative to load and seals: errors of these are errors of the friction. The
        # wound-up spring would separate them, but not if one visit in a hundred is assigned to the wrong flank.
        load = _load_variance(estimate, profile.joint) + _seals(estimate, profile.joint) ** 2
        covariance += load * np.outer(profile.slope, profile.slope)
    return replace(estimate, covariance=covariance)


def _open(problem: FitProblem, priors: Sequence[Prior]) -> list[int]:
    """Numbers of the frictions that decide on flanks, with no prior of their own.

    A joint's load must be one that they can be compared with: one that is always the same turns all flanks or none.
    """
    if not problem.kind.points or not problem.chain.reads_flanks or not problem.rows.used.any():
        return []
    known = {slot for prior in priors for slot in prior.slots}
    signals = problem.rows.signals
    contrary = signals["gravity_torque"] * signals["direction"] < 0.0
    load = np.where(contrary, np.abs(signals["gravity_torque"]) - np.abs(signals["rest_direction"]), 0.0)
    out = []
    play = {problem.slots[k].place for k in problem.numbers_of("clearance")}
    for k in problem.numbers_of("arm_friction"):
        slot = problem.slots[k]
        if slot in known or slot.place not in play:
            continue
        joint = int(slot.place.removeprefix("joint")) - 1
        turns = load[load[:, joint] > 0.0, joint]
        if len(turns) and np.ptp(turns) > VARIES * turns.max():
            out.append(k)
    return out


def _fixed_prior(problem: FitProblem, open_: Sequence[int], theta: Array) -> Prior:
    tight = FIXED_STD * problem.sizes()[list(open_)]
    return Prior(tuple(problem.slots[k] for k in open_), theta[list(open_)], np.diag(tight**2))


def _solved(problem: FitProblem, priors: Sequence[Prior], open_: Sequence[int], theta: Array) -> Estimate:
    precision, mean = prior_of(problem, (*priors, _fixed_prior(problem, open_, theta)))
    mean = np.where(problem.fixed(), theta, mean)
    return solve(problem, theta, initial_noise(problem.rows), precision, mean)


def _cost(estimate: Estimate) -> float:
    """Whitened squares of rows and priors, of fixed frictions as if they were not."""
    assumed, mean = estimate.problem.prior()
    frictions = estimate.problem.numbers_of("arm_friction")
    weak = sum(assumed[k, k] * (estimate.theta[k] - mean[k]) ** 2 for k in frictions)
    return estimate.cost + float(weak)


@dataclass(frozen=True)
class _Profile:
    """Fits with one friction fixed at each of some values.

    Attributes
    ----------
    value, cost
        ``(K,)``: Nm, and whitened squares of rows and prior.
    theta
        ``(K, P)``: all parameters.
    weight
        ``(K,)``: of the values between which no further flank turns.
    slope
        ``(P,)``: d theta / d value, flanks frozen as the estimate has them.
    """

    joint: int
    value: Array
    cost: Array
    theta: Array
    weight: Array
    slope: Array

    @property
    def likeliest(self) -> float:
        """The value of the lowest cost; of frictions that no load exceeds the least."""
        best = int(np.argmin(self.cost))
        return float(self.value[min(best, len(self.value) - TAIL_NODES)])

    @classmethod
    def of(cls, estimate: Estimate, friction: int) -> _Profile:
        joint = int(estimate.slots[friction].place.removeprefix("joint")) - 1
        clearances = estimate.problem.numbers_of("clearance")
        gap = next(k for k in clearances if estimate.slots[k].place == f"joint{joint + 1}")
        row, visit = np.unique(estimate.problem.rows.unit, return_index=True, return_inverse=True)[1:]
        none = estimate.theta.copy()
        none[friction] = 0.0
        pressing = _pressing(estimate, none)
        direction = estimate.problem.rows.signals["direction"][row, joint]
        without, fitted = pressing[row, joint], _pressing(estimate, estimate.theta)[row, joint]
        contrary = np.flatnonzero(without * direction < 0.0)  # what presses against the direction, friction turns
        order = contrary[np.argsort(np.abs(without[contrary]), kind="stable")]
        value, width, after = _values(
            np.abs(without[order]), TAIL_DEVIATIONS * float(estimate.problem.prior_std()[friction])
        )
        side = np.where(without * fitted < 0.0, -1.0, 1.0)
        loose = _Loose.of(estimate, friction, gap)
        theta, cost, normal, slopes = loose.fitted(value, visit, side, order, after)
        variance = variance_along(estimate, np.array([gap]))
        log = -0.5 * cost / variance - 0.5 * np.log(normal) + np.log(width)
        weight = np.exp(log - log.max())
        now = int(np.argmin(np.abs(value - estimate.theta[friction])))
        return cls(joint, value, cost, theta, weight / weight.sum(), slopes[now])


def _pressing(estimate: Estimate, theta: Array) -> Array:
    """What presses on the flanks ``(N, n)``, Nm."""
    found = poses.pressing(estimate.problem.rows, estimate.problem.chain, theta)
    if found is None:
        raise ValueError("expected a fit with clearances that follow the flanks, found none")
    return found


def _values(turns: Array, most: float) -> tuple[Array, Array, Integers]:
    """Frictions to try ``(K,)``, Nm, how wide the range is that each stands for, and how many flanks turn below it.

    ``turns``: at which frictions flanks turn, in their order; ``most``: a friction that hardly any bearing has.
    """
    at = np.unique(np.r_[turns, np.linspace(0.0, turns.max(initial=1e-6), LEAST)])
    chosen = np.unique(np.linspace(0, len(at) - 1, min(len(at), CELLS)).astype(int))
    edge = at[chosen]
    inside, last = 0.5 * (edge[1:] + edge[:-1]), 1.001 * float(edge[-1])
    beyond = np.geomspace(last, max(most, 10.0 * last), TAIL_NODES)
    value = np.r_[inside, beyond]
    width = np.r_[np.diff(edge), np.gradient(beyond)]
    return value, width, np.asarray(np.searchsorted(turns, value), dtype=np.int64)


@dataclass(frozen=True)
class _Loose:
    """A fit's rows and priors, whitened, with one friction and one clearance taken out.

    Attributes
    ----------
    rest
        ``(M, R)``: columns of all other parameters, scaled by ``size`` ``(R,)``; ``index`` ``(R,)`` says which.
    gap, friction
        ``(M,)``: their columns.
    residual
        ``(M,)``: at no clearance and no friction.
    rows
        How many of the M are of rows; the others are the priors'.
    """

    estimate: Estimate
    at: tuple[int, int]
    index: Integers
    size: Array
    rest: Array
    gap: Array
    friction: Array
    residual: Array
    rows: int

    @classmethod
    def of(cls, estimate: Estimate, friction: int, gap: int) -> _Loose:
        white, theta = estimate.whitened, estimate.theta
        precision, mean = estimate.prior_precision.copy(), estimate.prior_mean.copy()
        assumed, at_first = estimate.problem.prior()
        precision[friction], precision[:, friction] = 0.0, 0.0
        precision[friction, friction], mean[friction] = assumed[friction, friction], at_first[friction]
        scale = np.sqrt(np.diag(precision))
        square, axes = linalg.eigh(precision / np.outer(scale, scale))
        root = np.sqrt(np.maximum(square, 0.0))[:, None] * axes.T * scale
        J = np.concatenate([white.jacobian, root])
        residual = np.concatenate([white.residual, root @ (mean - theta)])
        residual = residual + J[:, gap] * theta[gap] + J[:, friction] * theta[friction]
        index = np.setdiff1d(np.arange(len(theta)), [friction, gap])
        size = 1.0 / np.linalg.norm(J[:, index], axis=0)
        return cls(
            estimate, (friction, gap), index, size, J[:, index] * size, J[:, gap], J[:, friction], residual,
            len(white.residual),
        )  # fmt: skip

    def fitted(
        self, value: Array, visit: Integers, side: Array, order: Integers, after: Integers
    ) -> tuple[Array, Array, Array, Array]:
        """Best parameters ``(K, P)``, their cost ``(K,)``, and what the normal equations say of them.

        That is, the clearance's own ``(K,)``, and d parameters / d friction ``(K, P)``.

        Parameters
        ----------
        value
            Frictions ``(K,)``.
        visit
            Of each of the estimate's rows ``(N,)``.
        side
            ``(V,)``: on the flank of the fit, +1, or on the other, -1, without friction.
        order, after
            Visits whose flanks turn one after the other, and how many of them have turned ``(K,)``.
        """
        X, entry = self.rest, self.estimate.whitened.entry
        C = self.gap.copy()
        C[: self.rows] *= side[visit[entry]]
        by_visit = sums_over(visit[entry], len(side))

        def turned(products: Array) -> Array:
            """``(K, ...)``: sums of products with the clearance's column, with as many visits turned."""
            steps = np.cumsum(-2.0 * by_visit(products[: self.rows])[order], axis=0)
            return np.asarray(products.sum(axis=0) + np.concatenate([np.zeros((1, *steps.shape[1:])), steps])[after])

        root = linalg.cholesky(X.T @ X, lower=True)
        r, f = self.residual, self.friction
        known = linalg.solve_triangular(root, np.stack([X.T @ r, X.T @ f], axis=1), lower=True)
        inside = linalg.solve_triangular(root, turned(C[:, None] * X).T, lower=True)  # (R, K)
        normal = np.maximum(C @ C - np.sum(inside**2, axis=0), 1e-12 * (C @ C))
        by_friction = turned(C * f) - inside.T @ known[:, 1]
        slope = turned(C * r) - inside.T @ known[:, 0] - value * by_friction
        gap = np.maximum(slope / normal, 0.0)
        gap_by = -by_friction / normal
        squares = np.array([[r @ r, r @ f], [r @ f, f @ f]]) - known.T @ known
        apart = squares[0, 0] - 2.0 * value * squares[0, 1] + value**2 * squares[1, 1]
        cost = apart - gap * (2.0 * slope - gap * normal)
        step = linalg.solve_triangular(root.T, known[:, :1] - value * known[:, 1:] - gap * inside, lower=False)
        step_by = linalg.solve_triangular(root.T, -known[:, 1:] - gap_by * inside, lower=False)
        theta = np.tile(self.estimate.theta, (len(value), 1))
        slopes = np.zeros_like(theta)
        theta[:, self.index] += (self.size[:, None] * step).T
        theta[:, self.at[0]], theta[:, self.at[1]] = value, gap
        slopes[:, self.index] = (self.size[:, None] * step_by).T
        slopes[:, self.at[0]], slopes[:, self.at[1]] = 1.0, gap_by
        return theta, cost, normal, slopes


def _seals(estimate: Estimate, joint: int) -> float:
    """How far a joint's seals may be from what they are taken for, Nm.

    A lip rubs with the square of the shaft's diameter, of which the third power bears the torque.
    """
    rest = np.abs(estimate.problem.rows.signals["rest_direction"][:, joint]).max()
    return float(LIPS * LIP * (rest / REST_FRICTION / RATED) ** (2.0 / 3.0))


def _load_variance(estimate: Estimate, joint: int) -> float:
    """Variance of a joint's load, Nm², as far as masses are not known: friction shows only beside it."""
    masses = estimate.problem.numbers_of(*WEIGHTS, per="link")
    if not masses:
        return 0.0
    part = {"": 0, "x": 1, "y": 2, "z": 3}  # axis of a first moment; none of a mass
    at = [
        (int(estimate.slots[k].place.removeprefix("link")), part[estimate.problem.parameters[k].axis]) for k in masses
    ]
    Y = estimate.problem.rows.signals["regressor"][:, joint][:, [4 * (link - 1) + p for link, p in at]]
    return float(np.mean(np.einsum("np,pq,nq->n", Y, estimate.covariance[np.ix_(masses, masses)], Y)))
