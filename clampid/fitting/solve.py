"""One stage's least squares with a prior: weights given, rows given, the flanks on which gears rest followed."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from clampid.chain.chain import FOLLOWING
from clampid.fitting.descent import Chord, Limits, covariance_of, descend, inverse_of
from clampid.fitting.flanks import mirrored, settled
from clampid.fitting.many_amplitudes import AmplitudePoint, has_many_amplitudes
from clampid.fitting.noise import Noise, Whitened
from clampid.fitting.parted_log import LinearPart, PartedLog, PartedPoint
from clampid.fitting.repeatability import Scatter
from clampid.slots import Prior, Slot
from clampid.stages.fit_problem import FitProblem
from clampid.stages.rows import Array, Bools, Integers

__all__ = [
    "Estimate",
    "FitError",
    "Shared",
    "StagePoint",
    "clamping_offsets",
    "holding",
    "limits_of",
    "point_at",
    "prior_of",
    "solve",
    "stage_point",
    "start_of",
    "whitened_columns",
]


class FitError(ValueError):
    """The rows cannot carry the fit; the message says why."""


@dataclass(frozen=True)
class Estimate:
    """The result of a fit.

    Attributes
    ----------
    problem
        What was fitted; its rows are marked with the outliers found.
    theta, covariance
        ``(P + K,)`` and ``(P + K, P + K)``: values and covariance, SI.
    noise
        The noise model that weighted the rows.
    whitened
        Residual and Jacobian at the solution.
    residual
        ``(N, m)``, SI, of all rows, used or not.
    outliers
        ``(N,)``: rows rejected.
    prior_precision, prior_mean
        The prior that was used.
    scatter
        In poses, how the noise is shared between the measurement and the robot's own repeatability; None if unknown.
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

    @property
    def identified(self) -> Bools:
        """Which parameters ``(P + K,)`` the rows determine to within their reasonable size."""
        return self.std < self.problem.clear()

    @property
    def cost(self) -> float:
        """Whitened squares of rows and prior, flanks as the parameters have them."""
        off = self.theta - self.prior_mean
        return self.point.cost + float(off @ self.prior_precision @ off)

    @property
    def point(self) -> StagePoint:
        """The rows alone, where the fit has ended."""
        return StagePoint(self.theta, self.residual, self.whitened)

    def values(self) -> dict[Slot, float]:
        """Slot → value."""
        return {slot: float(v) for slot, v in zip(self.slots, self.theta, strict=False)}


@dataclass(frozen=True)
class StagePoint:
    """One stage at one parameter vector."""

    theta: Array
    residual: Array
    white: Whitened

    @property
    def matrix(self) -> Array:
        """Normal matrix ``(P, P)``."""
        return self.white.normal

    @property
    def cost(self) -> float:
        """Sum of the whitened squares."""
        return float(self.white.residual @ self.white.residual)

    @property
    def count(self) -> int:
        """How many there are."""
        return len(self.white.residual)

    def normal(self) -> tuple[Array, Array]:
        """Normal matrix and downhill gradient."""
        return self.matrix, self.white.jacobian.T @ self.white.residual

    def covariance(self, precision: Array) -> Array:
        """Covariance ``(P, P)`` of a fit that has ended here, with a prior of ``precision`` ``(P, P)``."""
        return covariance_of(self.matrix, precision, self.cost, self.count)


def stage_point(problem: FitProblem, noise: Noise, theta: Array) -> StagePoint:
    """One stage at ``theta`` ``(P + K,)``, flanks as they are frozen.

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
    """What several searches of the same rows share, which differ in their weights or in which of the rows are used.

    Attributes
    ----------
    chord
        Of hundreds of amplitudes: a normal matrix, which hardly changes.
    part
        Of a log: what its linear parameters do.
    """

    chord: Chord[AmplitudePoint] = field(default_factory=lambda: Chord(AmplitudePoint.gradient))
    part: LinearPart | None = None

    @staticmethod
    def at(matrix: Array) -> Shared:
        """A normal matrix ``(P, P)`` of an earlier search."""
        return Shared(Chord(AmplitudePoint.gradient, matrix))

    def linear_part(self, problem: FitProblem, at: Array) -> LinearPart:
        """The linear part of a log's problem, found at ``(P + K,)`` if it is not known."""
        if self.part is None or not self.part.serves(problem):
            self.part = LinearPart.of(problem, at)
        return self.part


