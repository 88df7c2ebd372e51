"""How much of a model's deflections stands in measured poses: whether, and how, a controller has compensated them.

Poses are measured at joint values that somebody asked for. The springs' twist, q_arm = q - C·tau, is in the points in
full if nothing compensates it, and not at all if the controller compensates it correctly. The model is fixed. Factors
on the deflection by the arm's own weight and on that by the tool, and the positions of base and targets, are fitted to
the points by Gauss-Newton, with a covariance from the residuals' scatter from pose to pose (Liang and Zeger, Biometrika
73, 1986) and from that of the model's springs.

The pair of factors says which mistake it is, such as 1 - 180/pi for a deflection that was multiplied by 180/pi, or (1,
0) where only the tool's weight is compensated. Where the base is the model's own, its shift is compared with what a
base takes up of the deflections when a model without springs is fitted.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd
from scipy import stats

from clampid.chain.chain import Deviations
from clampid.display import with_error
from clampid.fitting.noise import MAD_TO_STD
from clampid.identification.model_on_campaign import ModelOnCampaign
from clampid.role_slots import any_of_role, numbers_of_role
from clampid.roles import WEIGHTS
from clampid.stages import poses
from clampid.stages.fit_problem import FitProblem
from clampid.stages.rows import Array, Bools, Rows
from clampid.stages.stage_kind import known_of, only_of

__all__ = ["Compensation", "compensation_of", "put_right", "sent_elsewhere"]

MAX_NEWTON_STEPS = 12
SHIFT_SETTLED = 1e-7  # of a factor, m or rad
ELSEWHERE = 1e-6  # rad: where a robot is sent closer than this, it gives way as it would here
WEIGHT = ("gravity_torque", "sag_torque", "regressor", "tool_regressor")
_NONE, _NO = np.zeros((0, 0)), np.zeros(0, dtype=np.int64)
FALSE_REJECTIONS = 1e-3  # chance that a true explanation is not accepted
DEFLECTION_SHARE = 0.5  # of a base's shift, in the metric of its errors: so much of it must look like a deflection's
KNOWN = 0.25  # standard error of a factor beyond which these poses cannot determine it
ROUNDING = 1e-9  # standard error of a factor that no row depends on, such as that of a tool without mass
OUTLIER_DEVIATIONS = 6.0  # robust standard deviations: wrong rows
DEGREES = 180.0 / np.pi
AMPLIFIED = 5.0  # times the deflections: what is then left of the model's own small errors shows among the noise
EXPLANATIONS: tuple[tuple[float, float, str], ...] = (
    (1.0, 1.0, ""),
    (0.0, 0.0, "the deflections are compensated in full"),
    (1.0, 0.0, "only the tool's weight is compensated: the arm's own weight is left out"),
    (0.0, 1.0, "only the arm's own weight is compensated: the tool's is left out"),
    (1.0 - DEGREES, 1.0 - DEGREES, "the compensation is multiplied by 180/pi: a deflection in degrees went out as rad"),
    (1.0, 1.0 - DEGREES,
     "the compensation is multiplied by 180/pi, and the arm's own weight is left out of it"),
    (2.0, 2.0, "the compensation has the wrong sign: it doubles the deflections"),
)  # fmt: skip
"""Factors of own weight and tool, and what they mean; the first is a campaign without any compensation."""
FINE = ("", EXPLANATIONS[1][2])


@dataclass(frozen=True)
class Compensation:
    """What part of the model's deflections stands in the poses.

    Attributes
    ----------
    factors, covariance
        ``(2,)`` and ``(2, 2)``: on the deflection by the arm's own weight, and by the tool; 1: in full, 0: none.
    base, base_std
        ``(6,)``: how far the base is from the model's, (w, v), rad and m; None where the campaign has its own.
    mistake
        What was done wrong, in words; empty where nothing was.
    said
        The finding in a sentence; empty where the deflections stand there in full, as the model says.
    explained
        The factors of the explanation that was reported; None if none was.
    """

    factors: Array
    covariance: Array
    base: Array | None
    base_std: Array | None
    mistake: str
    said: str
    explained: tuple[float, float] | None

    def to_json(self) -> dict[str, Any]:
        """For programs."""
        std = np.sqrt(np.diag(self.covariance))
        return {
            "own_weight": {"factor": float(self.factors[0]), "std": float(std[0])},
            "tool": {"factor": float(self.factors[1]), "std": float(std[1])},
            "base": None if self.base is None else self.base.tolist(),
            "base_std": None if self.base_std is None else self.base_std.tolist(),
            "mistake": self.mistake or None,
            "summary": self.said,
        }


def sent_elsewhere(found: Compensation) -> str:
    """What a diagnosis of the poses that were :func:`put_right` begins with."""
    said = "With the joint values to which that sent the robot:"
    times = max(abs(factor - 1.0) for factor in found.explained or (1.0,))
    if times > AMPLIFIED:
        said = (
            f"It multiplies errors of springs and weights by {times:.0f}; other effects may be named below for it. "
            f"Correct the compensation and measure again. {said}"
        )
    return said


def compensation_of(opened: ModelOnCampaign) -> Compensation | None:
    """Look for a compensation, and for mistakes in it, in a campaign's poses.

    Returns
    -------
    Compensation or None
        None where the model has no springs in its poses, the campaign has none, nothing is deflected, or nobody knows
        what the arm weighs.
    """
    model = known_of(opened.stages, "points")
    if (
        model is None
        or "poses" not in opened.campaign.tables
        or not any_of_role(model.slots, "compliance", effects=opened.effects)
    ):
        return None
    if not opened.campaign.robot.has_masses and not any_of_role(
        model.slots, *WEIGHTS, per="link", effects=opened.effects
    ):
        return None
    trial = opened.fit_problem("poses", opened.rows("poses").points)
    bent = _bending(opened, trial)
    if not np.any(bent.parts):
        return None
    fitted = _fit(opened, trial, bent)
    if not np.isfinite(fitted.theta).all():
        return None
    factors, spread = 1.0 + fitted.theta[:2], fitted.covariance[:2, :2]
    mistake = _explained(factors, spread)
    said = _in_words(factors, spread, mistake)
    explained = next(((own, tool) for own, tool, words in EXPLANATIONS if said and words == mistake), None)
    base = base_std = None
    if opened.session is not None:
        base, base_std = fitted.theta[2:8], np.sqrt(np.diag(fitted.covariance)[2:8])
        biased = "" if mistake else _like_deflection(base, fitted.covariance[2:8, 2:8], fitted.columns)
        if biased:
            mistake = "the base frame is biased by deflection"
            said = f"The base stands {biased}: {mistake}, as of a model that was fitted without springs."
    wrong = "" if mistake is None or mistake in FINE else mistake
    return Compensation(factors, spread, base, base_std, wrong, said, explained)


def put_right(opened: ModelOnCampaign, found: Compensation) -> ModelOnCampaign | None:
    """The campaign with the joint values to which its compensation sent the robot, instead of those asked for.

    With the factors that the explanation has, so that a mistake is taken for what it is called, and springs within what
    the model knows of them: what a small error of theirs does, a large factor multiplies. None where no compensation
    explains the poses, or distances stand beside them: nobody knows then where the robot was sent.
    """
    if found.explained is None or "distances" in opened.campaign.tables:
        return None
    less = np.array(found.explained) - 1.0
    tables, rows = dict(opened.campaign.tables), opened.rows("poses")
    trial = opened.fit_problem("poses", rows)
    bent = _bending(opened, trial)
    springs = _search(
        opened, trial, np.einsum("p,pkni->kni", less, bent.parts), np.ones(bent.parts.shape[1]), bent.covariance
    ).theta[: bent.parts.shape[1]]
    tables["poses"] = _shifted(tables["poses"], np.einsum("p,k,pkni->ni", less, springs, bent.parts))
    others = opened.verification()
    if others is not None:
        parts = _bending(opened, opened.fit_problem("poses", others)).parts
        tables["verification"] = _shifted(tables["verification"], np.einsum("p,k,pkni->ni", less, springs, parts))
    campaign = replace(opened.campaign, tables=tables)
    return replace(opened, campaigns=(campaign,), base={0: rows.pose.base_reference[0]})


@dataclass(frozen=True)
class _Bending:
    """The springs' twist, spring by spring.

    Attributes
    ----------
    parts
        ``(2, K, N, n)``, rad: by the arm's own weight and by the tool, through each of K springs.
    covariance
        ``(K, K)``: of the springs' compliances, relative to each.
    """

    parts: Array
    covariance: Array


def _bending(opened: ModelOnCampaign, trial: FitProblem) -> _Bending:
    """The deflections of the joints at the joint values that were asked for."""
    model = only_of(opened.stages, "points")
    springs = numbers_of_role(model.slots, "compliance")
    at_flanks = trial.with_flanks(model.theta).rows.signals
    angle = trial.chain.offsets["joint_angle"]
    stiff = model.theta.copy()
    stiff[springs] = 0.0
    n = angle.stop - angle.start

    def through_each(signals: Mapping[str, Array]) -> Array:
        """``(K, N, n)``, rad: compliances times what a unit of each does, for springs are linear."""
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
        **{name: np.zeros_like(at_flanks[name]) for name in WEIGHT},
    }  # dry friction still winds up springs
    whole, arm, rest = (through_each(signals) for signals in (at_flanks, bare, weightless))
    size = np.where(model.theta[springs] != 0.0, model.theta[springs], np.inf)
    covariance = model.covariance[np.ix_(springs, springs)] / np.outer(size, size)
    return _Bending(np.array([arm - rest, whole - arm]), covariance)


@dataclass(frozen=True)
class _Fit:
    """Factors less 1, shifts of base and targets ``(8 + 3m,)``, their covariance, and the columns ``(N, 3, P)``."""

    theta: Array
    covariance: Array
    columns: Array


@dataclass(frozen=True)
class _Search:
    """Where Gauss-Newton has ended, and its last step's equations.

    Attributes
    ----------
    theta
        ``(F + 6 + 3m,)``: factors on F deflections less 1, shifts of the base, (w, v), and of m targets.
    used
        ``(N,)``: rows that are not wrong.
    lever, columns
        ``(N, 3, n)`` and ``(N, 3, P)``: derivatives of the points by the joints, and by ``theta``.
    residual, step
        ``(3 N,)`` of the used rows before the last step, and that ``(P,)``.
    """

    theta: Array
    rows: Rows
    used: Bools
    lever: Array
    columns: Array
    residual: Array
    step: Array


def _search(
    opened: ModelOnCampaign, trial: FitProblem, parts: Array, mean: Array | None = None, spread: Array | None = None
) -> _Search:
    """Gauss-Newton on factors of deflections ``(F, N, n)``; where a compensation sends the robot, it gives way anew.

    ``mean`` and ``spread`` ``(F,)`` and ``(F, F)``: what is known of the factors less 1, and its covariance.
    """
    n, count, targets = trial.rows.robot.n, len(parts), trial.rows.signals["target_is"]
    theta, sent = np.zeros(count + 6 + 3 * targets.shape[1]), np.zeros_like(parts[0])
    theta[:count] = 0.0 if mean is None else mean
    rows, at = trial.rows, _values(trial, opened)
    for _ in range(MAX_NEWTON_STEPS):
        shift = np.einsum("p,pni->ni", theta[:count], parts)
        if np.abs(shift - sent).max() > ELSEWHERE:
            moved = trial.with_rows(_sent(opened, trial.rows, shift))
            rows, at, sent = moved.rows, _values(moved, opened), shift
        values = at.copy()
        values[:, :n] += shift - sent
        values[:, n : n + 6] += theta[count : count + 6]
        values[:, 7 * n + 6 : 7 * n + 9] += targets @ theta[count + 6 :].reshape(-1, 3)
        position, _, sensitivity = poses.predict(rows, Deviations(values, _NONE, _NO, _NO))
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
        if mean is not None and spread is not None:  # in units of the points' scatter
            root = np.linalg.pinv(np.linalg.cholesky(spread)) * np.sqrt(np.mean(r**2))
            known = np.zeros((count, len(theta)))
            known[:, :count] = root / scale[:count]
            A, b = np.vstack([A, known]), np.r_[b, root @ (mean - theta[:count])]
        step = np.linalg.lstsq(A, b, rcond=1e-10)[0] / scale
        theta = theta + step
        if not np.isfinite(theta).all() or np.all(np.abs(step) < SHIFT_SETTLED):
            break
    return _Search(theta, rows, used, S[:, :, :n], columns, r, step)


def _fit(opened: ModelOnCampaign, trial: FitProblem, bent: _Bending) -> _Fit:
    """Factors on what the arm's own weight and the tool bend, and their covariance."""
    found = _search(opened, trial, bent.parts.sum(axis=1))
    theta, used, r = found.theta, found.used, found.residual
    J = found.columns[used].reshape(-1, len(theta))
    scale = np.linalg.norm(J, axis=0)
    scale[scale == 0.0] = 1.0
    inverse = np.linalg.pinv((J / scale).T @ (J / scale), rcond=1e-12, hermitian=True)
    _, unit = np.unique(np.repeat(found.rows.fold[used], 3), return_inverse=True)
    pulls = np.zeros((int(unit.max()) + 1, len(theta)))
    np.add.at(pulls, unit, (J / scale) * (r - J @ found.step)[:, None])
    scatter = pulls.T @ pulls * len(pulls) / max(len(pulls) - len(theta), 1)
    # Springs that are a little softer or stiffer than the model's, times how much more of them stands in the points.
    wrong = np.einsum("p,pkni->kni", theta[:2], bent.parts)
    by_spring = np.einsum("nij,knj->nik", found.lever, wrong)[used].reshape(len(r), -1)
    pulled = (J / scale).T @ by_spring
    covariance = inverse @ (scatter + pulled @ bent.covariance @ pulled.T) @ inverse / np.outer(scale, scale)
    return _Fit(theta, covariance, found.columns[used])


