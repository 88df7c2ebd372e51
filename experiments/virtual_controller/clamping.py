"""A flange that is clamped: the motors wind up the drives, and the arm stays where it is.

The statics are those of `experiments.virtual_robot.clamp`; time, friction and temperature are the controller's.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from experiments.virtual_controller.errors import ControllerError
from experiments.virtual_controller.track import Rows
from experiments.virtual_robot import Plant
from experiments.virtual_robot.bodies import Bodies
from experiments.virtual_robot.clamp import clamped_torques
from experiments.virtual_robot.description import Array
from experiments.virtual_robot.drive import arm_at_rest, compliance_matrix, gear_output, motor_angles, off_by_approach
from experiments.virtual_robot.friction import Motion, motor_torque
from experiments.virtual_robot.outside import outside_torque

__all__ = ["Clamping", "close_clamp", "gauges", "held_torques"]

WINDING_SHARE = 0.4  # of the rated torque, to which every joint is wound up as a test
BISECTIONS = 20  # a millionth of the tilt
STIFF = 0.01  # of the torque against a rigid block; below it the joint turns freely


@dataclass(frozen=True)
class Clamping:
    """One time that the flange was clamped.

    Attributes
    ----------
    start, end
        s; infinite while it lasts.
    direction
        From where each axis had come, ±1, (n,).
    arm
        True joint angles at which it was clamped, rad, (n,).
    load
        Joint torques that held it there, Nm, (n,).
    slips
        When the block slips by what is hidden, if it does, s.
    slipped
        When it slipped besides, s, and by how much, m and rad, (6,).
    rocks
        From when on the block rocks, s, and from one rest to the other, m and rad, (6,); None: it does not.
    """

    start: float
    direction: Array
    arm: Array
    load: Array
    slips: float
    end: float = math.inf
    slipped: tuple[tuple[float, Array], ...] = ()
    rocks: tuple[float, Array] | None = None


def close_clamp(plant: Plant, bodies: Bodies, time: float, rows: Rows, rng: np.random.Generator) -> Clamping:
    """Clamp the flange of a robot at rest; the preload of its joints is drawn at random.

    Raises
    ------
    ControllerError
        The posture is so near a singular one that the joints can turn although the flange is held.
    """
    arm, load = arm_at_rest(plant, bodies, rows.q, rows.direction)
    pinch = plant.fixture.preload * plant.drive.rated * rng.standard_normal(plant.n)
    clamping = Clamping(
        start=time,
        direction=rows.direction[0],
        arm=np.asarray(arm[0] - pinch @ compliance_matrix(plant.drive), dtype=float),
        load=load[0],
        slips=time + plant.fixture.slips_at,
    )
    compliance = np.diag(compliance_matrix(plant.drive))
    wound = np.diag(WINDING_SHARE * plant.drive.rated * compliance + plant.drive.gap)
    try:
        tau, _ = _pressed(plant, bodies, clamping, [time] * (plant.n + 1), rows.q + np.vstack([wound, 0 * wound[:1]]))
    except RuntimeError:
        tau = np.zeros((plant.n + 1, plant.n))
    if np.any(np.diag(tau[:-1] - tau[-1]) < np.diag(wound) / compliance * STIFF):
        raise ControllerError("posture: expected one in which a held flange holds every joint, found a singular one")
    return clamping


def _pressed(plant: Plant, bodies: Bodies, clamping: Clamping, times: Sequence[float], q: Array) -> tuple[Array, Array]:
    output = gear_output(plant.drive, motor_angles(plant.drive, q), plant.geometry.zero)
    output = output + off_by_approach(plant, q, np.broadcast_to(clamping.direction, q.shape))
    when = np.asarray(times)
    slips = [(clamping.slips, plant.fixture.shift), *clamping.slipped]
    shift = np.sum([np.outer(when >= time, by) for time, by in slips], axis=0)
    if clamping.rocks is None:
        return clamped_torques(plant, bodies, output, clamping.arm, clamping.load, shift=shift)
    since, tilt = clamping.rocks
    loose = when >= since
    if loose.any():
        shift = shift + np.outer(_rest(plant, bodies, clamping, output, shift, tilt) * loose, tilt)
    return clamped_torques(plant, bodies, output, clamping.arm, clamping.load, shift=shift)


def _rest(plant: Plant, bodies: Bodies, clamping: Clamping, output: Array, shift: Array, tilt: Array) -> Array:
    """Where a rocking block stands, (N,): at -1/2 or 1/2 as it is loaded along its tilt, between without a load."""
    load = clamping.load
    wrench = np.linalg.pinv(bodies.jacobian(clamping.arm)).T  # W = J⁻ᵀ (tau - load)

    def push(place: Array) -> Array:
        tau, _ = clamped_torques(plant, bodies, output, clamping.arm, load, shift=shift + np.outer(place, tilt))
        return np.asarray((tau - load) @ wrench.T @ tilt)

    high, low = np.full(len(output), 0.5), np.full(len(output), -0.5)
    up, down = push(high) >= 0.0, push(low) <= 0.0  # the load falls as the block gives way
    low, high = np.where(up, high, low), np.where(down & ~up, low, high)
    if np.any(low < high):
        for _ in range(BISECTIONS):
            middle = (low + high) / 2
            more = push(middle) >= 0.0
            low, high = np.where(more, middle, low), np.where(more, high, middle)
    return np.asarray((low + high) / 2)


def held_torques(
    plant: Plant, bodies: Bodies, clamping: Clamping, times: Sequence[float], rows: Rows, temperature: Array
) -> Array:
    """Return the torques that the motors of a clamped arm read, without noise, Nm, (N, n).

    Parameters
    ----------
    plant, bodies
        The robot.
    clamping
        How it is clamped.
    times, rows
        When, s, (N,), and the axes then.
    temperature
        Motor temperatures, °C, (N, n).
    """
    tau, _ = _pressed(plant, bodies, clamping, times, rows.q)
    turning = Motion(*(motor_angles(plant.drive, part) for part in (rows.q, rows.qd, rows.qdd)))
    shaft = motor_torque(
        plant, tau, turning, state=rows.motor_state, gear_state=rows.gear_state, temperature=temperature, arm=False
    )
    return np.asarray(shaft + outside_torque(plant.outside, rows.q), dtype=float)


def gauges(plant: Plant, bodies: Bodies, clamping: Clamping, time: float, q: Array) -> Array:
    """Return what the dial gauges at the block see without noise, m and rad, (6,); ``q`` is reported, rad, (n,)."""
    _, moved = _pressed(plant, bodies, clamping, [time], q[None])
    return np.asarray(moved[0], dtype=float)
