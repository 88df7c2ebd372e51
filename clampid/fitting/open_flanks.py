"""The flanks on which unloaded joints rest, with an unknown tilt of the robot.

A joint with an upright axis bears no weight, so dry friction keeps it on the flank that it came from. If the axis is
tilted by a milliradian, the arm's weight acts on it with a thousandth of its moment, to one side or the other. If this
exceeds the friction, it selects the flank. Neither the tilt nor the small friction of an unloaded bearing is known. A
fit that takes the flanks from the approach directions then has biased parameters.

So tilts and frictions are drawn from their plausible ranges. Each gives a pattern of flanks, with which clearances and
all other parameters are fitted to first order. Weighted by their fit, the draws are a posterior. The fit continues with
the mean tilt, and the second moment of the parameters is added to its covariance. Flanks determine only the ratio of
tilt to friction, so the tilt selects flanks and adds no load.
Source: Hoeting, Madigan, Raftery, Volinsky (1999), Bayesian model averaging: a tutorial, Statistical Science 14.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy import linalg, special

from clampid.fitting.fit import again
from clampid.fitting.repeatability import sums_over
from clampid.fitting.solve import Estimate
from clampid.fitting.unknown_friction import unknown_frictions
from clampid.fitting.visits import variance_along
from clampid.role_slots import slot_of
from clampid.stages import poses
from clampid.stages.rows import Array, Bools, Integers

__all__ = ["with_open_flanks"]

TILT_STD = 5e-4  # rad: half a millimetre per metre, by a spirit level or between axis 1 and the robot's foot
FLANK_DRAWS, SEED = 4000, 0


def with_open_flanks(estimate: Estimate) -> Estimate:
    """The pose fit with the tilt that its unloaded joints determine, and the flanks' uncertainty in its covariance.

    Unchanged if no tilt turns a flank, or if the residual exceeds the noise: flanks would absorb other errors.
    """
    rows, level = estimate.problem.rows, estimate.problem.leaning(None)
    pressing = poses.pressing(rows, level.chain, estimate.theta) if rows.kind.points else None
    gaps = {} if pressing is None else _unloaded(estimate, pressing)
    if not gaps or pressing is None:
        return estimate
    first, visit = np.unique(rows.unit, return_index=True, return_inverse=True)[1:]
    lean, turned = _turned(estimate, list(gaps), pressing, first)
    own, some = turned.any(axis=(0, 1)), turned.any(axis=(1, 2))
    if not own.any():
        return estimate
    side = np.where(turned[some][:, :, own], -1.0, 1.0)
    side = np.concatenate([np.ones((1, *side.shape[1:])), side])
    share = np.r_[np.mean(~some), np.full(some.sum(), 1.0 / FLANK_DRAWS)]
    theta, weight = _fitted(estimate, np.array(list(gaps.values()))[own], visit, side, share)
    found = estimate
    if weight[0] < 0.5:
        mean = np.zeros((rows.robot.n, 3))
        mean[np.array(list(gaps))[own]] = np.einsum("k,kmx->mx", weight[1:], lean[some][:, own]) / weight[1:].sum()
        leaning = {f"joint{j + 1}" for j in np.flatnonzero(mean.any(axis=1))}
        none = [k for k in unknown_frictions(estimate) if estimate.slots[k].place in leaning]
        found = again(estimate, level.leaning(mean), none)
    off = theta - weight @ theta
    open_ = (weight * off.T) @ off
    return estimate if _more_than_noise(found) else replace(found, covariance=found.covariance + open_)


def _more_than_noise(estimate: Estimate) -> bool:
    """Whether the squared residual is more than twice that of the instrument's stated noise."""
    rows = estimate.problem.rows
    white = (rows.in_noise_axes(estimate.residual) / rows.sigma)[rows.used]
    return float(np.mean(white**2)) > 2.0


def _unloaded(estimate: Estimate, pressing: Array) -> Mapping[int, int]:
    """Joint number -> number of its clearance, for joints that rest in every pose on the flank that they came from."""
    direction = estimate.problem.rows.signals["direction"]
    decided = ((pressing * direction > 0) | (direction == 0)).all(axis=0) & direction.any(axis=0)
    clearances = estimate.problem.numbers_of("clearance")
    slots = {estimate.slots[k].number: k for k in clearances}
    return {joint: k for joint, k in slots.items() if decided[joint]}