def _sent(opened: ModelOnCampaign, rows: Rows, shift: Array) -> Rows:
    """The rows at joint values shifted by ``(N, n)``, seen from the same base."""
    table = _shifted(opened.campaign.tables["poses"], shift)
    campaign = replace(opened.campaign, tables={**opened.campaign.tables, "poses": table})
    return replace(opened, campaigns=(campaign,), base={0: rows.pose.base_reference[0]}).rows("poses").points


def _shifted(table: pd.DataFrame, shift: Array) -> pd.DataFrame:
    """A table with its joint values shifted by ``(N, n)``."""
    names = [f"q{i + 1}_rad" for i in range(shift.shape[1])]
    return table.assign(**dict(zip(names, (table[names].to_numpy(float) + shift).T, strict=True)))


def _values(trial: FitProblem, opened: ModelOnCampaign) -> Array:
    """The model's station values ``(N, S)``."""
    theta = only_of(opened.stages, "points").theta
    return trial.chain.evaluate(theta, trial.with_flanks(theta).rows.signals).values


def _explained(factors: Array, covariance: Array) -> str | None:
    """The first explanation that the factors do not contradict, likeliest first; None where there is none."""
    distance = []
    for own, tool, _ in EXPLANATIONS:
        off = factors - np.array([own, tool])
        distance.append(float(off @ np.linalg.pinv(covariance, hermitian=True) @ off))
    limit = float(stats.chi2.isf(FALSE_REJECTIONS, 2))
    if distance[0] <= limit:
        return ""  # as the model says: nothing speaks for a compensation
    best = int(np.argmin(distance))
    return EXPLANATIONS[best][2] if distance[best] <= limit else None


