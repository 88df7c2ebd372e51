"""Judges torque logs against the weight of the robot: unit, side of the gears, sign, and clock.

A motor's torque contains the weight of the described links, transformed by the transmission. The factor κ that fits
this weight best shows the unit, the side of the gears and the sign of the torque. The weight changes as a joint turns
and changes back as it turns back, so the log also shows a delay between torques and positions.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np
from scipy.stats import norm

from experiments.campaign import Campaign
from experiments.checks.finding import Finding
from experiments.checks.moving_log import MovingLog, clear_moves, freed, read_log, weight_regressor
from experiments.columns import joint_columns
from experiments.signals import Shift, combine_shifts, time_shift
from experiments.signals.typing_ import Array
from kinematics.gravity import add_tool, gravity_parameters

__all__ = ["torque_findings", "torque_shift"]

# Errors of descriptions, undeclared tools and balancers change the weight by a factor of 1.5 (one sigma), and by less
# than 3.4 for 997 of 1000 motors. Gears are factors of 30 to 250, percent of the rated torque of 10 to 100.
SPREAD = np.log(1.5)
# A motor is judged if its weight exceeds this many standard errors and most of what is not friction.
CLEAR_ERRORS, MAX_SHARE = 5.0, 0.5
# The median motor is rejected at one in a million correct logs (a factor of 7); another unit is accepted if it makes
# the median usual.
REJECTED, BELIEVED = 1e-6, 1e-2
# A shift is reported if its p-value is below 1e-4 and it is more than a quarter of the
# sample step: drives read position and current at different instants of their own cycle.
FALSE_ALARMS, SHIFT_STEPS = 1e-4, 0.25
MOVES = 6
BEHIND_GEARS = "torques look like those at the joints, behind the gears"


def torque_findings(campaign: Campaign, logs: Mapping[str, MovingLog]) -> Iterator[Finding]:
    """Look at the torques of free air and wrist, where the robot's masses and transmission are known.

    Parameters
    ----------
    campaign
        The campaign.
    logs
        Its torque tables by name, without those whose angles are known to be in another unit.

    Yields
    ------
    Finding
        Errors for torques of another unit, side or sign, warnings for a shift in time.
    """
    robot = campaign.robot
    if not robot.has_masses or not np.any(campaign.gravity):
        return
    for table, log in logs.items():
        regressor = weight_regressor(campaign, log.q)
        if robot.transmission_known:
            yield from _units(campaign, table, log, regressor)
        shift = _shift(campaign, log, regressor)
        if shift and shift.p_value < FALSE_ALARMS and abs(shift.seconds) > SHIFT_STEPS * log.step:
            late = "after" if shift.seconds > 0.0 else "before"
            message = (
                f"torques are logged {abs(shift.seconds):.3g} ± {shift.std_error:.1g} s {late} the positions, "
                f"{abs(shift.seconds) / log.step:.2g} sample steps (weight rising and falling says so; a sound log "
                f"gives this in fewer than {FALSE_ALARMS:g} of cases)"
            )
            yield Finding("warning", table, "tau1_Nm", None, message)


def torque_shift(campaign: Campaign, table: str) -> Shift | None:
    """Estimate how late the torques of a table are against its positions.

    Parameters
    ----------
    campaign
        The campaign; its robot's masses have to be described.
    table
        ``free_air`` or ``wrist``.

    Returns
    -------
    Shift or None
        All motors together; None where fewer than two carry weight that moves enough.
    """
    log = read_log(campaign, campaign.tables[table])
    return _shift(campaign, log, weight_regressor(campaign, log.q))


def _masses(campaign: Campaign) -> Array:
    robot, tool = campaign.robot, campaign.tool
    return add_tool(gravity_parameters(robot.links), robot.flange, tool.mass, tool.com)


def _friction(campaign: Campaign, log: MovingLog, motor: int, speed: Array) -> Array:
    """Regressors ``(N, k)`` of a motor's torque besides weight."""
    T = campaign.robot.transmission
    coupled = np.flatnonzero((T[motor] != 0.0) & (np.arange(campaign.robot.n) != motor))
    own = [np.ones_like(speed), np.sign(speed), speed * np.abs(speed)]
    i, k = np.triu_indices(campaign.robot.n)
    return np.column_stack([*own, np.sign(log.qd[:, coupled]), log.qd, log.qdd, log.qd[:, i] * log.qd[:, k]])


def _shift(campaign: Campaign, log: MovingLog, regressor: Array) -> Shift | None:
    robot = campaign.robot
    motor_regressor = np.asarray(robot.transmission @ regressor)
    weight = motor_regressor @ _masses(campaign)
    speed = log.qd @ np.linalg.inv(robot.transmission)
    found = []
    for m in range(robot.n):
        used, move = clear_moves(speed[:, m], log.run)
        if len(np.unique(move[used])) < MOVES:
            continue
        # Friction that grows with the load changes with it, up and down: without this it would look like a shift.
        loaded = np.abs(weight[:, m]) * np.sign(speed[:, m])
        others = np.column_stack([_friction(campaign, log, m, speed[:, m]), loaded])
        carrier, corrections = weight[:, m, None], motor_regressor[:, m]
        corrections = corrections[:, np.any(corrections != 0.0, axis=0)]
        shift = time_shift(log.tau[:, m], carrier, corrections, others, log.time, log.run, used, move)
        found += [shift] if shift else []
    return combine_shifts(found)


