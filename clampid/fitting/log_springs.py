"""Bias of the masses fitted to a torque log by joint compliances, which the log does not determine.

Under load each drive's spring yields by c T tau. The arm moves with it, and the torques of its weight change by K times
that; K is their derivative by the posture. A fit of torques assumes the arm where its motors are. Its masses are then
biased by some tenths of a percent, in proportion to compliances c that only clamped sweeps or poses determine. To first
order, for least squares with the design X, weights W and prior precision P::

    theta - theta_fitted = B c,    B = -(X' W X + P)^-1 X' W S,    S = d torque / d c

A stage that uses these masses as a prior and has springs uses B too (:attr:`clampid.slots.Prior.slope`). Source: the
omitted-variable formula, as in Greene, Econometric Analysis (2012), section 4.3.2; K: :mod:`kinematics.gravity`.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from clampid.fitting.descent import inverse_of
from clampid.fitting.log_sample import sampled_columns, sampled_postures, sampled_rows
from clampid.fitting.moments import Moments
from clampid.fitting.solve import Estimate
from clampid.role_slots import slot_of
from clampid.slots import Slot
from clampid.stages.loads import described_weight, gravity_regressors, weight_stiffness
from clampid.stages.log_design import LogDesign
from clampid.stages.log_facts import LogPart
from clampid.stages.rows import Array
from kinematics.robot import RobotDescription

__all__ = ["by_springs", "log_by_springs", "rows_by_springs", "spring_torques", "springs"]


def springs(joints: int) -> tuple[Slot, ...]:
    """The drives' compliances, in the order of the columns of B."""
    return tuple(slot_of("compliance", f"joint{j + 1}") for j in range(joints))


def spring_torques(robot: RobotDescription, weight: Array, gravity: Array, q: Array) -> Array:
    """S ``(N, n, n)``, Nm/(rad/Nm): derivative of the motors' torques by each drive's compliance.

    Drive l moves the joints by -T_l' c_l (T tau)_l, and T K times that is the change of the torques.

    Parameters
    ----------
    robot
        Its transmission T and geometry.
    weight
        ``(4n,)``: (m, m c) of all links, base axes at the zero pose, kg and kg m.
    gravity
        ``(3,)``, base frame, m/s².
    q
        ``(N, n)``, rad.
    """
    T = np.asarray(robot.transmission)
    load = gravity_regressors(robot, gravity, q)["regressor"] @ weight @ T.T
    follows = T @ weight_stiffness(robot, weight, gravity, q) @ T.T
    return np.asarray(-follows * load[:, None, :])


def by_springs(columns: Array, torques: Array, normal: Array, precision: Array) -> Array:
    """B ``(P, n)``, derivative of the fitted parameters by the compliances, from a sample of a log's rows.

    Parameters
    ----------
    columns, torques
        ``(M, P)`` and ``(M, n)``: X and S in those rows, over the noise.
    normal, precision
        ``(P, P)``: normal matrix of all rows, and precision of the prior.
    """
    own = columns.T @ columns
    informative = np.diag(own) > 0.0
    # The sample has fewer rows, which are not prewhitened: its normal matrix is scaled to that of all rows.
    share = float(np.median(np.diag(normal)[informative] / np.diag(own)[informative]))
    return np.asarray(-inverse_of(share * own + precision) @ (share * (columns.T @ torques)))


def rows_by_springs(estimate: Estimate) -> Array | None:
    """B ``(P, n)`` of a fit of torque logs in memory; None if no link's mass is known."""
    rows = estimate.problem.rows
    chosen = sampled_rows(rows)
    part, count = rows.take(chosen), len(estimate.slots)
    torques = np.zeros((len(part), rows.robot.n, rows.robot.n))
    for s in np.unique(part.session):
        own = part.session == s
        weight, gravity = (rows.log.weight[s], rows.log.gravity_vector[s])
        torques[own] = spring_torques(rows.robot, weight, gravity, part.signals["q"][own])
    if not torques.any():
        return None
    trial = estimate.problem.with_rows(part)
    _, jacobian = trial.residual(np.r_[estimate.theta[:count], np.zeros(trial.offsets)])
    noise = estimate.noise.sigma[chosen][:, :, None]
    columns, torques = ((v / noise)[part.used] for v in (jacobian[:, :, :count], torques))
    normal, precision = (A[:count, :count] for A in (estimate.point.matrix, estimate.prior_precision))
    return by_springs(columns, torques, normal, precision)


def log_by_springs(
    design: LogDesign, parts: Sequence[LogPart], slots: Sequence[Slot], sigma: Array, moments: Moments, precision: Array
) -> Array | None:
    """B ``(P, n)`` of a log fitted by windows; None if no link's mass is known, or no row counts.

    Parameters
    ----------
    design, parts
        The log.
    slots
        The fitted slots.
    sigma
        Standard deviation of the motors' noise ``(n,)``, Nm.
    moments, precision
        Sums of the fit, and precision of its prior ``(P + K, P + K)``.
    """
    row, motor, q = sampled_postures(design, parts)
    torques, before = np.zeros((len(row), design.n)), 0
    for part in parts:
        here = np.flatnonzero((row >= before) & (row < before + part.table.rows))
        campaign = part.campaign
        found = spring_torques(campaign.robot, described_weight(campaign), np.asarray(campaign.gravity), q[here])
        torques[here] = found[np.arange(len(here)), motor[here]]
        before += part.table.rows
    if not torques.any():
        return None
    columns = np.concatenate(sampled_columns(design, parts, slots, sigma, at_rest=False), axis=1)
    return by_springs(columns, torques / sigma[motor][:, None], moments.normal, precision)[: len(slots)]
