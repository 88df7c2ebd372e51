"""The joint fit of all stages, with one value for each parameter that several stages share.

The whitened residuals of the stages are stacked. One parameter vector holds the parameters of every stage, and once
those that several stages share: masses, arm-side friction, springs, clearances. The normal equations are the sums of
those of the stages, each in its columns, so a step costs as much as one step of each stage. A torque log with linear
effects enters by its sums only, which are sufficient statistics. Source: Golub & Van Loan, Matrix Computations (2013),
section 5.3 (normal equations of stacked rows). The weights are those of each stage's fit alone.

Effects at a motor's shaft are not shared: a motor that creeps against a clamp has other friction than one in motion.
Springs and clearances are not shared if the poses contradict the clamped sweeps (`clampid.identification.carried`). The
model of one of the two is then wrong, and would bias the other.

For each stage the result also has the information of all *other* rows on its parameters, with all other parameters
eliminated. With this prior a stage can be fitted again alone, with other effects or folds, without counting any row
twice. To first order the result is that of the joint fit.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from clampid.effect import Effect, Stage
from clampid.fitting.descent import Limits, Point, descend, inverse_of
from clampid.fitting.flanks import settled
from clampid.fitting.moments import LogPoint
from clampid.fitting.prior_and_start import prior_of
from clampid.fitting.priors import description_priors
from clampid.fitting.solve import Estimate, StagePoint, limits_of, stage_point
from clampid.fitting.visits import gradient_covariance
from clampid.identification.fitted_stage import FittedStage
from clampid.identification.identify_log import FittedLog
from clampid.models.agreement import is_of_drives
from clampid.slots import Prior, Slot
from clampid.stages.fit_problem import FitProblem
from clampid.stages.rows import Array, Integers

__all__ = ["JointPart", "fit_jointly", "is_shared", "shared_slots"]

JointPart = FittedStage | FittedLog
"""A stage that was fitted alone."""

Key = tuple[Stage | None, Slot | int]
"""A parameter of the joint fit: its stage (None if shared), and its slot or the number of its offset."""


def is_shared(effect: Effect) -> bool:
    """Whether an effect has the same parameters in every experiment: all but those at a motor's shaft alone."""
    return set(effect.acts) != {"motor_torque"}


@dataclass(frozen=True)
class _Union:
    """The joint parameter vector ``(U,)``.

    Attributes
    ----------
    columns
        For each stage, the numbers of its parameters in the joint vector.
    precision, mean
        The prior: ``(U, U)`` and ``(U,)``.
    limits
        Sizes and bounds of the parameters.
    """

    columns: tuple[Integers, ...]
    precision: Array
    mean: Array
    limits: Limits

    def prior_cost(self, theta: Array) -> float:
        """The prior's part of the cost."""
        return float((theta - self.mean) @ self.precision @ (theta - self.mean))


@dataclass(frozen=True)
class _Joint:
    """The stages at one joint parameter vector ``theta`` ``(U,)``; a point of `clampid.fitting.descent.descend`."""

    theta: Array
    points: tuple[Point, ...]
    columns: tuple[Integers, ...]

    @property
    def cost(self) -> float:
        """Sum of squares of the whitened residuals of all stages."""
        return sum(p.cost for p in self.points)

    @property
    def count(self) -> int:
        """Number of their entries."""
        return sum(p.count for p in self.points)

    def normal(self) -> tuple[Array, Array]:
        """Normal matrix ``(U, U)`` and downhill gradient ``(U,)``."""
        return self.weighted(np.ones(len(self.points)))

    def weighted(self, weights: Array) -> tuple[Array, Array]:
        """Sums of the normal matrices ``(U, U)`` and gradients ``(U,)`` of the stages, times ``weights`` (stages,)."""
        A, g = np.zeros((len(self.theta), len(self.theta))), np.zeros(len(self.theta))
        for point, columns, weight in zip(self.points, self.columns, weights, strict=True):
            own, slope = point.normal()
            A[np.ix_(columns, columns)] += weight * own
            g[columns] += weight * slope
        return A, g


