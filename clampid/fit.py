"""The fit: damped Gauss-Newton on scaled, whitened normal equations with a weak prior, robust against wrong rows."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Protocol, TypeVar

import numpy as np
from scipy import linalg, stats

from clampid.flanks import mirrored, settled
from clampid.held_motors import other_crossings
from clampid.noise import NORMAL, Noise, Whitened, initial_noise, learn_noise
from clampid.repeatability import Scatter, clustered_covariance, shared_moments, visit_scatter
from clampid.slots import Prior, Slot
from clampid.stages.clamped import BLOCK_ROWS, loop_compliance
from clampid.stages.experiment import HELD, Experiment
from clampid.stages.rows import Array, Bools, Integers, Rows

__all__ = [
    "ITERATIONS",
    "NEGLIGIBLE",
    "Estimate",
    "FitError",
    "Limits",
    "Point",
    "StagePoint",
    "clamping_offsets",
    "descend",
    "fit",
    "gradient_covariance",
    "inverse_of",
    "limits_of",
    "newton_step",
    "prior_of",
    "solve",
    "stage_point",
    "start_of",
]

OUTLIER_RATE = 0.01  # chance that a clean table has a row called an outlier
OUTLIER_PASSES = 3
OUTLIER_SHARE = 0.05  # more than this is not outliers but structure: then nothing is rejected
ITERATIONS = 30
CROSSING_PASSES = 2
FIRST = 0.01  # of its friction: by how much a held motor may at first be off what it is taken to have kept
DAMPING_START, DAMPING_END = 1e-3, 1e8
IDLE_GAIN, IDLE_STEPS = 1e-6, 3  # so many steps that gain less than this share of the cost end the search
SHOWN = 3.0  # standard errors: a spring that is not known, and still no chance
WORSE = 1.0  # of chi-square: what a number that is not there would gain by chance on average
NEGLIGIBLE = 1e-3  # a step that promises less than this of a unit of chi-square moves nothing by its error


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

    experiment: Experiment
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
        """Which parameters ``(P + K,)`` the rows tell to within their reasonable size."""
        return self.std < self.experiment.clear()

    def values(self) -> dict[Slot, float]:
        """Slot → value."""
        return {slot: float(v) for slot, v in zip(self.slots, self.theta, strict=False)}


def fit(
    experiment: Experiment,
    priors: Sequence[Prior] = (),
    start: Mapping[Slot, float] | None = None,
    *,
    reject: bool = True,
    noise: Noise | None = None,
) -> Estimate:
    """Fit the experiment's slots to its rows.

    Weighted first by what the instrument states, then by what the residual shows, in two rounds; in between, rows
    whose residual a clean table would show with a chance of 1 % are rejected, in at most three passes.

    Raises
    ------
    FitError
        There are no rows to fit, or no finite solution.
    """
    if not experiment.rows.used.any():
        raise FitError(f"{experiment.stage}: no rows can be used: no motor moves, or every row is an outlier")
    precision, mean = prior_of(experiment, priors)
    theta = start_of(experiment, start, priors)
    mean = np.where(experiment.held(), theta, mean)
    rejected = np.zeros(len(experiment.rows), dtype=bool)
    model = noise or initial_noise(experiment.rows)
    theta = _kept_first(experiment, theta, model, precision, mean)
    estimate = _past_clearances(solve(experiment, theta, model, precision, mean))
    for _ in range(OUTLIER_PASSES if reject else 0):
        bad = _outliers(experiment.rows, estimate.residual) & ~rejected
        if not bad.any() or (bad | rejected).mean() > OUTLIER_SHARE:
            break
        rejected |= bad
        experiment = experiment.with_rows(experiment.rows.without(bad))
        estimate = solve(experiment, estimate.theta, model, precision, mean)
    if noise is None:
        for _ in range(1 if experiment.stage == "poses" else 2):
            model = learn_noise(experiment.rows, estimate.residual, _absorbed(estimate))
            if experiment.stage == "free_air" and estimate.noise.settled(model):
                break
            estimate = solve(experiment, estimate.theta, model, precision, mean)
    if experiment.stage == "poses":
        estimate = _with_repeatability(_without_unknown_friction(estimate))
    return replace(estimate, outliers=rejected)


def _yields(experiment: Experiment) -> bool:
    """Whether what holds a clamped arm moves in the model, so that torques of held joints change."""
    return any("fixture" in experiment.effects[slot.effect].acts for slot in experiment.slots)


def _kept_first(experiment: Experiment, theta: Array, noise: Noise, precision: Array, mean: Array) -> Array:
    """Where the search of a clamped arm begins: found with held motors' friction as their last motion left it.

    Springs, and a block of which nothing is known yet, would else draw that friction to where other clearances are
    crossed, and a search does not come back from there.
    """
    if not _yields(experiment):
        return theta
    motors = experiment.rows.constants["offset_keys"][:, 1] >= experiment.rows.robot.n
    kept = len(experiment.slots) + np.flatnonzero(motors)
    held = _holding(experiment, precision, kept, FIRST)
    return solve(experiment, theta, noise, held, mean).theta if len(kept) else theta


def _holding(experiment: Experiment, precision: Array, chosen: Sequence[int] | Integers, within: float) -> Array:
    """A prior's precision ``(P + K, P + K)`` with some parameters held at its mean to ``within`` of their sizes."""
    held = precision.copy()
    held[chosen, chosen] += 1.0 / (within * experiment.sizes()[chosen]) ** 2
    return held


