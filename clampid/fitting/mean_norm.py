"""The fit of the universal model: minimum of the mean norm of the errors, by sequential quadratic programming.

The universal model minimises P̄ = (1/N) Σ |e_i|, with e_i the errors of the measured points, by SLSQP (Kraft1988). Its
tables give P̄, σ_P and P_max. Least squares, the default here, is the better estimate for Gaussian errors; the mean
norm is less sensitive to a few large errors. The search starts at the least-squares solution, with the rows that it
kept.

Priors keep their influence: a prior of precision A is added to Σ |e_i| as κ/2 δ'Aδ, where δ is the difference to its
mean and κ = 2/3 √(2/π) σ. Both costs then have the same curvature for Gaussian errors with standard deviation σ in each
axis.

Standard errors are those of an M-estimator, by a sandwich over visits: H⁻¹ (Σ_v g_v g_v' + κ² A) H⁻¹ with
H = Σ J_i' (1 - u_i u_i') J_i / |e_i| + κ A, u_i = e_i/|e_i| and g_v = Σ J_i' u_i over a visit. Source: Huber, Robust
Statistics, 1981, ch. 6; Liang, Zeger, Biometrika 73, 1986.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import linalg, optimize

from clampid.fitting.descent import inverse_of
from clampid.fitting.flanks import settled
from clampid.fitting.noise import Noise
from clampid.fitting.solve import Estimate, FitError, limits_of, stage_point
from clampid.stages.fit_problem import FitProblem
from clampid.stages.rows import Array
from experiments.measures.metrics import norm_metrics

__all__ = ["compared", "mean_norm"]

CURVATURE_OF_NORM = 2 / 3 * np.sqrt(2 / np.pi)  # sigma E[(1 - uu')/|e|] in each axis, for Gaussian errors in 3 D
TOLERANCE, MAX_SLSQP_STEPS = 1e-9, 1000  # of SLSQP: the first is of the cost, in units of chi-square
LEAST_RESIDUAL = 1e-3  # in units of sigma: smaller errors count as this large in H


def mean_norm(estimate: Estimate) -> Estimate:
    """The model with the smallest mean norm of the errors.

    Parameters
    ----------
    estimate
        A least-squares fit of the stage ``poses``; it gives the initial values, the rows and the priors.

    Returns
    -------
    Estimate
        Its weights are such that its normal equations hold: the variance of a point is κ |e_i|. Orientations do not
        count.

    Raises
    ------
    FitError
        The fit is not of poses, it has distances, or SLSQP does not converge.
    """
    if not estimate.problem.kind.points:
        raise FitError(f"mean norm: expected a fit of measured points (stage poses), found {estimate.problem.stage}")
    rows = estimate.problem.rows
    if rows.ranged.any():
        raise FitError("mean norm: expected measured points only, found a table distances")
    used = rows.used.copy()
    used[:, 3:] = False
    trial = estimate.problem.with_rows(replace(rows, used=used))
    sigma = float(np.sqrt(np.mean(estimate.residual[used[:, 0], :3] ** 2)))
    kappa = CURVATURE_OF_NORM * sigma
    theta = settled(
        estimate.theta,
        lambda at: [trial.with_flanks(at)],
        lambda frozen, at: _Lowest(_search(frozen[0], at, estimate, kappa)),
        lambda frozen, at: _cost(frozen[0], at, estimate, kappa)[0],
    ).theta
    frozen = trial.with_flanks(theta)
    error = np.linalg.norm(frozen.residual(theta)[0][:, :3], axis=1)
    variance = kappa * np.maximum(error, LEAST_RESIDUAL * sigma)
    noise = Noise(np.repeat(np.sqrt(variance)[:, None], rows.measured.shape[1], axis=1))
    point = stage_point(frozen, noise, theta)
    return replace(
        estimate,
        problem=trial,
        theta=theta,
        covariance=_covariance(frozen, theta, estimate.prior_precision, kappa, LEAST_RESIDUAL * sigma),
        noise=noise,
        whitened=point.white,
        residual=point.residual,
        scatter=None,
    )


def compared(estimate: Estimate, squares: Estimate) -> dict[str, dict[str, float | None]]:
    """P_mean, P_std and P_max, m, of the fitted points, by the mean norm and by least squares."""
    used = estimate.problem.rows.used[:, 0]
    fits = {"mean-norm": estimate, "least-squares": squares}
    return {name: norm_metrics(np.linalg.norm(e.residual[used, :3], axis=1)) for name, e in fits.items()}


@dataclass(frozen=True)
class _Lowest:
    """Parameters ``(P,)`` at the end of a search with frozen flanks."""

    theta: Array


def _cost(trial: FitProblem, theta: Array, estimate: Estimate, kappa: float) -> tuple[float, Array]:
    """Cost in units of chi-square: sum of the norms over κ plus the prior's term; and its gradient ``(P,)``."""
    used = trial.rows.used[:, 0]
    residual, by = trial.residual(theta)
    e = residual[used, :3]
    norm = np.linalg.norm(e, axis=1)
    u = e / np.maximum(norm, 1e-15)[:, None]
    off = theta - estimate.prior_mean
    pull = estimate.prior_precision @ off
    return float(norm.sum() / kappa + 0.5 * off @ pull), pull - np.einsum("ni,nip->p", u, by[used, :3]) / kappa


