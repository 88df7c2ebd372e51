"""The torque experiments, free air and wrist: motor torques of an arm that moves and stops.

tau_motor = T tau_joint + motor friction. Static friction is indeterminate, so that a motor at rest says nothing here;
its rows are predicted but not used. Where a motor turns while a joint that it is coupled with has not moved in the
whole
run, the dry friction of that joint's arm side is an unknown constant of the run.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from clampid.chain import Chain
from clampid.slots import Layout
from clampid.stages.loads import gravity_signals, inertial_signals
from clampid.stages.presliding import dry_states
from clampid.stages.rows import Array, Bools, Integers, Rows
from experiments.campaign import Campaign
from experiments.signals import acceleration, held_sign, rest_threshold, segments, speeds, typical_step

__all__ = ["residual", "steady_share", "torque_rows"]

FIFTHS = 5  # a log of one run is held out by contiguous fifths
WINDOW_S = 0.02  # over which speeds and accelerations are taken
CLEAR_MOTION = 0.02  # of the top speed of the log
STEADY = 0.15  # of the log's largest acceleration of a joint
INERTIA_SHARE = 0.5  # of the noise between neighbouring rows
NORMAL = 1.4826  # median absolute deviation to standard deviation of a normal
BLOCK_S = 2.0  # rows this close in time share their noise and are flipped together
BLOCKS = 200  # at least, where a log is short: fewer could not say what is one chance in a hundred
BLOCK_ROWS = 24  # at least: twice as far as the noise is taken to remember itself


def residual(rows: Rows, chain: Chain, theta: Array, offsets: Array) -> tuple[Array, Array]:
    """Measured less predicted motor torques ``(N, n)``, Nm, and the prediction's derivative ``(N, n, P + K)``.

    ``offsets`` ``(K,)``, Nm at the joint: the friction of joints that stood still for a whole run.
    """
    deviations = chain.evaluate(theta, rows.signals)
    T = np.asarray(rows.robot.transmission)
    n = rows.robot.n
    joint = (
        rows.signals["gravity_torque"]
        + rows.signals["inertia_torque"]
        + deviations.values[:, chain.offsets["joint_torque"]]
    )
    joint = joint + rows.offset_table(offsets)
    predicted = joint @ T.T + deviations.values[:, chain.offsets["motor_torque"]]
    sensitivity = np.concatenate([T, np.eye(n)], axis=1)  # (n, 2n): joint torques, then motor torques
    jacobian = np.zeros((len(rows), n, len(chain.slots) + len(offsets)))
    for k, (station, parameter) in enumerate(zip(deviations.station, deviations.parameter, strict=True)):
        for motor in np.flatnonzero(sensitivity[:, station]):
            jacobian[:, motor, parameter] += sensitivity[motor, station] * deviations.partials[:, k]
    for k, (run, still) in enumerate(rows.constants["offset_keys"]):
        jacobian[rows.constants["run"] == run, :, len(chain.slots) + k] = T[:, still]
    return rows.measured - predicted, jacobian


def torque_rows(
    campaigns: Sequence[Campaign], layout: Layout, accelerating: bool = False, resting: bool = False
) -> Rows:
    """Rows of the tables free_air and wrist of one or several sessions.

    Rows in acceleration are used only where the model has the bodies' and rotors' inertia (``accelerating``), rows of
    motors at rest only where it has the state of their friction (``resting``).
    """
    import pandas as pd

    frames, names, sessions = [], [], []
    for s, campaign in enumerate(campaigns):
        for name in ("free_air", "wrist"):
            if name in campaign.tables:
                frames.append(campaign.tables[name])
                names.append(name)
                sessions.append(s)
    robot = campaigns[0].robot
    n = robot.n
    T = np.asarray(robot.transmission)
    joined = pd.concat(frames, ignore_index=True)
    lengths = [len(f) for f in frames]
    part = np.repeat(np.arange(len(frames)), lengths)
    _, run = np.unique(np.c_[part, joined["run"].to_numpy()], axis=0, return_inverse=True)
    run = run.astype(np.int64)
    time = joined["time_s"].to_numpy(float)
    q = joined[[f"q{i + 1}_rad" for i in range(n)]].to_numpy(float)
    names_qd = [f"qd{i + 1}_rad_s" for i in range(n)]
    logged = all(c in joined.columns and not joined[c].isna().any() for c in names_qd)
    qd = joined[names_qd].to_numpy(float) if logged else speeds(q, time, run, window_s=WINDOW_S)
    qdd = acceleration(qd, time, run, window_s=WINDOW_S)
    to_motor = np.linalg.inv(T)  # rows: w_joint @ T^-1 = (T^-T w_joint)'
    wm = qd @ to_motor
    rest, rest_m = rest_threshold(qd), rest_threshold(wm)
    # Dry friction takes a distance to build up: between rest and clear motion its torque is not known.
    clear, clear_m = CLEAR_MOTION * np.abs(qd).max(axis=0), CLEAR_MOTION * np.abs(wm).max(axis=0)
    moving = np.abs(wm) > np.maximum(rest_m, clear_m)
    motion, motion_m = held_sign(qd, rest, run), held_sign(wm, rest_m, run)
    session = np.repeat(np.array(sessions), lengths)
    signals = {
        "q": q,
        "motor": q @ to_motor,
        "joint_speed": qd,
        "motor_speed": wm,
        "joint_motion": motion,
        "motor_motion": motion_m,
        "own_speed": qd / np.diag(T),
        "own_motion": motion * np.sign(np.diag(T)),
        "joint_acceleration": qdd,
        "elapsed": time - time.min(),
        **temperatures(joined, n),
    }
    for s, campaign in enumerate(campaigns):
        if not np.any(session == s):
            continue
        own = gravity_signals(campaign, q[session == s])
        chosen = session == s
        for name, values in inertial_signals(campaign, q[chosen], qd[chosen], qdd[chosen]).items():
            own[name] = own[name] + values if name in own else values
        for name, values in own.items():
            signals.setdefault(name, np.zeros((len(q), *values.shape[1:])))[chosen] = values
    signals["rest_direction"] = np.zeros_like(q)
    if resting:
        signals["dry_state"] = _friction_states(signals, time, run, logged)
    measured = joined[[f"tau{i + 1}_Nm" for i in range(n)]].to_numpy(float)
    still, undecided = _standing(layout, T, run, qd, motion, rest, clear)
    # Masses are described well enough for gravity, not for full dynamics: what they give in acceleration is taken off,
    # and where that is more than a fraction of the noise, the row is left out.
    inertial = np.abs(signals["inertia_torque"] @ T.T)
    noise = NORMAL * np.median(np.abs(np.diff(measured, axis=0)), axis=0) / np.sqrt(2.0)
    steady = np.abs(qdd) <= STEADY * np.abs(qdd).max(axis=0, initial=0.0)  # rotors and links have inertia of their own
    used = (moving | (motion_m != 0.0 if resting else False)) & ~undecided  # before its first motion nobody knows
    if not accelerating:
        used &= (inertial <= INERTIA_SHARE * noise) & steady
    signals["torque_rate"] = np.gradient(measured, axis=0)
    stretch = segments(run, time, np.ones(len(run), dtype=bool))
    _, unit = np.unique(np.c_[stretch, np.floor(time / _block_seconds(time, run))], axis=0, return_inverse=True)
    fold = run if run.max() > 0 else (np.arange(len(run)) * FIFTHS // len(run)).astype(np.int64)
    return Rows(
        stage="free_air",
        robot=robot,
        layout=layout,
        signals=signals,
        measured=measured,
        sigma=np.ones_like(measured),
        used=used,
        unit=unit.astype(np.int64),
        fold=fold,
        table=np.repeat(np.array(names), lengths),
        row=np.concatenate([np.arange(1, k + 1) for k in lengths]),
        session=session,
        constants={
            "time": time,
            "run": run,
            "offset_keys": np.array(still, dtype=np.int64).reshape(-1, 2),
            "gravity": np.array([campaign.gravity for campaign in campaigns], dtype=float),
        },
        per_row=("time", "run"),
    )


def _friction_states(signals: dict[str, Array], time: Array, run: Integers, logged: bool) -> Array:
    """States of dry friction ``(N, n, S x K)``.

    Speeds taken over a window do not have the jitter of an encoder's counts, which would wear the state down; a log
    that has speeds of its own may be too sparse to integrate them.
    """
    if logged:
        turned = np.diff(signals["motor"], axis=0, prepend=signals["motor"][:1])
    else:
        wm = signals["motor_speed"]
        steps = np.diff(time, prepend=time[:1])[:, None]
        turned = 0.5 * (wm + np.vstack([wm[:1], wm[:-1]])) * steps
    return dry_states(turned, time, run)


def _block_seconds(time: Array, run: Integers) -> float:
    """How long the blocks of a log are of which the null hypothesis changes the sign, s."""
    step = typical_step(time, run)
    return min(BLOCK_S, max(step * len(time) / BLOCKS, BLOCK_ROWS * step))


def steady_share(campaign: Campaign) -> float:
    """The share, 0 to 1, of a log's motion that is steady; 1 for a campaign without logs."""
    steady = moving = 0
    n = campaign.robot.n
    for name in ("free_air", "wrist"):
        if name in campaign.tables:
            table = campaign.tables[name]
            q, time = table[[f"q{i + 1}_rad" for i in range(n)]].to_numpy(float), table["time_s"].to_numpy(float)
            run = table["run"].to_numpy(np.int64)
            qd = speeds(q, time, run, window_s=WINDOW_S)
            qdd = acceleration(qd, time, run, window_s=WINDOW_S)
            moves = np.abs(qd) > np.maximum(rest_threshold(qd), CLEAR_MOTION * np.abs(qd).max(axis=0, initial=0.0))
            moving += int(moves.sum())
            steady += int((moves & (np.abs(qdd) <= STEADY * np.abs(qdd).max(axis=0, initial=0.0))).sum())
    return steady / moving if moving else 1.0


