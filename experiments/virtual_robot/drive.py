"""Gears, springs and gaps between motor shaft and arm, and the torque that goes through them.

Signs: ``tau_joint`` is what the drive exerts (static: +dV/dq); the arm lags, q_arm = T'θ_m − C·tau_joint − ½·gap·flank,
with C = T' diag(1/k) T.
"""

from __future__ import annotations

import numpy as np

from experiments.virtual_robot.bodies import Bodies
from experiments.virtual_robot.description import Array
from experiments.virtual_robot.outside import outside_angle
from experiments.virtual_robot.plant import Attachments, Drive, Plant
from experiments.virtual_robot.play import slipping

HARDENED = 0.8  # of the rated torque, up to which springs harden
SEALS = 0.5  # Nm at the joint; below it, seals hold the arm on the flank that it came from
SMALL_JOINT = 100.0  # Nm: of joints of less rated torque the seals are smaller as well


def motor_angles(drive: Drive, q: Array) -> Array:
    """Return motor angles, rad, (N, n), at which the controller reports joint angles q, rad, (N, n)."""
    return np.asarray(q @ drive.to_motors, dtype=float)  # rows: θ_m = T⁻ᵀ q


def compliance_matrix(drive: Drive) -> Array:
    """Return the joint-side compliance of the drives, rad/Nm, (n, n), symmetric."""
    T = drive.transmission
    motor = np.diag(1.0 / drive.spring) + drive.coupling
    return np.asarray(T.T @ motor @ T + np.diag(drive.extra_compliance), dtype=float)


def gear_output(drive: Drive, motor: Array, zero: Array) -> Array:
    """Return the joint angles that unloaded gears give, rad, (N, n), from motor angles, rad, (N, n)."""
    q = motor @ drive.transmission + zero
    periodic = _twice(drive.eccentricity, q) + _twice(drive.resolver, motor)
    return np.asarray(q + periodic + _disc_error(drive, q) + _tooth_error(drive, q), dtype=float)


def _twice(e: Array, angle: Array) -> Array:
    """Return errors once and twice per revolution, rad, (N, n), from amplitudes (n, 4) and angles, rad, (N, n)."""
    once = e[:, 0] * np.sin(angle) + e[:, 1] * np.cos(angle)
    return np.asarray(once + e[:, 2] * np.sin(2 * angle) + e[:, 3] * np.cos(2 * angle), dtype=float)


def _disc_error(drive: Drive, q: Array) -> Array:
    """Return the errors of the encoders' discs, rad, (N, n): linear between marks."""
    joint, marks = np.arange(len(drive.disc)), drive.disc.shape[1]
    turns = (drive.disc_sense * q + drive.disc_turn) / (2 * np.pi) * marks
    before = np.floor(turns).astype(int)
    part = turns - before
    left, right = drive.disc[joint, before % marks], drive.disc[joint, (before + 1) % marks]
    return np.asarray(drive.disc_sense * (left + part * (right - left)), dtype=float)


def _tooth_error(drive: Drive, q: Array) -> Array:
    """Return the errors by damaged teeth, rad, (N, n): zero unless such a tooth is in mesh."""
    height, middle, width = drive.tooth.T
    away = np.abs(np.remainder(q - middle + np.pi, 2 * np.pi) - np.pi) / width  # in mesh below 1/2
    return np.asarray(np.where(away < 0.5, height * np.cos(np.pi * np.minimum(away, 0.5)) ** 2, 0.0), dtype=float)


def nonlinear_yield(drive: Drive, tau: Array) -> Array:
    """Return the deflection of the springs beyond the linear part, rad, (N, n); negative where they harden.

    Springs that are soft near zero have two slopes, as makers of gears tabulate them.
    """
    cubic = np.clip(tau, -HARDENED * drive.rated, HARDENED * drive.rated)
    # Beyond, the spring goes on with the slope that it has reached.
    hard = -drive.hardening * (cubic**3 + 3 * cubic**2 * (tau - cubic))
    return np.asarray(hard + drive.soft * np.clip(tau, -drive.soft_torque, drive.soft_torque), dtype=float)


def attached_load(attachments: Attachments, q: Array) -> Array:
    """Return the torque that springs between the links ask of the drives, Nm, (N, n), at joint angles q, rad."""
    a = attachments
    load = a.dress_stiffness * (q - a.dress_rest)
    if a.balancer_rate:
        r1, r2 = a.balancer_arms
        angle = q[:, a.balancer_joint] - a.balancer_angle
        length = np.sqrt(r1**2 + r2**2 - 2 * r1 * r2 * np.cos(angle))
        load[:, a.balancer_joint] += a.balancer_rate * (length - a.balancer_length) * r1 * r2 * np.sin(angle) / length
    return np.asarray(load, dtype=float)


def static_load(plant: Plant, bodies: Bodies, q: Array) -> Array:
    """Return the joint torques that hold the arm at rest, Nm, (N, n), at true joint angles q, rad, (N, n)."""
    weight = bodies.gravity(q) if plant.masses.known else np.zeros_like(q)
    return weight + attached_load(plant.attachments, q)


def transmitted(plant: Plant, load: Array, direction: Array) -> Array:
    """Return the torque that stays in a drive that stopped from ``direction``: load and the arm side's dry friction."""
    return load + plant.friction.arm * direction


def seals(drive: Drive) -> Array:
    """Return the load, Nm, (n,), below which seals hold a joint on the flank that it came from."""
    return np.asarray(SEALS * np.minimum(drive.rated / SMALL_JOINT, 1.0), dtype=float)


def flank(drive: Drive, tau: Array, direction: Array) -> Array:
    """Return the side of the gap on which a drive presses, ±1."""
    return np.where(np.abs(tau) < seals(drive), direction, np.sign(tau))


def off_by_approach(plant: Plant, q: Array, direction: Array) -> Array:
    """Return the offsets of the joints by the approach direction, rad, (N, n), independent of the load.

    A clamped arm does not move, and stays on the side on which it was clamped.
    """
    return outside_angle(plant.outside, q, direction) - 0.5 * plant.drive.reversal * direction


def arm_at_rest(plant: Plant, bodies: Bodies, q: Array, direction: Array) -> tuple[Array, Array]:
    """Return where the arm stands after it stopped, and the torque that its drives transmit.

    Parameters
    ----------
    plant, bodies
        The robot.
    q
        Reported joint angles in the order of time, rad, (N, n).
    direction
        Last direction of motion of each joint, ±1, (N, n).

    Returns
    -------
    tuple of Array
        True joint angles, rad, (N, n), in equilibrium with the load; transmitted torques, Nm, (N, n).
    """
    drive = plant.drive
    ideal = gear_output(drive, motor_angles(drive, q), plant.geometry.zero)
    ideal = ideal + off_by_approach(plant, q, direction)
    C = compliance_matrix(drive)
    arm, tau = ideal, np.zeros_like(ideal)
    for _ in range(4):  # each pass gains about three digits
        tau = transmitted(plant, static_load(plant, bodies, arm), direction)
        slip = -slipping(drive.slip, drive.slip_torque, tau)
        arm = ideal - tau @ C - nonlinear_yield(drive, tau) - slip - 0.5 * drive.gap * flank(drive, tau, direction)
    return arm, tau
