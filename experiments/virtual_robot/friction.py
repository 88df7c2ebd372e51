"""The parts of a motor's torque reading."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from experiments.virtual_robot.description import Array
from experiments.virtual_robot.plant import Friction, Plant

WARM = 25.0  # °C, at which the friction has its nominal size


@dataclass(frozen=True)
class Motion:
    """How the motors move, row by row: angle, speed, acceleration, rad and s, (N, n)."""

    angle: Array
    speed: Array
    acceleration: Array


def motor_friction(friction: Friction, speed: Array, state: Array, temperature: Array) -> Array:
    """Return the friction of the motors, Nm, (N, n).

    Parameters
    ----------
    friction
        The plant's friction.
    speed
        Motor speeds, rad/s, (N, n).
    state
        State of the dry friction, −1 … 1, (N, n).
    temperature
        Motor temperatures, °C, (N, n).
    """
    slow = np.exp(-((speed / friction.stribeck_speed) ** 2))
    thin = np.exp(-friction.thermal * (temperature - WARM))  # oil gets thinner
    dry = (friction.coulomb + friction.stribeck * slow) * state
    return np.asarray(thin * (dry + friction.viscous * speed) + friction.asymmetry * (1 + state) / 2, dtype=float)


def ripple(friction: Friction, motor: Array) -> Array:
    """Return the torque ripple at the joints, Nm, (N, n), at motor angles, rad, (N, n)."""
    total = np.zeros_like(motor)
    for k in range(friction.ripple.shape[1] // 2):
        sine, cosine = friction.ripple[:, 2 * k], friction.ripple[:, 2 * k + 1]
        if sine.any() or cosine.any():
            total += sine * np.sin((k + 1) * motor) + cosine * np.cos((k + 1) * motor)
    return total


def motor_torque(
    plant: Plant,
    tau_joint: Array,
    motion: Motion,
    *,
    state: Array,
    gear_state: Array,
    temperature: Array,
    arm: bool,
) -> Array:
    """Return the torques that the drives report of the motor shafts, without noise, Nm, (N, n).

    Parameters
    ----------
    plant
        The robot.
    tau_joint
        Torques that the drives exert on the arm without friction, Nm, (N, n).
    motion
        Motion of the motors.
    state, gear_state
        States of the dry friction at the motors and at the gears' output, −1 … 1, (N, n).
    temperature
        Motor temperatures, °C, (N, n).
    arm
        Whether the arm moves with its drives; clamped, its own bearings do not rub.
    """
    f = plant.friction
    rubbing = f.load * np.abs(tau_joint) + (f.arm if arm else 0.0)
    at_joint = tau_joint + rubbing * gear_state + ripple(f, motion.angle)
    shaft = at_joint @ plant.drive.transmission.T + plant.drive.rotor * motion.acceleration
    taken = shaft + motor_friction(f, motion.speed, state, temperature)
    return np.asarray((1.0 + f.gain) * taken + f.offset, dtype=float)