def _standing(
    layout: Layout, T: Array, run: Integers, qd: Array, motion: Array, rest: Array, clear: Array
) -> tuple[list[tuple[int, int]], Bools]:
    """Coupled joints that stand still for a whole run, and motors ``(N, n)`` whose joint's friction is open."""
    still, unknown = [], np.zeros(qd.shape, dtype=bool)
    for j in layout.wrist:
        for r in np.unique(run):
            inside = run == r
            if not motion[inside, j].any():
                still.append((int(r), j))
            else:
                slow = (np.abs(qd[:, j]) > rest[j]) & (np.abs(qd[:, j]) <= clear[j])
                unknown[inside, j] = slow[inside] | (motion[inside, j] == 0)  # creeping, or not moved yet in this run
    return still, np.asarray((unknown.astype(float) @ (T != 0).T.astype(float)) > 0)


def temperatures(table: object, n: int) -> dict[str, Array]:
    """Temperatures of links and motors less 20 degC, ``(N, n)``; zeros where no sensor is."""
    out = {}
    for kind in ("link", "motor"):
        values = np.zeros((len(table), n))  # type: ignore[arg-type]
        for i in range(n):
            column = f"temp_{kind}{i + 1}_C"
            if column in table.columns:  # type: ignore[attr-defined]
                values[:, i] = np.nan_to_num(table[column].to_numpy(float) - 20.0)  # type: ignore[index]
        out[f"{kind}_temperature"] = values
    return out