def _past_clearances(estimate: Estimate) -> Estimate:
    """The estimate, or a likelier one, of a clamped arm whose held joints cross their clearances elsewhere."""
    if not _yields(estimate.experiment):
        return estimate
    noise, precision, mean = estimate.noise, estimate.prior_precision, estimate.prior_mean
    for _ in range(CROSSING_PASSES):
        other = other_crossings(estimate.experiment, noise, estimate.theta, precision, mean)
        if other is None:
            return estimate
        found = solve(estimate.experiment, other, noise, precision, mean)
        if not _unlikely(found) < _unlikely(estimate):
            return estimate
        estimate = found
    return estimate


def _unlikely(estimate: Estimate) -> float:
    """-2 log of the evidence of where a search has ended, by Laplace's approximation."""
    white, off = estimate.whitened, estimate.theta - estimate.prior_mean
    size = estimate.experiment.sizes()
    A = (white.jacobian.T @ white.jacobian + estimate.prior_precision) * np.outer(size, size)
    return float(white.residual @ white.residual + off @ estimate.prior_precision @ off + np.linalg.slogdet(A)[1])


def again(estimate: Estimate, experiment: Experiment, none: Sequence[int]) -> Estimate:
    """The same pose fit of another experiment with the same parameters and rows: noise, prior and outliers stay.

    Frictions ``none`` stay at zero, for the reason that :func:`_without_unknown_friction` gives.
    """
    found = _without_unknown_friction(_at_no_friction(replace(estimate, experiment=experiment), none))
    return replace(_with_repeatability(found), outliers=estimate.outliers)


def gradient_covariance(estimate: Estimate, point: StagePoint) -> Array:
    """Covariance ``(P + K, P + K)`` of the gradient of a pose fit whose visits share where the robot has stopped.

    Parameters
    ----------
    estimate
        A pose fit with a ``scatter``.
    point
        Where the gradient is taken, with the same rows and noise.
    """
    if estimate.scatter is None:
        raise ValueError("expected a fit of poses that tells measurement and repeatability apart, found none")
    white = point.white
    by_joint, visit = _by_joint(estimate, white, point.theta)
    return shared_moments(white.jacobian, by_joint, visit, estimate.scatter)


def variance_along(estimate: Estimate, chosen: Integers) -> float:
    """Variance of the whitened numbers of a pose fit along some parameters, what visits share included."""
    white = estimate.whitened
    if estimate.scatter is None:
        return float(white.residual @ white.residual / max(len(white.residual) - white.jacobian.shape[1], 1))
    moments = gradient_covariance(estimate, StagePoint(estimate.theta, estimate.residual, white))
    squares = np.sum(white.jacobian[:, chosen] ** 2)
    return float(np.trace(moments[np.ix_(chosen, chosen)]) / squares)


def _by_joint(estimate: Estimate, white: Whitened, theta: Array) -> tuple[Array, Integers]:
    """What a joint's stop does to each whitened number ``(M, n)``, and the visit ``(M,)`` that each is of."""
    rows = estimate.experiment.rows
    by_joint = rows.in_noise_axes(estimate.experiment.by_joint(theta))[white.entry, white.channel]
    return by_joint / estimate.noise.sigma[white.entry, white.channel, None], rows.unit[white.entry]


