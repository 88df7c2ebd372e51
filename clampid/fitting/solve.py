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
    experiment
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
        In poses, how the noise is shared between the measurement and the robot's own repeatability, where told.
    """

    experiment: FitProblem
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
        return self.experiment.slots

    @property
    def std(self) -> Array:
        """Standard errors ``(P + K,)``."""
        return np.sqrt(np.maximum(np.diag(self.covariance), 0.0))

    @property
    def identified(self) -> Bools:
        """Which parameters ``(P + K,)`` the rows determine to within their reasonable size."""
        return self.std < self.experiment.clear()

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


def stage_point(experiment: FitProblem, noise: Noise, theta: Array) -> StagePoint:
    """One stage at ``theta`` ``(P + K,)``, flanks as they are held.

    Raises
    ------
    FitError
        The model gives no finite prediction.
    """
    residual, jacobian = experiment.residual(theta)
    _must_be_finite(experiment, residual)
    return StagePoint(theta, residual, noise.whiten(experiment.rows, residual, jacobian))


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

    def linear_part(self, experiment: FitProblem, at: Array) -> LinearPart:
        """The linear part of a log's experiment, found at ``(P + K,)`` if it is not known."""
        if self.part is None or not self.part.serves(experiment):
            self.part = LinearPart.of(experiment, at)
        return self.part


def _points(
    experiment: FitProblem, noise: Noise, start: Array, shared: Shared
) -> Callable[[Array], StagePoint | PartedPoint]:
    """What gives the points of a search: of a model linear in its parameters, all from the first.

    Of a log, of which the derivative is large, the linear parameters' is taken from the first point, too.
    """
    if not experiment.kind.moving or not (experiment.affine or not experiment.chain.bends.all()):
        return lambda theta: stage_point(experiment, noise, theta)
    part = shared.linear_part(experiment, start)
    if not experiment.affine:
        return PartedLog.of(experiment, noise, start, part).at
    residual = part.left(start)
    _must_be_finite(experiment, residual)
    white = noise.whiten(experiment.rows, residual, part.columns)
    return lambda theta: StagePoint(theta, part.left(theta), white.moved(theta - start))


def point_at(experiment: FitProblem, noise: Noise, theta: Array) -> StagePoint | AmplitudePoint:
    """The same with a Jacobian that is made when it is asked for, where it is large."""
    if not has_many_amplitudes(experiment, noise):
        return stage_point(experiment, noise, theta)
    return _amplitude_point(experiment, noise, theta)


def _amplitude_point(experiment: FitProblem, noise: Noise, theta: Array) -> AmplitudePoint:
    point = AmplitudePoint.at(experiment, noise, theta)
    _must_be_finite(experiment, point.residual)
    return point


def _must_be_finite(experiment: FitProblem, residual: Array) -> None:
    if not np.all(np.isfinite(residual)):
        raise FitError(f"{experiment.stage}: the model gives no finite prediction; are the units right?")


def limits_of(experiment: FitProblem) -> Limits:
    """Sizes and bounds ``(P + K,)`` of a stage's parameters."""
    lower, upper = experiment.bounds()
    return Limits(experiment.sizes(), lower, upper, experiment.bounded())