def _turned(estimate: Estimate, joints: Sequence[int], pressing: Array, first: Integers) -> tuple[Array, Bools]:
    """Random tilts of m joints, and the flanks that they reverse.

    Each tilt is drawn with a friction, and then scaled to the fitted friction: only their ratio selects flanks.

    Parameters
    ----------
    joints
        Numbers of the m unloaded joints, from 0.
    pressing
        Torque that presses on the flank of each joint ``(N, n)``, Nm.
    first
        One row of each of the V visits.

    Returns
    -------
    lean, turned
        Rotation vectors ``(K, m, 3)``, rad, and whether the joint rests on the other flank ``(K, V, m)``.
    """
    signals, rng = estimate.problem.rows.signals, np.random.default_rng(SEED)
    least = np.abs(signals["rest_direction"]).max(axis=0)[joints]
    values = estimate.values()
    own = [values.get(slot_of("arm_friction", f"joint{j + 1}"), 0.0) for j in joints]
    fitted = np.maximum(own, 0.0)
    by_lean, now = (v[first][:, joints] for v in (signals["lean_torque"], pressing))
    friction = fitted + least * rng.uniform(0.0, 2.0, (FLANK_DRAWS, 1))
    lean = TILT_STD * rng.standard_normal((FLANK_DRAWS, 1, 3)) * ((fitted + least) / friction)[:, :, None]
    pressed = now + np.einsum("vmx,kmx->kvm", by_lean, lean)
    return lean, np.asarray(pressed * now < 0)


def _fitted(estimate: Estimate, gaps: Integers, visit: Integers, side: Array, share: Array) -> tuple[Array, Array]:
    """Best parameters ``(K, P)`` for each pattern of flanks, SI, and its posterior weight ``(K,)``.

    The columns of the clearances change sign with the flanks. So clearances are taken out of the residual and fitted
    again, together with all other parameters except frictions that the data do not identify. Only sums over visits are
    formed.

    Parameters
    ----------
    gaps
        Numbers of the clearances ``(m,)``.
    visit
        Visit of each row ``(N,)``.
    side
        ``(K, V, m)``: -1 if the joint rests on the other flank in a visit, else 1.
    share
        Prior probability of each pattern ``(K,)``.
    """
    white, theta, precision = estimate.whitened, estimate.theta, estimate.prior_precision
    rest = np.setdiff1d(np.arange(len(theta)), [*gaps, *unknown_frictions(estimate)])
    X, C = white.jacobian[:, rest], white.jacobian[:, gaps]
    residual = white.residual + C @ theta[gaps]
    size = 1.0 / np.sqrt(np.diag(X.T @ X) + np.diag(precision)[rest])
    X = X * size
    root = linalg.cholesky(X.T @ X + precision[np.ix_(rest, rest)] * np.outer(size, size), lower=True)
    pull = size * (precision[rest] @ (estimate.prior_mean - theta) + precision[np.ix_(rest, gaps)] @ theta[gaps])
    known = linalg.solve_triangular(root, X.T @ residual + pull, lower=True)
    by_visit, turn = sums_over(visit[white.entry], side.shape[1]), np.moveaxis(side, 2, 0)  # (m, K, V)
    cross, slope = by_visit(C[:, :, None] * X[:, None, :]), by_visit(C * residual[:, None])
    square = by_visit(C[:, :, None] * C[:, None, :])
    inside = turn @ np.moveaxis(cross, 1, 0) + (precision[np.ix_(gaps, rest)] * size)[:, None, :]  # (m, K, R)
    inside = linalg.solve_triangular(root, inside.reshape(-1, len(rest)).T, lower=True).T.reshape(inside.shape)
    normal = np.einsum("ikv,jkv,vij->kij", turn, turn, square, optimize=True) + precision[np.ix_(gaps, gaps)]
    normal -= np.einsum("iko,jko->kij", inside, inside, optimize=True)
    own = precision[gaps] @ estimate.prior_mean - precision[np.ix_(gaps, rest)] @ theta[rest]
    slopes = np.einsum("ikv,vi->ki", turn, slope) + own - (inside @ known).T
    gap = np.linalg.solve(normal, slopes[:, :, None])[:, :, 0]
    out = np.tile(theta, (len(side), 1))
    step = linalg.solve_triangular(root.T, known[:, None] - np.einsum("iko,ki->ok", inside, gap), lower=False)
    out[:, rest], out[:, gaps] = theta[rest] + (size[:, None] * step).T, gap
    variance = variance_along(estimate, gaps)
    positive = special.log_ndtr(gap * np.sqrt(np.diagonal(normal, axis1=1, axis2=2) / variance)).sum(axis=1)
    weight = np.log(np.maximum(share, 1e-300)) + 0.5 * np.sum(slopes * gap, axis=1) / variance + positive
    weight = np.exp(weight - weight.max())
    return out, weight / weight.sum()
