"""Covariance of a clamped block's slip when the friction of the motors at rest is unknown.

The torque of a motor at rest is its gear's torque plus the friction that it kept, which lies anywhere between its
limits. A slip changes the torques. A gear whose torque changes its sign also crosses its backlash. The data identify
such a crossing only if no possible friction can hide it; otherwise the slip is known except for that backlash. A fit
ends at one combination of crossings, and its standard error ignores the others, which fit equally well. So the second
moment of the slip over frictions uniform between their limits is added to the covariance.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from clampid.fitting.solve import Estimate
from clampid.stages.clamped import joint_torques
from clampid.stages.rows import Array

__all__ = ["with_kept_friction"]

FRICTION_DRAWS, SEED = 1000, 0
AXES = ("rx", "ry", "rz", "x", "y", "z")


def with_kept_friction(estimate: Estimate) -> Estimate:
    """The fit with the unknown friction of motors at rest included in the covariance of its slips.

    Unchanged if no slip is fitted. The transmission T relates torques about the arm's joints to those at the motors.
    """
    effects = estimate.problem.effects
    covariance = estimate.covariance.copy()
    for name in dict.fromkeys(slot.effect for slot in estimate.slots):
        if effects[name].event is None:
            continue
        index = {slot.parameter: k for k, slot in enumerate(estimate.slots) if slot.effect == name}
        own = [index[axis] for axis in AXES]
        covariance[np.ix_(own, own)] += _open(estimate, float(estimate.theta[index[str(effects[name].event)]]))
    return replace(estimate, covariance=covariance)


def _open(estimate: Estimate, at: float) -> Array:
    """Second moment ``(6, 6)`` of a slip's error by unknown friction, (rotation, translation), rad and m.

    ``at``: time of the slip as a value of ``sweep_progress``.
    """
    problem, n = estimate.problem, estimate.problem.rows.robot.n
    rows, count = problem.rows, len(estimate.slots)
    mine = np.flatnonzero(rows.series.run == int(at))
    after = int(np.searchsorted(rows.signals["sweep_progress"][mine], at))
    if not 0 < after < len(mine):
        return np.zeros((6, 6))
    beside = mine[[after - 1, after]]
    theta, offsets = estimate.theta[:count], estimate.theta[count:]
    torque = joint_torques(rows, problem.chain, theta, offsets)[beside]
    kept = rows.offset_table(offsets, 2)[beside[0], n:]
    gap = problem.clearances(theta)
    at_rest = ~np.any(rows.signals["motor_motion"][mine] != 0.0, axis=0)
    limit = np.where(at_rest, rows.sweep.loop_friction, 0.0)
    drawn = np.where(at_rest, np.random.default_rng(SEED).choice([-1.0, 1.0], (FRICTION_DRAWS, n)) * limit, kept)
    T = np.asarray(rows.robot.transmission)
    other = torque + np.linalg.solve(T, (kept - drawn).T).T[:, None, :]  # (FRICTION_DRAWS, 2, n)
    passed = 0.5 * (np.sign(other[:, 1]) - np.sign(other[:, 0])) - 0.5 * (np.sign(torque[1]) - np.sign(torque[0]))
    slip = (passed * gap) @ np.linalg.pinv(rows.sweep.inverse_jacobian[beside[0]]).T
    return np.asarray(slip.T @ slip / FRICTION_DRAWS)
