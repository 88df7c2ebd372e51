"""The description that the virtual robot needs: a protocol, so that no kinematics code is imported.

A description may also have ``linkage`` (n, n), the matrix from the controller's joint values to those of the chain
(a parallel linkage couples them); it is the identity where there is none.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


class JointLike(Protocol):
    """One joint as a nominal screw, in the base frame at the zero pose."""

    @property
    def name(self) -> str:
        """Name of the joint."""

    @property
    def kind(self) -> str:
        """Kind: ``revolute``, ``prismatic`` or ``helical``."""

    @property
    def axis(self) -> Array:
        """Unit axis direction, (3,)."""

    @property
    def point(self) -> Array:
        """A point on the axis, m, (3,)."""

    @property
    def pitch(self) -> float:
        """Advance of a helical joint, m/rad."""

    @property
    def lower(self) -> float:
        """Lower limit, rad (m for a prismatic joint)."""

    @property
    def upper(self) -> float:
        """Upper limit, rad (m)."""

    @property
    def max_speed(self) -> float | None:
        """Speed limit, rad/s (m/s)."""

    @property
    def rated_torque(self) -> float | None:
        """Rated torque at the joint, Nm (N), where known."""


class LinkLike(Protocol):
    """The body that moves with a joint."""

    @property
    def mass(self) -> float:
        """Mass, kg."""

    @property
    def com(self) -> Array:
        """Centre of mass in the base frame at the zero pose, m, (3,)."""


class RobotDescription(Protocol):
    """A nominal robot: screws, link masses, flange and transmission."""

    @property
    def name(self) -> str:
        """Name of the robot, as campaigns quote it."""

    @property
    def joints(self) -> Sequence[JointLike]:
        """The joints from base to flange."""

    @property
    def links(self) -> Sequence[LinkLike]:
        """Link i moves with joint i; fewer links than joints: the rest is massless; none: no gravity known."""

    @property
    def flange(self) -> Array:
        """Flange pose in the base frame at the zero pose, (4, 4)."""

    @property
    def transmission(self) -> Array:
        """Matrix T with theta_joint = T' theta_motor and tau_motor = T tau_joint, (n, n)."""

    @property
    def motor_spring(self) -> Array | None:
        """Spring constants at the motors, Nm/rad, (n,), where known."""
