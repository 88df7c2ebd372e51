"""What is known of one type of robot, as frozen values; `kinematics.description` reads them from files."""

from dataclasses import dataclass, field
from functools import cached_property
from typing import Literal

import numpy as np

from kinematics.dh import DHTable
from kinematics.screws import prismatic_screw, screw
from kinematics.typing_ import Array, frozen_array

__all__ = ["DescriptionError", "Joint", "JointKind", "Link", "RobotDescription"]

JointKind = Literal["revolute", "prismatic", "helical"]

USUAL_TORQUE = 100.0  # Nm, of a middling joint


class DescriptionError(ValueError):
    """A robot description is missing, unreadable or contradicts itself."""


@dataclass(frozen=True, eq=False)
class Joint:
    """
    One joint, where its axis is at the zero pose.

    Attributes
    ----------
    name
        Name on the machine.
    kind
        Revolute, prismatic or helical.
    axis
        Unit vector (3,) in the base frame at the zero pose; the joint turns positively about it.
    point
        A point on the axis (3,) in the base frame at the zero pose [m].
    pitch
        Advance per angle of a helical joint [m/rad].
    lower, upper
        Limits [rad, or m].
    max_speed
        [rad/s, or m/s], if known.
    rated_torque
        At the joint [Nm, or N], if known.
    """

    name: str
    kind: JointKind
    axis: Array
    point: Array
    pitch: float = 0.0
    lower: float = -np.inf
    upper: float = np.inf
    max_speed: float | None = None
    rated_torque: float | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "axis", frozen_array(self.axis))
        object.__setattr__(self, "point", frozen_array(self.point))

    @cached_property
    def screw(self) -> Array:
        """The joint's screw (6,), (omega, v) [1, m], in the base frame at the zero pose."""
        if self.kind == "prismatic":
            return frozen_array(prismatic_screw(self.axis))
        return frozen_array(screw(self.axis, self.point, self.pitch))


@dataclass(frozen=True, eq=False)
class Link:
    """
    Mass properties of what one joint moves and the next does not.

    Attributes
    ----------
    mass
        [kg].
    com
        Centre of mass (3,) in the base frame at the zero pose [m].
    inertia
        About the centre of mass, in base axes at the zero pose (3, 3) [kg m²], if known.
    """

    mass: float
    com: Array
    inertia: Array | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "com", frozen_array(self.com))
        if self.inertia is not None:
            object.__setattr__(self, "inertia", frozen_array(self.inertia))


@dataclass(frozen=True, eq=False, repr=False)
class RobotDescription:
    """
    The nominal robot.

    Attributes
    ----------
    name, title
        Short name (also of the file) and full name.
    joints
        The n joints, from the base.
    flange
        Pose of the flange at the zero pose in the base frame (4, 4) [m]; z points out of it.
    links
        What joint i moves, for each joint; empty if masses are unknown.
    transmission
        T (n, n) with θ_joint = Tᵀ·θ_motor and τ_motor = T·τ_joint; the identity if unknown.
    transmission_known
        Whether it is known.
    motor_spring
        Spring constants at the motor shafts (n,) [Nm/rad], if known.
    linkage
        Matrix (n, n) from the controller's joint values to those of the chain: the identity except where a parallel
        linkage couples joints.
    dh
        The nominal Denavit–Hartenberg table, if one is given; agrees with the joints.
    notes, unverified
        What a user should know; what was not confirmed by a second source.
    source
        Where the numbers come from.
    """

    name: str
    title: str
    joints: tuple[Joint, ...]
    flange: Array
    links: tuple[Link, ...] = ()
    transmission: Array = field(default_factory=lambda: np.zeros((0, 0)))
    transmission_known: bool = False
    motor_spring: Array | None = None
    linkage: Array = field(default_factory=lambda: np.zeros((0, 0)))
    dh: DHTable | None = None
    notes: tuple[str, ...] = ()
    unverified: tuple[str, ...] = ()
    source: str = ""

    def __post_init__(self) -> None:
        for name in ("transmission", "linkage"):
            given = np.asarray(getattr(self, name), dtype=np.float64)
            object.__setattr__(self, name, frozen_array(given if given.size else np.eye(self.n)))
        object.__setattr__(self, "flange", frozen_array(self.flange))
        if self.motor_spring is not None:
            object.__setattr__(self, "motor_spring", frozen_array(self.motor_spring))

    def __repr__(self) -> str:
        return f"<RobotDescription: {self.title}; {self.n} joints>"

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.joints)

    @cached_property
    def screws(self) -> Array:
        """Screws (n, 6), (omega, v) [1, m], in the base frame at the zero pose."""
        return frozen_array(np.array([joint.screw for joint in self.joints]).reshape(-1, 6))

    @cached_property
    def lower(self) -> Array:
        """Lower limits (n,) [rad, or m]."""
        return frozen_array([joint.lower for joint in self.joints])

    @cached_property
    def upper(self) -> Array:
        """Upper limits (n,) [rad, or m]."""
        return frozen_array([joint.upper for joint in self.joints])

    @cached_property
    def rated_torques(self) -> Array:
        """What each joint is built for (n), Nm, or N where it slides; 100 where the description says nothing."""
        return frozen_array([joint.rated_torque or USUAL_TORQUE for joint in self.joints])

    @cached_property
    def reach(self) -> float:
        """How far the last joint's point is from the second one's, stretched out, m."""
        points = np.array([joint.point for joint in self.joints])
        return float(np.linalg.norm(np.diff(points[1:], axis=0), axis=1).sum())

    @cached_property
    def stretched(self) -> float:
        """How far the flange is from the second joint's point, the arm stretched out, m."""
        return self.reach + float(np.linalg.norm(self.flange[:3, 3] - np.asarray(self.joints[-1].point)))

    @property
    def has_masses(self) -> bool:
        """Whether the masses of the links are known."""
        return len(self.links) > 0

    @property
    def dh_signs(self) -> tuple[int, ...]:
        """The signs (n) with which joint values enter the nominal DH table; +1 where none is given."""
        return tuple(row.sign for row in self.dh.rows) if self.dh else (1,) * self.n
