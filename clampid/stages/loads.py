"""Loads that gravity puts on joints, links and base in a posture, from the description and the declared tool."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from clampid.stages.rows import Array
from experiments.campaign import Campaign
from kinematics.dynamics import inertial_parameters, inertial_regressor
from kinematics.gravity import (
    add_tool,
    gravity_parameters,
    gravity_regressor,
    gravity_stiffness,
    inclination_axes,
    torque_by_gravity,
)
from kinematics.masses import links_of
from kinematics.poe import joint_transforms
from kinematics.robot import RobotDescription

__all__ = [
    "axis_torque",
    "bearing_signals",
    "declared_weight",
    "described_weight",
    "flange_to_base",
    "gravity_regressors",
    "gravity_signals",
    "inclination_torque",
    "inertia_torque",
    "inertial_bodies",
    "inertial_signals",
    "lean_torque",
    "standing_loads",
    "weight_behind_tilts",
    "weight_rate",
    "weight_stiffness",
    "with_tilts",
]

ROWS_AT_ONCE = 1 << 12  # of which the stiffness is held, of all joints and their tilts
RATE_STEP = 1e-4  # s: of the difference; its error goes with the square of the angle turned in it


def gravity_signals(campaign: Campaign, q: Array) -> dict[str, Array]:
    """Regressors and nominal gravity torque of postures ``q`` ``(N, n)``.

    ``regressor`` ``(N, n, 4n)`` of the links' (m, m c), base axes at the zero pose; ``tool_regressor`` ``(N, n, 4)`` of
    the tool's (m, m c) in the flange frame; ``gravity_torque`` ``(N, n)``, Nm, of the declared tool and of the links as
    described, or as usual (:mod:`kinematics.masses`).
    """
    robot = campaign.robot
    found = gravity_regressors(robot, np.asarray(campaign.gravity, dtype=float), q)
    declared = campaign.tool.mass * np.r_[1.0, campaign.tool.com]
    torque = found["tool_regressor"] @ declared
    torque = torque + found["regressor"] @ gravity_parameters(links_of(robot))
    return {**found, "gravity_torque": torque}


def lean_torque(campaign: Campaign, q: Array) -> Array:
    """How the weight's torques follow a lean of the robot ``(N, n, 3)``, Nm/rad, at ``q`` ``(N, n)``, rad.

    Last index: about the base's axes, by which gravity turns as the base sees it, g + w x g.
    """
    return _torque_by_gravity(campaign, q) @ np.cross(np.eye(3), campaign.gravity).T


def inclination_torque(campaign: Campaign, q: Array) -> Array:
    """How the weight's torques follow an inclination of the base ``(N, n, 2)``, Nm/rad, at ``q`` ``(N, n)``, rad.

    Last index: about the two axes of :func:`kinematics.gravity.inclination_axes`. A base that is turned by w sees
    gravity turned back, g + g x w.
    """
    return -_torque_by_gravity(campaign, q) @ np.cross(inclination_axes(campaign.gravity), campaign.gravity).T


def axis_torque(campaign: Campaign, q: Array) -> Array:
    """How the weight's torques follow tilts of the joints' axes ``(N, n, 2n)``, Nm/rad, at ``q`` ``(N, n)``, rad.

    Last index: two tilts of each joint, as of :func:`with_tilts`; those of joint 1, an inclination of the base, are
    zero. A tilt is a further joint before the tilted one, so that this is how torques follow its angle.
    """
    robot, n = campaign.robot, campaign.robot.n
    linkage, screws, weight = np.asarray(robot.linkage), with_tilts(robot), weight_behind_tilts(campaign)
    out = np.zeros((len(q), n, 2 * n))
    for first in range(0, len(q), ROWS_AT_ONCE):
        angles = np.zeros((len(q[first : first + ROWS_AT_ONCE]), 3 * n))
        angles[:, 2::3] = q[first : first + ROWS_AT_ONCE] @ linkage.T
        stiffness = gravity_stiffness(screws, angles, weight, campaign.gravity)
        tilts = stiffness[:, 2::3].reshape(-1, n, n, 3)[..., :2].reshape(-1, n, 2 * n)
        out[first : first + ROWS_AT_ONCE, :, 2:] = linkage.T @ tilts[..., 2:]
    return out


def weight_behind_tilts(campaign: Campaign) -> Array:
    """:func:`declared_weight` of the links of :func:`with_tilts` ``(12n,)``: those between tilts weigh nothing."""
    out = np.zeros((campaign.robot.n, 3, 4))
    out[:, 2] = declared_weight(campaign).reshape(-1, 4)
    return out.ravel()


def with_tilts(robot: RobotDescription) -> Array:
    """Screws ``(3n, 6)`` of the joints, each after two about its point that tilt its axis, base frame, zero pose.

    The first tilt is about the base's axis that is most across the joint's, less what it has along it. A prismatic
    joint has none.
    """
    out = np.zeros((robot.n, 3, 6))
    for joint, screw, three in zip(robot.joints, np.asarray(robot.screws), out, strict=True):
        axis, three[2] = screw[:3], screw
        if not axis.any():
            continue
        across = np.eye(3)[int(np.argmin(np.abs(axis)))]
        first = across - axis * (across @ axis)
        first /= np.linalg.norm(first)
        for k, tilt in enumerate((first, np.cross(axis, first))):
            three[k] = np.r_[tilt, -np.cross(tilt, np.asarray(joint.point, dtype=float))]
    return out.reshape(-1, 6)


def _torque_by_gravity(campaign: Campaign, q: Array) -> Array:
    """How the described weight's torques follow gravity ``(N, n, 3)``, kg m, at ``q`` ``(N, n)``, rad."""
    linkage = np.asarray(campaign.robot.linkage)
    found = torque_by_gravity(campaign.robot.screws, q @ linkage.T, declared_weight(campaign))
    return np.asarray(linkage.T @ found)


