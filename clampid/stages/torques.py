"""The torque experiments, free air and wrist: motor torques of an arm that moves and stops.

tau_motor = T tau_joint + motor friction. Rows that do not count are predicted but not used; which do:
`clampid.stages.counting`.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from clampid.chain.chain import Chain, Deviations
from clampid.slots import Layout
from clampid.stages.counting import counting, folds_of, motion_signals, negligible, standing_joints
from clampid.stages.loads import (
    axis_torque,
    described_weight,
    gravity_signals,
    inclination_torque,
    inertial_signals,
    weight_rate,
)
from clampid.stages.log_facts import WINDOW, LogFacts, LogPart, facts_of, log_parts
from clampid.stages.log_motion import Motion, joint_columns
from clampid.stages.presliding import friction_states
from clampid.stages.repeats import with_repeats
from clampid.stages.row_constants import LogConstants
from clampid.stages.rows import Array, Integers, Rows
from clampid.stages.temperatures import temperatures
from experiments.campaign import Campaign
from experiments.log_windows import LogTable, windows
from experiments.signals import segments, typical_step

__all__ = ["derivative", "error", "moved", "residual", "torque_rows"]

BLOCK_S = 2.0  # rows this close in time share their noise and are flipped together
BLOCKS = 200  # at least, where a log is short: fewer cannot resolve a chance of 1 %
BLOCK_ROWS = 12  # at least: the order of the noise's autoregression, which whitening takes out
TRANSPOSED_AT_ONCE = 128  # rows that the processor's cache holds


def residual(rows: Rows, chain: Chain, theta: Array, offsets: Array) -> tuple[Array, Array]:
    """Measured less predicted motor torques ``(N, n)``, Nm, and the prediction's derivative ``(N, n, P + K)``.

    The ``offsets`` ``(K,)`` are Nm at the joint: the friction of joints that stood still for a whole run.
    """
    deviations = chain.evaluate(theta, rows.signals)
    T, count = np.asarray(rows.robot.transmission), len(chain.slots)
    jacobian = _by_parameter(rows, deviations, count + len(offsets))
    for k, (run, still) in enumerate(rows.series.offset_keys):
        of_run = rows.series.run == run
        jacobian[:, count + k, of_run] = T[:, still, None]
    return _error(rows, chain, deviations, offsets), jacobian.transpose(2, 0, 1)


def derivative(rows: Rows, chain: Chain, theta: Array, first: int) -> Array:
    """Derivative of the predicted torques by the slots from the ``first`` on ``(N, n, P - first)``, SI."""
    deviations = chain.derivatives_from(first).evaluate(theta, rows.signals)
    return _by_parameter(rows, deviations, len(chain.slots) - first, first).transpose(2, 0, 1)


def _by_parameter(rows: Rows, deviations: Deviations, count: int, first: int = 0) -> Array:
    """Derivative of the motors' torques by ``count`` parameters from the ``first`` on: ``(n, count, N)``, SI.

    In memory row after row: a table of which each entry is written alone takes five times as long.
    """
    n = rows.robot.n
    sensitivity = np.concatenate([rows.robot.transmission, np.eye(n)], axis=1)  # (n, 2n): joint, then motor torques
    jacobian = np.zeros((n, count, len(rows)))
    partials = _transposed(deviations.partials)
    written = np.zeros((n, count), dtype=bool)
    for k, (station, parameter) in enumerate(zip(deviations.station, deviations.parameter - first, strict=True)):
        for motor in np.flatnonzero(sensitivity[:, station]):
            if written[motor, parameter]:
                jacobian[motor, parameter] += sensitivity[motor, station] * partials[k]
            else:
                np.multiply(partials[k], sensitivity[motor, station], out=jacobian[motor, parameter])
                written[motor, parameter] = True
    return jacobian


def _transposed(table: Array) -> Array:
    """A table ``(N, k)`` in memory column after column: ``(k, N)``. Part by part, which takes an eighth of the time."""
    out = np.empty(table.shape[::-1])
    for start in range(0, len(table), TRANSPOSED_AT_ONCE):
        part = slice(start, start + TRANSPOSED_AT_ONCE)
        out[:, part] = table[part].T
    return out


def error(rows: Rows, chain: Chain, theta: Array, offsets: Array) -> Array:
    """Measured less predicted motor torques ``(N, n)``, Nm; arguments as of :func:`residual`."""
    return _error(rows, chain, chain.evaluate(theta, rows.signals), offsets)


def moved(rows: Rows, chain: Chain, theta: Array, steps: Array) -> Array:
    """Change of the prediction ``(N, n, k)`` by steps ``(P + K, k)``, to first order."""
    d, T, count = chain.evaluate(theta, rows.signals), np.asarray(rows.robot.transmission), len(chain.slots)
    by_station = np.zeros((len(rows), d.values.shape[1], steps.shape[1]))
    for a, run in chain.runs:
        by_station[:, a] = d.partials[:, run] @ steps[d.parameter[run]]
    n = rows.robot.n
    joint, motor = (by_station[:, chain.offsets[name]] for name in ("joint_torque", "motor_torque"))
    for k in range(steps.shape[1]) if len(steps) > count else ():
        joint[:, :, k] += rows.offset_table(steps[count:, k])
    return np.asarray(np.einsum("ij,njk->nik", T, joint[:, :n]) + motor)


def _error(rows: Rows, chain: Chain, deviations: Deviations, offsets: Array) -> Array:
    T = np.asarray(rows.robot.transmission)
    joint = (
        rows.signals["gravity_torque"]
        + rows.signals["inertia_torque"]
        + deviations.values[:, chain.offsets["joint_torque"]]
    )
    joint = joint + rows.offset_table(offsets)
    predicted = joint @ T.T + deviations.values[:, chain.offsets["motor_torque"]]
    return np.asarray(rows.measured - predicted)


def torque_rows(
    campaigns: Sequence[Campaign], layout: Layout, accelerating: bool = False, resting: bool = False
) -> Rows:
    """Rows of the tables free_air and wrist of one or several sessions.

    Rows in acceleration are used only where the model has the bodies' and rotors' inertia (``accelerating``), rows of
    motors at rest only where it has the state of their friction (``resting``).
    """
    import pandas as pd

    parts = log_parts(campaigns)
    facts = facts_of(parts)
    robot, n = campaigns[0].robot, campaigns[0].robot.n
    T = np.asarray(robot.transmission)
    joined = pd.concat([part.table.frame(_columns(part.table, n)) for part in parts], ignore_index=True)
    lengths = [part.table.rows for part in parts]
    session = np.repeat([part.session for part in parts], lengths)
    _, run = np.unique(np.c_[np.repeat(np.arange(len(parts)), lengths), joined["run"]], axis=0, return_inverse=True)
    run, time = run.astype(np.int64), joined["time_s"].to_numpy(float)
    motion = _motion_of(parts, facts)
    signals = motion_signals(motion, T, facts, run, time) | temperatures(joined, n)
    used = counting(signals, T, facts, run, layout.wrist, accelerating, resting) & motion.resolved[:, None]
    signals["dry_state"] = friction_states(
        signals["motor"], np.abs(signals["motor_speed"]) <= facts.rest_motor, time, run
    )
    for s, campaign in enumerate(campaigns):
        chosen = session == s
        if not np.any(chosen):
            continue
        q, qd, qdd, _ = motion.of(chosen)
        own = gravity_signals(campaign, q) | {"inclination_torque": inclination_torque(campaign, q)}
        own["axis_torque"] = axis_torque(campaign, q)
        own["torque_rate"] = weight_rate(campaign, q, qd)
        for name, values in inertial_signals(campaign, q, qd, qdd).items():
            own[name] = own[name] + values if name in own else values
        for name, values in own.items():
            signals.setdefault(name, np.zeros((len(time), *values.shape[1:])))[chosen] = values
    if not accelerating:
        used &= negligible(signals["inertia_torque"] @ T.T, facts)
    measured = joined[joint_columns("tau", "Nm", n)].to_numpy(float)
    stretch = segments(run, time, np.ones(len(run), dtype=bool))
    _, unit = np.unique(np.c_[stretch, np.floor(time / _block_seconds(time, run))], axis=0, return_inverse=True)
    return Rows(
        stage="free_air",
        robot=robot,
        layout=layout,
        signals=signals,
        measured=measured,
        sigma=np.ones_like(measured),
        used=used,
        unit=with_repeats(unit.astype(np.int64), run, time, motion.position),
        fold=folds_of(facts, run, np.arange(len(run))),
        table=np.repeat([part.name for part in parts], lengths),
        row=np.concatenate([np.arange(1, k + 1) for k in lengths]),
        session=session,
        constants=LogConstants(
            time=time,
            run=run,
            together=facts.together,
            known_noise=facts.known_noise,
            known_from="repeated_runs" if np.any(facts.repeated < facts.regression) else "regression",
            log_row=np.arange(len(run)),
            offset_keys=standing_joints(facts, layout.wrist),
            gravity_vector=np.array([campaign.gravity for campaign in campaigns], dtype=float),
            weight=np.array([described_weight(campaign) for campaign in campaigns]),
        ),
    )


def _columns(table: LogTable, n: int) -> list[str]:
    """The columns of a log that rows are made of."""
    names = ["run", "time_s", *joint_columns("q", "rad", n), *joint_columns("tau", "Nm", n)]
    return names + [name for name in table.names if name.startswith("temp_")]


def _motion_of(parts: Sequence[LogPart], facts: LogFacts) -> Motion:
    """The motion of the whole log, by the same windows as in a fit that reads the log by windows."""
    found = [
        facts.motions.of(p, w).of(slice(w.start, w.stop))
        for p, part in enumerate(parts)
        for w in windows(part.table, facts.motions.columns, WINDOW, facts.halo)
    ]
    return Motion(
        position=np.concatenate([m.position for m in found]),
        speed=np.concatenate([m.speed for m in found]),
        acceleration=np.concatenate([m.acceleration for m in found]),
        resolved=np.concatenate([m.resolved for m in found]),
    )


def _block_seconds(time: Array, run: Integers) -> float:
    """How long the blocks of a log are of which the null hypothesis changes the sign, s."""
    step = typical_step(time, run)
    return min(BLOCK_S, max(step * len(time) / BLOCKS, BLOCK_ROWS * step))