def solve(
    experiment: FitProblem,
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
    theta = limits_of(experiment).clipped(theta)

    def cost(held: Sequence[FitProblem], at: Array) -> float:
        return point_at(held[0], noise, at).cost + float((at - mean) @ precision @ (at - mean))

    known: dict[bytes, FitProblem] = {}
    shared = shared or Shared()
    chord = shared.chord if has_many_amplitudes(experiment, noise) else None

    def held_at(at: Array) -> FitProblem:
        """Flanks and loads where a parameter vector puts them, found once."""
        key = at.tobytes()
        if key not in known:
            known[key] = experiment.with_flanks(at)
        return known[key]

    def search(held: Sequence[FitProblem], at: Array) -> _End:
        limits, one = limits_of(experiment), held[0]
        if chord is None:
            return _End(*descend(_points(one, noise, at, shared), at, precision, mean, limits), one)
        return _End(*descend(lambda x: _amplitude_point(one, noise, x), at, precision, mean, limits, chord), one)

    def found(start: Array) -> _End:
        end = settled(start, lambda at: [held_at(at)], search, cost)
        own = held_at(end.theta)  # the flanks and loads that it gives, which its predictions will have
        return end if _follows_alike(end.experiment, own) else end._replace(point=point_at(own, noise, end.theta))

    end = found(theta)
    image = mirrored(experiment, end.theta)
    if image is not None:
        upright = found(image)
        if mirrored(experiment, upright.theta) is None:
            end = upright
    return Estimate(
        experiment=experiment,
        theta=end.theta,
        covariance=end.point.covariance(precision) if errors else np.zeros((0, 0)),
        noise=noise,
        whitened=end.point.white,
        residual=end.point.residual,
        outliers=np.zeros(len(experiment.rows), dtype=bool),
        prior_precision=precision,
        prior_mean=mean,
        iterations=end.iterations,
    )


class _End(NamedTuple):
    """Where a search with flanks held has ended, after how many iterations, and with which experiment."""

    point: StagePoint | PartedPoint | AmplitudePoint
    iterations: int
    experiment: FitProblem

    @property
    def theta(self) -> Array:
        """Where ``(P + K,)``."""
        return self.point.theta


def _follows_alike(held: FitProblem, other: FitProblem) -> bool:
    """Whether two experiments have the same flanks and loads."""
    before, after = held.rows.signals, other.rows.signals
    return before is after or all(np.array_equal(before[name], after[name]) for name in FOLLOWING if name in after)


def prior_of(experiment: FitProblem, priors: Sequence[Prior]) -> tuple[Array, Array]:
    """Precision ``(P + K, P + K)`` and mean: each parameter's own prior, or what earlier stages know of it."""
    precision, mean = experiment.prior()
    index = {slot: k for k, slot in enumerate(experiment.slots)}
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


def holding(experiment: FitProblem, precision: Array, chosen: Sequence[int] | Integers, within: float) -> Array:
    """A prior's precision ``(P + K, P + K)`` with some parameters held at its mean to ``within`` of their sizes."""
    held = precision.copy()
    held[chosen, chosen] += 1.0 / (within * experiment.sizes()[chosen]) ** 2
    return held


def start_of(experiment: FitProblem, start: Mapping[Slot, float] | None, priors: Sequence[Prior]) -> Array:
    """Where a fit begins ``(P + K,)``: what is known, else what the experiment says."""
    theta = experiment.start()
    known = {slot: float(v) for prior in priors for slot, v in zip(prior.slots, prior.mean, strict=True)}
    known |= dict(start or {})
    # A drive without spring would be infinitely stiff, and its torque undefined: the loops' slopes are the start.
    for k, slot in enumerate(experiment.slots):
        if slot in known:
            theta[k] = known[slot]
        elif experiment.kind.solved and experiment.parameters[k].role == "compliance":
            theta[k] = experiment.rows.sweep.loop_compliance[int(slot.place.removeprefix("joint")) - 1]
    if experiment.kind.solved:
        theta[len(experiment.slots) :] = clamping_offsets(experiment, theta)
    return theta


def clamping_offsets(experiment: FitProblem, theta: Array) -> Array:
    """Offsets ``(K,)`` at which, with the measured torques, the sweeps' mean equilibrium holds.

    Of the friction that held motors keep: what their last motion left, or none where that is not known.
    """
    rows, n = experiment.rows, experiment.rows.robot.n
    torque = rows.sweep.start_torque
    d = experiment.chain.evaluate(theta[: len(experiment.slots)], rows.signals, torque)
    wound = rows.sweep.wound + d.values[:, :n]
    run = rows.series.run
    keys, kept = rows.series.offset_keys, rows.sweep.kept_sign * rows.sweep.held_friction
    return np.array([wound[run == s, j].mean() if j < n else kept[s, j - n] for s, j in keys])


def whitened_columns(estimate: Estimate, extra: Sequence[Slot], values: Sequence[float] | Array) -> Whitened:
    """What a unit of each further slot would do, at the given values of the shapes and zero amplitudes."""
    count = len(estimate.slots)
    trial = estimate.experiment.with_slots((*estimate.slots, *extra))
    theta = np.r_[estimate.theta[:count], values, estimate.theta[count:]]
    return estimate.noise.whiten(estimate.experiment.rows, *trial.derivative(theta, count))
