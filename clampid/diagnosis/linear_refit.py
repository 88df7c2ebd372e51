"""Held-out error with an alternative, estimated by one Gauss-Newton step instead of a fit."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from clampid.diagnosis.next_measurement import SAME
from clampid.diagnosis.probes import probes
from clampid.evidence.candidates import columns_of
from clampid.evidence.columns import Columns
from clampid.evidence.score import Scored
from clampid.fitting.descent import newton_step
from clampid.fitting.noise import Whitened
from clampid.fitting.solve import Estimate, limits_of
from clampid.stages.rows import Array, Integers

__all__ = ["Step", "at_fit", "is_costlier", "linear_refit", "step_towards"]


def linear_refit(estimate: Estimate, s: Scored) -> Estimate | None:
    """The estimate with a candidate, by one linear step from the fit without; None if it is no amplitude of rows.

    Noise and covariance stay those of the fit without it: the result is for predictions only.
    """
    c, white = s.candidate, estimate.whitened
    if estimate.problem.effects[c.name].event is not None or set(c.slots) & set(estimate.slots):
        return None
    shapes = {slot: value for slot, value in c.shapes.items() if slot not in estimate.slots}
    problem = estimate.problem.with_slots((*estimate.slots, *c.slots, *shapes))
    count, new, whole = len(estimate.slots), len(c.slots), len(estimate.slots) + len(c.slots) + len(shapes)
    old = np.r_[np.arange(count), np.arange(whole, whole + len(estimate.theta) - count)]
    theta, mean = np.zeros(len(old) + whole - count), np.zeros(len(old) + whole - count)
    theta[old], mean[old] = estimate.theta, estimate.prior_mean
    theta[count:whole] = mean[count:whole] = [*np.zeros(new), *shapes.values()]
    precision = np.diag(1.0 / problem.prior_std() ** 2)
    if c.prior is not None:
        precision[range(count, count + new), range(count, count + new)] = 1.0 / c.prior**2
    precision[np.ix_(old, old)] = estimate.prior_precision
    at, D = np.arange(count, count + new), c.columns.dense(len(white.residual))
    normal, moment = np.zeros_like(precision), precision @ (mean - theta)
    cross = white.jacobian.T @ np.c_[D, white.residual]
    normal[np.ix_(old, old)] += white.normal
    normal[np.ix_(old, at)] += cross[:, :-1]
    normal[np.ix_(at, old)] += cross[:, :-1].T
    normal[np.ix_(at, at)] += D.T @ D
    moment[old] += cross[:, -1]
    moment[at] += D.T @ white.residual
    free = np.ones(len(theta), dtype=bool)
    free[old] = ~limits_of(estimate.problem).resting(estimate.theta)
    step = newton_step(normal + precision, moment, problem.sizes(), 0.0, free)
    left = white.residual - white.jacobian @ step[old] - D @ step[at]
    joined = _Joined(white, D, normal, old, at)
    return replace(
        estimate,
        problem=problem,
        theta=theta + step,
        whitened=Whitened(left, joined, white.entry, white.channel),
        prior_precision=precision,
        prior_mean=mean,
    )


@dataclass(frozen=True, eq=False)
class _Joined:
    """The Jacobian of a fit and a candidate's columns D ``(M, k)`` in it: :class:`clampid.fitting.noise.Late`.

    ``old`` and ``at`` say which parameters are the fit's and the candidate's; J'J is ``square``.
    """

    white: Whitened
    D: Array
    square: Array
    old: Integers
    at: Integers

    def dense(self) -> Array:
        """J ``(M, P)``."""
        out = np.zeros((len(self.D), len(self.square)))
        out[:, self.old], out[:, self.at] = self.white.jacobian, self.D
        return out

    def normal(self) -> Array:
        """J'J ``(P, P)``."""
        return self.square


@dataclass(frozen=True)
class Step:
    """One Gauss-Newton step towards a candidate.

    Attributes
    ----------
    near
        The estimate there, if everything were linear.
    promised, kept
        Fall of the whitened squares of the fitted rows: as predicted by the linear model, and the actual one.
    """

    near: Estimate
    promised: float
    kept: float

    @property
    def falls(self) -> bool:
        """Whether the step lowers the error of the fitted rows."""
        return self.kept > 0.0

    @property
    def linear(self) -> bool:
        """Whether the score, which is that of a linear model, is right for the candidate."""
        return abs(self.kept - self.promised) <= SAME

    def may_reach(self, other: Step | None) -> bool:
        """Whether a search from here may explain as much as the other step, judged by the observed curvature."""
        return other is None or max(self.kept, self.promised) + abs(self.kept - self.promised) >= other.kept


def at_fit(estimate: Estimate, s: Scored) -> Scored:
    """A candidate scored at another fit, its columns evaluated at this one.

    This one may drop other rows as outliers, and its noise may be another, as if readings wander.
    """
    if not s.candidate.terms:
        own = next(p for p in probes(estimate) if p.label == s.candidate.label)
        return replace(s, candidate=replace(own, prior=s.candidate.prior))
    columns = columns_of(estimate, [s.candidate])
    return replace(s, candidate=replace(s.candidate, columns=Columns(((0, columns),), columns.shape[1])))


def step_towards(estimate: Estimate, *candidates: Scored) -> Step | None:
    """A step towards a candidate, or several, with the predicted and the actual fall; None if any is no amplitude.

    A closing gap or a time constant is not linear; then only a full fit decides.
    """
    near = estimate
    for s in candidates:
        found = linear_refit(near, s)
        if found is None:
            return None
        near = found
    trial = near.problem.with_flanks(near.theta)
    residual = trial.error(limits_of(trial).clipped(near.theta))
    if not np.all(np.isfinite(residual)):
        return Step(near, 0.0, -np.inf)
    white = near.noise.whiten(trial.rows, residual, np.zeros((*residual.shape, 0)))
    before, linear = estimate.point.cost, float(near.whitened.residual @ near.whitened.residual)
    return Step(near, before - linear, before - float(white.residual @ white.residual))


def is_costlier(s: Scored, own: Step | None, best: Scored, step: Step | None) -> bool:
    """Whether a variant has more parameters than the best, which BIC does not justify, and its score is reliable.

    Its fit would lower the residual of these rows, and by chance half the time the held-out error.
    """
    scores_decide = all(
        one.candidate.prior is None and not one.candidate.shapes and near is not None and near.linear
        for one, near in ((s, own), (best, step))
    )
    return scores_decide and s.freedom > best.freedom and s.bic < best.bic