def _search(trial: FitProblem, theta: Array, estimate: Estimate, kappa: float) -> Array:
    """SLSQP from ``theta`` with frozen flanks, in coordinates in which the least-squares cost is isotropic."""
    free = np.flatnonzero(~trial.fixed())
    J = estimate.whitened.jacobian
    L = linalg.cholesky(inverse_of(J.T @ J + estimate.prior_precision)[np.ix_(free, free)], lower=True)

    def at(z: Array) -> Array:
        out = theta.copy()
        out[free] += L @ z
        return out

    def cost(z: Array) -> tuple[float, Array]:
        value, gradient = _cost(trial, at(z), estimate, kappa)
        return value, L.T @ gradient[free]

    limits = limits_of(trial)
    rows = [(sign * L[k], sign * (theta[j] - bound)) for k, j in enumerate(free) if limits.bounded[j]
            for sign, bound in ((1.0, limits.lower[j]), (-1.0, limits.upper[j])) if np.isfinite(bound)]  # fmt: skip
    constraints = []
    if rows:
        by_z, slack = np.array([r for r, _ in rows]), np.array([s for _, s in rows])
        constraints.append({"type": "ineq", "fun": lambda z: by_z @ z + slack, "jac": lambda z: by_z})
    found = optimize.minimize(
        cost, np.zeros(len(free)), jac=True, method="SLSQP", constraints=constraints,
        options={"ftol": TOLERANCE, "maxiter": MAX_SLSQP_STEPS},
    )  # fmt: skip
    if not found.success or not np.all(np.isfinite(found.x)):
        raise FitError(f"poses: SLSQP did not find the least mean norm: {found.message}")
    return at(found.x)


def _covariance(trial: FitProblem, theta: Array, precision: Array, kappa: float, nearest: float) -> Array:
    """The sandwich ``(P, P)`` of the module's docstring."""
    residual, by = trial.residual(theta)
    used = trial.rows.used[:, 0]
    e, J = residual[used, :3], by[used, :3]
    norm = np.linalg.norm(e, axis=1)
    along = np.einsum("ni,nip->np", e / np.maximum(norm, nearest)[:, None], J)
    weight = 1.0 / np.maximum(norm, nearest)
    whole = np.einsum("n,nip,niq->pq", weight, J, J, optimize=True)
    H = whole - (along * weight[:, None]).T @ along + kappa * precision
    _, visit = np.unique(trial.rows.unit[used], return_inverse=True)
    g = np.zeros((int(visit.max()) + 1, len(theta)))
    np.add.at(g, visit, along)
    inverse = inverse_of(H)
    determined = max(len(theta) - float(np.sum(inverse * precision) * kappa), 0.0)
    small = len(g) / max(len(g) - determined / 3, 1.0)  # a visit has three coordinates or more
    return np.asarray(inverse @ (small * g.T @ g + kappa**2 * precision) @ inverse)
