"""A session: one robot, one instrument, one programme of each kind, and what they give without noise."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TypedDict

import numpy as np

from experiments.second_world.arrays import Array, stream
from experiments.second_world.chain import points_in_base
from experiments.second_world.dynamics import rigid_body_model, rigid_torques
from experiments.second_world.equilibrium import rest
from experiments.second_world.friction import coulomb, dahl, direction, viscous
from experiments.second_world.hidden import HIDDEN, Active, Setting
from experiments.second_world.individual import Robot
from experiments.second_world.instrument import Instrument, place_instrument
from experiments.second_world.log_programs import LOG_PROGRAMS, Log, LogProgram, run_log
from experiments.second_world.noise import Noise, choose_noise
from experiments.second_world.pose_programs import POSE_PROGRAMS, PoseProgram, run_poses
from experiments.second_world.states import LogState, Visits

__all__ = ["Hidden", "Session", "SessionChoice", "activate", "open_session", "points_seen", "row_times", "torques"]

Hidden = tuple[str, str | None, float]  # name, where (None: its default place), magnitude
_SLIP_RAD = 4e-4  # presliding of the elastic friction, seen at the joint


@dataclass(frozen=True)
class Session:
    """What is measured, with what, in which order."""

    robot: Robot
    seed: int
    noise_name: str
    noise: Noise
    instrument: Instrument
    poses: PoseProgram
    log: LogProgram

    @cached_property
    def visits(self) -> Visits:
        """Visits of the table `poses`."""
        return run_poses(self.robot, self.poses, self.seed, "poses", 0.0, 1)

    @cached_property
    def verification_visits(self) -> Visits:
        """Visits of the table `verification`, which follows `poses` on its clock."""
        fewer = replace(self.poses, poses=max(9, round(0.35 * self.poses.poses)), returns=0, cycles=1)
        start = float(self.visits.time_s[-1]) + 30.0
        return run_poses(self.robot, fewer, self.seed, "verification", start, self.poses.poses + 1)

    @cached_property
    def motion(self) -> Log:
        """The motion of the free-air table."""
        return run_log(self.robot, self.log, self.seed)


class SessionChoice(TypedDict, total=False):
    """
    What is chosen of a session, by name; see `open_session`.

    Attributes
    ----------
    program, log
        Names in `POSE_PROGRAMS` and `LOG_PROGRAMS`.
    noise
        Name in `NOISES`; None chooses one by seed.
    seed
        Of the session: programme, instrument and noise.
    """

    program: str
    log: str
    noise: str | None
    seed: int


def open_session(
    robot: Robot, program: str = "quick", log: str = "trapezoids_10hz", noise: str | None = None, seed: int = 0
) -> Session:
    """
    Choose programmes and noise by name, and set up the instrument.

    Parameters
    ----------
    robot
        The robot.
    program, log
        Names in `POSE_PROGRAMS` and `LOG_PROGRAMS`.
    noise
        Name in `NOISES`; None chooses one by seed.
    seed
        Of the session.

    Returns
    -------
    Session
        Ready to measure.
    """
    if program not in POSE_PROGRAMS:
        raise ValueError(f"program {program!r}: expected one of {', '.join(POSE_PROGRAMS)}")
    if log not in LOG_PROGRAMS:
        raise ValueError(f"log {log!r}: expected one of {', '.join(LOG_PROGRAMS)}")
    name, kind = choose_noise(noise, seed)
    instrument = place_instrument(robot, kind, seed)
    return Session(robot, seed, name, kind, instrument, POSE_PROGRAMS[program], LOG_PROGRAMS[log])


def _check(session: Session, name: str, where: str | None) -> str:
    if name not in HIDDEN:
        raise ValueError(f"hidden effect {name!r}: expected one of {', '.join(HIDDEN)}")
    places = HIDDEN[name].places(session.robot.n)
    if where is not None and where not in places:
        raise ValueError(f"{name} at {where!r}: expected one of {', '.join(places)}")
    return places[0] if where is None else where


def activate(session: Session, hidden: Sequence[Hidden]) -> list[tuple[str, str, Active]]:
    """
    Put hidden effects in force.

    Parameters
    ----------
    session
        Where they act. What is drawn for an effect follows from the session's seed, its name and place only.
    hidden
        Names, places and magnitudes.

    Returns
    -------
    list of tuple
        Name, place and laws of each.
    """
    visited = session.visits.q
    out = []
    for name, wanted, magnitude in hidden:
        where = _check(session, name, wanted)
        rng = stream(session.seed, f"hidden {name} {where}")
        setting = Setting(session.robot, where, magnitude, rng, visited, session.instrument)
        out.append((name, where, HIDDEN[name].build(setting)))
    return out


def _altered(robot: Robot, actives: Sequence[Active]) -> Robot:
    for active in actives:
        robot = active.alter(robot) if active.alter else robot
    return robot


def row_times(session: Session, visits: Visits) -> Array:
    """Times (N, K), s, at which each target is measured."""
    step = min(1.5, session.poses.seconds / 6)
    return np.asarray(visits.time_s[:, None] + step * np.arange(session.poses.targets))


def points_seen(session: Session, visits: Visits, actives: Sequence[Active], jitter_rad: Array | float = 0.0) -> Array:
    """
    Place all targets as the instrument would read them without noise of its own.

    Parameters
    ----------
    session, visits, actives
        Where, when, and what is hidden.
    jitter_rad
        The robot's repeatability (N, n), if it is wanted.

    Returns
    -------
    Array
        Points (N, K, 3) in the instrument's frame, m.
    """
    robot = _altered(session.robot, actives)
    frames = rest(robot, visits, [a.bend for a in actives if a.bend], jitter_rad)
    points = session.instrument.see(points_in_base(frames, robot.targets_m[: session.poses.targets]))
    flat, times = points.reshape(-1, 3), row_times(session, visits).ravel()
    read = flat + sum((a.reading(flat, times) for a in actives if a.reading), np.zeros_like(flat))
    return np.asarray(read.reshape(points.shape))


def torques(session: Session, log: Log, actives: Sequence[Active]) -> Array:
    """
    Torques of all motors without noise.

    Parameters
    ----------
    session, log, actives
        Where, which motion, and what is hidden.

    Returns
    -------
    Array
        Torques (S, n), Nm, at the motor shafts, which turn as the joints do.
    """
    robot = _altered(session.robot, actives)
    top = robot.nominal.max_speeds()
    model = rigid_body_model(robot.arm, robot.tool, robot.gravity_m_s2)
    load = rigid_torques(model, robot.rotor_kg_m2, log.q, log.qd, log.qdd)
    rubbing = (
        dahl(log.q, robot.coulomb_Nm, _SLIP_RAD)
        if robot.friction_law == "dahl"
        else coulomb(log.qd, top, robot.coulomb_Nm)
    )
    tau = load + rubbing + viscous(log.qd, top, robot.viscous_Nm, 1.0)
    state = LogState(
        robot=robot,
        time_s=log.time_s,
        work_s=log.work_s,
        q=log.q,
        qd=log.qd,
        qdd=log.qdd,
        direction=direction(log.qd, top),
        load_Nm=load,
        motor_temps_C=robot.climate.motors(log.time_s, log.work_s),
        ambient_C=robot.climate.ambient(log.time_s),
    )
    tau = np.asarray(tau) + sum((a.torque(state) for a in actives if a.torque), np.zeros_like(tau))
    for joint, factor in (a.gain for a in actives if a.gain):
        tau[:, joint] *= factor
    lag = sum(a.lag_s for a in actives)
    return _late(tau, log, lag) if lag else np.asarray(tau)


def _late(tau: Array, log: Log, lag_s: float) -> Array:
    """Torques of `lag_s` ago, run by run, linear between samples."""
    out = tau.copy()
    for run in np.unique(log.run):
        rows = log.run == run
        for j in range(tau.shape[1]):
            out[rows, j] = np.interp(log.time_s[rows] - lag_s, log.time_s[rows], tau[rows, j])
    return out
