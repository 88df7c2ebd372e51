"""Least squares of one stage with a prior, for given weights and rows; the gear flanks in contact follow the loads."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from clampid.chain.chain import FOLLOWING
from clampid.fitting.descent import Chord, Limits, covariance_of, descend
from clampid.fitting.flanks import mirrored, settled
from clampid.fitting.many_amplitudes import AmplitudePoint, has_many_amplitudes
from clampid.fitting.noise import Noise, Whitened
from clampid.fitting.parted_log import LinearPart, PartedLog, PartedPoint
from clampid.fitting.repeatability import Scatter
from clampid.slots import Slot
from clampid.stages.fit_problem import FitProblem
from clampid.stages.rows import Array, Bools

__all__ = [
    "Estimate",
    "FitError",
    "Shared",
    "StagePoint",
    "limits_of",
    "point_at",
    "solve",
    "stage_point",
]


class FitError(ValueError):
    """The rows do not allow the fit; the message says why."""


@dataclass(frozen=True)
class Estimate:
    """The result of a fit.

    Attributes
    ----------
    problem
        The problem that was fitted; outliers are marked in its rows.
    theta, covariance
        Values ``(P + K,)`` and covariance ``(P + K, P + K)``, SI.
    noise
        The noise model that weighted the rows.
    whitened
        Residual and Jacobian at the solution.
    residual
        Residual of all rows ``(N, m)``, used or not, SI.
    outliers
        Which rows were rejected ``(N,)``.
    prior_precision, prior_mean
        The prior that was used.
    iterations
        Number of steps of the search.
    scatter
        Poses: variance of the measurement and of the robot's repeatability; None if unknown.
    """

    problem: FitProblem
    theta: Array
    covariance: Array
    noise: Noise
    whitened: Whitened
    residual: Array
    outliers: Bools
    prior_precision: Array
    prior_mean: Array
    iterations: int
    scatter: Scatter | None = None

    @property
    def slots(self) -> tuple[Slot, ...]:
        """The slots of the first P parameters."""
        return self.problem.slots

    @property
    def std(self) -> Array:
        """Standard errors ``(P + K,)``."""
        return np.sqrt(np.maximum(np.diag(self.covariance), 0.0))

    def beyond_bounds(self, errors: float = 0.0) -> Bools:
        """Which parameters ``(P + K,)`` lie beyond their physical bounds by more than so many standard errors."""
        lower, upper = self.problem.bounds()
        margin = errors * self.std
        return np.asarray((self.theta + margin < lower) | (self.theta - margin > upper))

    @property
    def identified(self) -> Bools:
        """Which parameters ``(P + K,)`` have a standard error small enough to count as identified."""
        return self.std < self.problem.clear()

    @property
    def cost(self) -> float:
        """Sum of squares of the whitened rows and the prior."""
        off = self.theta - self.prior_mean
        return self.point.cost + float(off @ self.prior_precision @ off)

    @property
    def point(self) -> StagePoint:
        """The rows without the prior, at the solution."""
        return StagePoint(self.theta, self.residual, self.whitened)

    def values(self) -> dict[Slot, float]:
        """Slot → value, SI, of the first P parameters."""
        return {slot: float(v) for slot, v in zip(self.slots, self.theta, strict=False)}


@dataclass(frozen=True)
class StagePoint:
    """One stage at one parameter vector.

    Attributes
    ----------
    theta
        Parameters ``(P,)``, SI.
    residual
        ``(N, m)``, SI.
    white
        Residual and Jacobian, whitened.
    """

    theta: Array
    residual: Array
    white: Whitened

    @property
    def matrix(self) -> Array:
        """Normal matrix ``(P, P)``."""
        return self.white.normal

    @property
    def cost(self) -> float:
        """Sum of squares of the whitened residual."""
        return float(self.white.residual @ self.white.residual)

    @property
    def count(self) -> int:
        """Number of entries of the whitened residual."""
        return len(self.white.residual)

    def normal(self) -> tuple[Array, Array]:
        """Normal matrix ``(P, P)`` and downhill gradient ``(P,)``."""
        return self.matrix, self.white.jacobian.T @ self.white.residual

    def covariance(self, precision: Array) -> Array:
        """Covariance ``(P, P)`` of a fit with its minimum here; ``precision`` ``(P, P)`` is that of the prior."""
        return covariance_of(self.matrix, precision, self.cost, self.count)


def stage_point(problem: FitProblem, noise: Noise, theta: Array) -> StagePoint:
    """One stage at parameters ``theta`` ``(P + K,)``, with its flanks frozen.

    Raises
    ------
    FitError
        The model gives no finite prediction.
    """
    residual, jacobian = problem.residual(theta)
    _must_be_finite(problem, residual)
    return StagePoint(theta, residual, noise.whiten(problem.rows, residual, jacobian))


@dataclass
class Shared:
    """Results that several searches of the same rows share; the searches differ in weights or in the rows used.

    Attributes
    ----------
    chord
        For models with hundreds of amplitudes: a normal matrix, which hardly changes.
    part
        For torque logs: the linear part of the model.
    """

    chord: Chord[AmplitudePoint] = field(default_factory=lambda: Chord(AmplitudePoint.gradient))
    part: LinearPart | None = None

    @staticmethod
    def at(matrix: Array) -> Shared:
        """Start from the normal matrix ``(P, P)`` of an earlier search."""
        return Shared(Chord(AmplitudePoint.gradient, matrix))

    def linear_part(self, problem: FitProblem, at: Array) -> LinearPart:
        """The linear part of a log's problem; computed at parameters ``at`` ``(P + K,)`` if it is not known."""
        if self.part is None or not self.part.serves(problem):
            self.part = LinearPart.of(problem, at)
        return self.part


