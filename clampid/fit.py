"""The fit: damped Gauss-Newton on scaled, whitened normal equations with a weak prior, robust against wrong rows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import linalg, stats

from clampid.noise import NORMAL, Noise, Whitened, initial_noise, learn_noise
from clampid.slots import Slot
from clampid.stages.clamped import loop_compliance
from clampid.stages.experiment import Experiment
from clampid.stages.rows import Array, Bools, Rows

__all__ = [
    "ITERATIONS",
    "NEGLIGIBLE",
    "Estimate",
    "FitError",
    "Prior",
    "clamping_offsets",
    "fit",
    "inverse_of",
    "newton_step",
    "prior_of",
    "solve",
    "start_of",
]

OUTLIER_RATE = 0.01  # chance that a clean table has a row called an outlier
OUTLIER_PASSES = 3
OUTLIER_SHARE = 0.05  # more than this is not outliers but structure: then nothing is rejected
ITERATIONS = 30
FLANK_ROUNDS = 8
DAMPING_START, DAMPING_END = 1e-3, 1e8
IDLE_GAIN, IDLE_STEPS = 1e-6, 3  # so many steps that gain less than this share of the cost end the search
NEGLIGIBLE = 1e-3  # a step that promises less than this of a unit of chi-square moves nothing by its error


class FitError(ValueError):
    """The rows cannot carry the fit; the message says why."""


@dataclass(frozen=True)
class Prior:
    """What earlier stages know: slots, their values ``(k,)`` and covariance ``(k, k)``, SI."""

    slots: tuple[Slot, ...]
    mean: Array
    covariance: Array


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
    rejected = np.zeros(len(experiment.rows), dtype=bool)
    model = noise or initial_noise(experiment.rows)
    estimate = solve(experiment, theta, model, precision, mean)
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
            estimate = solve(experiment, estimate.theta, model, precision, mean)
    return replace(estimate, outliers=rejected)


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


@dataclass(frozen=True)
class _Point:
    """The cost and its local quadratic model at one parameter vector."""

    theta: Array
    residual: Array
    white: Whitened
    cost: float

    def normal(self, precision: Array, mean: Array) -> tuple[Array, Array]:
        """Normal matrix and downhill gradient, prior included."""
        J = self.white.jacobian
        return J.T @ J + precision, J.T @ self.white.residual - precision @ (self.theta - mean)


def solve(experiment: Experiment, theta: Array, noise: Noise, precision: Array, mean: Array) -> Estimate:
    """Minimise the whitened squares plus the prior's from ``theta``; no rejection, no reweighting.

    The flanks on which gears rest jump with the loads, and the loads depend on free parameters: flanks are held in each
    search and follow between searches, until they stay.

    Raises
    ------
    FitError
        The model gives no finite prediction.
    """
    held = experiment.with_flanks(theta)
    estimate = _search(held, theta, noise, precision, mean)
    for _ in range(FLANK_ROUNDS):
        moved = experiment.with_flanks(estimate.theta)
        if moved is experiment or np.array_equal(moved.rows.signals["flank"], held.rows.signals["flank"]):
            break
        held = moved
        estimate = _search(held, estimate.theta, noise, precision, mean)
    return replace(estimate, experiment=experiment)


def _search(experiment: Experiment, theta: Array, noise: Noise, precision: Array, mean: Array) -> Estimate:
    """Damped Gauss-Newton with flanks held."""
    size = experiment.sizes()
    lower, upper = experiment.bounds()
    bounded = experiment.shapes() | (experiment.stage == "clamped")

    def at(theta: Array) -> _Point:
        residual, jacobian = experiment.residual(theta)
        if not np.all(np.isfinite(residual)):
            raise FitError(f"{experiment.stage}: the model gives no finite prediction; are the units right?")
        white = noise.whiten(experiment.rows, residual, jacobian)
        off = theta - mean
        return _Point(theta, residual, white, float(white.residual @ white.residual + off @ precision @ off))

    best = at(theta)
    A, g = best.normal(precision, mean)
    damping, idle, iteration = 0.0, 0, 0
    while iteration < ITERATIONS and idle <= IDLE_STEPS and damping < DAMPING_END:
        iteration += 1
        # A parameter that rests on its bound and would leave it stays there, so that the others' step is their own.
        on_bound = ((best.theta <= lower) & (g < 0)) | ((best.theta >= upper) & (g > 0))
        free = ~(bounded & on_bound)
        step = newton_step(A, g, size, damping, free)
        if float(g @ step) < NEGLIGIBLE * max(1.0, best.cost / max(len(best.white.residual), 1)):
            break
        moved = best.theta + step
        trial = at(np.where(bounded, np.clip(moved, lower, upper), moved))
        # Where gaps close, the cost has kinks, along which steps zigzag without getting anywhere.
        idle = idle + 1 if trial.cost > best.cost * (1 - IDLE_GAIN) else 0
        if trial.cost > best.cost:
            damping = max(10 * damping, DAMPING_START)
            continue
        best = trial
        A, g = best.normal(precision, mean)
        damping = 0.0 if damping < DAMPING_START else damping / 10
    covariance = inverse_of(A)
    told = len(theta) - float(np.sum(covariance * precision))  # parameters that the rows tell, not the prior
    freedom = max(len(best.white.residual) - told, 1.0)
    scale = float(best.white.residual @ best.white.residual) / freedom
    return Estimate(
        experiment=experiment,
        theta=best.theta,
        covariance=covariance * max(scale, 1e-12),
        noise=noise,
        whitened=best.white,
        residual=best.residual,
        outliers=np.zeros(len(experiment.rows), dtype=bool),
        prior_precision=precision,
        prior_mean=mean,
        iterations=iteration,
    )


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
    precision = np.diag(1.0 / experiment.prior_std() ** 2)
    mean = np.where(experiment.shapes(), experiment.start(), 0.0)
    for prior in priors:
        index = {slot: k for k, slot in enumerate(experiment.slots)}
        shared = [k for k, slot in enumerate(prior.slots) if slot in index]
        where = [index[prior.slots[k]] for k in shared]
        if where:
            precision[np.ix_(where, where)] = linalg.pinvh(prior.covariance[np.ix_(shared, shared)])
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
    """Offsets ``(K,)`` at which, with the measured torques, the sweeps' mean equilibrium holds."""
    rows, n = experiment.rows, experiment.rows.robot.n
    torque = rows.constants["start_torque"]
    d = experiment.chain.evaluate(theta[: len(experiment.slots)], rows.signals, torque)
    wound = rows.constants["wound"] + d.values[:, :n]
    run = rows.constants["run"]
    return np.array([wound[run == sweep, joint].mean() for sweep, joint in rows.constants["offset_keys"]])


def _outliers(rows: Rows, residual: Array) -> Bools:
    """Rows far beyond what a clean table would show; scales are medians, so that the outliers do not set them."""
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
    return out
