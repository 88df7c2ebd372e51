"""Fit of factors on a model's deflections to measured points.

The springs' twist of the joints is computed for the arm's own weight and for the tool, spring by spring. The model is
fixed. Factors on these deflections, and the positions of base and targets, are fitted to the points by Gauss-Newton.
The covariance comes from the scatter of the residuals from pose to pose (Liang and Zeger, Biometrika 73, 1986), and
from the covariance of the model's springs.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from clampid.chain.chain import Deviations
from clampid.fitting.noise import MAD_TO_STD
from clampid.identification.model_on_campaign import ModelOnCampaign
from clampid.role_slots import numbers_of_role
from clampid.stages import poses
from clampid.stages.fit_problem import FitProblem
from clampid.stages.rows import Array, Bools, Rows
from clampid.stages.stage_kind import only_of

__all__ = [
    "Deflections",
    "FactorFit",
    "FactorSearch",
    "deflections_of",
    "factors_with_covariance",
    "fit_factors",
    "shifted_table",
]

MAX_GAUSS_NEWTON_STEPS = 12
CONVERGED_STEP = 1e-7  # of a factor, m or rad
SAME_POSTURE = 1e-6  # rad: for a smaller change of the joint values the deflections are not computed again
WEIGHT_SIGNALS = ("gravity_torque", "sag_torque", "regressor", "tool_regressor")
_NO_PARTIALS, _NO_ENTRIES = np.zeros((0, 0)), np.zeros(0, dtype=np.int64)
OUTLIER_DEVIATIONS = 6.0  # robust standard deviations: larger errors are wrong rows


@dataclass(frozen=True)
class Deflections:
    """Twist of the joints by each of K springs.

    Attributes
    ----------
    parts
        ``(2, K, N, n)``, rad: by the arm's own weight and by the tool.
    covariance
        Relative covariance ``(K, K)`` of the compliances.
    """

    parts: Array
    covariance: Array


def deflections_of(opened: ModelOnCampaign, trial: FitProblem) -> Deflections:
    """The deflections of the joints at the recorded joint values of ``trial``."""
    model = only_of(opened.stages, "points")
    springs = numbers_of_role(model.slots, "compliance")
    at_flanks = trial.with_flanks(model.theta).rows.signals
    angle = trial.chain.offsets["joint_angle"]
    stiff = model.theta.copy()
    stiff[springs] = 0.0
    n = angle.stop - angle.start

    def through_each(signals: Mapping[str, Array]) -> Array:
        """Twist by each spring ``(K, N, n)``, rad: compliance times derivative, since springs are linear."""
        found = trial.chain.evaluate(stiff, signals)
        each = np.zeros((len(springs), len(found.values), n))
        for k, spring in enumerate(springs):
            for entry in np.flatnonzero(found.parameter == spring):
                station = found.station[entry] - angle.start
                if 0 <= station < n:
                    each[k, :, station] = model.theta[spring] * found.partials[:, entry]
        return each

    declared = opened.campaign.tool.mass * np.r_[1.0, opened.campaign.tool.com]
    bare = {**at_flanks, "gravity_torque": at_flanks["gravity_torque"] - at_flanks["tool_regressor"] @ declared}
    weightless = {
        **at_flanks,
        **{name: np.zeros_like(at_flanks[name]) for name in WEIGHT_SIGNALS},
    }  # the rest: springs are also wound up by dry friction
    whole, arm, rest = (through_each(signals) for signals in (at_flanks, bare, weightless))
    size = np.where(model.theta[springs] != 0.0, model.theta[springs], np.inf)
    covariance = model.covariance[np.ix_(springs, springs)] / np.outer(size, size)
    return Deflections(np.array([arm - rest, whole - arm]), covariance)


@dataclass(frozen=True)
class FactorFit:
    """The fitted factors on the two deflections, with shifts of base and m targets.

    Attributes
    ----------
    theta, covariance
        Factors less 1, shift of the base (w, v), shifts of the targets ``(8 + 3m,)``, and their covariance.
    columns
        Derivatives of the used points by ``theta`` ``(N, 3, P)``.
    """

    theta: Array
    covariance: Array
    columns: Array


@dataclass(frozen=True)
class FactorSearch:
    """The end of a Gauss-Newton search, with the equations of its last step.

    Attributes
    ----------
    theta
        Factors on F deflections less 1, shift of the base (w, v), shifts of m targets ``(F + 6 + 3m,)``.
    rows
        The rows at the joint values that were commanded with these factors.
    used
        Rows that are not outliers ``(N,)``.
    lever, columns
        Derivatives of the points by the joints ``(N, 3, n)`` and by ``theta`` ``(N, 3, P)``.
    residual, step
        Residual of the used rows before the last step ``(3 N,)``, m, and that step ``(P,)``.
    """

    theta: Array
    rows: Rows
    used: Bools
    lever: Array
    columns: Array
    residual: Array
    step: Array


def fit_factors(
    opened: ModelOnCampaign, trial: FitProblem, parts: Array, mean: Array | None = None, spread: Array | None = None
) -> FactorSearch:
    """Fit factors on deflections to the points by Gauss-Newton; the model's other parameters are fixed.

    If the factors change the commanded joint values, the deflections are computed again at these.

    Parameters
    ----------
    opened, trial
        The model on the campaign, and the problem of its poses.
    parts
        Deflections at the recorded joint values ``(F, N, n)``, rad.
    mean, spread
        Prior of the factors less 1: mean ``(F,)`` and covariance ``(F, F)``; None: no prior.
    """
    n, count, targets = trial.rows.robot.n, len(parts), trial.rows.signals["target_is"]
    theta, sent = np.zeros(count + 6 + 3 * targets.shape[1]), np.zeros_like(parts[0])
    theta[:count] = 0.0 if mean is None else mean
    rows, at = trial.rows, _values(trial, opened)
    for _ in range(MAX_GAUSS_NEWTON_STEPS):
        shift = np.einsum("p,pni->ni", theta[:count], parts)
        if np.abs(shift - sent).max() > SAME_POSTURE:
            moved = trial.with_rows(_at_shifted_joints(opened, trial.rows, shift))
            rows, at, sent = moved.rows, _values(moved, opened), shift
        values = at.copy()
        values[:, :n] += shift - sent
        values[:, n : n + 6] += theta[count : count + 6]
        values[:, 7 * n + 6 : 7 * n + 9] += targets @ theta[count + 6 :].reshape(-1, 3)
        position, _, sensitivity = poses.predict(rows, Deviations(values, _NO_PARTIALS, _NO_ENTRIES, _NO_ENTRIES))
        S = sensitivity[:, :3]
        factors = [np.einsum("nij,nj->ni", S[:, :, :n], part) for part in parts]
        shifts = (S[:, :, None, 7 * n + 6 : 7 * n + 9] * targets[:, None, :, None]).reshape(
            len(rows), 3, 3 * targets.shape[1]
        )
        columns = np.concatenate([np.stack(factors, axis=2), S[:, :, n : n + 6], shifts], axis=2)
        residual = rows.measured[:, :3] - position
        size = np.linalg.norm(residual, axis=1)
        used = rows.used[:, 0] & (size <= OUTLIER_DEVIATIONS * MAD_TO_STD * np.median(size[rows.used[:, 0]]) + 1e-12)
        J, r = columns[used].reshape(-1, len(theta)), residual[used].ravel()
        scale = np.linalg.norm(J, axis=0)
        scale[scale == 0.0] = 1.0
        A, b = J / scale, r
        if mean is not None and spread is not None:  # weighted by the scatter of the points
            root = np.linalg.pinv(np.linalg.cholesky(spread)) * np.sqrt(np.mean(r**2))
            known = np.zeros((count, len(theta)))
            known[:, :count] = root / scale[:count]
            A, b = np.vstack([A, known]), np.r_[b, root @ (mean - theta[:count])]
        step = np.linalg.lstsq(A, b, rcond=1e-10)[0] / scale
        theta = theta + step
        if not np.isfinite(theta).all() or np.all(np.abs(step) < CONVERGED_STEP):
            break
    return FactorSearch(theta, rows, used, S[:, :, :n], columns, r, step)


def factors_with_covariance(opened: ModelOnCampaign, trial: FitProblem, deflections: Deflections) -> FactorFit:
    """Factors on the deflections by the arm's own weight and by the tool, with their covariance.

    The covariance includes the scatter of the residuals from pose to pose (a sandwich: Liang and Zeger, Biometrika 73,
    1986), and the covariance of the model's springs.
    """
    found = fit_factors(opened, trial, deflections.parts.sum(axis=1))
    theta, used, r = found.theta, found.used, found.residual
    J = found.columns[used].reshape(-1, len(theta))
    scale = np.linalg.norm(J, axis=0)
    scale[scale == 0.0] = 1.0
    inverse = np.linalg.pinv((J / scale).T @ (J / scale), rcond=1e-12, hermitian=True)
    _, unit = np.unique(np.repeat(found.rows.fold[used], 3), return_inverse=True)
    pulls = np.zeros((int(unit.max()) + 1, len(theta)))
    np.add.at(pulls, unit, (J / scale) * (r - J @ found.step)[:, None])
    scatter = pulls.T @ pulls * len(pulls) / max(len(pulls) - len(theta), 1)
    # An error of the model's springs acts on the points times the fitted factor less 1.
    wrong = np.einsum("p,pkni->kni", theta[:2], deflections.parts)
    by_spring = np.einsum("nij,knj->nik", found.lever, wrong)[used].reshape(len(r), -1)
    pulled = (J / scale).T @ by_spring
    covariance = inverse @ (scatter + pulled @ deflections.covariance @ pulled.T) @ inverse / np.outer(scale, scale)
    return FactorFit(theta, covariance, found.columns[used])


def _at_shifted_joints(opened: ModelOnCampaign, rows: Rows, shift: Array) -> Rows:
    """The rows of points at joint values shifted by ``shift`` ``(N, n)``, rad, with the same base reference."""
    name = rows.stage  # also the name of its table
    table = shifted_table(opened.campaign.tables[name], shift)
    campaign = replace(opened.campaign, tables={**opened.campaign.tables, name: table})
    return replace(opened, campaigns=(campaign,), base={0: rows.pose.base_reference[0]}).rows(name).points


def shifted_table(table: pd.DataFrame, shift: Array) -> pd.DataFrame:
    """A table with its joint values shifted by ``shift`` ``(N, n)``, rad."""
    names = [f"q{i + 1}_rad" for i in range(shift.shape[1])]
    return table.assign(**dict(zip(names, (table[names].to_numpy(float) + shift).T, strict=True)))


def _values(trial: FitProblem, opened: ModelOnCampaign) -> Array:
    """The model's deviations of all stations ``(N, S)``, SI."""
    theta = only_of(opened.stages, "points").theta
    return trial.chain.evaluate(theta, trial.with_flanks(theta).rows.signals).values