def _points(
    problem: FitProblem, noise: Noise, start: Array, shared: Shared
) -> Callable[[Array], StagePoint | PartedPoint]:
    """The function that gives the points of a search.

    For a log whose model is linear in all parameters, all points follow from the first. For one that is linear in some,
    their columns are computed at the first point.
    """
    if not problem.kind.moving or not (problem.affine or not problem.chain.bends.all()):
        return lambda theta: stage_point(problem, noise, theta)
    part = shared.linear_part(problem, start)
    if not problem.affine:
        return PartedLog.of(problem, noise, start, part).at
    residual = part.left(start)
    _must_be_finite(problem, residual)
    white = noise.whiten(problem.rows, residual, part.columns)
    return lambda theta: StagePoint(theta, part.left(theta), white.moved(theta - start))


def point_at(problem: FitProblem, noise: Noise, theta: Array) -> StagePoint | AmplitudePoint:
    """One stage at parameters ``theta`` ``(P + K,)``; a large Jacobian is computed only when it is used.

    Raises
    ------
    FitError
        The model gives no finite prediction.
    """
    if not has_many_amplitudes(problem, noise):
        return stage_point(problem, noise, theta)
    return _amplitude_point(problem, noise, theta)


def _amplitude_point(problem: FitProblem, noise: Noise, theta: Array) -> AmplitudePoint:
    """One stage with many amplitudes at parameters ``theta`` ``(P + K,)``; raises :class:`FitError`."""
    point = AmplitudePoint.at(problem, noise, theta)
    _must_be_finite(problem, point.residual)
    return point


def _must_be_finite(problem: FitProblem, residual: Array) -> None:
    """Raise :class:`FitError` unless the residual is finite."""
    if not np.all(np.isfinite(residual)):
        raise FitError(f"{problem.stage}: the model gives no finite prediction; are the units right?")


def limits_of(problem: FitProblem) -> Limits:
    """Sizes and bounds ``(P + K,)`` of a stage's parameters."""
    lower, upper = problem.bounds()
    return Limits(problem.sizes(), lower, upper, problem.bounded())


def solve(
    problem: FitProblem,
    theta: Array,
    noise: Noise,
    precision: Array,
    mean: Array,
    *,
    errors: bool = True,
    shared: Shared | None = None,
) -> Estimate:
    """Minimise the sum of squares of whitened rows and prior; outliers are not rejected, nor weights changed.

    The flanks on which gears rest follow the loads (:mod:`clampid.fitting.flanks`).

    Parameters
    ----------
    problem, noise
        What is fitted, and the noise that weights the rows.
    theta
        Initial values ``(P + K,)``, SI.
    precision, mean
        The prior: ``(P + K, P + K)`` and ``(P + K,)``.
    errors
        Whether the covariance is computed; otherwise it is empty. For hundreds of amplitudes it takes as long as the
        search.
    shared
        Results from other searches of the same rows.

    Raises
    ------
    FitError
        The model gives no finite prediction.
    """
    theta = limits_of(problem).clipped(theta)

    def cost(frozen: Sequence[FitProblem], at: Array) -> float:
        return point_at(frozen[0], noise, at).cost + float((at - mean) @ precision @ (at - mean))

    known: dict[bytes, FitProblem] = {}
    shared = shared or Shared()
    chord = shared.chord if has_many_amplitudes(problem, noise) else None

    def frozen_at(at: Array) -> FitProblem:
        """The problem with flanks and loads as they are at parameters ``at``, cached."""
        key = at.tobytes()
        if key not in known:
            known[key] = problem.with_flanks(at)
        return known[key]

    def search(frozen: Sequence[FitProblem], at: Array) -> _End:
        limits, one = limits_of(problem), frozen[0]
        if chord is None:
            return _End(*descend(_points(one, noise, at, shared), at, precision, mean, limits), one)
        return _End(*descend(lambda x: _amplitude_point(one, noise, x), at, precision, mean, limits, chord), one)

    def found(start: Array) -> _End:
        end = settled(start, lambda at: [frozen_at(at)], search, cost)
        own = frozen_at(end.theta)  # predictions with the found parameters will have these flanks and loads
        return end if _same_flanks_and_loads(end.problem, own) else end._replace(point=point_at(own, noise, end.theta))

    end = found(theta)
    image = mirrored(problem, end.theta)
    if image is not None:
        upright = found(image)
        if mirrored(problem, upright.theta) is None:
            end = upright
    return Estimate(
        problem=problem,
        theta=end.theta,
        covariance=end.point.covariance(precision) if errors else np.zeros((0, 0)),
        noise=noise,
        whitened=end.point.white,
        residual=end.point.residual,
        outliers=np.zeros(len(problem.rows), dtype=bool),
        prior_precision=precision,
        prior_mean=mean,
        iterations=end.iterations,
    )


class _End(NamedTuple):
    """The end of a search with frozen flanks: its point, number of iterations, and problem."""

    point: StagePoint | PartedPoint | AmplitudePoint
    iterations: int
    problem: FitProblem

    @property
    def theta(self) -> Array:
        """Parameters ``(P + K,)`` at the end, SI."""
        return self.point.theta


def _same_flanks_and_loads(frozen: FitProblem, other: FitProblem) -> bool:
    """Whether two problems have the same flanks and loads."""
    before, after = frozen.rows.signals, other.rows.signals
    return before is after or all(np.array_equal(before[name], after[name]) for name in FOLLOWING if name in after)
