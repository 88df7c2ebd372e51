"""How far model and measurement are apart, on fitted and on held-out rows, and how far noise alone would put them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from clampid.fitting.descent import newton_step
from clampid.fitting.fit import without_outlying
from clampid.fitting.noise import Noise
from clampid.fitting.solve import Estimate, clamping_offsets, limits_of, solve
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
QUIET_S = 3.0  # s: a log's noise is mostly forgotten after this long, and what varies with posture is still smooth
FEWEST_TRIPLES = 20  # of rows, from which noise is estimated
QUIET_ROWS = 6  # the same for sweeps of single steps
REPEATS = 4e-5
"""Repeatability, rms, over the length of the arm. Data sheets state RP by ISO 9283, the mean distance and three of its
standard deviations, about twice the rms: 0.1 mm for a UR10 of 1.3 m; KUKA's and ABB's arms have a third of that."""


@dataclass(frozen=True)
class Floor:
    """The error that noise alone leaves: per channel ``(m,)`` SI, and where that is known from.

    Of poses ``(3,)``, with distances ``(4,)``: the mean square over all rows, those that lack a channel counted as none
    there, as the errors of :func:`size_of` are, so that floor and errors go together.

    Attributes
    ----------
    repeats
        Of poses: by how much a robot of that size may come back beside its place, rms in m, where no returns say.
    freedom
        Of poses: degrees of freedom of the returns that say so, the fewest of points and distances; 0: none.
    """

    sigma: Array
    source: Literal["replicates", "instrument", "log", "regression"]
    repeats: float = 0.0
    freedom: int = 0

    @property
    def norm(self) -> float:
        """Of poses: root sum of squares, m; of points over their coordinates."""
        return float(np.sqrt(np.sum(self.sigma**2)))

    @property
    def most(self) -> float:
        """Of poses: what noise and the robot's repeatability may leave at most, m."""
        return float(np.hypot(self.norm, self.repeats))


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
    noise stated by the instrument's maker. Torques: the smaller of two figures, motor by motor. One is the change of
    the residual within a few rows, so that a missing effect that varies with posture is not counted as noise. The other
    is independent of the model: the held-out error of a regression on rigid-body dynamics and friction. It counts if it
    is smaller by more than two standard errors; then the model lacks an effect that these rows determine.
    """
    if rows.kind.points:
        return _pose_floor(rows)
    run, time = rows.series.run, rows.constants.time
    lag = QUIET_ROWS
    if rows.kind.moving and len(time) > 1:
        lag = max(1, round(QUIET_S / max(float(np.median(np.diff(time))), 1e-9)))
    out = np.array([_spread(run, residual[:, c], rows.used[:, c], lag) for c in range(residual.shape[1])])
    known = np.full(len(out), np.inf) if rows.series.known_noise is None else rows.series.known_noise
    lower = np.any((known < out) & rows.used.any(axis=0))
    return Floor(np.maximum(np.minimum(out, known), 1e-12), rows.series.known_from if lower else "log")


def _spread(run: Integers, residual: Array, used: Bools, lag: int) -> float:
    """Noise of one motor by how far its residual ``(N,)`` is off the middle of its neighbours ``lag`` rows away.

    A smooth misfit cancels there, and noise that is forgotten by then has 3/2 its variance. Stretches shorter than that
    are judged by nearer neighbours, of which noise that lasts cancels in part: the floor is then low, not high. 1 where
    no row counts.
    """
    while lag > 0:
        same = (run[2 * lag :] == run[: -2 * lag]) & used[2 * lag :] & used[lag:-lag] & used[: -2 * lag]
        if np.count_nonzero(same) > FEWEST_TRIPLES:
            bent = (residual[lag:-lag] - 0.5 * (residual[2 * lag :] + residual[: -2 * lag]))[same]
            return float(np.sqrt(np.mean(bent**2) / 1.5))
        lag //= 2
    return float(np.sqrt(np.mean(residual[used] ** 2))) if used.any() else 1.0


def _pose_floor(rows: Rows) -> Floor:
    """That of points and of distances, each from its own returns where there are enough, by their shares of rows."""
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
    return Floor(np.sqrt(np.concatenate(variances)), source, float(np.sqrt(repeats)), min(freedom))


def _returns(rows: Rows, mine: Bools, channels: Sequence[int]) -> tuple[Array, int] | None:
    """Pooled standard deviation of channels of some rows ``(N,)`` over returns, degrees of freedom; None if too few."""
    place = np.c_[rows.session, rows.fold, rows.signals["target_is"], rows.signals["anchor_is"]]
    warm = np.c_[rows.signals["link_temperature"], rows.signals["motor_temperature"]]
    usable = mine & rows.used[:, channels].all(axis=1)  # an outlier is no noise
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
    """Errors as the stage counts them, and which count: in metres ``(N,)``, or ``(N, n)`` in units of noise.

    In metres a point's is a norm, and a distance's its one number.
    """
    if rows.kind.points:
        return lengths(residual), np.asarray(rows.used.any(axis=1))
    return residual / floor.sigma, rows.used


def rms_of(rows: Rows, residual: Array, floor: Floor) -> float:
    """Root mean square of the errors of the rows that count."""
    size, counts = size_of(rows, residual, floor)
    return float(np.sqrt(np.mean(size[counts] ** 2))) if counts.any() else float("nan")


def predicted(problem: FitProblem, theta: Array, noise: Noise | None = None) -> Array:
    """Residuals ``(N, m)`` of rows that were not fitted, at given slot values ``(P,)``.

    The unknown constants of a run or sweep are found from it, all else fixed.
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
    """Residuals of the fitted rows, each predicted by a fit without its fold (whole poses, runs or sweeps; five parts).

    What belongs to single runs or sweeps, such as the posture at which one was clamped, these show themselves.
    A fit without a fifth of its rows differs from the whole by about its standard errors, so that one Gauss-Newton step
    from the whole fit's normal equations, less those of the part, is that fit: all that is left out is the model's
    curvature within a standard error. Flanks stay where the whole fit has them.
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
        if len(its_own):  # a run or sweep that was not fitted shows its own constants itself
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
    """Which of five parts each row ``(N,)`` is of, whole folds."""
    order = rows.shuffled_folds(seed)
    place = np.argsort(order)  # order holds each fold once
    return np.asarray((place % FOLDS)[np.searchsorted(np.sort(order), rows.fold)])


def _normal(J: Array, r: Array) -> tuple[Array, Array]:
    return J.T @ J, J.T @ r


def counted(estimate: Estimate, verification: Rows | None) -> tuple[Rows, Array]:
    """Fitted rows and residual that errors are of: beside a verification table, which is of points, no distances."""
    rows, residual = estimate.problem.rows, estimate.residual
    if verification is None or not rows.kind.points:
        return rows, residual
    return rows.points, residual[~rows.ranged]


def unseen(
    estimate: Estimate, rows: Rows, held_out: Sequence[Sequence[int]], verification: Rows | None, seed: int
) -> tuple[Rows, Array]:
    """Rows that no fit has seen, with their residuals.

    Those of a verification table, else those kept out, else all, each predicted by a fit without it.
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
    """Errors on fitted and held-out rows: a verification table, else the rows kept out, else cross-validation.

    Where points are compared with a verification table, distances beside them do not count. Single rows of that table
    that are wrong do not count either, as in a fit. ``floor``: what torques are measured in, so that models can be
    compared; the estimate's own by default.
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
