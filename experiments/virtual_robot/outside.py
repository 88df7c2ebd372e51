"""Effects that no library has: they test that diagnosis reports them as unknown."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from experiments.virtual_robot.description import Array

# name: (the joint it sits at, unit of its amplitude, what it does)
OUTSIDE_KINDS: dict[str, tuple[int, str, str]] = {
    "outside_q4_direction": (4, "rad", "joint 5 errs by A·(q4/π)·dir4"),
    "outside_third_harmonic": (2, "rad", "joint 3 errs by A·sin(3·q3)"),
    "outside_saturating_sag": (1, "m", "the flange sags by A·tanh((r − 1 m)/0.25 m), r its horizontal reach"),
    "outside_posture_product": (3, "rad", "joint 4 errs by A·sin(2·q1)·sin(q5)"),
    "outside_height_wave": (0, "m", "the point moves along the base's x by A·sin(2π·z/0.6 m)"),
    "outside_torque_wave": (2, "Nm", "motor 3 reads A·sin(5·q1) too much"),
}


def outside_angle(amplitudes: Mapping[str, float], q: Array, direction: Array) -> Array:
    """Return joint angle errors, rad, (N, n), at reported angles q, rad, and directions, ±1, (N, n)."""
    error = np.zeros_like(q)
    if a := amplitudes.get("outside_q4_direction"):
        error[:, 4] += a * q[:, 3] / np.pi * direction[:, 3]
    if a := amplitudes.get("outside_third_harmonic"):
        error[:, 2] += a * np.sin(3 * q[:, 2])
    if a := amplitudes.get("outside_posture_product"):
        error[:, 3] += a * np.sin(2 * q[:, 0]) * np.sin(q[:, 4])
    return error


def outside_shift(amplitudes: Mapping[str, float], flange: Array, point: Array) -> Array:
    """Return shifts of a tracked point in the base frame, m, (N, 3), from flange and point positions, m, (N, 3)."""
    shift = np.zeros_like(point)
    if a := amplitudes.get("outside_saturating_sag"):
        shift[:, 2] -= a * np.tanh((np.hypot(flange[:, 0], flange[:, 1]) - 1.0) / 0.25)
    if a := amplitudes.get("outside_height_wave"):
        shift[:, 0] += a * np.sin(2 * np.pi * point[:, 2] / 0.6)
    return shift


def outside_torque(amplitudes: Mapping[str, float], q: Array) -> Array:
    """Return torques that motors read too much, Nm, (N, n), at reported angles q, rad, (N, n)."""
    torque = np.zeros_like(q)
    if a := amplitudes.get("outside_torque_wave"):
        torque[:, 2] += a * np.sin(5 * q[:, 0])
    return torque
