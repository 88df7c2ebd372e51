"""Errors of a fitted model on fitted and held-out rows, and the noise floor: the error that noise alone would leave."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from clampid.fitting.anisotropy import scatter_in_groups
from clampid.fitting.descent import newton_step
from clampid.fitting.fit import without_outlying
from clampid.fitting.noise import Noise
from clampid.fitting.prior_and_start import clamping_offsets
from clampid.fitting.solve import Estimate, limits_of, solve
from clampid.stages.fit_problem import FitProblem
from clampid.stages.rows import Array, Bools, Integers, Rows, lengths
from experiments.measures.returns import ENOUGH_RETURNS, comparable_returns, freedom_of

__all__ = [
    "Floor",
    "StageErrors",
    "counted",
    "cross_validated",
    "noise_floor",
    "parts_of_rows",
    "predicted",
    "stage_errors",
    "unseen",
]

FOLDS = 5
QUIET_S = 3.0  # s: a log's noise is nearly uncorrelated over this time, and what varies with posture is still smooth
FEWEST_TRIPLES = 20  # triples of rows from which noise is estimated
OVERLAP = 35 / 18  # by which the variance of their mean square is larger than of as many independent differences
QUIET_ROWS = 6  # the same as a number of rows, for sweeps of single steps
REPEATS = 4e-5
"""Repeatability, rms, over the length of the arm. Data sheets state RP by ISO 9283: the mean distance plus three of its
standard deviations, about twice the rms. It is 0.1 mm for a UR10 of 1.3 m, and a third of that for KUKA and ABB."""


@dataclass(frozen=True)
class Floor:
    """The noise floor: the error that noise alone leaves.

    Attributes
    ----------
    sigma
        Root mean square for each channel ``(m,)``, SI. For poses ``(3,)``, with distances ``(4,)``: the mean square is
        over all rows, and rows without a channel count as zero in it, as in :func:`size_of`.
    source
        Where it comes from: repeated poses, the instrument's stated noise, the log itself, runs of it with one motion,
        or a regression on it.
    repeats
        Poses: typical repeatability of a robot of that size, rms in m; 0 where returns to poses measure it.
    freedom
        Degrees of freedom of the mean square. Poses: of the returns, the fewer of points and distances; 0 if these are
        too few. Torques: of the neighbours' differences, over all motors.
    in_visits
        Poses: how the points of single visits scatter about their mean, rms in m; 0 where returns measure the noise, or
        visits have one point. No motion of the flange explains it, so that it is noise even if more than was stated.
    """

    sigma: Array
    source: Literal["replicates", "instrument", "log", "repeated_runs", "regression"]
    repeats: float = 0.0
    freedom: int = 0
    in_visits: float = 0.0

    @property
    def norm(self) -> float:
        """Poses: root sum of squares over the channels, m."""
        return float(np.sqrt(np.sum(self.sigma**2)))

    @property
    def most(self) -> float:
        """Poses: the largest error that noise and the robot's repeatability explain, m."""
        return float(np.hypot(max(self.norm, self.in_visits), self.repeats))


@dataclass(frozen=True)
class StageErrors:
    """Root mean square errors of a stage: metres in ``poses``, units of the motors' noise elsewhere."""

    rms: float
    heldout_rms: float
    noise_floor: float
    heldout_rows: int


def noise_floor(rows: Rows, residual: Array) -> Floor:
    """The noise floor.

    Poses: from repeated poses with the same directions and, within 0.5 K, temperatures, if there are enough; else the
    noise stated by the instrument's maker. Torques: the smallest of three figures, motor by motor. One is the change of
    the residual within a few rows, so that a missing effect that varies with posture is not counted as noise. The
    others are independent of the model: by how much runs of one motion differ, and the held-out error of a regression
    on rigid-body dynamics and friction. They count if they are smaller by more than two standard errors; then the model
    lacks an effect that these rows determine.
    """
    if rows.kind.points:
        return _pose_floor(rows, residual)
    run, time = rows.series.run, rows.constants.time
    lag = QUIET_ROWS
    if rows.kind.moving and len(time) > 1:
        lag = max(1, round(QUIET_S / max(float(np.median(np.diff(time))), 1e-9)))
    spreads = [_spread(run, residual[:, c], rows.used[:, c], lag) for c in range(residual.shape[1])]
    out = np.array([spread.std for spread in spreads])
    known = np.full(len(out), np.inf) if rows.series.known_noise is None else rows.series.known_noise
    lower = np.any((known < out) & rows.used.any(axis=0))
    share = rows.used.sum(axis=0) / max(np.count_nonzero(rows.used), 1)
    freedom = 1.0 / max(sum(a**2 / s.freedom for a, s in zip(share, spreads, strict=True) if s.freedom), 1e-9)
    source = rows.series.known_from if lower else "log"
    return Floor(np.maximum(np.minimum(out, known), 1e-12), source, freedom=round(freedom))


