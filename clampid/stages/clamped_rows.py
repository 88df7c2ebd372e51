"""Rows of the clamping experiment: sweeps, with rough estimates of motion, compliance and friction."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from clampid.slots import Layout
from clampid.stages.row_constants import SweepConstants
from clampid.stages.rows import Array, Bools, Integers, Rows
from clampid.stages.temperatures import temperatures
from experiments.campaign import Campaign
from experiments.signals import slip_states
from experiments.temperatures import filled
from kinematics.poe import forward, space_jacobian

__all__ = ["BLOCK_ROWS", "GAP_SOFTNESS", "clamped_rows"]

BLOCK_ROWS = 8  # neighbouring rows share their noise and are flipped together
STILL, SETTLED = 1e-3, 0.9  # of a motor's usual step: less is a motor at rest; SETTLED of it builds up its friction
SLIPS = (0.05, 0.15, 0.4)  # of a sweep's amplitude, which an element takes to be wound up: twice that after a reversal
GAP_SOFTNESS = 0.1  # of a torque's noise, at the joint: how sharply a gap closes


def clamped_rows(campaigns: Sequence[Campaign], layout: Layout) -> Rows:
    """Rows of the table clamped of one or several sessions."""
    import pandas as pd

    robot, n = campaigns[0].robot, campaigns[0].robot.n
    T = np.asarray(robot.transmission)
    frames = [filled(c.placed("clamped")) for c in campaigns if "clamped" in c.tables]
    session = np.concatenate(
        [np.full(len(c.tables["clamped"]), s) for s, c in enumerate(campaigns) if "clamped" in c.tables]
    )
    joined = pd.concat(frames, ignore_index=True)
    _, sweep = np.unique(np.c_[session, joined["sweep"].to_numpy()], axis=0, return_inverse=True)
    sweep = sweep.astype(np.int64)
    driven = joined["joint"].to_numpy(int) - 1
    time = joined["time_s"].to_numpy(float)
    motor = joined[[f"motor{i + 1}_rad" for i in range(n)]].to_numpy(float)
    measured = joined[[f"tau{i + 1}_Nm" for i in range(n)]].to_numpy(float)
    q = motor @ T
    count, sweeps = len(joined), int(sweep.max()) + 1
    reference = np.array([q[sweep == s].mean(axis=0) for s in range(sweeps)])
    motion = np.zeros((count, n))
    used, fraction, progress = np.ones((count, n), dtype=bool), np.zeros(count), np.zeros(count)
    typical = _typical_steps(motor, driven, sweep)
    for s in range(sweeps):
        rows = np.flatnonzero(sweep == s)
        fraction[rows] = np.linspace(0.0, 1.0, len(rows))
        progress[rows] = s + np.arange(len(rows)) / len(rows)
        steps = _steps(motor[rows])
        for j in range(n):
            # A coupled joint's sweep turns several motors a little: each has its own friction, by its own steps.
            sign = np.where(np.abs(steps[:, j]) > STILL * typical[j], np.sign(steps[:, j]), 0.0)
            if not sign.any():
                continue  # a motor at rest: its friction is a constant that the offsets take up
            for i in range(1, len(sign)):
                sign[i] = sign[i] or sign[i - 1]
            motion[rows, j] = sign
            turned = np.r_[True, sign[1:] != sign[:-1]]
            path = np.cumsum(np.abs(steps[:, j]))
            travel = path - np.maximum.accumulate(np.where(turned, path, 0.0))
            # Friction builds up again over the first step after a reversal; until then it is not known.
            used[rows[travel < SETTLED * typical[j]], j] = False
    inverse, wrench = np.zeros((sweeps, n, 6)), np.zeros((sweeps, 6, n))
    for s in range(sweeps):
        chain_q = np.asarray(robot.linkage) @ reference[s]
        J = _flange_jacobian(robot, chain_q)
        inverse[s] = np.linalg.pinv(J, rcond=1e-3)
        wrench[s] = inverse[s].T
    noise = step_noise(measured, motion, sweep)
    compliance = loop_compliance(motor, measured, motion, driven, used, sweep)
    to_joints = np.linalg.inv(T).T
    load = motor / compliance @ to_joints  # what springs alone carry; only its changes count
    stood = _stood(motor, typical, sweep, session)
    still = [(s, i) for s in range(sweeps) for i in range(n) if not motion[sweep == s, i].any()]
    keeping = [(s, n + i) for s, i in still if np.ptp(measured[sweep == s, i]) > 0.0]  # an imagined table has none
    signals = {
        "q": q,
        "motor": motor,
        "motor_motion": motion,
        "joint_motion": np.sign(motion @ T),
        "rest_direction": np.tile(GAP_SOFTNESS * noise / np.abs(np.diag(T)), (count, 1)),
        "wrench_map": wrench[sweep],
        "elapsed": time - time.min(),
        "fixture_motion": _watched(joined, sweep),
        "slip": slip_states(load, _widths(load, driven, sweep), sweep),
        "sweep_fraction": fraction,
        "sweep_progress": progress,
        **temperatures(joined, n),
    }
    _, blocks = np.unique(np.c_[sweep, np.arange(count) // BLOCK_ROWS], axis=0, return_inverse=True)
    return Rows(
        stage="clamped",
        robot=robot,
        layout=layout,
        signals=signals,
        measured=measured,
        sigma=np.tile(noise, (count, 1)),
        used=used,
        unit=blocks.astype(np.int64),
        fold=sweep,
        table=np.full(count, "clamped"),
        row=np.concatenate([np.arange(1, len(f) + 1) for f in frames]),
        session=session,
        constants=SweepConstants(
            run=sweep,
            time=time,
            offset_keys=np.array([(s, j) for s in range(sweeps) for j in range(n)] + keeping),
            loop_compliance=compliance,
            loop_friction=loop_friction(motor, measured, motion, used, sweep),
            stood=stood,
            kept_sign=_kept_signs(motion, used, stood, sweep),
            driven=driven,
            wound=q - reference[sweep],
            reference=reference,
            inverse_jacobian=inverse[sweep],
            start_torque=measured @ to_joints,
            rated=robot.rated_torques,
        ),
    )


def _steps(motor: Array) -> Array:
    """Steps ``(N, n)`` of the motors from row to row; the first counts as the second."""
    steps = np.diff(motor, axis=0, prepend=motor[:1])
    if len(motor) > 1:
        steps[0] = steps[1]
    return steps


def _typical_steps(motor: Array, driven: Integers, sweep: Integers) -> Array:
    """The usual size ``(n,)`` of a motor's step in the sweeps that drive it; of the smallest, where none does."""
    n = motor.shape[1]
    out = np.full(n, np.nan)
    for j in range(n):
        own = [np.abs(_steps(motor[sweep == s])[:, j]) for s in np.unique(sweep[driven == j])]
        moved = np.concatenate(own) if own else np.zeros(0)
        moved = moved[moved > 0]
        if len(moved):
            out[j] = np.median(moved)
    known = out[np.isfinite(out)]
    return np.where(np.isfinite(out), out, known.min() if len(known) else 1.0)


