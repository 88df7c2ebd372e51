"""The fit of one stage: weights that the residual shows, wrong rows left out, and what its errors are."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy import linalg, stats

from clampid.fitting.agreeing import Agreement, agreement
from clampid.fitting.anisotropy import relative_axes
from clampid.fitting.leverage import root_of_inverse, share_left
from clampid.fitting.motors_at_rest import other_crossings
from clampid.fitting.noise import NORMAL, Noise, initial_noise, learn_noise
from clampid.fitting.solve import Estimate, FitError, Shared, holding, prior_of, solve, start_of
from clampid.fitting.unknown_friction import at_no_friction, without_unknown_friction
from clampid.fitting.visits import with_repeatability
from clampid.slots import Prior, Slot
from clampid.stages.clamped_rows import BLOCK_ROWS
from clampid.stages.fit_problem import FitProblem
from clampid.stages.rows import POSE_CHANNELS, Array, Bools, Rows, lengths
from clampid.stages.statements import about

__all__ = [
    "OUTLIER_PASSES",
    "OUTLIER_RATE",
    "OUTLIER_SHARE",
    "again",
    "agreeing_rows",
    "fit",
    "outlying",
    "without_outlying",
]

OUTLIER_RATE = 0.01  # chance that a clean table has a row called an outlier
OUTLIER_PASSES = 3
OUTLIER_FACTOR = 1.5  # of the farthest row that a fit has kept
OUTLIER_SHARE = 0.05  # more than this is not outliers but structure: then nothing is rejected
AGREEING_SHARE = 2.0 * OUTLIER_SHARE  # of what would be rejected, while it is asked whether most of it agrees
CROSSING_PASSES = 2
BAR_PASSES, BAR_MOVED = 3, 0.1  # standard errors of a certified distance
FIRST_FRICTION_STEP = 0.01  # of a motor's friction: prior standard deviation of the kept friction in the first search


def fit(
    problem: FitProblem,
    priors: Sequence[Prior] = (),
    start: Mapping[Slot, float] | None = None,
    *,
    reject: bool = True,
    noise: Noise | None = None,
    weights: Noise | None = None,
) -> Estimate:
    """Fit the problem's slots to its rows.

    Weighted first by what the instrument states, then by what the residual shows, in two rounds; in between, rows
    whose residual a clean table would show with a chance of 1 % are rejected, in at most three passes; but for rows of
    poses that agree with each other (:mod:`clampid.fitting.agreeing`).

    Parameters
    ----------
    noise
        Kept throughout.
    weights
        At first, instead of the instrument's: what another fit of the same rows has left. Where a model leaves much,
        the instrument's would make a narrow valley of it, along which a search takes long.

    Raises
    ------
    FitError
        There are no rows to fit, or no finite solution.
    """
    if not problem.rows.used.any():
        raise FitError(f"{problem.stage}: no rows can be used: no motor moves, or every row is an outlier")
    precision, mean = prior_of(problem, priors)
    theta = start_of(problem, start, priors)
    mean = np.where(problem.fixed(), theta, mean)
    rejected = np.zeros(len(problem.rows), dtype=bool)
    model = noise or weights or initial_noise(problem.rows)
    theta = _kept_first(problem, theta, model, precision, mean)
    early = not problem.kind.points or noise is not None  # else another search follows, with the noise learned
    shared = Shared()
    estimate = _past_clearances(solve(problem, theta, model, precision, mean, errors=early, shared=shared))
    whole, agreed = problem.rows, np.zeros(len(rejected), dtype=bool)
    for _ in range(OUTLIER_PASSES if reject else 0):
        if problem.kind.points:  # a wrong row may have pulled others off that are right
            bad = outlying(whole, estimate.residual) & ~agreed
        else:
            bad = rejected | outlying(problem.rows, _studentised(estimate))
        if bad.mean() <= AGREEING_SHARE:
            agreed |= _agreeing(whole, bad, estimate.residual)
            bad &= ~agreed
        if bad.mean() > OUTLIER_SHARE or np.array_equal(bad, rejected):
            break
        rejected = bad
        problem = problem.with_rows(whole.without(rejected))
        estimate = solve(problem, estimate.theta, model, precision, mean, errors=early, shared=shared)
    if noise is None:
        rounds = 1 if problem.kind.points and weights is None else 2
        for number in range(rounds):
            model = learn_noise(problem.rows, estimate.residual, _absorbed(estimate))
            if problem.kind.moving and estimate.noise.settled(model):
                break
            errors = early or number == rounds - 1
            estimate = solve(problem, estimate.theta, model, precision, mean, errors=errors, shared=shared)
    if problem.kind.points:
        estimate = _along_bars(estimate, priors)
        estimate = with_repeatability(without_unknown_friction(estimate))
    return replace(estimate, outliers=rejected)


def _along_bars(estimate: Estimate, priors: Sequence[Prior]) -> Estimate:
    """The fit with certified distances linear about where their targets were found.

    About the nominal targets a distance of 0.2 m is wrong by 3 µm where one of them is off by a millimetre across it.
    """
    for _ in range(BAR_PASSES):
        rows = estimate.problem.rows
        stated = rows.constants.stated
        if not any(s.bar for s in stated):
            return estimate
        now = about(stated, estimate.values())
        values = estimate.values()
        moved = [
            np.abs(new.value - old.value - (new.matrix - old.matrix) @ [values.get(slot, 0.0) for slot in new.slots])
            for new, old in zip(now, stated, strict=True)
        ]
        if max(float(m.max()) for m in moved) < BAR_MOVED:
            return estimate
        problem = estimate.problem.with_rows(replace(rows, constants=replace(rows.constants, stated=now)))
        precision, mean = prior_of(problem, priors)
        mean = np.where(problem.fixed(), estimate.theta, mean)
        estimate = solve(problem, estimate.theta, estimate.noise, precision, mean)
    return estimate


def agreeing_rows(estimate: Estimate) -> list[Agreement]:
    """Rows of poses that are as far off as outliers are, but agree, so that they are none; of other stages none."""
    rows = estimate.problem.rows
    bad = estimate.outliers | outlying(rows, estimate.residual)
    if not rows.kind.points or bad.mean() > AGREEING_SHARE:
        return []
    return agreement(rows, bad, lengths(estimate.residual))


def _agreeing(rows: Rows, bad: Bools, residual: Array) -> Bools:
    """Which of the rows that would be rejected agree with each other, so that a model may say what moves them."""
    out = np.zeros(len(rows), dtype=bool)
    if rows.kind.points:
        for found in agreement(rows, bad, lengths(residual)):
            out |= found.rows
    return out


def again(estimate: Estimate, problem: FitProblem, none: Sequence[int]) -> Estimate:
    """The same pose fit of another problem with the same parameters and rows: noise, prior and outliers stay.

    Frictions ``none`` stay at zero, for the reason that :mod:`clampid.fitting.unknown_friction` gives.
    """
    found = without_unknown_friction(at_no_friction(replace(estimate, problem=problem), none))
    return replace(with_repeatability(found), outliers=estimate.outliers)


def _yields(problem: FitProblem) -> bool:
    """Whether the clamping fixture moves in the model, so that torques of joints at rest change."""
    return any("fixture" in problem.effects[slot.effect].acts for slot in problem.slots)


def _kept_first(problem: FitProblem, theta: Array, noise: Noise, precision: Array, mean: Array) -> Array:
    """Initial values for a clamped arm: fitted with the friction of motors at rest as their last motion left it.

    Otherwise springs and an unknown block would draw that friction to a local minimum in which other clearances are
    crossed, and the search would stay there.
    """
    if not _yields(problem):
        return theta
    motors = problem.rows.series.offset_keys[:, 1] >= problem.rows.robot.n
    kept = len(problem.slots) + np.flatnonzero(motors)
    tight = holding(problem, precision, kept, FIRST_FRICTION_STEP)
    return solve(problem, theta, noise, tight, mean).theta if len(kept) else theta


def _past_clearances(estimate: Estimate) -> Estimate:
    """The estimate, or a likelier one, of a clamped arm whose joints at rest cross their clearances in other rows."""
    if not _yields(estimate.problem):
        return estimate
    noise, precision, mean = estimate.noise, estimate.prior_precision, estimate.prior_mean
    for _ in range(CROSSING_PASSES):
        other = other_crossings(estimate.problem, noise, estimate.theta, precision, mean)
        if other is None:
            return estimate
        found = solve(estimate.problem, other, noise, precision, mean)
        if not _unlikely(found) < _unlikely(estimate):
            return estimate
        estimate = found
    return estimate


def _unlikely(estimate: Estimate) -> float:
    """-2 log of the evidence of where a search has ended, by Laplace's approximation."""
    size = estimate.problem.sizes()
    A = (estimate.point.matrix + estimate.prior_precision) * np.outer(size, size)
    return estimate.cost + float(np.linalg.slogdet(A)[1])


