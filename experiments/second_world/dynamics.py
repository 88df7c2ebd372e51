"""Torques that move an arm: rigid bodies by pinocchio's recursive Newton–Euler, and the rotors of the motors."""

import numpy as np
import pinocchio as pin

from experiments.second_world.arms import Arm, Body
from experiments.second_world.arrays import Array
from experiments.second_world.urdf_text import urdf_text

__all__ = ["rigid_body_model", "rigid_torques"]


def rigid_body_model(arm: Arm, tool: Body, gravity_m_s2: Array) -> pin.Model:
    """
    Build pinocchio's model of an arm with its tool.

    Parameters
    ----------
    arm, tool
        The arm, and the tool in the flange frame.
    gravity_m_s2
        Gravity (3,) in the base frame.

    Returns
    -------
    pin.Model
        Its frame tool0 is the flange.
    """
    model = pin.buildModelFromXML(urdf_text(arm))
    frame = model.frames[model.getFrameId("tool0")]
    inertia = pin.Inertia(tool.mass_kg, tool.com_m, tool.inertia_kg_m2)
    model.inertias[model.njoints - 1] += frame.placement.act(inertia)
    model.gravity.linear = gravity_m_s2
    return model


def rigid_torques(model: pin.Model, rotor_kg_m2: Array, q: Array, qd: Array, qdd: Array) -> Array:
    """
    Inverse dynamics along a trajectory.

    Parameters
    ----------
    model
        Of `rigid_body_model`.
    rotor_kg_m2
        Inertia of each rotor (n,), seen at the joint.
    q, qd, qdd
        Trajectory (S, n), rad, rad/s, rad/s².

    Returns
    -------
    Array
        Torque that the drives exert (S, n), Nm, without friction.
    """
    data = model.createData()
    tau = np.empty_like(q)
    for k in range(len(q)):
        tau[k] = pin.rnea(model, data, q[k], qd[k], qdd[k])
    return np.asarray(tau + rotor_kg_m2 * qdd)