def fit_jointly(parts: Sequence[JointPart]) -> list[JointPart]:
    """Fit several stages jointly, starting from their separate fits.

    Parameters
    ----------
    parts
        The stages, each fitted alone to its own rows.

    Returns
    -------
    list
        The stages at the joint solution, with a ``carried_prior`` in their models.

    Raises
    ------
    clampid.fitting.solve.FitError
        A stage gives no finite prediction.
    """
    union = _union(parts)
    best = settled(
        _start(parts, union),
        lambda theta: [_problem(p).with_flanks(theta[c]) for p, c in zip(parts, union.columns, strict=True)],
        lambda frozen, theta: _search(parts, frozen, union, theta),
        lambda frozen, theta: _at(parts, frozen, union, theta).cost + union.prior_cost(theta),
    )
    weights = _weights(best, union)
    covariance = _covariance(parts, best, union, weights)
    out: list[JointPart] = []
    for k, (part, columns) in enumerate(zip(parts, union.columns, strict=True)):
        carried_prior = _prior_of_the_others(best, union, weights, k, _problem(part))
        own, spread = best.theta[columns], covariance[np.ix_(columns, columns)]
        if isinstance(part, FittedLog):
            out.append(part.with_solution(own, spread, carried_prior))
        else:
            out.append(part.with_estimate(_estimate(part, own, spread, carried_prior), carried_prior))
    return out


def _union(parts: Sequence[JointPart]) -> _Union:
    """The joint parameter vector of the stages; a shared parameter has one number in it."""
    shared = shared_slots(parts)
    number: dict[Key, int] = {}
    columns = []
    for part in parts:
        trial = _problem(part)
        own: list[int] = []
        for slot in trial.slots:
            own.append(number.setdefault((None if slot in shared else trial.stage, slot), len(number)))
        own += [number.setdefault((trial.stage, j), len(number)) for j in range(trial.offsets)]
        columns.append(np.array(own, dtype=np.int64))
    size = len(number)
    mean, precision = np.zeros(size), np.zeros((size, size))
    scale, lower, upper, bounded = np.ones(size), np.full(size, -np.inf), np.full(size, np.inf), np.zeros(size, bool)
    for part, here in zip(parts, columns, strict=True):
        trial = _problem(part)
        own_precision, own_mean = prior_of(trial, description_priors(trial.rows))
        precision[np.ix_(here, here)] = own_precision
        limits = limits_of(trial)
        scale[here], lower[here], upper[here] = limits.size, limits.lower, limits.upper
        bounded[here] |= limits.bounded
        mean[here] = np.where(trial.centred(), _alone(part), own_mean)
    return _Union(tuple(columns), precision, mean, Limits(scale, lower, upper, bounded))


def shared_slots(parts: Sequence[JointPart]) -> frozenset[Slot]:
    """The parameters that have one value in several of these stages."""
    contradicted = any(isinstance(p, FittedStage) and p.contradicted for p in parts)
    count: Counter[Slot] = Counter()
    for trial in map(_problem, parts):
        count.update(
            s
            for s in trial.slots
            if is_shared(trial.effects[s.effect]) and not (contradicted and is_of_drives(trial.effects[s.effect]))
        )
    return frozenset(slot for slot, stages in count.items() if stages > 1)


def _start(parts: Sequence[JointPart], union: _Union) -> Array:
    """Initial values ``(U,)``: the mean of the separate fits and the prior, weighted by their information.

    With one stage's values of the shared parameters, the constants of another stage's sweeps would be far from their
    best values. Where clearances open and close, a search from there may find no lower cost.
    """
    A, b = union.precision.copy(), union.precision @ union.mean
    for part, columns in zip(parts, union.columns, strict=True):
        alone = _alone(part)
        own, slope = _point(part, _problem(part), alone).normal()
        A[np.ix_(columns, columns)] += own
        b[columns] += own @ alone + slope
    return union.limits.clipped(inverse_of(A) @ b)


def _alone(part: JointPart) -> Array:
    """The parameters ``(P + K,)`` of a stage's separate fit, SI."""
    return part.fit.moments.at if isinstance(part, FittedLog) else part.estimate.theta


