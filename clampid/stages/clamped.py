"""The clamping experiment: the flange is clamped, one motor goes back and forth in small steps, springs wind up.

With the flange clamped the arm cannot move: the joints' springs and gaps and the fixture take up the motors' motion::

    T' theta_m + dq(tau) = q_clamp + offset + J^-1 (motion of the fixture)

This is solved for the joint torques tau, row by row; then tau_motor = T (tau + friction at the joint) + friction at the
motor. The offset is the unknown posture at which the arm was clamped, one per joint and sweep. Gravity only shifts load
between clamp and drives; the offset includes it.

A motor at rest keeps some friction: that of its last motion or, if it has not moved since the arm was clamped, any
value between its limits. The offsets absorb it if the joint's torque stays constant. If a block yields or slips, the
torque changes, and this friction decides when the joint's gap is crossed. So it is an unknown too, one per motor at
rest and sweep. This holds for small changes of torque as well: a change below the noise of one row still reveals a
crossed clearance over a whole sweep.
"""

from __future__ import annotations

import numpy as np

from clampid.chain.chain import Chain, Deviations
from clampid.stages.rows import Array, Integers, Rows

__all__ = ["fixture_motion", "joint_torques", "residual", "residual_by_angle", "standing_angles"]

NEWTON_STEPS, HALVINGS = 60, 12
SETTLED_STEP = 1e-9  # of the rated torque
CLOSING_TORQUE = 10.0  # rated torques, at which every gap is closed
NONE = 1e-12  # rad/Nm: a joint that yields less, its gap closed, has no spring in the model
STIFF = 0.1  # of the loops' compliance, for such a joint


def residual(rows: Rows, chain: Chain, theta: Array, offsets: Array) -> tuple[Array, Array]:
    """Measured less predicted motor torques ``(N, n)``, Nm, and derivatives ``(N, n, P + offsets)``.

    Parameters
    ----------
    offsets
        ``(K,)``: one per joint and sweep, rad, and one per motor at rest, Nm; see the module.
    """
    n, count = rows.robot.n, len(rows)
    T = np.asarray(rows.robot.transmission)
    run, keys = rows.series.run, rows.series.offset_keys
    inverse = rows.sweep.inverse_jacobian
    left, by_angle, deviations = _by_angle(rows, chain, theta, offsets)
    motor, joint = chain.offsets["motor_torque"], chain.offsets["joint_torque"]
    # Implicit differentiation: d tau = -(d balance / d tau)^-1 d balance.
    balance, direct = np.zeros((2, count, n, len(chain.slots)))
    for k, (station, parameter) in enumerate(zip(deviations.station, deviations.parameter, strict=True)):
        part = deviations.partials[:, k]
        if station < n:
            balance[:, station, parameter] += part
        elif station >= joint.start:
            direct[:, :, parameter] += T[:, station - joint.start] * part[:, None]
        elif station >= motor.start:
            direct[:, station - motor.start, parameter] += part
        else:
            balance[:, :, parameter] -= inverse[:, :, station - n] * part[:, None]
    jacobian = np.zeros((count, n, len(chain.slots) + len(offsets)))
    jacobian[:, :, : len(chain.slots)] = direct - by_angle @ balance
    for k, (sweep, unknown) in enumerate(keys):  # an offset is an angle that is missing, in the rows of its own sweep
        mine = run == sweep
        if unknown < n:
            jacobian[mine, :, len(chain.slots) + k] = by_angle[mine, :, unknown]
        else:
            jacobian[mine, unknown - n, len(chain.slots) + k] = 1.0
    return left, jacobian


def residual_by_angle(rows: Rows, chain: Chain, theta: Array, offsets: Array) -> tuple[Array, Array]:
    """Measured less predicted motor torques ``(N, n)``, Nm, and their derivative by each joint's missing angle.

    The latter ``(N, n, n)``, Nm/rad, by motor and joint. Friction of a motor at rest is added to its torque directly.
    """
    left, by_angle, _ = _by_angle(rows, chain, theta, offsets)
    return left, by_angle


def _by_angle(rows: Rows, chain: Chain, theta: Array, offsets: Array) -> tuple[Array, Array, Deviations]:
    T, n = np.asarray(rows.robot.transmission), rows.robot.n
    constant = rows.offset_table(offsets, 2)
    shift = rows.sweep.wound - constant[:, :n]
    torque, deviations, slope = _equilibrium(rows, chain, theta, shift, rows.sweep.inverse_jacobian)
    motor, joint = chain.offsets["motor_torque"], chain.offsets["joint_torque"]
    predicted = (torque + deviations.values[:, joint]) @ T.T + deviations.values[:, motor] + constant[:, n:]
    by_torque = _by_torque(deviations)
    # Friction may follow the load, so that the torque reaches the motors by way of it too.
    through = T + T @ by_torque[:, joint] + by_torque[:, motor]
    return rows.measured - predicted, through @ np.linalg.inv(slope), deviations


def joint_torques(rows: Rows, chain: Chain, theta: Array, offsets: Array) -> Array:
    """Joint torques ``(N, n)``, Nm, at which the model is in balance, friction apart."""
    shift = rows.sweep.wound - rows.offset_table(offsets, 2)[:, : rows.robot.n]
    return _equilibrium(rows, chain, theta, shift, rows.sweep.inverse_jacobian)[0]