class _Spread(NamedTuple):
    """The noise of one motor, and the degrees of freedom of its square."""

    std: float
    freedom: float


def _spread(run: Integers, residual: Array, used: Bools, lag: int) -> _Spread:
    """Noise of one motor, from the difference of its residual ``(N,)`` to the mean of its neighbours ``lag`` rows away.

    Smooth misfit cancels in this difference. Noise that is uncorrelated over ``lag`` rows gives it 3/2 of its variance.
    Shorter stretches use nearer neighbours, where correlated noise cancels in part: the floor is then too low, never
    too high. 1 if no row counts. A difference has correlations of -2/3 and 1/6 with those `lag` and twice as many rows
    away, so that the variance of their mean square is 1 + 2 (4/9 + 1/36) = 35/18 times that of independent ones.
    """
    while lag > 0:
        same = (run[2 * lag :] == run[: -2 * lag]) & used[2 * lag :] & used[lag:-lag] & used[: -2 * lag]
        if np.count_nonzero(same) > FEWEST_TRIPLES:
            bent = (residual[lag:-lag] - 0.5 * (residual[2 * lag :] + residual[: -2 * lag]))[same]
            return _Spread(float(np.sqrt(np.mean(bent**2) / 1.5)), len(bent) / OVERLAP)
        lag //= 2
    return _Spread(float(np.sqrt(np.mean(residual[used] ** 2))) if used.any() else 1.0, float(np.count_nonzero(used)))


def _pose_floor(rows: Rows, residual: Array) -> Floor:
    """Noise floor of poses: points and distances, each from its own returns if there are enough, by shares of rows."""
    kinds = [(~rows.ranged, [0, 1, 2]), (rows.ranged, [6])]
    variances, sources, repeats = [], [], 0.0
    freedom: list[int] = []
    for mine, channels in kinds:
        if not mine.any() and channels == [6]:
            continue
        returns = _returns(rows, mine, channels)
        sources.append("instrument" if returns is None else "replicates")
        freedom.append(0 if returns is None else returns[1])
        if returns is not None:
            spread = returns[0]
        else:
            repeats += float(np.mean(mine)) * len(channels) / 3.0 * (REPEATS * rows.robot.stretched) ** 2
            spread = np.sqrt(np.mean(rows.sigma[mine][:, channels] ** 2, axis=0)) if mine.any() else np.zeros(3)
        variances.append(np.mean(mine) * spread**2)
    source: Literal["replicates", "instrument"] = "instrument" if "instrument" in sources else "replicates"
    in_visits = _in_visits(rows, residual) if source == "instrument" else 0.0
    return Floor(np.sqrt(np.concatenate(variances)), source, float(np.sqrt(repeats)), min(freedom), in_visits)


def _in_visits(rows: Rows, residual: Array) -> float:
    """How the points of single visits scatter about their mean, rms of the norm in m; 0 if hardly any has several."""
    points = rows.used[:, :3].all(axis=1) & ~rows.ranged
    squares, freedom = scatter_in_groups(residual[points, :3], rows.unit[points])
    return float(np.sqrt(squares.sum() / freedom)) if freedom >= ENOUGH_RETURNS else 0.0