def unknown_frictions(estimate: Estimate) -> list[int]:
    """Numbers of the arm-side frictions that a fit's rows do not tell.

    Where only the product with the spring's compliance shows, a friction that nothing else says anything of is as
    unknown as the spring.
    """
    springs = {estimate.slots[k].place for k in _untold_springs(estimate)}
    weak = np.sqrt(np.diag(estimate.prior_precision)) * estimate.experiment.prior_std() < 1.0 + 1e-9
    slots = enumerate(zip(estimate.slots, estimate.identified, strict=False))
    frictions = [(k, slot, told) for k, (slot, told) in slots if slot.effect == "wrist_coupling_friction"]
    return [k for k, slot, told in frictions if not told or (weak[k] and slot.place in springs)]


def _untold_springs(estimate: Estimate) -> list[int]:
    """Numbers of the compliances that a fit's rows do not tell, nor set apart from what springs are taken for."""
    clear = np.abs(estimate.theta - estimate.prior_mean) > SHOWN * estimate.std
    slots = enumerate(zip(estimate.slots, estimate.identified | clear, strict=False))
    return [k for k, (slot, told) in slots if slot.effect == "joint_compliance" and not told]


def _without_unknown_friction(estimate: Estimate) -> Estimate:
    """The same pose fit with frictions of zero where the rows do not tell them, and its covariance there.

    What a joint yields to its dry friction is a product c F. Where neither is known by itself and the product is small,
    F has some value by chance, and the linearised fit would take c for known through it; and whoever propagates an
    unknown c at that F would take the product for unknown, which is known. At F = 0 both are right, where the rest of
    the model reproduces the rows as well. Where it does not, only the covariance is that at F = 0. A spring that no row
    tells is there as stiff as springs are: through one that is soft by chance F would seem known.
    """
    experiment, precision, mean = estimate.experiment, estimate.prior_precision, estimate.prior_mean

    def cost(at: Estimate) -> float:
        return _cost(experiment.with_flanks(at.theta), at.theta, estimate.noise, precision, mean)

    found, reached = estimate, cost(estimate)
    gone: list[int] = []
    shown: list[int] = []
    for k in unknown_frictions(estimate):
        without = _at_no_friction(found, [*gone, k])
        if cost(without) - reached < WORSE * len(_moot(found, [*gone, k])[0]):
            found, gone = without, [*gone, k]
        elif not estimate.identified[k]:
            shown.append(k)
    if not shown:
        return found
    theta = found.theta.copy()
    moot, value = _moot(found, shown)
    theta[moot] = value
    # The flanks stay those of the fit.
    there = stage_point(experiment.with_flanks(found.theta), estimate.noise, theta)
    white = replace(found.whitened, jacobian=there.white.jacobian)
    normal = white.jacobian.T @ white.jacobian
    return replace(found, whitened=white, covariance=_covariance(white, precision, normal))


def _at_no_friction(estimate: Estimate, unknown: Sequence[int]) -> Estimate:
    """The fit with some frictions held at none, its covariance as if they were free there."""
    experiment, precision, mean = estimate.experiment, estimate.prior_precision, estimate.prior_mean
    moot, value = _moot(estimate, unknown)
    theta, at_zero, held = estimate.theta.copy(), mean.copy(), _holding(experiment, precision, moot, HELD)
    theta[moot] = at_zero[moot] = value
    found = solve(experiment, theta, estimate.noise, held, at_zero)
    white = found.whitened
    covariance = _covariance(white, precision, white.jacobian.T @ white.jacobian)
    return replace(found, covariance=covariance, prior_precision=precision, prior_mean=mean)


def _moot(estimate: Estimate, unknown: Sequence[int]) -> tuple[list[int], Array]:
    """Numbers of frictions and of untold springs that they wind up, and the values where they do nothing."""
    places = {estimate.slots[k].place for k in unknown}
    springs = [k for k in _untold_springs(estimate) if estimate.slots[k].place in places]
    return [*unknown, *springs], np.r_[np.zeros(len(unknown)), estimate.prior_mean[springs]]


def _cost(held: Experiment, theta: Array, noise: Noise, precision: Array, mean: Array) -> float:
    """Whitened squares of the rows, flanks held, and of a prior at ``theta`` ``(P + K,)``."""
    return stage_point(held, noise, theta).cost + float((theta - mean) @ precision @ (theta - mean))


