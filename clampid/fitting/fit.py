"""The fit of one stage: weights learned from the residual, outliers rejected, and standard errors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy import linalg, stats

from clampid.fitting.agreeing import Agreement, agreement
from clampid.fitting.anisotropy import relative_axes
from clampid.fitting.leverage import root_of_inverse, share_left
from clampid.fitting.motors_at_rest import other_crossings
from clampid.fitting.noise import MAD_TO_STD, Noise, initial_noise, learn_noise
from clampid.fitting.prior_and_start import precision_with_fixed, prior_of, start_of
from clampid.fitting.solve import Estimate, FitError, Shared, solve
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

OUTLIER_RATE = 0.01  # chance that any row of a clean table is rejected
OUTLIER_PASSES = 3
OUTLIER_FACTOR = 1.5  # times the largest error of a fitted row: held-out rows farther off are outliers
OUTLIER_SHARE = 0.05  # if more rows than this share look like outliers, an effect is missing and none is rejected
AGREEING_SHARE = 2.0 * OUTLIER_SHARE  # share of suspected outliers up to which it is tested whether they agree
CROSSING_PASSES = 2
BAR_PASSES, BAR_MOVED = 3, 0.1  # linearisations; the second in standard errors of a certified distance
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

    1. A fit with weights by the instrument's stated noise.
    2. Outliers are rejected, in at most three passes: rows so far off that a clean table would have one with a chance
    of
       1 %. Rows of poses that agree with each other are kept (:mod:`clampid.fitting.agreeing`).
    3. One or two fits with weights by the noise that the residual shows.

    Parameters
    ----------
    problem
        Rows and slots.
    priors
        Results of other stages.
    start
        Initial values of slots, SI; zero or declared ones by default.
    reject
        Whether outliers are rejected.
    noise
        Noise that is used throughout, instead of being learned from the residual.
    weights
        Noise for the first fit, instead of the instrument's: the residual of another fit of the same rows. If a model
        leaves large errors, the instrument's noise would make the cost a narrow valley, along which a search is slow.

    Raises
    ------
    FitError
        There are no rows to fit, or no finite solution.
    """
    if not problem.rows.used.any():
        raise FitError(f"{problem.stage}: no rows can be used: no motor moves, or every row is an outlier")
    precision, mean = prior_of(problem, priors)
    theta = start_of(problem, start, priors)
    mean = np.where(problem.centred(), theta, mean)
    rejected = np.zeros(len(problem.rows), dtype=bool)
    model = noise or weights or initial_noise(problem.rows)
    theta = _kept_first(problem, theta, model, precision, mean)
    early = not problem.kind.points or noise is not None  # else another fit follows, with the noise learned
    shared = Shared()
    estimate = _past_clearances(solve(problem, theta, model, precision, mean, errors=early, shared=shared))
    whole, agreed = problem.rows, np.zeros(len(rejected), dtype=bool)
    left = _share_left(estimate) if reject else None  # few rows are rejected, so that it hardly changes
    for _ in range(OUTLIER_PASSES if reject else 0):
        if problem.kind.points:  # rejected rows are tested again: other outliers may have caused their errors
            bad = outlying(whole, estimate.residual) & ~agreed
        else:
            bad = rejected | outlying(problem.rows, estimate.residual if left is None else estimate.residual / left)
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
    """The fit with certified distances linearised at the fitted positions of their targets.

    Linearised at the nominal positions, a distance of 0.2 m is wrong by 3 µm if a target is off by 1 mm sideways.
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
        mean = np.where(problem.centred(), estimate.theta, mean)
        estimate = solve(problem, estimate.theta, estimate.noise, precision, mean)
    return estimate


def agreeing_rows(estimate: Estimate) -> list[Agreement]:
    """Groups of rows of poses as far off as outliers that agree with each other and are kept; none in other stages."""
    rows = estimate.problem.rows
    bad = estimate.outliers | outlying(rows, estimate.residual)
    if not rows.kind.points or bad.mean() > AGREEING_SHARE:
        return []
    return agreement(rows, bad, lengths(estimate.residual))


def _agreeing(rows: Rows, bad: Bools, residual: Array) -> Bools:
    """Which of the rows that would be rejected ``(N,)`` agree with each other, so that they are kept."""
    out = np.zeros(len(rows), dtype=bool)
    if rows.kind.points:
        for found in agreement(rows, bad, lengths(residual)):
            out |= found.rows
    return out


def again(estimate: Estimate, problem: FitProblem, none: Sequence[int]) -> Estimate:
    """The pose fit of another problem with the same parameters and rows; noise, prior and outliers are kept.

    Parameters
    ----------
    estimate
        The fit so far.
    problem
        The other problem.
    none
        Numbers of the slots of dry frictions that stay at zero (see :mod:`clampid.fitting.unknown_friction`).
    """
    found = without_unknown_friction(at_no_friction(replace(estimate, problem=problem), none))
    return replace(with_repeatability(found), outliers=estimate.outliers)


def _yields(problem: FitProblem) -> bool:
    """Whether the clamping fixture moves in the model, so that torques of joints at rest change."""
    return any("fixture" in problem.effects[slot.effect].acts for slot in problem.slots)


def _kept_first(problem: FitProblem, theta: Array, noise: Noise, precision: Array, mean: Array) -> Array:
    """Initial values for a clamped arm, from a fit in which the friction of motors at rest hardly moves.

    Without this step, springs and an unknown block pull that friction into a local minimum in which other clearances
    are crossed, and the search stays there.
    """
    if not _yields(problem):
        return theta
    motors = problem.rows.series.offset_keys[:, 1] >= problem.rows.robot.n
    kept = len(problem.slots) + np.flatnonzero(motors)
    tight = precision_with_fixed(problem, precision, kept, FIRST_FRICTION_STEP)
    return solve(problem, theta, noise, tight, mean).theta if len(kept) else theta


def _past_clearances(estimate: Estimate) -> Estimate:
    """The fit of a clamped arm, or a likelier one in which joints at rest cross their clearances in other rows."""
    if not _yields(estimate.problem):
        return estimate
    noise, precision, mean = estimate.noise, estimate.prior_precision, estimate.prior_mean
    for _ in range(CROSSING_PASSES):
        other = other_crossings(estimate.problem, noise, estimate.theta, precision, mean)
        if other is None:
            return estimate
        found = solve(estimate.problem, other, noise, precision, mean)
        if not _minus_twice_log_evidence(found) < _minus_twice_log_evidence(estimate):
            return estimate
        estimate = found
    return estimate


def _minus_twice_log_evidence(estimate: Estimate) -> float:
    """-2 ln(evidence) of a local minimum, by Laplace's approximation, up to a constant."""
    size = estimate.problem.sizes()
    A = (estimate.point.matrix + estimate.prior_precision) * np.outer(size, size)
    return estimate.cost + float(np.linalg.slogdet(A)[1])