def _in_words(factors: Array, covariance: Array, mistake: str | None) -> str:
    """A sentence on the factors; empty where the deflections stand in full, or cannot be determined."""
    std = np.sqrt(np.diag(covariance))
    if mistake == "" or std[0] > KNOWN * max(1.0, abs(float(factors[0] - 1.0))):
        return ""
    what = mistake or "no known mistake of a compensation explains this"
    arm, tool = (with_error(float(f), float(s), "") for f, s in zip(factors, std, strict=True))
    known = ROUNDING < std[1] <= KNOWN * max(1.0, abs(float(factors[1] - 1.0)))
    by_tool = f" and {tool} times those by the tool's" if known else ""
    return (
        f"The measured deflections are {arm} times the modelled ones by the arm's weight{by_tool} "
        f"(1 without compensation, 0 with it): {what}."
    )


def _like_deflection(base: Array, covariance: Array, columns: Array) -> str:
    """How far a base is off, in words, if that is what a base takes up of the deflections; else empty."""
    flat = columns.reshape(-1, columns.shape[2])
    scale = np.linalg.norm(flat[:, 2:], axis=0)
    scale[scale == 0.0] = 1.0
    taken = (np.linalg.lstsq(flat[:, 2:] / scale, flat[:, 0] + flat[:, 1], rcond=1e-10)[0] / scale)[:6]
    weight = np.linalg.pinv(covariance, rcond=1e-14, hermitian=True)
    size, whole, along = base @ weight @ base, taken @ weight @ taken, base @ weight @ taken
    if size <= stats.chi2.isf(FALSE_REJECTIONS, 6) or along >= 0.0 or along**2 < DEFLECTION_SHARE * size * whole:
        return ""
    std = np.sqrt(np.diag(covariance))
    shift = with_error(float(np.linalg.norm(base[3:])), float(np.linalg.norm(std[3:])), "m")
    turn = with_error(float(np.linalg.norm(base[:3])), float(np.linalg.norm(std[:3])), "rad")
    return f"{shift} and {turn} from the model's, as if it had absorbed the deflections"