def _point(part: JointPart, trial: FitProblem, theta: Array) -> Point:
    """One stage at its parameters ``theta`` ``(P + K,)``."""
    if isinstance(part, FittedLog):
        return LogPoint(part.fit.moments.moved(theta))
    return stage_point(trial, part.estimate.noise, theta)


def _search(parts: Sequence[JointPart], frozen: Sequence[FitProblem], union: _Union, start: Array) -> _Joint:
    """The minimum reached from ``start`` ``(U,)``, with frozen flanks."""
    return descend(lambda x: _at(parts, frozen, union, x), start, union.precision, union.mean, union.limits)[0]


def _at(parts: Sequence[JointPart], frozen: Sequence[FitProblem], union: _Union, theta: Array) -> _Joint:
    """The stages at the joint parameter vector ``theta`` ``(U,)``, with frozen flanks."""
    found = (_point(p, e, theta[c]) for p, e, c in zip(parts, frozen, union.columns, strict=True))
    return _Joint(theta, tuple(found), union.columns)


def _problem(part: JointPart) -> FitProblem:
    """The problem of a stage's separate fit."""
    return part.stage.problem if isinstance(part, FittedLog) else part.estimate.problem


def _weights(best: _Joint, union: _Union) -> Array:
    """Reciprocal variance of each stage's whitened residual at the joint solution ``(stages,)``."""
    A, _ = best.normal()
    covariance = inverse_of(A + union.precision)
    out = []
    for point, columns in zip(best.points, best.columns, strict=True):
        determined = float(np.sum(point.normal()[0] * covariance[np.ix_(columns, columns)]))  # degrees of freedom
        out.append(max(point.count - determined, 1.0) / max(point.cost, 1e-12))
    return np.array(out)


def _covariance(parts: Sequence[JointPart], best: _Joint, union: _Union, weights: Array) -> Array:
    """Covariance ``(U, U)`` of the solution, with the robot's repeatability as in `clampid.fitting.visits`.

    It is A^-1 M A^-1, with A the normal matrix and M the covariance of the gradient.
    """
    A, _ = best.normal()
    inverse = inverse_of(A + union.precision)
    middle = union.precision.copy()
    for part, point, columns, weight in zip(parts, best.points, best.columns, weights, strict=True):
        own = point.normal()[0] / weight
        if isinstance(part, FittedStage) and part.estimate.scatter is not None and isinstance(point, StagePoint):
            own = gradient_covariance(part.estimate, point)
        middle[np.ix_(columns, columns)] += own
    size = np.sqrt(np.maximum(np.diag(inverse), 1e-300))  # for numerical balance: parameters have different sizes
    balanced, middle = inverse / np.outer(size, size), middle * np.outer(size, size)
    found = balanced @ middle @ balanced
    return np.asarray(0.5 * (found + found.T) * np.outer(size, size))


def _prior_of_the_others(best: _Joint, union: _Union, weights: Array, k: int, trial: FitProblem) -> Prior:
    """Information of the description and of all rows but those of stage ``k`` on its shared slots, as a prior."""
    others = weights.copy()
    others[k] = 0.0
    A, _ = best.weighted(others)
    covariance = inverse_of(A + union.precision)
    # At the solution the gradients cancel: that of all others, prior and bounds is the opposite of the stage's own.
    pull = np.zeros(len(best.theta))
    pull[best.columns[k]] = -weights[k] * best.points[k].normal()[1]
    mean = best.theta + covariance @ pull
    chosen = [i for i, slot in enumerate(trial.slots) if is_shared(trial.effects[slot.effect])]
    here = best.columns[k][chosen]
    return Prior(tuple(trial.slots[i] for i in chosen), mean[here], covariance[np.ix_(here, here)])


def _estimate(part: FittedStage, theta: Array, covariance: Array, carried_prior: Prior) -> Estimate:
    """A stage's estimate at the joint solution ``theta`` ``(P + K,)``, with its ``covariance``."""
    alone = part.estimate
    point = stage_point(alone.problem, alone.noise, theta)
    precision, mean = prior_of(alone.problem, (carried_prior,))
    return replace(
        alone,
        theta=theta,
        covariance=covariance,
        whitened=point.white,
        residual=point.residual,
        prior_precision=precision,
        prior_mean=np.where(alone.problem.centred(), theta, mean),
    )