def declared_weight(campaign: Campaign) -> Array:
    """(m, m c) of described or usual links with the declared tool on the last ``(4n,)``, base axes at the zero pose."""
    robot, declared = campaign.robot, campaign.tool
    return add_tool(gravity_parameters(links_of(robot)), robot.flange, declared.mass, declared.com)


def described_weight(campaign: Campaign) -> Array:
    """The same of what is described only: of links of unknown weight nothing, instead of what is usual."""
    robot, declared = campaign.robot, campaign.tool
    phi = gravity_parameters(robot.links) if robot.has_masses else np.zeros(4 * robot.n)
    return add_tool(phi, robot.flange, declared.mass, declared.com)


def weight_stiffness(robot: RobotDescription, phi: Array, gravity: npt.ArrayLike, q: Array) -> Array:
    """How torques of weights ``phi`` ``(4n,)`` follow the posture ``(N, n, n)``, Nm/rad, at ``q`` ``(N, n)``, rad."""
    linkage = np.asarray(robot.linkage)
    stiffness = gravity_stiffness(robot.screws, q @ linkage.T, phi, gravity)
    return np.asarray(linkage.T @ stiffness @ linkage)


def standing_loads(campaign: Campaign, q: Array) -> dict[str, Array]:
    """Signals of the loads of an arm that stands still at ``q`` ``(N, n)``, rad, and how they follow its posture."""
    return {
        **gravity_signals(campaign, q),
        "weight_stiffness": weight_stiffness(campaign.robot, declared_weight(campaign), campaign.gravity, q),
        "lean_torque": lean_torque(campaign, q),
        **bearing_signals(campaign, q),
    }


