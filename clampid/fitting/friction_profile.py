"""Profile likelihood of a joint's dry friction in a pose fit: the cost at every value at which a flank changes.

For each value of the friction, the clearance of its joint and all other parameters are fitted to first order. Source:
profile likelihood, as in Venzon, Moolgavkar, Applied Statistics 37, 1988; used here as a posterior with the friction's
prior. :mod:`clampid.fitting.rest_friction` says where it is needed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import linalg

from clampid.fitting.repeatability import sums_over
from clampid.fitting.solve import Estimate
from clampid.fitting.visits import variance_along
from clampid.stages import poses
from clampid.stages.rows import Array, Integers

__all__ = ["FrictionProfile"]

MAX_FRICTION_VALUES, MIN_FRICTION_VALUES = 2000, 33  # values of a friction that are tried
TAIL_NODES, TAIL_DEVIATIONS = 16, 3.0  # frictions tried above all loads: number, and end in prior standard deviations


@dataclass(frozen=True)
class FrictionProfile:
    """Profile likelihood of one friction: a fit with the friction fixed at each of K values.

    Attributes
    ----------
    joint
        The friction's joint, from 0.
    value, cost
        Friction ``(K,)``, Nm, and sum of squares of the whitened rows and the prior.
    theta
        All parameters ``(K, P)``, SI.
    weight
        Posterior probability of the interval about each value ``(K,)``; no flank changes inside an interval.
    slope
        d theta / d value ``(P,)``, with the flanks of the estimate.
    """

    joint: int
    value: Array
    cost: Array
    theta: Array
    weight: Array
    slope: Array

    @property
    def likeliest(self) -> float:
        """The value with the lowest cost; at most the smallest of the values above all loads."""
        best = int(np.argmin(self.cost))
        return float(self.value[min(best, len(self.value) - TAIL_NODES)])

    @classmethod
    def of(cls, estimate: Estimate, friction: int) -> FrictionProfile:
        """The profile of parameter number ``friction``, about a fit of poses."""
        joint = estimate.slots[friction].number
        clearances = estimate.problem.numbers_of("clearance")
        gap = next(k for k in clearances if estimate.slots[k].place == f"joint{joint + 1}")
        row, visit = np.unique(estimate.problem.rows.unit, return_index=True, return_inverse=True)[1:]
        none = estimate.theta.copy()
        none[friction] = 0.0
        pressing = _pressing(estimate, none)
        direction = estimate.problem.rows.signals["direction"][row, joint]
        without, fitted = pressing[row, joint], _pressing(estimate, estimate.theta)[row, joint]
        contrary = np.flatnonzero(without * direction < 0.0)  # only loads against the direction are overcome
        order = contrary[np.argsort(np.abs(without[contrary]), kind="stable")]
        value, width, after = _values(
            np.abs(without[order]), TAIL_DEVIATIONS * float(estimate.problem.prior_std()[friction])
        )
        side = np.where(without * fitted < 0.0, -1.0, 1.0)
        loose = _Separated.of(estimate, friction, gap)
        theta, cost, normal, slopes = loose.fitted(value, visit, side, order, after)
        variance = variance_along(estimate, np.array([gap]))
        log = -0.5 * cost / variance - 0.5 * np.log(normal) + np.log(width)
        weight = np.exp(log - log.max())
        now = int(np.argmin(np.abs(value - estimate.theta[friction])))
        return cls(joint, value, cost, theta, weight / weight.sum(), slopes[now])


def _pressing(estimate: Estimate, theta: Array) -> Array:
    """Torque that presses on the flank of each joint ``(N, n)``, Nm."""
    found = poses.pressing(estimate.problem.rows, estimate.problem.chain, theta)
    if found is None:
        raise ValueError("expected a fit with clearances that follow the flanks, found none")
    return found


def _values(turns: Array, most: float) -> tuple[Array, Array, Integers]:
    """Frictions to try ``(K,)``, Nm, the width of the interval about each, and the number of flanks changed below it.

    Parameters
    ----------
    turns
        Frictions at which a flank changes, Nm, in increasing order.
    most
        The largest friction to try, Nm.
    """
    at = np.unique(np.r_[turns, np.linspace(0.0, turns.max(initial=1e-6), MIN_FRICTION_VALUES)])
    chosen = np.unique(np.linspace(0, len(at) - 1, min(len(at), MAX_FRICTION_VALUES)).astype(int))
    edge = at[chosen]
    inside, last = 0.5 * (edge[1:] + edge[:-1]), 1.001 * float(edge[-1])
    beyond = np.geomspace(last, max(most, 10.0 * last), TAIL_NODES)
    value = np.r_[inside, beyond]
    width = np.r_[np.diff(edge), np.gradient(beyond)]
    return value, width, np.asarray(np.searchsorted(turns, value), dtype=np.int64)


@dataclass(frozen=True)
class _Separated:
    """The linearised fit of rows and priors, whitened, with one friction and one clearance separated from the rest.

    Attributes
    ----------
    estimate
        The fit that is linearised.
    at
        Numbers of the friction and of the clearance.
    index, size, rest
        Numbers of all other parameters ``(R,)``, their scales ``(R,)`` and their scaled columns ``(M, R)``.
    gap, friction
        Columns of the clearance and of the friction ``(M,)``.
    residual
        Residual ``(M,)`` at zero clearance and zero friction.
    rows
        Number of entries of M that come from rows; the others come from priors.
    """

    estimate: Estimate
    at: tuple[int, int]
    index: Integers
    size: Array
    rest: Array
    gap: Array
    friction: Array
    residual: Array
    rows: int

    @classmethod
    def of(cls, estimate: Estimate, friction: int, gap: int) -> _Separated:
        """The fit with parameters number ``friction`` and ``gap`` separated; the friction has its weak prior."""
        white, theta = estimate.whitened, estimate.theta
        precision, mean = estimate.prior_precision.copy(), estimate.prior_mean.copy()
        assumed, at_first = estimate.problem.prior()
        precision[friction], precision[:, friction] = 0.0, 0.0
        precision[friction, friction], mean[friction] = assumed[friction, friction], at_first[friction]
        scale = np.sqrt(np.diag(precision))
        square, axes = linalg.eigh(precision / np.outer(scale, scale))
        root = np.sqrt(np.maximum(square, 0.0))[:, None] * axes.T * scale
        J = np.concatenate([white.jacobian, root])
        residual = np.concatenate([white.residual, root @ (mean - theta)])
        residual = residual + J[:, gap] * theta[gap] + J[:, friction] * theta[friction]
        index = np.setdiff1d(np.arange(len(theta)), [friction, gap])
        size = 1.0 / np.linalg.norm(J[:, index], axis=0)
        return cls(
            estimate, (friction, gap), index, size, J[:, index] * size, J[:, gap], J[:, friction], residual,
            len(white.residual),
        )  # fmt: skip

    def fitted(
        self, value: Array, visit: Integers, side: Array, order: Integers, after: Integers
    ) -> tuple[Array, Array, Array, Array]:
        """Best parameters for each friction, to first order, with a clearance that is not negative.

        Parameters
        ----------
        value
            Frictions ``(K,)``, Nm.
        visit
            Visit of each of the estimate's rows ``(N,)``.
        side
            ``(V,)``: +1 if a visit without friction has the flank of the fit, else -1.
        order, after
            Visits in the order in which their flanks change with rising friction, and for each value the number of
            flanks changed ``(K,)``.

        Returns
        -------
        theta, cost, normal, slopes
            Parameters ``(K, P)``, SI; their cost ``(K,)``; the clearance's normal equation with all others eliminated
            ``(K,)``; d theta / d friction ``(K, P)``.
        """
        X, entry = self.rest, self.estimate.whitened.entry
        C = self.gap.copy()
        C[: self.rows] *= side[visit[entry]]
        by_visit = sums_over(visit[entry], len(side))

        def turned(products: Array) -> Array:
            """Sums ``(K, ...)`` of products with the clearance's column, with the flanks changed at each value."""
            steps = np.cumsum(-2.0 * by_visit(products[: self.rows])[order], axis=0)
            return np.asarray(products.sum(axis=0) + np.concatenate([np.zeros((1, *steps.shape[1:])), steps])[after])

        root = linalg.cholesky(X.T @ X, lower=True)
        r, f = self.residual, self.friction
        known = linalg.solve_triangular(root, np.stack([X.T @ r, X.T @ f], axis=1), lower=True)
        inside = linalg.solve_triangular(root, turned(C[:, None] * X).T, lower=True)  # (R, K)
        normal = np.maximum(C @ C - np.sum(inside**2, axis=0), 1e-12 * (C @ C))
        by_friction = turned(C * f) - inside.T @ known[:, 1]
        slope = turned(C * r) - inside.T @ known[:, 0] - value * by_friction
        gap = np.maximum(slope / normal, 0.0)
        gap_by = -by_friction / normal
        squares = np.array([[r @ r, r @ f], [r @ f, f @ f]]) - known.T @ known
        apart = squares[0, 0] - 2.0 * value * squares[0, 1] + value**2 * squares[1, 1]
        cost = apart - gap * (2.0 * slope - gap * normal)
        step = linalg.solve_triangular(root.T, known[:, :1] - value * known[:, 1:] - gap * inside, lower=False)
        step_by = linalg.solve_triangular(root.T, -known[:, 1:] - gap_by * inside, lower=False)
        theta = np.tile(self.estimate.theta, (len(value), 1))
        slopes = np.zeros_like(theta)
        theta[:, self.index] += (self.size[:, None] * step).T
        theta[:, self.at[0]], theta[:, self.at[1]] = value, gap
        slopes[:, self.index] = (self.size[:, None] * step_by).T
        slopes[:, self.at[0]], slopes[:, self.at[1]] = 1.0, gap_by
        return theta, cost, normal, slopes