def _with_repeatability(estimate: Estimate) -> Estimate:
    """The same fit, its covariance that of visits whose numbers share where the robot has stopped."""
    white = estimate.whitened
    by_joint, visit = _by_joint(estimate, white, estimate.theta)
    inverse = inverse_of(white.jacobian.T @ white.jacobian + estimate.prior_precision)
    scatter = visit_scatter(white, by_joint, visit, inverse)
    if scatter is None:
        return estimate
    return replace(
        estimate,
        covariance=clustered_covariance(white, by_joint, visit, estimate.prior_precision, scatter, inverse),
        scatter=scatter,
    )


def _absorbed(estimate: Estimate) -> Array | None:
    """A square root ``(N, m, P + K)`` of the covariance of what a fit predicts; None in poses.

    There every row has few neighbours and the noise one scale, so that what is absorbed is a count of parameters.
    """
    if estimate.experiment.stage != "clamped":
        return None
    _, jacobian = estimate.experiment.residual(estimate.theta)
    size = estimate.experiment.sizes()
    values, vectors = linalg.eigh(estimate.covariance / np.outer(size, size))
    root = size[:, None] * vectors * np.sqrt(np.maximum(values, 0.0))
    return np.asarray(jacobian @ root)


class Point(Protocol):
    """The cost and its local quadratic model at one parameter vector, prior left out."""

    @property
    def theta(self) -> Array:
        """Where ``(P,)``."""

    @property
    def cost(self) -> float:
        """Sum of the whitened squares."""

    @property
    def count(self) -> int:
        """How many there are."""

    def normal(self) -> tuple[Array, Array]:
        """Normal matrix ``(P, P)`` and downhill gradient ``(P,)`` of half the cost."""


PointT = TypeVar("PointT", bound=Point)


@dataclass(frozen=True)
class StagePoint:
    """One stage at one parameter vector."""

    theta: Array
    residual: Array
    white: Whitened

    @cached_property
    def matrix(self) -> Array:
        """Normal matrix ``(P, P)``."""
        return np.asarray(self.white.jacobian.T @ self.white.jacobian)

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


def stage_point(experiment: Experiment, noise: Noise, theta: Array) -> StagePoint:
    """One stage at ``theta`` ``(P + K,)``, flanks as they are held.

    Raises
    ------
    FitError
        The model gives no finite prediction.
    """
    residual, jacobian = experiment.residual(theta)
    if not np.all(np.isfinite(residual)):
        raise FitError(f"{experiment.stage}: the model gives no finite prediction; are the units right?")
    return StagePoint(theta, residual, noise.whiten(experiment.rows, residual, jacobian))


@dataclass(frozen=True)
class Limits:
    """What a search keeps to: sizes that scale it, bounds, and which parameters ``(P,)`` they hold."""

    size: Array
    lower: Array
    upper: Array
    bounded: Bools

    def clipped(self, theta: Array) -> Array:
        """A parameter vector ``(P,)`` brought back within the bounds that hold."""
        return np.where(self.bounded, np.clip(theta, self.lower, self.upper), theta)

    def resting(self, theta: Array) -> Bools:
        """Which parameters ``(P,)`` rest on a bound that holds."""
        return np.asarray(self.bounded & ((theta <= self.lower) | (theta >= self.upper)))


def limits_of(experiment: Experiment) -> Limits:
    """Sizes and bounds ``(P + K,)`` of a stage's parameters."""
    lower, upper = experiment.bounds()
    return Limits(experiment.sizes(), lower, upper, experiment.bounded())


def solve(experiment: Experiment, theta: Array, noise: Noise, precision: Array, mean: Array) -> Estimate:
    """Minimise the whitened squares plus the prior's from ``theta``; no rejection, no reweighting.

    The flanks on which gears rest follow the loads (:mod:`clampid.flanks`).

    Raises
    ------
    FitError
        The model gives no finite prediction.
    """
    theta = limits_of(experiment).clipped(theta)

    def cost(held: Sequence[Experiment], at: Array) -> float:
        return _cost(held[0], at, noise, precision, mean)

    def found(start: Array) -> Estimate:
        end = settled(
            start,
            lambda at: [experiment.with_flanks(at)],
            lambda held, at: _search(held[0], at, noise, precision, mean),
            cost,
        )
        return _at_its_own(end, experiment.with_flanks(end.theta))

    estimate = found(theta)
    image = mirrored(experiment, estimate.theta)
    if image is not None:
        upright = found(image)
        if mirrored(experiment, upright.theta) is None:
            estimate = upright
    return replace(estimate, experiment=experiment)


