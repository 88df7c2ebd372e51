"""Loads that gravity puts on joints, links and base in a posture, from the description and the declared tool."""

from __future__ import annotations

import numpy as np

from clampid.stages.rows import Array
from experiments.campaign import Campaign
from kinematics.gravity import gravity_parameters, gravity_regressor
from kinematics.poe import joint_transforms

__all__ = ["bearing_signals", "gravity_signals", "inertia_torque"]


def gravity_signals(campaign: Campaign, q: Array) -> dict[str, Array]:
    """Regressors and nominal gravity torque of postures ``q`` ``(N, n)``.

    ``regressor`` ``(N, n, 4n)`` of the links' (m, m c), base axes at the zero pose; ``tool_regressor`` ``(N, n, 4)`` of
    the tool's (m, m c) in the flange frame; ``gravity_torque`` ``(N, n)``, Nm, of described links and declared tool.
    """
    robot = campaign.robot
    chain_q = q @ np.asarray(robot.linkage).T
    Y = gravity_regressor(robot.screws, chain_q, campaign.gravity)
    # The linkage maps the controller's joints to the chain's, so that torques go the other way (power is conserved).
    Y = np.asarray(robot.linkage).T @ Y
    to_base = np.eye(4)
    to_base[1:, 0] = robot.flange[:3, 3]
    to_base[1:, 1:] = robot.flange[:3, :3]
    tool = Y[:, :, -4:] @ to_base
    declared = campaign.tool.mass * np.r_[1.0, campaign.tool.com]
    torque = tool @ declared
    if robot.has_masses:
        torque = torque + Y @ gravity_parameters(robot.links)
    return {"regressor": Y, "tool_regressor": tool, "gravity_torque": torque}


def bearing_signals(campaign: Campaign, q: Array) -> dict[str, Array]:
    """Moments and forces that the weight puts on the base, on bearings and on links, base axes at the zero pose.

    ``base_moment`` ``(N, 3)`` about the base's origin, base frame; ``transverse_moment`` ``(N, n, 3)`` across joint i's
    axis, in the link before it; ``link_moment``, ``link_force`` ``(N, n, 3)`` at link i's far end, in link i. Each
    comes
    with its ``…_regressor``, the derivative by the links' (m, m c), rows flattened.
    """
    robot, n = campaign.robot, campaign.robot.n
    G = joint_transforms(robot.screws, q @ np.asarray(robot.linkage).T)  # (N, n + 1, 4, 4)
    g = np.asarray(campaign.gravity, dtype=float)
    tool_at = robot.flange[:3, :3] @ campaign.tool.com + robot.flange[:3, 3]
    tool = campaign.tool.mass * np.r_[1.0, tool_at]
    masses = np.zeros(4 * n)
    if robot.has_masses:
        masses = np.asarray(gravity_parameters(robot.links), dtype=float).copy()
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
        local = np.swapaxes(R, 1, 2) @ about(here, i)
        axis = robot.joints[i].axis
        transverse[:, i] = local - axis[:, None] * np.einsum("j,njk->nk", axis, local)[:, None, :]
        if i > 0:  # what joint i+1 carries is what link i's far end carries
            moment[:, i - 1] = local
            force[:, i - 1, :, 4 * i :: 4] = np.einsum("nji,j->ni", R, g)[:, :, None]
    R = G[:, n, :3, :3]
    end = np.einsum("nij,j->ni", R, points[n]) + G[:, n, :3, 3]
    held = np.einsum("nij,j->ni", R, tool_at) + G[:, n, :3, 3]
    weight = campaign.tool.mass * g
    link_moment, link_force = weighed(moment), weighed(force)
    link_moment[:, n - 1] = np.einsum("nji,nj->ni", R, np.cross(held - end, weight))
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


def inertia_torque(campaign: Campaign, q: Array, speed: Array, acceleration: Array) -> Array:
    """Joint torques ``(N, n)``, Nm, that described masses and declared tool need in motion, beyond gravity.

    Masses count as points at their centres (and with their inertia tensors where described): J' m a, J the Jacobian of
    each centre of mass.
    """
    robot, n = campaign.robot, campaign.robot.n
    if not robot.has_masses:
        return np.zeros_like(q)
    linkage = np.asarray(robot.linkage)
    G = joint_transforms(robot.screws, q @ linkage.T)
    qd, qdd = speed @ linkage.T, acceleration @ linkage.T
    J = np.stack([_moved(G[:, i], np.asarray(robot.screws[i])) for i in range(n)], axis=1)  # (N, n, 6), space screws
    tool = robot.flange[:3, :3] @ campaign.tool.com + robot.flange[:3, 3]
    bodies = [(k, link.mass, np.asarray(link.com), link.inertia) for k, link in enumerate(robot.links)]
    bodies.append((n - 1, campaign.tool.mass, tool, None))
    torque = np.zeros_like(q)
    for k, mass, com, inertia in bodies:
        R, at = G[:, k + 1, :3, :3], np.einsum("nij,j->ni", G[:, k + 1, :3, :3], com) + G[:, k + 1, :3, 3]
        w = alpha = v = a = np.zeros((len(q), 3))
        for i in range(k + 1):  # spatial acceleration of the body: sum J qdd + sum ad(V_before) J qd
            Jw, Jv = J[:, i, :3], J[:, i, 3:]
            rate = qd[:, i, None]
            alpha = alpha + Jw * qdd[:, i, None] + np.cross(w, Jw) * rate
            a = a + Jv * qdd[:, i, None] + (np.cross(w, Jv) + np.cross(v, Jw)) * rate
            w, v = w + Jw * rate, v + Jv * rate
        velocity = v + np.cross(w, at)
        force = mass * (a + np.cross(alpha, at) + np.cross(w, velocity))
        moment = np.zeros_like(force)
        if inertia is not None:
            own = R @ np.asarray(inertia) @ np.swapaxes(R, 1, 2)
            spin = np.einsum("nij,nj->ni", own, w)
            moment = np.einsum("nij,nj->ni", own, alpha) + np.cross(w, spin)
        moment = moment + np.cross(at, force)
        for i in range(k + 1):
            torque[:, i] += np.einsum("ni,ni->n", J[:, i, :3], moment) + np.einsum("ni,ni->n", J[:, i, 3:], force)
    return torque @ linkage


def _moved(G: Array, screw: Array) -> Array:
    """The screw ``(6,)`` carried along by motions ``(N, 4, 4)``: Ad_G xi."""
    w = np.einsum("nij,j->ni", G[:, :3, :3], screw[:3])
    v = np.einsum("nij,j->ni", G[:, :3, :3], screw[3:]) + np.cross(G[:, :3, 3], w)
    return np.concatenate([w, v], axis=1)
