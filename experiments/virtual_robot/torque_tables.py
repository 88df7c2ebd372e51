"""The tables with motor torques: free air, wrist and clamped."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from experiments.virtual_robot.bodies import Bodies
from experiments.virtual_robot.clamp import clamped_torques
from experiments.virtual_robot.description import Array
from experiments.virtual_robot.drive import (
    arm_at_rest,
    attached_load,
    compliance_matrix,
    gear_output,
    motor_angles,
    off_by_approach,
    static_load,
)
from experiments.virtual_robot.friction import Motion, motor_torque
from experiments.virtual_robot.heat import History, read_sensors
from experiments.virtual_robot.instrument import torque_noise
from experiments.virtual_robot.outside import outside_torque
from experiments.virtual_robot.plant import Plant
from experiments.virtual_robot.play import creeping_friction, dry_friction
from experiments.virtual_robot.programs import LOG_RATE, ClampProgram, Run

SPEED_NOISE = 3e-5  # rad/s, of logged joint speeds


@dataclass(frozen=True)
class Logged:
    """A table as written, and its torques without noise, Nm, (N, n)."""

    table: pd.DataFrame
    noise_free: Array


def columns(name: str, values: Array, unit: str) -> dict[str, Array]:
    """Return numbered columns such as ``q1_rad`` from values (N, n)."""
    return {f"{name}{i + 1}_{unit}": column for i, column in enumerate(values.T)}


def log_runs(
    plant: Plant, bodies: Bodies, runs: Sequence[Run], *, history: History, since: float, rng: np.random.Generator
) -> Logged:
    """Measure free-air or wrist programs.

    Parameters
    ----------
    plant, bodies
        The robot.
    runs
        What it was told to do.
    history
        Temperatures of the session.
    since
        Time of the session at which the table's clock starts, s.
    rng
        The stream of this table's noise.
    """
    # The state of the dry friction after the last, unlogged, motion.
    state, gear = rng.choice([-1.0, 1.0], (2, plant.n))
    tables, truths = [], []
    for number, run in enumerate(runs, 1):
        time = np.arange(0.0, run.path.length, 1 / LOG_RATE)
        q, qd, qdd = run.path.at(time)
        temperature = history.at(since + run.start + time)
        if number > 1:  # driven from where the last run ended to where this one starts
            back = motor_angles(plant.drive, np.array([runs[number - 2].path.knots[-1], q[0]]))
            state = dry_friction(back, plant.friction.presliding, state)[-1]
            gear = dry_friction(back @ plant.drive.nominal, _gear_width(plant), gear)[-1]
        motor = motor_angles(plant.drive, q)
        states = _dry_states(plant, motor, state)
        gears = dry_friction(q, _gear_width(plant), gear)
        state, gear = states[-1], gears[-1]
        shaft = moving_torques(
            plant, bodies, (q, qd, qdd), state=states, gear_state=gears, temperature=temperature.motor
        )
        shaft = late(shaft, plant.friction.lag)
        noise = torque_noise(plant.instrument.torque_sigma, len(time), 1 / LOG_RATE, rng)
        speed = qd + SPEED_NOISE * rng.standard_normal(qd.shape)
        data: dict[str, Array] = {"time_s": np.round(run.start + time, 3)}
        data |= columns("q", q, "rad") | columns("qd", speed, "rad_s") | columns("tau", shaft + noise, "Nm")
        data |= read_sensors(temperature, plant.instrument.temperature_sigma, rng)
        tables.append(pd.DataFrame({"run": np.full(len(time), number), **data}))
        truths.append(shaft)
    return Logged(pd.concat(tables, ignore_index=True), np.vstack(truths))


def moving_torques(
    plant: Plant, bodies: Bodies, motion: tuple[Array, Array, Array], *, state: Array, gear_state: Array,
    temperature: Array,
) -> Array:  # fmt: skip
    """Return the torques that the motors of a free arm read, without lag and noise, Nm, (N, n).

    Parameters
    ----------
    plant, bodies
        The robot.
    motion
        Reported joint angles, speeds and accelerations, rad and s, (N, n) each.
    state, gear_state
        States of the dry friction at the motors and at the gears' output, −1 … 1, (N, n).
    temperature
        Motor temperatures, °C, (N, n).
    """
    q, qd, qdd = motion
    motor = motor_angles(plant.drive, q)
    ideal = gear_output(plant.drive, motor, plant.geometry.zero)
    arm = ideal - static_load(plant, bodies, ideal) @ compliance_matrix(plant.drive)
    tau = bodies.torque(arm, qd, qdd) + attached_load(plant.attachments, arm)
    turning = Motion(motor, motor_angles(plant.drive, qd), motor_angles(plant.drive, qdd))
    shaft = motor_torque(plant, tau, turning, state=state, gear_state=gear_state, temperature=temperature, arm=True)
    return np.asarray(shaft + outside_torque(plant.outside, q), dtype=float)


def _dry_states(plant: Plant, motor: Array, start: Array) -> Array:
    """States of the motors' dry friction along a run (N, n): one contact each, or several that creep."""
    friction = plant.friction
    states = dry_friction(motor, friction.presliding, start)
    creeping = friction.creep > 0.0
    if creeping.any():
        crept = creeping_friction(motor, 1 / LOG_RATE, friction.presliding, friction.creep, start)
        states = np.where(creeping, crept, states)
    return states