def _at_its_own(estimate: Estimate, held: Experiment) -> Estimate:
    """The estimate on the flanks and loads that it gives, which its predictions will have."""
    if held.rows.signals is estimate.experiment.rows.signals:
        return estimate
    there = stage_point(held, estimate.noise, estimate.theta)
    covariance = _covariance(there.white, estimate.prior_precision, there.matrix)
    return replace(estimate, whitened=there.white, residual=there.residual, covariance=covariance)


def _search(experiment: Experiment, theta: Array, noise: Noise, precision: Array, mean: Array) -> Estimate:
    """Damped Gauss-Newton with flanks held."""
    best, iterations = descend(
        lambda at: stage_point(experiment, noise, at), theta, precision, mean, limits_of(experiment)
    )
    return Estimate(
        experiment=experiment,
        theta=best.theta,
        covariance=_covariance(best.white, precision, best.matrix),
        noise=noise,
        whitened=best.white,
        residual=best.residual,
        outliers=np.zeros(len(experiment.rows), dtype=bool),
        prior_precision=precision,
        prior_mean=mean,
        iterations=iterations,
    )


def _covariance(white: Whitened, precision: Array, normal: Array) -> Array:
    """Covariance ``(P, P)`` of a fit of independent numbers, of which the residual says the scale."""
    inverse = inverse_of(normal + precision)
    told = len(inverse) - float(np.sum(inverse * precision))  # parameters that the rows tell, not the prior
    scale = float(white.residual @ white.residual) / max(len(white.residual) - told, 1.0)
    return np.asarray(inverse * max(scale, 1e-12))


def descend(
    at: Callable[[Array], PointT], theta: Array, precision: Array, mean: Array, limits: Limits
) -> tuple[PointT, int]:
    """The lowest point from ``theta`` downhill, prior included, by damped Gauss-Newton; and the iterations it took.

    Parameters
    ----------
    at
        The cost at a parameter vector.
    precision, mean
        The prior: ``(P, P)`` and ``(P,)``.
    """

    def whole(point: PointT) -> float:
        off = point.theta - mean
        return point.cost + float(off @ precision @ off)

    def normal(point: PointT) -> tuple[Array, Array]:
        A, g = point.normal()
        return A + precision, g - precision @ (point.theta - mean)

    best = at(theta)
    cost, (A, g) = whole(best), normal(best)
    damping, idle, iteration = 0.0, 0, 0
    while iteration < ITERATIONS and idle <= IDLE_STEPS and damping < DAMPING_END:
        iteration += 1
        # A parameter that rests on its bound and would leave it stays there, so that the others' step is their own.
        on_bound = ((best.theta <= limits.lower) & (g < 0)) | ((best.theta >= limits.upper) & (g > 0))
        step = newton_step(A, g, limits.size, damping, ~(limits.bounded & on_bound))
        if float(g @ step) < NEGLIGIBLE * max(1.0, cost / max(best.count, 1)):
            break
        moved = best.theta + step
        trial = at(limits.clipped(moved))
        reached = whole(trial)
        if reached > cost:
            damping = max(10 * damping, DAMPING_START)
            continue
        # Where gaps close, the cost has kinks, along which steps zigzag without getting anywhere.
        idle = idle + 1 if reached > cost * (1 - IDLE_GAIN) else 0
        best, cost = trial, reached
        A, g = normal(best)
        damping = 0.0 if damping < DAMPING_START else damping / 10
    return best, iteration


def inverse_of(A: Array) -> Array:
    """Inverse of a normal matrix, its columns balanced first.

    The prior makes it definite. A pseudo-inverse would drop, as numerically zero, the directions of which only the
    prior knows anything, and give them no error at all where it is largest.
    """
    balance = 1.0 / np.sqrt(np.maximum(np.diag(A), 1e-300))
    scaled = A * np.outer(balance, balance)
    try:
        inverse = linalg.cho_solve(linalg.cho_factor(scaled), np.eye(len(A)))
    except linalg.LinAlgError:
        inverse = linalg.pinvh(scaled)
    inverse = 0.5 * (inverse + inverse.T)
    return np.asarray(inverse * np.outer(balance, balance))