def _absorbed(estimate: Estimate) -> Array | None:
    """A square root ``(N, m, P + K)`` of the covariance of what a fit predicts; None in poses.

    There every row has few neighbours and the noise one scale, so that what is absorbed is a count of parameters.
    """
    if not estimate.problem.kind.solved:
        return None
    _, jacobian = estimate.problem.residual(estimate.theta)
    size = estimate.problem.sizes()
    values, vectors = linalg.eigh(estimate.covariance / np.outer(size, size))
    root = size[:, None] * vectors * np.sqrt(np.maximum(values, 0.0))
    return np.asarray(jacobian @ root)


def _studentised(estimate: Estimate) -> Array:
    """Residuals ``(N, m)`` of a log over what the fit leaves of each one's error (:mod:`clampid.fitting.leverage`)."""
    problem, out = estimate.problem, estimate.residual.copy()
    if not problem.kind.moving:
        return out
    white = estimate.whitened
    if estimate.noise.autocorrelations:  # leverage is that of rows, not of what is new in each
        white = Noise(estimate.noise.sigma).whiten(problem.rows, *problem.residual(estimate.theta))
    root = root_of_inverse(white.normal + estimate.prior_precision)
    out[white.entry, white.channel] /= share_left(white.jacobian, root)
    return out


def outlying(rows: Rows, residual: Array) -> Bools:
    """Rows far beyond what a clean table would show; scales are medians, so that the outliers do not set them.

    Outliers are single rows. Where most rows of a block of a sweep are off, something has happened there: with 5 % of
    outliers, more than anyone would use, that is so by chance in one of 60,000 blocks.
    """
    out = np.zeros(len(rows), dtype=bool)
    for inside in map(list, rows.kind.channels(residual.shape[1])):
        used = rows.used[:, inside].all(axis=1) if inside else np.zeros(len(rows), dtype=bool)
        if used.sum() < 20:
            continue
        white = rows.in_noise_axes(residual)[:, inside] / rows.sigma[:, inside]
        if rows.kind.points and inside == list(POSE_CHANNELS[0]):
            white = white / relative_axes(rows, residual)
        scale = NORMAL * np.median(np.abs(white[used]))
        size = np.linalg.norm(white, axis=1) / max(scale, 1e-12)
        limit = np.sqrt(stats.chi2.isf(OUTLIER_RATE / used.sum(), len(inside)))
        out |= used & (size > max(limit, 4.0))
    if rows.kind.solved:
        out &= np.bincount(rows.unit, out)[rows.unit] <= BLOCK_ROWS // 2
    return out


