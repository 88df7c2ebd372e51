"""Masses of a robot's links: as described, or else those of an arm of its size.

Poses tell how far springs wind up, and in that mass and spring are one factor. So an arm of which nobody says what it
weighs can still be told to yield under its weight as an arm does; its springs are then known as well as its masses.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy import linalg

from kinematics.robot import Link, RobotDescription

__all__ = ["links_of", "own_moment", "usual_covariance", "usual_links"]

Array = npt.NDArray[np.float64]

GRAVITY = 9.81  # m/s²
AREAL = 13.6
"""kg/m²: what moves beyond a joint, over the square of the reach from there. Beyond joint 2, by
their bundled descriptions: KUKA KR20 R1810 28.5, Universal Robots UR10 6.5; this is the geometric mean."""
BUILD = 0.7  # log: from that mean to either of them
UNEVEN = 0.7  # of a link's mass, by which links differ from each other beside that
LEAST_MASS_SPREAD = 0.5  # kg
OFF_MIDDLE, OFF_LEAST = 0.25, 0.02  # of a link's length, and m: how far its centre of mass is from its middle
LEAST_OF_SHOULDER = 0.1  # of the moment about the shoulder, that any joint is built for
CENTRE_MASS = 2.0  # kg: what a link without length may hold of a neighbour's


def links_of(robot: RobotDescription) -> tuple[Link, ...]:
    """The links as described, or :func:`usual_links` where the description does not say what they weigh."""
    return robot.links if robot.has_masses else usual_links(robot)


def usual_links(robot: RobotDescription) -> tuple[Link, ...]:
    """Links of a usual arm of that size: masses, kg, half-way along each, m, base frame at the zero pose."""
    points, length = _along(robot)
    beyond = AREAL * np.r_[np.cumsum(length[::-1])[::-1], 0.0] ** 2
    middle = 0.5 * (points[1:] + points[:-1])
    return tuple(Link(float(m), at) for m, at in zip(-np.diff(beyond), middle, strict=True))


def usual_covariance(robot: RobotDescription) -> Array:
    """How far (m, m c) of the links may be from :func:`usual_links` ``(4n, 4n)``, kg and kg m, base axes."""
    links, (_, length) = usual_links(robot), _along(robot)
    blocks, mean = [], []
    for link, long in zip(links, length, strict=True):
        centre = np.asarray(link.com)
        J = np.vstack([np.r_[1.0, centre], np.c_[np.zeros(3), np.eye(3)]]).T  # (m, m c) by (dm, M dc)
        off = (OFF_MIDDLE * long + OFF_LEAST) * max(link.mass, CENTRE_MASS)
        spread = np.r_[UNEVEN * link.mass + LEAST_MASS_SPREAD, np.full(3, off)]
        blocks.append(J @ np.diag(spread**2) @ J.T)
        mean.append(np.r_[link.mass, link.mass * centre])
    whole = np.concatenate(mean)
    return np.asarray(linalg.block_diag(*blocks) + BUILD**2 * np.outer(whole, whole))


def own_moment(robot: RobotDescription, joint: int = 1) -> float:
    """Moment about a joint (from 0) of the weight that it carries, Nm, were the arm stretched out level from there.

    That of the first joint is the one about the shoulder, the joint after it. A wrist is built for more than its own
    weight: it counts with a tenth of the shoulder's at least. Of gears so much is usual: 1e5 to 1e6 Nm/rad in the first
    three joints, 1e4 to 1e5 Nm/rad in a wrist.
    """
    about = [_moment_about(robot, j) for j in (1, max(joint, 1))]
    return max(about[1], LEAST_OF_SHOULDER * about[0])


def _moment_about(robot: RobotDescription, joint: int) -> float:
    _, length = _along(robot)
    reach = np.r_[0.0, np.cumsum(length[joint:])]  # along the arm from the joint to each joint after it, and the flange
    middle = 0.5 * (reach[1:] + reach[:-1])
    return float(GRAVITY * sum(link.mass * at for link, at in zip(links_of(robot)[joint:], middle, strict=True)))


def _along(robot: RobotDescription) -> tuple[Array, Array]:
    """Points of the joints and of the flange ``(n + 1, 3)``, and lengths of the links ``(n,)``, m."""
    points = np.array([*(joint.point for joint in robot.joints), robot.flange[:3, 3]])
    return points, np.asarray(np.linalg.norm(np.diff(points, axis=0), axis=1))