def weight_rate(campaign: Campaign, q: Array, qd: Array) -> Array:
    """How fast the weight's torques at the motors change ``(N, n)``, Nm/s, at ``q``, ``qd`` ``(N, n)``, rad, rad/s."""
    ahead, behind = (_torque_by_gravity(campaign, q + s * RATE_STEP * qd) for s in (1.0, -1.0))
    rate = (ahead - behind) @ np.asarray(campaign.gravity, dtype=float) / (2.0 * RATE_STEP)
    return np.asarray(rate @ np.asarray(campaign.robot.transmission).T)


def gravity_regressors(robot: RobotDescription, gravity: Array, q: Array) -> dict[str, Array]:
    """``regressor`` and ``tool_regressor`` of :func:`gravity_signals`, of a robot under ``gravity`` ``(3,)``, m/s²."""
    Y = gravity_regressor(robot.screws, q @ np.asarray(robot.linkage).T, gravity)
    # The linkage maps the controller's joints to the chain's, so that torques go the other way (power is conserved).
    Y = np.asarray(robot.linkage).T @ Y
    return {"regressor": Y, "tool_regressor": Y[:, :, -4:] @ flange_to_base(robot)}


def bearing_signals(campaign: Campaign, q: Array) -> dict[str, Array]:
    """Moments and forces that the weight puts on the base, on bearings and on links, base axes at the zero pose.

    ``base_moment`` ``(N, 3)`` about the base's origin, base frame; ``transverse_moment`` ``(N, n, 3)`` across joint i's
    axis, in the link behind it, link i; ``link_moment``, ``link_force`` ``(N, n, 3)`` at link i's far end, in link i.
    Each comes with its ``…_regressor``, the derivative by the links' (m, m c), rows flattened.
    """
    robot, n = campaign.robot, campaign.robot.n
    G = joint_transforms(robot.screws, q @ np.asarray(robot.linkage).T)  # (N, n + 1, 4, 4)
    g = np.asarray(campaign.gravity, dtype=float)
    tool_at = robot.flange[:3, :3] @ campaign.tool.com + robot.flange[:3, 3]
    tool = campaign.tool.mass * np.r_[1.0, tool_at]
    masses = np.asarray(gravity_parameters(links_of(robot)), dtype=float).copy()
    points = np.array([*(joint.point for joint in robot.joints), robot.flange[:3, 3]])
    # By (m, m c) of link k: force m g, and about a point o the moment (R m c + (t - o) m) x g.
    by_link = np.zeros((len(q), n, 3, 4))
    by_link[..., 0] = np.cross(G[:, 1:, :3, 3], g)
    by_link[..., 1:] = np.swapaxes(np.cross(np.swapaxes(G[:, 1:, :3, :3], 2, 3), g), 2, 3)

    def about(point: Array, first: int) -> Array:
        """Moment regressor ``(N, 3, 4n)`` about points ``(N, 3)`` of links ``first`` and after."""
        out = np.zeros((len(q), 3, 4 * n))
        for k in range(first, n):
            part = by_link[:, k].copy()
            part[..., 0] -= np.cross(point, g)
            out[:, :, 4 * k : 4 * k + 4] = part
        return out

    def weighed(regressor: Array, with_tool: bool = True) -> Array:
        return np.asarray(regressor @ masses + (regressor[..., -4:] @ tool if with_tool else 0.0))

    base = about(np.zeros((len(q), 3)), 0)
    transverse, moment, force = (np.zeros((len(q), n, 3, 4 * n)) for _ in range(3))
    for i in range(n):
        R, p = G[:, i, :3, :3], G[:, i, :3, 3]
        here = np.einsum("nij,j->ni", R, points[i]) + p
        carried = about(here, i)
        local = np.swapaxes(R, 1, 2) @ carried
        axis = robot.joints[i].axis
        behind = np.swapaxes(G[:, i + 1, :3, :3], 1, 2) @ carried
        transverse[:, i] = behind - axis[:, None] * np.einsum("j,njk->nk", axis, behind)[:, None, :]
        if i > 0:  # what joint i+1 carries is what link i's far end carries
            moment[:, i - 1] = local
            force[:, i - 1, :, 4 * i :: 4] = np.einsum("nji,j->ni", R, g)[:, :, None]
    R = G[:, n, :3, :3]
    end = np.einsum("nij,j->ni", R, points[n]) + G[:, n, :3, 3]
    tool_place = np.einsum("nij,j->ni", R, tool_at) + G[:, n, :3, 3]
    weight = campaign.tool.mass * g
    link_moment, link_force = weighed(moment), weighed(force)
    link_moment[:, n - 1] = np.einsum("nji,nj->ni", R, np.cross(tool_place - end, weight))
    link_force[:, n - 1] = np.einsum("nji,j->ni", R, weight)
    flat = (len(q), 3 * n, 4 * n)
    return {
        "base_moment": weighed(base),
        "base_moment_regressor": base,
        "transverse_moment": weighed(transverse),
        "transverse_moment_regressor": transverse.reshape(flat),
        "link_moment": link_moment,
        "link_moment_regressor": moment.reshape(flat),
        "link_force": link_force,
        "link_force_regressor": force.reshape(flat),
    }


