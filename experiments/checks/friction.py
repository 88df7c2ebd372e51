"""Checks torque logs by their friction: it dissipates energy, whatever the robot weighs.

If friction points along the motion instead of against it, the torque or the joint angle has the wrong sign. Rows in
clear motion are regressed on friction, weight, acceleration and centrifugal torques of arbitrary masses. Moves, not
rows, are taken as independent.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np
from scipy.stats import t as student

from experiments.campaign import Campaign
from experiments.checks.finding import Finding
from experiments.checks.moving_log import MovingLog, clear_moves, freed, weight_regressor
from experiments.columns import joint_columns
from experiments.signals.typing_ import Array, Bools, Integers

__all__ = ["friction_findings"]

# At most one correct motor in a thousand is reported. Moves are independent of each other, rows are not.
FALSE_ALARMS = 1e-3
MOVES = 8
LEFT = 1e-6  # share of a column's square that the others must not explain, so that its factor is identifiable


def friction_findings(campaign: Campaign, logs: Mapping[str, MovingLog]) -> Iterator[Finding]:
    """Look at the friction in free air and wrist.

    Parameters
    ----------
    campaign
        The campaign.
    logs
        Its torque tables by name, without those whose angles or torques are known to be in another unit, or mirrored.

    Yields
    ------
    Finding
        Warnings, motor by motor.
    """
    robot = campaign.robot
    if not robot.transmission_known:
        return
    names = joint_columns("tau{}_Nm", robot.n)
    for table, log in logs.items():
        turning = log.qd @ np.linalg.inv(robot.transmission)
        others = _other_torques(campaign, log)
        for m in range(robot.n):
            drag, error = _drag(log, others[m], m, turning[:, m])
            if drag < -student.isf(FALSE_ALARMS, MOVES - 1) * error:
                message = (
                    f"friction of motor {m + 1} drives it: {drag:.2g} ± {error:.1g} Nm against the motion, more than 0 "
                    f"is expected; the torque or the joint's angle is mirrored, or the sign of its ratio in T is wrong"
                )
                yield Finding("warning", table, names[m], None, message)


def _other_torques(campaign: Campaign, log: MovingLog) -> list[Array]:
    """Regressors ``(N, k)`` of each motor's torque besides friction."""
    T = np.asarray(campaign.robot.transmission)
    weight = T @ weight_regressor(campaign, log.q) if np.any(campaign.gravity) else np.zeros((len(log.q), len(T), 0))
    i, k = np.triu_indices(campaign.robot.n)
    motion = np.column_stack([np.ones(len(log.q)), log.qdd, log.qd[:, i] * log.qd[:, k]])
    return [np.column_stack([motion, weight[:, m, np.any(weight[:, m] != 0.0, axis=0)]]) for m in range(len(T))]


def _rubbing(speed: Array) -> Array:
    return np.column_stack([np.sign(speed), speed])


def _drag(log: MovingLog, others: Array, motor: int, speed: Array) -> tuple[float, float]:
    """Torque against the motion at the median speed, Nm, and its standard error by moves; (0, 1) if not determined."""
    used, move = clear_moves(speed, log.run)
    found = _estimated(log, others, motor, used, move, _rubbing(speed))
    if found is None:
        return 0.0, 1.0
    at = np.array([1.0, float(np.median(np.abs(speed[used])))])
    return float(at @ found[0]), float(np.sqrt(at @ found[1] @ at))


def _estimated(
    log: MovingLog, others: Array, motor: int, used: Bools, move: Integers, columns: Array
) -> tuple[Array, Array] | None:
    """Factors ``(p,)`` of columns ``(N, p)`` in a motor's torque, and their covariance by moves; None if open."""
    moves, member = np.unique(move[used], return_inverse=True)
    if len(moves) < MOVES or used.sum() < 3 * (others.shape[1] + columns.shape[1]):
        return None
    free = freed(others[used], np.column_stack([columns[used], log.tau[used, motor]]))
    X, y = free[:, :-1], free[:, -1]
    if np.any(np.sum(X**2, axis=0) < LEFT * np.sum(columns[used] ** 2, axis=0)):
        return None
    scale = np.sqrt(np.sum(X**2, axis=0))
    inverse = np.linalg.pinv((X / scale).T @ (X / scale), rcond=LEFT) / np.outer(scale, scale)
    found = inverse @ (X.T @ y)
    score = X * (y - X @ found)[:, None]
    by_move = np.array([np.bincount(member, s) for s in score.T])
    return found, inverse @ (by_move @ by_move.T) @ inverse * len(moves) / (len(moves) - 1)
