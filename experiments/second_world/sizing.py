"""The size of a hidden effect: rms of the values that it adds to the measurements, over the noise."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Unpack

import numpy as np
import pinocchio as pin

from experiments.second_world.arrays import Array, stream
from experiments.second_world.chain import Bend
from experiments.second_world.dynamics import rigid_body_model
from experiments.second_world.equilibrium import clearance_side
from experiments.second_world.friction import direction
from experiments.second_world.hidden import HIDDEN, Active
from experiments.second_world.individual import Robot
from experiments.second_world.session import (
    Hidden,
    Session,
    SessionChoice,
    activate,
    open_session,
    points_seen,
    torques,
)
from experiments.second_world.states import PoseState

__all__ = [
    "NOTHING",
    "beyond",
    "magnitude_for",
    "pose_std_m",
    "size_in_sigma",
    "standard_pose_columns",
    "standard_torque_columns",
]

_ROWS = 1500  # of a log, that a refit of the standard model is judged by
_WHITE: SessionChoice = {"noise": "white"}
_STEPS, _WITHIN = 12, 0.01  # a magnitude's steps towards a size, and how near to it is enough
NOTHING = 1e-5  # sigma: what rounding may leave of an effect that is absorbed


def pose_std_m(session: Session) -> Array:
    """Noise (3,), m, of a point along the instrument's axes: the instrument's, and the robot's repeatability."""
    visits = session.visits
    jitter = session.robot.repeatability_rad * stream(session.seed, "sizing").standard_normal(visits.q.shape)
    moved = points_seen(session, visits, [], jitter) - points_seen(session, visits, [])
    return np.asarray(np.sqrt(session.instrument.std_m**2 + (moved**2).mean((0, 1))))


def _rms(whitened: Array) -> float:
    return float(np.sqrt((whitened**2).mean()))


def beyond(values: Array, columns: Array) -> Array:
    """
    Take from values what a least-squares fit of columns explains of them.

    Parameters
    ----------
    values
        One column (M,), or several (M, c).
    columns
        What is fitted (M, p); it may be dependent.

    Returns
    -------
    Array
        What is left, of the shape of the values.
    """
    if not columns.shape[1]:
        return values
    scale = np.linalg.norm(columns, axis=0)
    A = columns[:, scale > 0] / scale[scale > 0]
    return np.asarray(values - A @ np.linalg.lstsq(A, values, rcond=1e-9)[0])


def _nudge(kind: str, joint: int, axis: int, size: float) -> Active:
    """Make an effect that nudges one standard parameter of the chain."""

    def bend(state: PoseState) -> Bend:
        b = Bend.none(*state.visits.q.shape)
        if kind == "spring":
            b.angle_rad[:, joint] = (
                size * state.loads.torque_Nm[:, joint] / state.robot.nominal.joints[joint].max_torque_Nm
            )
        elif kind == "gap":
            b.angle_rad[:, joint] = (
                size * clearance_side(state.robot, state.loads.torque_Nm, state.visits.dirs)[:, joint]
            )
        elif kind == "drag":
            b.angle_rad[:, joint] = size * state.visits.dirs[:, joint]
        elif kind in ("tilt_rad", "shift_m"):
            getattr(b, kind)[:, joint, axis] = size
        else:
            getattr(b, kind)[:, axis] = size
        return b

    return Active((), bend=bend)


def standard_pose_columns(session: Session) -> Array:
    """
    Differentiate the points by geometry, springs, friction, clearances, base and targets.

    Dry friction winds a spring up against the approach. Of a joint without load a clearance does the same.

    Parameters
    ----------
    session
        Of which the visits of the table `poses` are taken.

    Returns
    -------
    Array
        Derivatives (N, K, 3, p) in the instrument's frame, m per SI unit of each parameter.
    """
    visits = session.visits
    plain = points_seen(session, visits, [])
    n, h = session.robot.n, 1e-5
    kinds = [("spring", j, 0) for j in range(n) if session.robot.compliance_rad_Nm.any()]
    kinds += [("drag", j, 0) for j in range(n) if session.robot.compliance_rad_Nm.any()]
    kinds += [("gap", j, 0) for j in range(n) if session.robot.clearance_rad.any()]
    kinds += [(k, j, a) for k in ("tilt_rad", "shift_m") for j in range(n) for a in range(3)]
    kinds += [(k, 0, a) for k in ("base_shift_m", "base_turn_rad") for a in range(3)]
    columns = [(points_seen(session, visits, [_nudge(*k, h)]) - plain) / h for k in kinds]
    for target in range(session.poses.targets):
        for step in np.eye(3):
            robot = session.robot
            moved = robot.targets_m.copy()
            moved[target] += h * step
            other = replace(session, robot=replace(robot, targets_m=moved))
            columns.append((points_seen(other, visits, []) - plain) / h)
    return np.stack(columns, axis=-1)  # (N, K, 3, p)