def _units(campaign: Campaign, table: str, log: MovingLog, regressor: Array) -> Iterator[Finding]:
    """Compare the factors of weight with those that other units, sides and signs would give."""
    robot = campaign.robot
    T = robot.transmission
    at_joint = regressor @ _masses(campaign)
    speed = log.qd @ np.linalg.inv(T)
    motor_side, joint_side = (_factors(campaign, log, speed, w) for w in (at_joint @ T.T, at_joint))
    names = joint_columns("tau{}_Nm", robot.n)
    weighed, loaded = _asked(motor_side), _asked(joint_side)
    signs = np.where(motor_side[:, 0] < 0.0, -1.0, 1.0)
    # Friction dissipates energy, whatever the hoses weigh: a torque of the wrong sign drives instead.
    drives = motor_side[:, 3] < 0.0
    mirrored = [m for m in weighed if drives[m] and _fits(motor_side, -np.ones(robot.n), [m]) >= BELIEVED]
    if mirrored and _fits(motor_side, signs, weighed) >= BELIEVED:
        which = "all motors" if len(mirrored) == len(weighed) else f"motor{_numbers(mirrored)}"
        message = (
            f"torques of {which} have the opposite sign: they are {motor_side[mirrored[0], 0]:.2g} times what the "
            f"weight of the links gives (motor {mirrored[0] + 1}), 1 is expected; a motor's torque is what it exerts"
        )
        yield Finding("error", table, names[mirrored[0]], None, message)
        return
    if not weighed or _fits(motor_side, np.ones(robot.n), weighed) >= REJECTED:
        return
    best, words = BELIEVED, ""
    for flip in (1.0, -1.0):
        opposite = "" if flip > 0.0 else ", with the opposite sign"
        likely = _fits(joint_side, np.full(robot.n, flip), loaded)
        if likely > best:
            best, words = likely, f"torques look like those at the joints, behind the gears{opposite}"
        if all(joint.rated_torque for joint in robot.joints):
            rated = np.abs(np.diag(T)) * [joint.rated_torque or 1.0 for joint in robot.joints]
            likely = _fits(motor_side, flip * 100.0 / rated, weighed)
            if likely > best:
                best, words = likely, f"torques look like per cent of the motors' rated torque{opposite}"
    m = max(weighed, key=lambda k: abs(motor_side[k, 0]) / motor_side[k, 1])
    ratio = f"{motor_side[m, 0]:.3g} times what the weight of the links gives there (motor {m + 1}), 1 is expected"
    if words:
        message = f"{words}; Nm at the motor shaft are expected: they are {ratio}"
        if words == BEHIND_GEARS:
            message += f'; if a sensor is there, state it in [tables]: {table} = {{ file = "…", side = "joint" }}'
        yield Finding("error", table, names[m], None, message)
    else:
        message = (
            f"torques cannot be Nm at the motor shaft, if the masses and the tool are as described: they are {ratio}"
        )
        yield Finding("warning", table, names[m], None, message)


def _asked(factors: Array) -> list[int]:
    """Motors whose factors ``(n, 4)`` are determined."""
    size, error, share = np.abs(factors[:, 0]), factors[:, 1], factors[:, 2]
    return [int(m) for m in np.flatnonzero((size > CLEAR_ERRORS * error) & (share > MAX_SHARE))]


def _numbers(motors: list[int]) -> str:
    return f"{'s' if len(motors) > 1 else ''} {', '.join(str(m + 1) for m in motors)}"


def _factors(campaign: Campaign, log: MovingLog, speed: Array, weight: Array) -> Array:
    """Weight ``(N, n)`` in each torque: factor, its standard error by moves, share of what is not friction, and drag.

    ``(n, 4)``; (0, 1, 0, 0) if the log does not determine it. Drag is the torque that follows the sign of motion.
    """
    out = np.tile([0.0, 1.0, 0.0, 0.0], (campaign.robot.n, 1))
    for m in range(campaign.robot.n):
        used, move = clear_moves(speed[:, m], log.run)
        moves, member = np.unique(move[used], return_inverse=True)
        others = _friction(campaign, log, m, speed[:, m])[used]
        if len(moves) < MOVES or used.sum() < 3 * others.shape[1]:
            continue
        own, tau = freed(others, np.column_stack([weight[used, m], log.tau[used, m]])).T
        power = float(own @ own)
        if power <= 1e-12 * float(weight[used, m] @ weight[used, m]) or power == 0.0:
            continue
        factor = float(own @ tau) / power
        score = np.bincount(member, own * (tau - factor * own))
        error = float(np.sqrt(np.sum(score**2) * len(moves) / (len(moves) - 1))) / power
        share = 1.0 - np.sum((tau - factor * own) ** 2) / float(tau @ tau)
        plain = np.column_stack([np.sign(speed[used, m]), np.ones(used.sum()), weight[used, m]])
        drag = np.linalg.lstsq(plain, log.tau[used, m], rcond=None)[0][0]
        out[m] = factor, max(error, 1e-9 * abs(factor)), share, drag
    return out


def _fits(factors: Array, wanted: Array, motors: list[int]) -> float:
    """Probability that a factor is as far off as the middle one of these ``(n, 4)``, if ``wanted`` ``(n,)`` is right.

    A unit is that of all motors; a tool, a balancer or a hose changes a few.
    """
    if not motors:
        return 0.0
    size = np.abs(factors[motors, 0])
    off = np.abs(np.log(size / np.abs(wanted[motors]))) / np.hypot(SPREAD, factors[motors, 1] / size)
    off = np.where(np.sign(factors[motors, 0]) == np.sign(wanted[motors]), off, np.inf)
    return float(2.0 * norm.sf(np.sort(off)[(len(off) - 1) // 2]))