def _absorbed(estimate: Estimate) -> Array | None:
    """A square root ``(N, m, P + K)`` of the covariance of a fit's predictions, for clamped sweeps; else None.

    In other stages the share of the noise that a fit absorbs follows from the number of parameters.
    """
    if not estimate.problem.kind.solved:
        return None
    _, jacobian = estimate.problem.residual(estimate.theta)
    size = estimate.problem.sizes()
    values, vectors = linalg.eigh(estimate.covariance / np.outer(size, size))
    root = size[:, None] * vectors * np.sqrt(np.maximum(values, 0.0))
    return np.asarray(jacobian @ root)


def _share_left(estimate: Estimate) -> Array:
    """Share ``(N, m)`` of each number's noise that a fit of a log leaves (:mod:`clampid.fitting.leverage`); else 1."""
    problem, out = estimate.problem, np.ones_like(estimate.residual)
    if not problem.kind.moving:
        return out
    if not estimate.noise.autocorrelations:
        white = estimate.whitened
        root = root_of_inverse(white.normal + estimate.prior_precision)
        for motor in np.unique(white.channel):
            own = white.channel == motor
            out[white.entry[own], motor] = share_left(white.jacobian[own], root)
        return out
    # Leverage is that of the rows, not of the prewhitened ones.
    _, jacobian = problem.residual(estimate.theta)
    normal, of_motor = estimate.prior_precision.copy(), list[tuple[Bools, Bools, Array]]()
    for motor in range(out.shape[1]):
        used, shown = problem.rows.used[:, motor], np.any(jacobian[:, motor], axis=0)
        columns = jacobian[:, motor, shown][used] / estimate.noise.sigma[used, motor, None]
        normal[np.ix_(shown, shown)] += columns.T @ columns
        of_motor.append((used, shown, columns))
    root = root_of_inverse(normal)
    for motor, (used, shown, columns) in enumerate(of_motor):
        out[used, motor] = share_left(columns, root[shown])
    return out