def standard_torque_columns(session: Session, rows: list[int]) -> Array:
    """
    Differentiate the torques by rigid bodies, rotors, viscous and Coulomb friction.

    Parameters
    ----------
    session, rows
        Of which the log is taken, and which R of its samples.

    Returns
    -------
    Array
        Derivatives (R, n, p), Nm per SI unit of each parameter.
    """
    robot, log = session.robot, session.motion
    model = rigid_body_model(robot.arm, robot.tool, robot.gravity_m_s2)
    data = model.createData()
    way = direction(log.qd, robot.nominal.max_speeds())
    blocks = []
    for k in rows:
        rigid = pin.computeJointTorqueRegressor(model, data, log.q[k], log.qd[k], log.qdd[k])
        blocks.append(np.hstack([rigid, *(np.diag(x) for x in (log.qdd[k], log.qd[k], way[k]))]))
    return np.stack(blocks)


Sizer = Callable[[Sequence[Active]], float]


def _pose_sizer(session: Session, beyond_standard: bool) -> Sizer:
    plain, std = points_seen(session, session.visits, []), pose_std_m(session)
    columns = standard_pose_columns(session) / std[:, None] if beyond_standard else np.zeros((*plain.shape, 0))

    def size(actives: Sequence[Active]) -> float:
        added = (points_seen(session, session.visits, actives) - plain) / std
        return _rms(beyond(added.ravel(), columns.reshape(added.size, -1)))

    return size


def _torque_sizer(session: Session, beyond_standard: bool) -> Sizer:
    std = session.robot.torque_std_Nm
    plain = torques(session, session.motion, [])
    rows = list(range(len(plain)))
    columns = np.zeros((len(rows), len(std), 0))
    if beyond_standard:
        rows = rows[:: -(-len(rows) // _ROWS)]
        columns = standard_torque_columns(session, rows) / std[:, None]

    def size(actives: Sequence[Active]) -> float:
        added = ((torques(session, session.motion, actives) - plain) / std)[rows]
        return _rms(beyond(added.ravel(), columns.reshape(added.size, -1)))

    return size


_SIZERS = {"poses": _pose_sizer, "free_air": _torque_sizer}


def size_in_sigma(
    robot: Robot,
    hidden: Sequence[Hidden],
    *,
    tables: Sequence[str] = ("poses", "free_air"),
    beyond_standard: bool = False,
    **chosen: Unpack[SessionChoice],
) -> dict[str, float]:
    """
    Size of what hidden effects add, per coordinate or motor, over its noise.

    Parameters
    ----------
    robot, hidden, chosen
        As for `measure`; the noise is white unless another one is chosen.
    tables
        Which of `poses` and `free_air` are asked for; a table in which nothing hidden acts is left out.
    beyond_standard
        Whether only the part counts that a refit of the standard model leaves. In poses that is geometry, base and
        targets, springs with the friction that winds them up, and clearances, where the robot has them; in free air
        it is rigid bodies, rotors, Coulomb and viscous friction.

    Returns
    -------
    dict
        Table to size in sigma: the rms over all numbers of the table of added value over standard deviation.
    """
    session = open_session(robot, **(_WHITE | chosen))
    laws = [active for _, _, active in activate(session, hidden)]
    touched = {t for name, _, _ in hidden for t in HIDDEN[name].tables}
    return {t: _SIZERS[t](session, beyond_standard)(laws) for t in tables if t in touched}


def magnitude_for(
    robot: Robot,
    name: str,
    where: str | None,
    sigma: float,
    *,
    table: str | None = None,
    beyond_standard: bool = False,
    **chosen: Unpack[SessionChoice],
) -> float:
    """
    Magnitude at which one hidden effect has a wanted size.

    Parameters
    ----------
    robot, chosen
        As for `measure`; the noise is white unless another one is chosen.
    name, where
        The effect and its place; None is its default place.
    sigma
        Wanted size, as of `size_in_sigma`.
    table
        Table in which it is wanted; by default the effect's first.
    beyond_standard
        As of `size_in_sigma`.

    Returns
    -------
    float
        For `measure`; within 1 % of the size.

    Raises
    ------
    ValueError
        The effect changes nothing, or no magnitude with this size was found.
    """
    table = table or HIDDEN[name].tables[0]
    session = open_session(robot, **(_WHITE | chosen))
    size_of = _SIZERS[table](session, beyond_standard)
    magnitude = 1.0
    for _ in range(_STEPS):
        size = size_of([active for _, _, active in activate(session, [(name, where, magnitude)])])
        if size < NOTHING:
            raise ValueError(f"{name} at {where}: it changes nothing in {table} of this robot and program")
        if abs(size / sigma - 1) < _WITHIN:
            return magnitude
        magnitude *= sigma / size
    raise ValueError(
        f"{name} at {where}: no magnitude with {sigma:g} sigma in {table} was found; the last had {size:g}"
    )