def inertial_signals(campaign: Campaign, q: Array, speed: Array, acceleration: Array) -> dict[str, Array]:
    """Regressors and nominal torque of motion ``(N, n)`` each, gravity left out.

    ``regressor`` ``(N, n, 4n)`` of the links' (m, m c) with their inertias about their own joints fixed;
    ``tool_regressor`` ``(N, n, 4)``; ``link_inertia_regressor`` ``(N, n, 6n)``; ``inertia_torque`` ``(N, n)``, Nm, of
    the same bodies as the gravity torque: see :func:`inertial_bodies`.
    """
    robot, n = campaign.robot, campaign.robot.n
    linkage, points = np.asarray(robot.linkage), np.array([joint.point for joint in robot.joints])
    Y = inertial_regressor(robot.screws, points, q @ linkage.T, speed @ linkage.T, acceleration @ linkage.T)
    Y = linkage.T @ Y
    torque = Y @ inertial_bodies(campaign)
    by_link = Y.reshape(len(q), n, n, 10)
    masses = by_link[..., :4].reshape(len(q), n, 4 * n)
    return {
        "regressor": masses,
        "tool_regressor": masses[:, :, -4:] @ flange_to_base(robot),
        "link_inertia_regressor": np.ascontiguousarray(by_link[..., 4:]).reshape(len(q), n, 6 * n),
        "inertia_torque": torque,
    }


def inertial_bodies(campaign: Campaign) -> Array:
    """(m, m c, inertia about the link's joint point) of the links with the declared tool on the last ``(10n,)``.

    Of the links as described, or as usual (:mod:`kinematics.masses`), as :func:`gravity_signals` weighs them: a body
    that has weight has inertia. Where no inertia is described it is that of a point at the centre of mass.
    """
    robot = campaign.robot
    points = [joint.point for joint in robot.joints]
    bodies = [inertial_parameters(b.mass, b.com, b.inertia, at) for b, at in zip(links_of(robot), points, strict=True)]
    tool = robot.flange[:3, :3] @ campaign.tool.com + robot.flange[:3, 3]
    bodies[-1] = bodies[-1] + inertial_parameters(campaign.tool.mass, tool, None, points[-1])
    return np.concatenate(bodies)


def inertia_torque(campaign: Campaign, q: Array, speed: Array, acceleration: Array) -> Array:
    """Joint torques ``(N, n)``, Nm, that the links and the declared tool need in motion, beyond gravity."""
    return inertial_signals(campaign, q, speed, acceleration)["inertia_torque"]


def flange_to_base(robot: RobotDescription) -> Array:
    """From (m, m c) in the flange frame to (m, m c) in the base frame at the zero pose ``(4, 4)``."""
    out = np.eye(4)
    out[1:, 0] = robot.flange[:3, 3]
    out[1:, 1:] = robot.flange[:3, :3]
    return out