def outlying(rows: Rows, residual: Array) -> Bools:
    """Outliers ``(N,)``: rows with errors that a clean table would not show. Scales are medians, robust to outliers.

    Outliers are single rows. If most rows of a block of a sweep are off, an event has happened there, and they are
    kept: with 5 % of outliers, more than any usable table has, one block in 60,000 is so by chance.

    Parameters
    ----------
    rows
        The rows.
    residual
        ``(N, m)``, SI.
    """
    out = np.zeros(len(rows), dtype=bool)
    for inside in map(list, rows.kind.channels(residual.shape[1])):
        used = rows.used[:, inside].all(axis=1) if inside else np.zeros(len(rows), dtype=bool)
        if used.sum() < 20:
            continue
        white = rows.in_noise_axes(residual)[:, inside] / rows.sigma[:, inside]
        if rows.kind.points and inside == list(POSE_CHANNELS[0]):
            white = white / relative_axes(rows, residual)
        scale = MAD_TO_STD * np.median(np.abs(white[used]))
        size = np.linalg.norm(white, axis=1) / max(scale, 1e-12)
        limit = np.sqrt(stats.chi2.isf(OUTLIER_RATE / used.sum(), len(inside)))
        out |= used & (size > max(limit, 4.0))
    if rows.kind.solved:
        out &= np.bincount(rows.unit, out)[rows.unit] <= BLOCK_ROWS // 2
    return out


def without_outlying(rows: Rows, residual: Array, fitted: Rows, left: Array) -> Rows:
    """Held-out pose rows without outliers; unchanged if these are too many, as in a fit.

    Errors of held-out rows show a missing effect more than those of fitted rows. A row is therefore an outlier only if
    it is clearly farther off than every fitted row, and if most points of its visit are not: a missing effect moves all
    points of a visit, a wrong measurement moves one.

    Parameters
    ----------
    rows, residual
        The held-out rows, and measured less predicted ``(N, m)``.
    fitted, left
        The fitted rows, and their residuals ``(M, m)``.
    """
    known = fitted.used[:, :3].all(axis=1)
    most = OUTLIER_FACTOR * float(_distance(fitted, left)[known].max(initial=0.0))
    bad = outlying(rows, residual) & (_distance(rows, residual) > most)
    points = np.bincount(rows.unit, rows.used[:, :3].all(axis=1))[rows.unit]
    bad &= (points < 2) | (np.bincount(rows.unit, bad)[rows.unit] <= points / 2)  # a single point has no majority
    return rows.without(bad) if bad.any() and bad.mean() <= OUTLIER_SHARE else rows


def _distance(rows: Rows, residual: Array) -> Array:
    """Errors of points ``(N,)``, in the instrument's standard deviations."""
    return np.asarray(np.linalg.norm(rows.in_noise_axes(residual)[:, :3] / rows.sigma[:, :3], axis=1))