def newton_step(A: Array, g: Array, size: Array, damping: float, free: Bools) -> Array:
    """Solve the normal equations of the free parameters, scaled by what each may amount to and by its column."""
    out = np.zeros_like(g)
    A, g, size = A[np.ix_(free, free)], g[free], size[free]
    balance = size / np.sqrt(np.maximum(np.diag(A) * size**2, 1e-300))
    scaled = A * np.outer(balance, balance) + damping * np.eye(len(g))
    try:
        step = linalg.cho_solve(linalg.cho_factor(scaled), g * balance)
    except linalg.LinAlgError:
        step = linalg.pinvh(scaled) @ (g * balance)
    out[free] = step * balance
    return out


def prior_of(experiment: Experiment, priors: Sequence[Prior]) -> tuple[Array, Array]:
    """Precision ``(P + K, P + K)`` and mean: each parameter's own prior, or what earlier stages know of it."""
    precision, mean = experiment.prior()
    for prior in priors:
        index = {slot: k for k, slot in enumerate(experiment.slots)}
        shared = [k for k, slot in enumerate(prior.slots) if slot in index]
        where = [index[prior.slots[k]] for k in shared]
        if where:
            precision[np.ix_(where, where)] = inverse_of(prior.covariance[np.ix_(shared, shared)])
            mean[where] = prior.mean[shared]
    return precision, mean


def start_of(experiment: Experiment, start: Mapping[Slot, float] | None, priors: Sequence[Prior]) -> Array:
    """Where a fit begins ``(P + K,)``: what is known, else what the experiment says."""
    theta = experiment.start()
    known = {slot: float(v) for prior in priors for slot, v in zip(prior.slots, prior.mean, strict=True)}
    known |= dict(start or {})
    # A drive without spring would be infinitely stiff, and its torque undefined: the loops' slopes are the start.
    stiffness = loop_compliance(experiment.rows) if experiment.stage == "clamped" else np.zeros(0)
    for k, slot in enumerate(experiment.slots):
        if slot in known:
            theta[k] = known[slot]
        elif experiment.stage == "clamped" and slot.effect == "joint_compliance":
            theta[k] = stiffness[int(slot.place.removeprefix("joint")) - 1]
    if experiment.stage == "clamped":
        theta[len(experiment.slots) :] = clamping_offsets(experiment, theta)
    return theta


def clamping_offsets(experiment: Experiment, theta: Array) -> Array:
    """Offsets ``(K,)`` at which, with the measured torques, the sweeps' mean equilibrium holds.

    Of the friction that held motors keep: what their last motion left, or none where that is not known.
    """
    rows, n = experiment.rows, experiment.rows.robot.n
    torque = rows.constants["start_torque"]
    d = experiment.chain.evaluate(theta[: len(experiment.slots)], rows.signals, torque)
    wound = rows.constants["wound"] + d.values[:, :n]
    run = rows.constants["run"]
    keys, kept = rows.constants["offset_keys"], rows.constants["kept_sign"] * rows.constants["held_friction"]
    return np.array([wound[run == s, j].mean() if j < n else kept[s, j - n] for s, j in keys])


def _outliers(rows: Rows, residual: Array) -> Bools:
    """Rows far beyond what a clean table would show; scales are medians, so that the outliers do not set them.

    Outliers are single rows. Where most rows of a block of a sweep are off, something has happened there: with 5 % of
    outliers, more than anyone would use, that is so by chance in one of 60,000 blocks.
    """
    out = np.zeros(len(rows), dtype=bool)
    groups = [[0, 1, 2], [3, 4, 5]] if rows.stage == "poses" else [[c] for c in range(residual.shape[1])]
    for group in groups:
        inside = [c for c in group if c < residual.shape[1]]
        used = rows.used[:, inside].all(axis=1) if inside else np.zeros(len(rows), dtype=bool)
        if used.sum() < 20:
            continue
        white = rows.in_noise_axes(residual)[:, inside] / rows.sigma[:, inside]
        scale = NORMAL * np.median(np.abs(white[used]))
        size = np.linalg.norm(white, axis=1) / max(scale, 1e-12)
        limit = np.sqrt(stats.chi2.isf(OUTLIER_RATE / used.sum(), len(inside)))
        out |= used & (size > max(limit, 4.0))
    if rows.stage == "clamped":
        out &= np.bincount(rows.unit, out)[rows.unit] <= BLOCK_ROWS // 2
    return out