def _gear_width(plant: Plant) -> Array:
    return np.asarray(plant.friction.presliding * np.abs(np.diag(plant.drive.nominal)), dtype=float)


def late(rows: Array, lag: float) -> Array:
    """Return rows of a log of ``LOG_RATE`` as they are when logged ``lag`` seconds late."""
    if not lag:
        return rows
    index = np.arange(len(rows), dtype=float)
    return np.column_stack([np.interp(index - lag * LOG_RATE, index, c) for c in rows.T])


def sweep_angles(plant: Plant, program: ClampProgram, amplitude: Array) -> Array:
    """Return the reported joint angles of the sweeps, rad, (N, n); ``amplitude`` (e, n) in rad."""
    q = program.posture[program.event].copy()
    rows = np.arange(len(q))
    q[rows, program.joint] += program.level * amplitude[program.event, program.joint]
    return q


def sweep_amplitudes(plant: Plant, bodies: Bodies, program: ClampProgram) -> Array:
    """Return how far each joint is driven, rad, (e, n), so that its torque stays below half the rated one."""
    load = np.abs(static_load(plant, bodies, program.posture))
    torque = np.maximum(0.45 * plant.drive.rated - load, 0.25 * plant.drive.rated)
    return np.asarray(torque * np.diag(compliance_matrix(plant.drive)) + plant.drive.gap / 2, dtype=float)


def log_sweeps(
    plant: Plant, bodies: Bodies, program: ClampProgram, amplitude: Array, *, history: History, since: float,
    rng: np.random.Generator,
) -> Logged:  # fmt: skip
    """Measure the clamped robot; the parameters are those of `log_runs`, with amplitudes in rad, (e, n)."""
    q = sweep_angles(plant, program, amplitude)
    motor = motor_angles(plant.drive, q)
    output = gear_output(plant.drive, motor, plant.geometry.zero)
    output = output + off_by_approach(plant, q, program.direction[program.event])
    tau, moved = np.empty_like(q), np.empty((len(q), 6))
    states, gears = np.empty_like(q), np.empty_like(q)
    for e, posture in enumerate(program.posture):
        rows = np.flatnonzero(program.event == e)
        arm, load = arm_at_rest(plant, bodies, posture[None], program.direction[e][None])
        pinch = plant.fixture.preload * plant.drive.rated * program.preload[e]
        clamped_at = arm[0] - pinch @ compliance_matrix(plant.drive)
        slipped = program.time[rows] >= plant.fixture.slips_at
        tau[rows], moved[rows] = clamped_torques(plant, bodies, output[rows], clamped_at, load[0], slipped)
        start = np.vstack([posture[None], q[rows]])
        states[rows] = dry_friction(motor_angles(plant.drive, start), plant.friction.presliding, program.direction[e])[
            1:
        ]
        gears[rows] = dry_friction(start, _gear_width(plant), program.direction[e])[1:]
    temperature = history.at(since + program.time)
    motion = Motion(motor, np.zeros_like(motor), np.zeros_like(motor))
    shaft = motor_torque(plant, tau, motion, state=states, gear_state=gears, temperature=temperature.motor, arm=False)
    shaft = shaft + outside_torque(plant.outside, q)
    noise = torque_noise(plant.instrument.torque_sigma, len(q), 1.0, rng)
    seen = moved + plant.fixture.sigma * rng.standard_normal(moved.shape)
    names = ("x_m", "y_m", "z_m", "rx_rad", "ry_rad", "rz_rad")
    data = columns("motor", motor, "rad") | columns("tau", shaft + noise, "Nm")
    data |= {f"fixture_{name}": column for name, column in zip(names, seen.T, strict=True)}
    data |= read_sensors(temperature, plant.instrument.temperature_sigma, rng)
    head = {"sweep": program.sweep, "joint": program.joint + 1, "time_s": program.time}
    return Logged(pd.DataFrame(head | data), shaft)