def _returns(rows: Rows, mine: Bools, channels: Sequence[int]) -> tuple[Array, int] | None:
    """Pooled standard deviation of channels over the returns among the rows ``mine``, and its degrees of freedom."""
    place = np.c_[rows.session, rows.fold, rows.signals["target_is"], rows.signals["anchor_is"]]
    warm = np.c_[rows.signals["link_temperature"], rows.signals["motor_temperature"]]
    usable = mine & rows.used[:, channels].all(axis=1)  # without outliers
    returns = comparable_returns(place[usable], rows.unit[usable], rows.signals["direction"][usable], warm[usable])
    freedom = freedom_of(returns)
    if freedom < ENOUGH_RETURNS:
        return None
    measured, squares = rows.measured[usable][:, channels], np.zeros(len(channels))
    for members in returns:
        x = measured[members]
        squares += ((x - x.mean(axis=0)) ** 2).sum(axis=0)
    return np.sqrt(squares / freedom), freedom


def size_of(rows: Rows, residual: Array, floor: Floor) -> tuple[Array, Bools]:
    """Sizes of the errors, and which of them count.

    Parameters
    ----------
    rows, residual
        The rows and their residual ``(N, m)``, SI.
    floor
        The noise in whose units errors of torques are given.

    Returns
    -------
    size, counts
        Poses: ``(N,)``, m, the norm of a point's error, or the error of a distance. Torques: ``(N, n)``, in units of
        each motor's noise. ``counts`` has the same shape.
    """
    if rows.kind.points:
        return lengths(residual), np.asarray(rows.used.any(axis=1))
    return residual / floor.sigma, rows.used


def rms_of(rows: Rows, residual: Array, floor: Floor) -> float:
    """Root mean square of the errors of the rows that count."""
    size, counts = size_of(rows, residual, floor)
    return float(np.sqrt(np.mean(size[counts] ** 2))) if counts.any() else float("nan")


def predicted(problem: FitProblem, theta: Array, noise: Noise | None = None) -> Array:
    """Residuals ``(N, m)``, SI, of rows that were not fitted.

    Unknown constants of a single run or sweep are fitted to its rows, with all other parameters fixed.

    Parameters
    ----------
    problem
        The rows with the model's slots.
    theta
        Values of the slots ``(P,)``, SI.
    noise
        Weights for the constants; by default the rows' own standard deviations.
    """
    if not problem.offsets:
        return problem.error(theta)
    count = len(problem.slots)
    full = np.r_[theta, np.zeros(problem.offsets)]
    if problem.kind.solved:
        full[count:] = clamping_offsets(problem, full)
    free = problem.own() & ~problem.fixed()
    precision = np.diag(np.where(free, 1.0 / problem.prior_std() ** 2, 1e12 / problem.sizes() ** 2))
    estimate = solve(problem, full, noise or Noise(problem.rows.sigma), precision, full)
    return estimate.residual


def cross_validated(estimate: Estimate, rows: Rows, seed: int) -> tuple[Rows, Array]:
    """Residuals of the fitted rows, each predicted by a fit without its part: fivefold cross-validation.

    Whole poses, runs or sweeps are left out together. Constants of single runs or sweeps, such as the posture at which
    one was clamped, are fitted to the left-out rows. A fit without a fifth of its rows differs from the whole fit by
    about its standard errors. Therefore each such fit is one Gauss-Newton step with the normal equations of the other
    parts; this neglects only the model's curvature within a standard error. Flanks stay as in the whole fit.

    Parameters
    ----------
    estimate
        The fit of ``rows``.
    rows
        The rows it was fitted to.
    seed
        For the division into parts.
    """
    problem, white = estimate.problem.with_flanks(estimate.theta), estimate.whitened
    part = parts_of_rows(rows, seed)
    residual = problem.error(estimate.theta)
    size = problem.sizes()
    its_own, of_part = np.flatnonzero(problem.own() & ~problem.fixed()), part[white.entry]
    shared = np.setdiff1d(np.arange(len(size)), its_own)
    normals = {k: _normal(white.jacobian[of_part == k], white.residual[of_part == k]) for k in np.unique(of_part)}
    free = ~limits_of(problem).resting(estimate.theta)
    lever = estimate.prior_precision @ (estimate.prior_mean - estimate.theta)
    steps: dict[int, Array] = {}
    for k, (A_out, b_out) in normals.items():
        others = [n for j, n in normals.items() if j != k]
        if not others:
            break
        A = sum((n[0] for n in others), estimate.prior_precision)
        b = sum((n[1] for n in others), lever)
        step = newton_step(A, b, size, 0.0, free)
        if len(its_own):  # constants of runs or sweeps that were left out are fitted to their own rows
            shown = np.diag(A_out)[its_own] > 0
            weak = estimate.prior_precision[np.ix_(its_own, its_own)]
            left = b_out[its_own] - A_out[np.ix_(its_own, shared)] @ step[shared] + lever[its_own]
            alone = newton_step(A_out[np.ix_(its_own, its_own)] + weak, left, size[its_own], 0.0, shown)
            step[its_own] = np.where(shown, alone, step[its_own])
        steps[k] = step
    moves = problem.moved(estimate.theta, np.array([*steps.values()]).reshape(len(steps), len(size)).T)
    for number, k in enumerate(steps):
        residual[part == k] -= moves[part == k][:, :, number]
    return rows, residual