def without_outlying(rows: Rows, residual: Array, fitted: Rows, left: Array) -> Rows:
    """Pose rows that no fit has seen, those that are wrong no longer used: as in a fit, if they are not too many.

    What a model lacks shows in such rows more than in those that were fitted. So they are wrong only if they are
    clearly farther off than any row that the fit has kept, and if not most points of their visit are: what a model
    lacks moves all of them, an instrument's error one.

    Parameters
    ----------
    residual, left
        ``(N, m)`` and ``(M, m)``: of the prediction, and of the fitted rows.
    """
    known = fitted.used[:, :3].all(axis=1)
    most = OUTLIER_FACTOR * float(_distance(fitted, left)[known].max(initial=0.0))
    bad = outlying(rows, residual) & (_distance(rows, residual) > most)
    points = np.bincount(rows.unit, rows.used[:, :3].all(axis=1))[rows.unit]
    bad &= (points < 2) | (np.bincount(rows.unit, bad)[rows.unit] <= points / 2)  # of one point nobody can say
    return rows.without(bad) if bad.any() and bad.mean() <= OUTLIER_SHARE else rows


def _distance(rows: Rows, residual: Array) -> Array:
    """How far points are off ``(N,)``, in the instrument's standard deviations."""
    return np.asarray(np.linalg.norm(rows.in_noise_axes(residual)[:, :3] / rows.sigma[:, :3], axis=1))
