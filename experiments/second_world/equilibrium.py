"""
The posture in which an arm comes to rest, with springs, clearances and other deflections under load.

Loads depend on the deflected posture, so deflections and loads are computed in turn until they agree (fixed point).
"""

from collections.abc import Sequence

import numpy as np

from experiments.second_world.arrays import Array
from experiments.second_world.chain import Bend, Frames, forward, loads_of
from experiments.second_world.individual import Robot
from experiments.second_world.states import BendLaw, PoseState, Visits

__all__ = ["clearance_side", "rest"]

_MAX_TURNS = 30
_AGREED_RAD = 1e-11


def clearance_side(robot: Robot, torque_Nm: Array, dirs: Array) -> Array:
    """
    Side of its clearance on which each joint rests.

    While the joint still moved, its drive exerted the load and the friction; it stops on the flank that carried them.
    Where the two nearly cancel, the flank's contact is soft.

    Parameters
    ----------
    robot
        Its Coulomb friction is taken to act behind the clearance.
    torque_Nm
        Static torque that each drive exerts (N, n).
    dirs
        Sign of the last motion (N, n).

    Returns
    -------
    Array
        In (−1, 1), (N, n); positive where the arm lags behind a drive that turned forward.
    """
    return np.asarray(np.tanh((torque_Nm + robot.coulomb_Nm * dirs) / (0.02 * robot.coulomb_Nm)))


def _standard(state: PoseState) -> Bend:
    """The deviations of a robot without hidden effects."""
    robot, torque = state.robot, state.loads.torque_Nm
    bend = Bend.none(*state.visits.q.shape)
    bend.angle_rad[:] = -robot.compliance_rad_Nm * torque
    bend.angle_rad[:] -= robot.clearance_rad / 2 * clearance_side(robot, torque, state.visits.dirs)
    return bend


def rest(robot: Robot, visits: Visits, laws: Sequence[BendLaw], jitter_rad: Array | float = 0.0) -> Frames:
    """
    Find where the arm rests at each visit.

    Parameters
    ----------
    robot
        The robot.
    visits
        N visits.
    laws
        What bends beyond the standard.
    jitter_rad
        Repeatability: added to the angles (N, n).

    Returns
    -------
    Frames
        In the base frame.
    """
    rows, n = visits.q.shape
    q = visits.q + jitter_rad
    bend = Bend.none(rows, n)
    frames = forward(robot.arm, q, bend)
    for _ in range(_MAX_TURNS):
        loads = loads_of(robot.arm, robot.tool, robot.gravity_m_s2, frames)
        state = PoseState(robot, visits, frames, loads)
        total = _standard(state)
        for law in laws:
            total = total + law(state)
        moved = np.abs(total.angle_rad - bend.angle_rad).max()
        bend = total
        frames = forward(robot.arm, q, bend)
        if moved < _AGREED_RAD:
            break
    return frames