def standing_angles(rows: Rows, chain: Chain, theta: Array, torque: Array) -> tuple[Array, Array]:
    """Offsets ``(N, n)``, rad, at which rows are in balance at joint torques ``(N, n)``; the balance by torque.

    The latter ``(N, n, n)``, rad/Nm.
    """
    n, fixture, inverse = rows.robot.n, chain.offsets["fixture"], rows.sweep.inverse_jacobian
    d = chain.evaluate(theta, rows.signals, torque)
    moved, rigid = np.einsum("nij,nj->ni", inverse, d.values[:, fixture]), _rigid(rows, chain, theta)
    return rows.sweep.wound + d.values[:, :n] - moved - rigid * torque, _slope(d, inverse, fixture, rigid)


def fixture_motion(rows: Rows, chain: Chain, theta: Array, offsets: Array) -> Array:
    """Motion ``(N, 6)`` of the clamped flange that the model gives, (w, v) in the base frame about it, rad and m."""
    shift = rows.sweep.wound - rows.offset_table(offsets, 2)[:, : rows.robot.n]
    _, deviations, _ = _equilibrium(rows, chain, theta, shift, rows.sweep.inverse_jacobian)
    return np.asarray(deviations.values[:, chain.offsets["fixture"]])


def _equilibrium(
    rows: Rows, chain: Chain, theta: Array, shift: Array, inverse: Array
) -> tuple[Array, Deviations, Array]:
    """Joint torques ``(N, n)`` at which springs and gaps take up ``shift`` ``(N, n)``: Newton, row by row.

    Rows that have settled are left alone: after three steps only those about to enter or leave a gap still move.
    """
    n = rows.robot.n
    fixture = chain.offsets["fixture"]
    signals = {name: rows.signals[name] for name, _ in chain.signals if name != "torque"} or {"q": rows.signals["q"]}
    scale = rows.sweep.rated
    step_limit = 0.5 * scale
    rigid = _rigid(rows, chain, theta)

    def balance(torque: Array, at: Integers) -> tuple[Array, Array]:
        d = chain.evaluate(theta, {name: values[at] for name, values in signals.items()}, torque)
        moved = np.einsum("nij,nj->ni", inverse[at], d.values[:, fixture])
        return shift[at] + d.values[:, :n] - moved - rigid * torque, _slope(d, inverse[at], fixture, rigid)

    torque = np.zeros((len(rows), n))  # not the measured ones: a solver that fails must not look right
    moving = np.arange(len(rows))
    error, slope = balance(torque, moving)
    for _ in range(NEWTON_STEPS):
        step = -np.linalg.solve(slope[moving], error[moving, :, None])[:, :, 0]
        step *= np.minimum(1.0, (step_limit / np.maximum(np.abs(step), 1e-300)).min(axis=1))[:, None]
        # A closing gap bends the curve: halve the step of a row until its error falls.
        size, factor = np.linalg.norm(error[moving], axis=1), np.ones(len(moving))
        trying = np.arange(len(moving))
        for _ in range(HALVINGS):
            at = moving[trying]
            error[at], slope[at] = balance(torque[at] + factor[trying, None] * step[trying], at)
            left = np.linalg.norm(error[at], axis=1)
            trying = trying[left > size[trying] * (1 - 1e-4 * factor[trying]) + 1e-13]
            if not len(trying):
                break
            factor[trying] *= 0.5
        else:
            factor[trying] *= 2.0  # the last one tried
        step *= factor[:, None]
        torque[moving] += step
        moving = moving[np.max(np.abs(step) / scale, axis=1) >= SETTLED_STEP]
        if not len(moving):
            break
    deviations = chain.evaluate(theta, signals, torque)
    return torque, deviations, _slope(deviations, inverse, fixture, rigid)


def _rigid(rows: Rows, chain: Chain, theta: Array) -> Array:
    """Compliance ``(n,)``, rad/Nm, of joints for which the model has no spring; zero of all others.

    A drive without any compliance could not be turned while the flange is clamped, and its torque would be undefined.
    A joint without a spring in the model gets :data:`STIFF` times the compliance of its loops: ten times too stiff, but
    within reach of a search.
    """
    T = np.asarray(rows.robot.transmission)
    first = {name: values[:1] for name, values in rows.signals.items()}
    far = _by_torque(chain.evaluate(theta, first, CLOSING_TORQUE * rows.sweep.rated[None]))
    yields, loops = np.abs(np.diag(far[0, : len(T)])), rows.sweep.loop_compliance
    return np.asarray(np.where(yields < NONE, STIFF * np.diag(T.T @ np.diag(loops) @ T), 0.0))


def _slope(deviations: Deviations, inverse: Array, fixture: slice, rigid: Array) -> Array:
    by_torque, n = _by_torque(deviations), inverse.shape[1]
    return np.asarray(by_torque[:, :n] - inverse @ by_torque[:, fixture] - rigid * np.eye(n))


def _by_torque(deviations: Deviations) -> Array:
    if deviations.by_torque is None:
        raise ValueError("the chain was not built for the stage clamped")
    return deviations.by_torque