def _points(
    problem: FitProblem, noise: Noise, start: Array, shared: Shared
) -> Callable[[Array], StagePoint | PartedPoint]:
    """What gives the points of a search: of a model linear in its parameters, all from the first.

    Of a log, of which the derivative is large, the linear parameters' is taken from the first point, too.
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
    """The same with a Jacobian that is made when it is asked for, where it is large."""
    if not has_many_amplitudes(problem, noise):
        return stage_point(problem, noise, theta)
    return _amplitude_point(problem, noise, theta)


def _amplitude_point(problem: FitProblem, noise: Noise, theta: Array) -> AmplitudePoint:
    point = AmplitudePoint.at(problem, noise, theta)
    _must_be_finite(problem, point.residual)
    return point


def _must_be_finite(problem: FitProblem, residual: Array) -> None:
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
    """Minimise the whitened squares plus the prior's from ``theta``; no rejection, no reweighting.

    The flanks on which gears rest follow the loads (:mod:`clampid.fitting.flanks`).

    Parameters
    ----------
    errors
        Whether the covariance is wanted; else it is empty. Of hundreds of amplitudes it takes as long as the search.
    shared
        What it has in common with other searches of the same rows. By default nothing.

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
        """Flanks and loads where a parameter vector puts them, found once."""
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
        own = frozen_at(end.theta)  # the flanks and loads that it gives, which its predictions will have
        return end if _follows_alike(end.problem, own) else end._replace(point=point_at(own, noise, end.theta))

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
    """Where a search with flanks frozen has ended, after how many iterations, and with which problem."""

    point: StagePoint | PartedPoint | AmplitudePoint
    iterations: int
    problem: FitProblem

    @property
    def theta(self) -> Array:
        """Where ``(P + K,)``."""
        return self.point.theta


def _follows_alike(frozen: FitProblem, other: FitProblem) -> bool:
    """Whether two experiments have the same flanks and loads."""
    before, after = frozen.rows.signals, other.rows.signals
    return before is after or all(np.array_equal(before[name], after[name]) for name in FOLLOWING if name in after)


def prior_of(problem: FitProblem, priors: Sequence[Prior]) -> tuple[Array, Array]:
    """Precision ``(P + K, P + K)`` and mean: each parameter's own prior, or what earlier stages know of it."""
    precision, mean = problem.prior()
    index = {slot: k for k, slot in enumerate(problem.slots)}
    following: list[tuple[list[int], list[int], Array]] = []
    for prior in priors:
        shared = [k for k, slot in enumerate(prior.slots) if slot in index]
        where = [index[prior.slots[k]] for k in shared]
        if where:
            precision[np.ix_(where, where)] = inverse_of(prior.covariance[np.ix_(shared, shared)])
            mean[where] = prior.mean[shared]
        others = [k for k, slot in enumerate(prior.follows) if slot in index]
        if where and others and prior.slope is not None:
            slope = prior.slope[np.ix_(shared, others)]
            following.append((where, [index[prior.follows[k]] for k in others], slope))
    for where, others, slope in following:  # when all blocks stand: what is followed may have a prior of its own
        own = precision[np.ix_(where, where)]
        precision[np.ix_(where, others)] -= own @ slope
        precision[np.ix_(others, where)] -= (own @ slope).T
        precision[np.ix_(others, others)] += slope.T @ own @ slope
        mean[where] += slope @ mean[others]
    return precision, mean


def holding(problem: FitProblem, precision: Array, chosen: Sequence[int] | Integers, within: float) -> Array:
    """A prior's precision ``(P + K, P + K)`` with some parameters fixed at its mean to ``within`` of their sizes."""
    fixed = precision.copy()
    fixed[chosen, chosen] += 1.0 / (within * problem.sizes()[chosen]) ** 2
    return fixed


def start_of(problem: FitProblem, start: Mapping[Slot, float] | None, priors: Sequence[Prior]) -> Array:
    """Where a fit begins ``(P + K,)``: what is known, else what the problem says."""
    theta = problem.start()
    known = {slot: float(v) for prior in priors for slot, v in zip(prior.slots, prior.mean, strict=True)}
    known |= dict(start or {})
    # A drive without spring would be infinitely stiff, and its torque undefined: the loops' slopes are the start.
    for k, slot in enumerate(problem.slots):
        if slot in known:
            theta[k] = known[slot]
        elif problem.kind.solved and problem.parameters[k].role == "compliance":
            theta[k] = problem.rows.sweep.loop_compliance[int(slot.place.removeprefix("joint")) - 1]
    if problem.kind.solved:
        theta[len(problem.slots) :] = clamping_offsets(problem, theta)
    return theta


def clamping_offsets(problem: FitProblem, theta: Array) -> Array:
    """Offsets ``(K,)`` at which, with the measured torques, the sweeps' mean equilibrium holds.

    The friction of motors at rest is that of their last motion, or zero where that is not known.
    """
    rows, n = problem.rows, problem.rows.robot.n
    torque = rows.sweep.start_torque
    d = problem.chain.evaluate(theta[: len(problem.slots)], rows.signals, torque)
    wound = rows.sweep.wound + d.values[:, :n]
    run = rows.series.run
    keys, kept = rows.series.offset_keys, rows.sweep.kept_sign * rows.sweep.loop_friction
    return np.array([wound[run == s, j].mean() if j < n else kept[s, j - n] for s, j in keys])


def whitened_columns(estimate: Estimate, extra: Sequence[Slot], values: Sequence[float] | Array) -> Whitened:
    """What a unit of each further slot would do, at the given values of the shapes and zero amplitudes."""
    count = len(estimate.slots)
    trial = estimate.problem.with_slots((*estimate.slots, *extra))
    theta = np.r_[estimate.theta[:count], values, estimate.theta[count:]]
    return estimate.noise.whiten(estimate.problem.rows, *trial.derivative(theta, count))
