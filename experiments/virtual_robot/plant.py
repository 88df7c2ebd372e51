"""The true numbers of one virtual robot. What a baseline robot lacks (an eccentric gear, a soft clamp) is zero.

Angles are radians, lengths metres, torques Nm; vectors are in the base frame at the zero pose unless said otherwise.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from experiments.virtual_robot.description import Array


@dataclass(frozen=True)
class Geometry:
    """True screws, flange and tracked points."""

    kinds: tuple[str, ...]
    axes: Array  # (n, 3)
    points: Array  # (n, 3)
    pitch: Array  # (n,) m/rad
    zero: Array  # (n,) rad, the angle at which the arm stands when zero is reported
    flange: Array  # (4, 4)
    linkage: Array  # (n, n) from the controller's joint values to the chain's
    targets: Mapping[str, Array]  # in the flange frame

    @property
    def link_vectors(self) -> Array:
        """Vector from each joint's point to the next one's, the last to the flange, m, (n, 3)."""
        ends = np.vstack([self.points[1:], self.flange[:3, 3]])
        return np.asarray(ends - self.points, dtype=float)


@dataclass(frozen=True)
class Masses:
    """True masses; ``link`` is all zero where the description knows no link."""

    gravity: Array  # (3,) m/s²
    link: Array  # (n,) kg
    com: Array  # (n, 3) m
    tool: float  # kg
    tool_com: Array  # (3,) m, flange frame

    @property
    def known(self) -> bool:
        """Whether the robot has weight at all."""
        return bool(self.link.any())


@dataclass(frozen=True)
class Drive:
    """From motor shaft to arm: gears, springs, gaps."""

    nominal: Array  # (n, n) T as the controller has it
    transmission: Array  # (n, n) T as the gears are
    spring: Array  # (n,) Nm/rad at the motor
    coupling: Array  # (n, n) rad/Nm at the motors, symmetric, off the diagonal
    extra_compliance: Array  # (n,) rad/Nm at the joint
    hardening: Array  # (n,) rad/Nm³ at the joint
    soft: Array  # (n,) rad/Nm at the joint, more compliance below a torque
    soft_torque: Array  # (n,) Nm, that torque
    rated: Array  # (n,) Nm at the joint
    gap: Array  # (n,) rad at the joint
    reversal: Array  # (n,) rad at the joint, between where it stops from either side, whatever its load
    slip: Array  # (n, k) rad/Nm, compliance of the elements that slip (hysteresis)
    slip_torque: Array  # (n, k) Nm, where they slip
    eccentricity: Array  # (n, 4) rad: sin q, cos q, sin 2q, cos 2q
    resolver: Array  # (n, 4) rad at the joint: sin m, cos m, sin 2m, cos 2m of the motor's angle
    rotor: Array  # (n,) kg m² at the motor
    disc: Array  # (n, marks) rad by which each encoder's disc is off at equal angles all round
    disc_turn: Array  # (n,) rad by which each drive's disc is turned
    disc_sense: Array  # (n,) ±1, on which of its sides it is read
    tooth: Array  # (n, 3) rad: how far a damaged tooth turns the joint, the joint angle in its middle, its whole width

    @cached_property
    def to_motors(self) -> Array:
        """The inverse of T, (n, n): rows of joint angles times it are rows of motor angles."""
        return np.asarray(np.linalg.inv(self.nominal), dtype=float)


@dataclass(frozen=True)
class Friction:
    """Friction and the other parts of a motor's torque reading besides the load."""

    coulomb: Array  # (n,) Nm at the motor
    viscous: Array  # (n,) Nm s/rad at the motor
    presliding: Array  # (n,) rad at the motor
    creep: Array  # (n,) 1/s, rate at which the contacts of the gear creep at rest; 0: one contact that does not
    arm: Array  # (n,) Nm at the joint, Coulomb
    stribeck: Array  # (n,) Nm at the motor
    stribeck_speed: Array  # (n,) rad/s at the motor
    asymmetry: Array  # (n,) Nm at the motor, more when turning forward
    load: Array  # (n,) share of the transmitted joint torque
    thermal: Array  # (n,) 1/K
    ripple: Array  # (n, 2k) Nm at the joint: sin m, cos m, sin 2m, cos 2m, … of the motor's angle
    offset: Array  # (n,) Nm at the motor
    gain: Array  # (n,) error of the torque that a drive reports, per torque
    lag: float  # s by which torques are logged late


@dataclass(frozen=True)
class Attachments:
    """Things bolted to the arm that load its joints."""

    dress_stiffness: Array  # (n,) Nm/rad
    dress_rest: Array  # (n,) rad
    balancer_rate: float  # N/m
    balancer_joint: int
    balancer_arms: tuple[float, float]  # m
    balancer_length: float  # m, unstretched
    balancer_angle: float  # rad


@dataclass(frozen=True)
class Structure:
    """What bends, grows and tilts between the joints."""

    expansion: Array  # (n,) 1/K along each link vector
    bending: Array  # (n,) 1/(Nm²), 1/EI of each link
    bearing: Array  # (n,) rad/Nm, tilt of each joint's bearing
    base: float  # rad/Nm, tilt of the base
    settling: Array  # (6,) rad and m, turn and shift of the base about its origin in the first hour


@dataclass(frozen=True)
class Heat:
    """First-order bodies: each motor is warmed by its motion, each link by its motor."""

    motor_time: Array  # (n,) s
    motor_rise: Array  # (n,) K above ambient after long work
    link_time: Array  # (n,) s, to ambient
    contact_time: Array  # (n,) s, from the motor
    start: Array  # (2, n) K above ambient at switch-on, motors then links
    ambient: float  # °C
    swing: float  # K
    period: float  # s
    phase: float  # rad


@dataclass(frozen=True)
class Instrument:
    """Where the measuring instrument stands, and how well it and the robot repeat."""

    rotation: Array  # (3, 3) base to instrument
    origin: Array  # (3,) m
    sigma: float  # m, one axis
    scale: float  # 1
    repeatability: Array  # (n,) rad per visit
    torque_sigma: Array  # (n,) Nm at the motor
    temperature_sigma: float  # K


@dataclass(frozen=True)
class Fixture:
    """The clamp's block: compliance at the flange, along and about the base axes, and its dial gauges."""

    compliance: Array  # (6,) m/N and rad/Nm
    shift: Array  # (6,) m and rad by which the block slips once
    slips_at: float  # s on the clock of the sweeps
    preload: float  # share of the rated torque
    sigma: Array  # (6,) m and rad


@dataclass(frozen=True)
class Plant:
    """One robot with everything that is true about it."""

    geometry: Geometry
    masses: Masses
    drive: Drive
    friction: Friction
    attachments: Attachments
    structure: Structure
    heat: Heat
    instrument: Instrument
    fixture: Fixture
    outside: Mapping[str, float]  # amplitudes of what no library knows

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.geometry.zero)