def parts_of_rows(rows: Rows, seed: int) -> Integers:
    """Number of the cross-validation part (0 to 4) of each row ``(N,)``; a fold is never divided."""
    order = rows.shuffled_folds(seed)
    place = np.argsort(order)  # order holds each fold once
    return np.asarray((place % FOLDS)[np.searchsorted(np.sort(order), rows.fold)])


def _normal(J: Array, r: Array) -> tuple[Array, Array]:
    """Normal matrix and downhill gradient of a whitened Jacobian ``(M, P)`` and residual ``(M,)``."""
    return J.T @ J, J.T @ r


def counted(estimate: Estimate, verification: Rows | None) -> tuple[Rows, Array]:
    """Fitted rows and their residual that errors are computed from: points only, if there is a verification table."""
    rows, residual = estimate.problem.rows, estimate.residual
    if verification is None or not rows.kind.points:
        return rows, residual
    return rows.points, residual[~rows.ranged]


def unseen(
    estimate: Estimate, rows: Rows, held_out: Sequence[Sequence[int]], verification: Rows | None, seed: int
) -> tuple[Rows, Array]:
    """Held-out rows with their residuals ``(N, m)``, SI.

    They are the rows of a verification table; else the rows that were held out; else all rows, by cross-validation.

    Parameters
    ----------
    estimate
        The fit.
    rows
        All rows of the stage.
    held_out
        Numbers of the folds that were not fitted, for each session.
    verification
        Rows of a verification table; None if there is none.
    seed
        For the cross-validation.
    """
    fitted, left = counted(estimate, verification)
    count = len(estimate.slots)
    if verification is not None:
        residual = predicted(estimate.problem.with_rows(verification), estimate.theta[:count])
        return without_outlying(verification, residual, fitted, left), residual
    if held_out and any(held_out):
        test = rows.take(np.flatnonzero(rows.in_folds(held_out)))
        return test, predicted(estimate.problem.with_rows(test), estimate.theta[:count])
    return cross_validated(estimate, fitted, seed)


def stage_errors(
    estimate: Estimate,
    rows: Rows,
    held_out: Sequence[Sequence[int]],
    verification: Rows | None,
    seed: int,
    floor: Floor | None = None,
) -> StageErrors:
    """Errors on fitted and held-out rows (a verification table, else rows held out, else cross-validation).

    With a verification table, distances do not count. Outliers of that table do not count either, as in a fit.

    Parameters
    ----------
    estimate
        The fit.
    rows
        The rows of the stage, held-out ones included.
    held_out
        Folds that were not fitted, for each campaign.
    verification
        Rows of a verification table.
    seed
        For the cross-validation.
    floor
        The noise in whose units errors of torques are given, so that models can be compared; by default from the
        estimate.
    """
    fitted, left = counted(estimate, verification)
    if floor is None or len(left) < len(estimate.residual):
        floor = noise_floor(fitted, left)
    test, residual = unseen(estimate, rows, held_out, verification, seed)
    level = floor.norm if rows.kind.points else 1.0
    return StageErrors(
        rms=rms_of(fitted, left, floor),
        heldout_rms=rms_of(test, residual, floor),
        noise_floor=level,
        heldout_rows=int(test.used.any(axis=1).sum()),
    )