def _stood(motor: Array, typical: Array, sweep: Integers, session: Integers) -> Bools:
    """Which motors ``(sweeps, n)`` have not moved since the sweep before."""
    sweeps = int(sweep.max(initial=-1)) + 1
    out = np.zeros((sweeps, motor.shape[1]), dtype=bool)
    for s in range(1, sweeps):
        last, first = np.flatnonzero(sweep == s - 1)[-1], np.flatnonzero(sweep == s)[0]
        out[s] = (np.abs(motor[first] - motor[last]) < STILL * typical) & (session[first] == session[last])
    return out


def _kept_signs(motion: Array, used: Bools, stood: Bools, sweep: Integers) -> Array:
    """The side ``(sweeps, n)``, +1 or -1, of the friction that a motor keeps from the sweep before; 0 if not known.

    It is the side of the motor's last motion after friction had built up, if the motor has not moved since.
    """
    out = np.zeros(stood.shape)
    for s in range(1, len(stood)):
        last = np.flatnonzero(sweep == s - 1)[-1]
        left = np.where(motion[last] != 0.0, motion[last] * used[last], out[s - 1])
        out[s] = np.where(stood[s], left, 0.0)
    return out


def _watched(table: object, sweep: Integers) -> Array:
    """Motion ``(N, 6)`` of the flange since its sweep began by the fixture's sensor, (w, v), rad and m; else zeros."""
    out = np.zeros((len(sweep), 6))
    axes = [f"fixture_r{a}_rad" for a in "xyz"] + [f"fixture_{a}_m" for a in "xyz"]
    for k, name in enumerate(axes):
        if name in table.columns:  # type: ignore[attr-defined]
            out[:, k] = table[name].to_numpy(float)  # type: ignore[index]
    _, first = np.unique(sweep, return_index=True)
    return np.nan_to_num(out - out[first][sweep])


