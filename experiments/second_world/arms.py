"""
The arms of this world: serial chains of revolute joints, with masses, limits and torques.

All lengths are invented; the proportions are those of common machines. At the zero posture every joint frame has the
axes of the base frame. The transmission is the identity: a motor turns its own joint and no other.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import radians
from typing import NamedTuple

import numpy as np

from experiments.second_world.arrays import Array

__all__ = ["ARMS", "Arm", "Body", "Joint"]

_DOWN = (0.0, np.pi / 2, 0.0)  # flange of a wrist that points along +x: z forward, x down


@dataclass(frozen=True)
class Joint:
    """A revolute joint: its frame on the body before it, its axis and its limits."""

    xyz_m: Array  # (3,) in the frame of the joint before
    rpy_rad: Array  # (3,)
    axis: Array  # (3,) unit vector in the joint's own frame
    lower_rad: float
    upper_rad: float
    max_speed_rad_s: float
    max_torque_Nm: float


@dataclass(frozen=True)
class Body:
    """A rigid body: mass, centre of mass and inertia about it, in the frame that carries it."""

    mass_kg: float
    com_m: Array  # (3,)
    inertia_kg_m2: Array  # (3, 3)


@dataclass(frozen=True)
class Arm:
    """A chain of joints with the body that each one moves, and the flange on the last."""

    name: str
    joints: tuple[Joint, ...]
    bodies: tuple[Body, ...]
    flange_xyz_m: Array  # (3,) in the frame of the last joint
    flange_rpy_rad: Array  # (3,)
    home_rad: Array  # (n,) a posture with the tool in front of the arm

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.joints)

    def limits(self) -> Array:
        """Lower and upper limits (2, n), rad."""
        return np.array([[j.lower_rad for j in self.joints], [j.upper_rad for j in self.joints]])

    def max_speeds(self) -> Array:
        """Largest joint speeds (n,), rad/s."""
        return np.array([j.max_speed_rad_s for j in self.joints])

    def max_torques(self) -> Array:
        """Largest joint torques (n,), Nm."""
        return np.array([j.max_torque_Nm for j in self.joints])


def _rod(mass: float, start: Array, end: Array) -> Body:
    """Make a thick rod: a solid cylinder from start to end, its radius a tenth of a metre or less."""
    along = end - start
    length = float(np.linalg.norm(along))
    radius = 0.04 + 0.12 * length
    e = along / length if length > 1e-6 else np.array([0.0, 0.0, 1.0])
    outer = np.outer(e, e)
    across = mass * (3 * radius**2 + length**2) / 12
    return Body(mass, (start + end) / 2, mass * radius**2 / 2 * outer + across * (np.eye(3) - outer))


class DataSheet(NamedTuple):
    """A maker's data of an arm: axes of its joints (letters; small is +, capital is −), and points at zero.

    Lengths in m, masses in kg, torques in Nm, speeds in rad/s; ranges, and where the arm is at home, in degrees.
    """

    name: str
    axes: str
    points: Sequence[Sequence[float]]
    flange: Sequence[float]
    flange_rpy: Sequence[float]
    masses: Sequence[float]
    torques: Sequence[float]
    speeds: Sequence[float]
    ranges_deg: Sequence[tuple[float, float]]
    home_deg: Sequence[float]

    def arm(self) -> Arm:
        """Its joints, and its links as rods."""
        p = np.array([*self.points, self.flange], dtype=float)
        steps = np.diff(np.vstack([np.zeros(3), p]), axis=0)
        directions = {c: np.eye(3)[i] for i, c in enumerate("xyz")} | {c: -np.eye(3)[i] for i, c in enumerate("XYZ")}
        joints = tuple(
            Joint(
                steps[i], np.zeros(3), directions[letter], radians(low), radians(high), self.speeds[i], self.torques[i]
            )
            for i, (letter, (low, high)) in enumerate(zip(self.axes, self.ranges_deg, strict=True))
        )
        bodies = tuple(_rod(self.masses[i], np.zeros(3), steps[i + 1]) for i in range(len(self.axes)))
        return Arm(self.name, joints, bodies, steps[-1], np.array(self.flange_rpy), np.deg2rad(self.home_deg))


ARMS: dict[str, Arm] = {
    sheet.name: sheet.arm()
    for sheet in (
        DataSheet(
            "uncoupled6",
            "zyyxyx",
            [(0, 0, 0), (0.14, 0, 0.43), (0.14, 0, 1.05), (0.14, 0, 1.16), (0.80, 0, 1.16), (0.80, 0, 1.16)],
            (0.91, 0, 1.16),
            _DOWN,
            (48.0, 31.0, 24.0, 9.0, 4.5, 1.1),
            (820.0, 860.0, 410.0, 92.0, 78.0, 45.0),
            (3.1, 2.9, 3.3, 6.2, 6.0, 8.5),
            ((-170, 170), (-85, 125), (-160, 70), (-185, 185), (-118, 118), (-300, 300)),
            (10, 25, 5, 20, 40, -30),
        ),
        DataSheet(
            "seven7",
            "zyzYzyz",
            [(0, 0, 0), (0, 0, 0.34), (0, 0, 0.34), (0, 0, 0.74), (0, 0, 0.74), (0, 0, 1.13), (0, 0, 1.13)],
            (0, 0, 1.26),
            (0.0, 0.0, 0.0),
            (5.8, 6.3, 3.9, 3.1, 1.9, 1.8, 0.5),
            (310.0, 310.0, 170.0, 170.0, 105.0, 40.0, 40.0),
            (1.7, 1.7, 1.75, 2.2, 2.4, 3.1, 3.1),
            ((-168, 168), (-118, 118), (-168, 168), (-118, 118), (-168, 168), (-118, 118), (-172, 172)),
            (15, 40, 10, 75, -20, 50, 30),
        ),
        DataSheet(
            "offset6",
            "zyyyZy",
            [
                (0, 0, 0),
                (0, 0.13, 0.16),
                (0.58, 0.01, 0.16),
                (1.10, 0.01, 0.16),
                (1.10, 0.12, 0.16),
                (1.10, 0.12, 0.05),
            ],
            (1.10, 0.21, 0.05),
            (-np.pi / 2, 0.0, 0.0),
            (8.2, 14.5, 5.1, 2.3, 2.0, 0.5),
            (340.0, 340.0, 160.0, 58.0, 56.0, 52.0),
            (2.1, 2.1, 3.0, 3.2, 3.2, 3.2),
            ((-180, 180), (-170, -5), (-140, 140), (-180, 180), (-180, 180), (-180, 180)),
            (-15, -80, 85, -60, 35, 20),
        ),
        DataSheet(
            "small6",
            "zyyxyx",
            [(0, 0, 0), (0, 0.02, 0.29), (0, 0, 0.55), (0, 0, 0.53), (0.29, 0, 0.53), (0.29, 0, 0.53)],
            (0.36, 0, 0.53),
            _DOWN,
            (6.4, 5.2, 2.8, 1.3, 0.8, 0.2),
            (62.0, 66.0, 29.0, 11.0, 10.0, 5.5),
            (5.8, 5.1, 6.3, 8.9, 7.2, 11.0),
            ((-165, 165), (-100, 110), (-200, 65), (-170, 170), (-115, 115), (-250, 250)),
            (-20, 30, 0, -35, 45, 60),
        ),
        DataSheet(
            "big6",
            "zyyxyx",
            [(0, 0, 0), (0.175, 0, 0.495), (0.175, 0, 1.395), (0.175, 0, 1.57), (1.135, 0, 1.57), (1.135, 0, 1.57)],
            (1.27, 0, 1.57),
            _DOWN,
            (155.0, 74.0, 68.0, 15.0, 8.5, 2.4),
            (2900.0, 3400.0, 1550.0, 310.0, 260.0, 130.0),
            (3.0, 3.0, 3.0, 4.3, 4.3, 6.2),
            ((-180, 180), (-88, 145), (-175, 72), (-200, 200), (-122, 118), (-350, 350)),
            (5, 30, 5, -15, 50, 40),
        ),
    )
}
