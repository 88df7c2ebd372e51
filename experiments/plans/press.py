"""The load on a clamp when a joint is driven against it: springs in the drives, and a fixed flange.

If the flange is fixed and the joints are commanded by dq beyond the posture, the springs wind up,
tau = load + C⁻¹ dq with C = Tᵀ diag(1/k) T. All but the weight goes through the flange: W = J⁻ᵀ (tau - load).
Clearances and a yielding clamp reduce this load, so it is an upper bound for springs of this stiffness.
Source: the thesis's clamping experiment; Lynch & Park, Modern Robotics, section 5.2 (statics).
"""

from __future__ import annotations

import numpy as np

from experiments.plans.errors import PlanError
from experiments.plans.motion import Array
from kinematics.description import RobotDescription
from kinematics.gravity import add_tool, gravity_parameters, gravity_regressor
from kinematics.poe import forward, space_jacobian

__all__ = ["SINGULAR", "flange_jacobian", "holding_torque", "motor_torques", "rated_motor_torque", "wrench", "wrenches"]

SINGULAR = 50.0  # condition number with lengths in metres, beyond which a small torque makes a large force


def flange_jacobian(robot: RobotDescription, q: Array) -> Array:
    """Jacobian ``(6, n)`` of the flange (linear, angular), base axes, about the flange's origin; q ``(n,)`` rad."""
    chain = np.asarray(robot.linkage) @ q
    J = space_jacobian(robot.screws, chain)
    lever = forward(robot.screws, robot.flange, chain)[:3, 3]
    return np.asarray(np.vstack([J[3:] + np.cross(J[:3].T, lever).T, J[:3]]) @ np.asarray(robot.linkage))


def holding_torque(robot: RobotDescription, q: Array, gravity: Array, tool_mass: float, tool_com: Array) -> Array:
    """Joint torques ``(..., n)``, Nm, that hold the described arm and its tool at q ``(..., n)``, rad."""
    phi = gravity_parameters(robot.links) if robot.has_masses else np.zeros(4 * robot.n)
    phi = add_tool(phi, robot.flange, tool_mass, tool_com)
    chain = q @ np.asarray(robot.linkage).T
    return np.asarray((gravity_regressor(robot.screws, chain, gravity) @ phi) @ np.asarray(robot.linkage))


def rated_motor_torque(robot: RobotDescription, joint_torque: Array | None = None) -> Array:
    """Rated torques ``(n,)`` at the motor shafts, Nm, from those at the joints.

    Raises
    ------
    PlanError
        The description does not say, and nobody else does.
    """
    given = [j.rated_torque for j in robot.joints] if joint_torque is None else list(joint_torque)
    if any(r is None for r in given):
        raise PlanError(
            f"{robot.name}: expected rated torques, found none in its description; give them with --rated-torque, "
            "one for each joint, Nm"
        )
    rated = np.array([float(r) for r in given if r is not None])
    if rated.shape != (robot.n,) or not np.all(np.isfinite(rated)) or np.any(rated <= 0):
        raise PlanError(f"rated torques: expected {robot.n} numbers above 0, found {rated.tolist()}")
    return np.asarray(rated * np.abs(np.diag(robot.transmission)))


def motor_torques(robot: RobotDescription, stiffness: Array, load: Array, dq: Array) -> Array:
    """Torques ``(m, n)``, Nm, at the motors when joints are commanded ``dq`` ``(m, n)``, rad, beyond a clamped posture.

    ``stiffness`` ``(n,)`` Nm/rad at the motors, ``load`` ``(n,)`` Nm at the joints.
    """
    T = np.asarray(robot.transmission)
    motor = dq @ np.linalg.inv(T)  # rows: T^-T dq
    return np.asarray(load @ T.T + motor * stiffness)


def wrench(robot: RobotDescription, jacobian: Array, load: Array, tau_motor: Array) -> Array:
    """Wrench ``(m, 6)`` (N, Nm; base axes, about the flange) that motor torques ``(m, n)`` put on the clamp."""
    tau = tau_motor @ np.linalg.inv(np.asarray(robot.transmission)).T
    return np.asarray((tau - load) @ np.linalg.pinv(jacobian))


def wrenches(
    robot: RobotDescription, stiffness: Array, posture: Array, joint: int, offset: Array
) -> tuple[Array, Array, Array]:
    """Motor torques beyond the load ``(m, n)`` Nm, force and moment ``(m,)`` N and Nm on the clamp, step by step."""
    dq = np.zeros((len(offset), robot.n))
    dq[:, joint] = offset
    none = np.zeros(robot.n)
    tau = motor_torques(robot, stiffness, none, dq)
    W = wrench(robot, flange_jacobian(robot, posture), none, tau)
    return tau, np.linalg.norm(W[:, :3], axis=1), np.linalg.norm(W[:, 3:], axis=1)