def _widths(load: Array, driven: Integers, sweep: Integers) -> Array:
    """Torques ``(n, 3)``, Nm, by which slipping elements are wound up: shares of the joint's usual amplitude."""
    amplitude = np.full(load.shape[1], np.inf)  # a joint that is never driven is hardly loaded, and slips nowhere
    for j in np.unique(driven):
        own = [0.5 * np.ptp(load[sweep == s, j]) for s in np.unique(sweep[driven == j])]
        amplitude[j] = max(float(np.median(own)), 1e-12)
    return np.asarray(amplitude[:, None] * np.array(SLIPS))


def loop_compliance(
    motor: Array, measured: Array, motion: Array, driven: Integers, used: Bools, sweep: Integers
) -> Array:
    """A rough compliance of each drive ``(n,)``, rad/Nm at the motor: the slope of its own loops, by direction."""
    n = motor.shape[1]
    out = np.full(n, 0.3)
    for j in range(n):
        angle, torque = [], []
        for s in np.unique(sweep[driven == j]):
            for sign in (-1.0, 1.0):
                branch = used[:, j] & (sweep == s) & (motion[:, j] == sign)
                if branch.sum() > 3:
                    m, t = motor[branch, j], measured[branch, j]
                    angle.append(m - m.mean())
                    torque.append(t - t.mean())
        if angle:
            a, t = np.concatenate(angle), np.concatenate(torque)
            slope = float(a @ t) / max(float(a @ a), 1e-300)
            if slope > 0:
                out[j] = 1.0 / slope
    return np.asarray(np.clip(out, 1e-3, 1e2))


def loop_friction(motor: Array, measured: Array, motion: Array, used: Bools, sweep: Integers) -> Array:
    """A rough dry friction of each motor ``(n,)``, Nm: half the distance between the branches of its own loops."""
    n = motor.shape[1]
    out = np.full(n, np.nan)
    for j in range(n):
        found = []
        for s in np.unique(sweep[motion[:, j] != 0.0]):
            at = (sweep == s) & used[:, j]
            sign = motion[at, j]
            if len(np.unique(sign)) > 1:
                columns = np.c_[np.ones(len(sign)), motor[at, j] - motor[at, j].mean(), sign]
                found.append(abs(float(np.linalg.lstsq(columns, measured[at, j], rcond=None)[0][2])))
        if found:
            out[j] = np.median(found)
    known = out[np.isfinite(out)]
    return np.maximum(np.where(np.isfinite(out), out, np.median(known) if len(known) else 1.0), 1e-6)


def step_noise(measured: Array, motion: Array, sweep: np.ndarray[tuple[int], np.dtype[np.int64]]) -> Array:
    """Noise ``(n,)`` of the torques from second differences along branches, where a smooth curve leaves little."""
    same = (sweep[2:] == sweep[:-2]) & np.all(motion[2:] == motion[:-2], axis=1)
    second = (measured[2:] - 2 * measured[1:-1] + measured[:-2])[same]
    if len(second) < 8:
        return np.asarray(np.maximum(measured.std(axis=0), 1e-9))
    # Median absolute value, so that steps of stick and slip do not count; var(second difference) = 6 var.
    return np.asarray(np.maximum(1.4826 * np.median(np.abs(second), axis=0) / np.sqrt(6.0), 1e-9))


def _flange_jacobian(robot: object, q: Array) -> Array:
    """Jacobian ``(6, n)`` of the flange's motion (w, v) about the flange's origin, base frame."""
    J = space_jacobian(robot.screws, q).copy()  # type: ignore[attr-defined]
    p = forward(robot.screws, robot.flange, q)[:3, 3]  # type: ignore[attr-defined]
    J[3:] = J[3:] - np.cross(p, J[:3].T).T
    return np.asarray(J)
