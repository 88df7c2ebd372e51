"""The arm as rigid bodies: against energies, virtual work, and the facts about the reference robot."""

import numpy as np
import pytest

from experiments.virtual_robot.bodies import Bodies
from experiments.virtual_robot.draw import nominal_geometry, nominal_masses
from experiments.virtual_robot.structure import Deformation, _cantilever, deformation, flange_poses


def _rigid(q):
    n = q.shape[1]
    still = np.zeros((len(q), n + 1, 3))
    return Deformation(still, still, np.zeros((len(q), 3)), np.zeros((len(q), 3)))


def _height_of_masses(bodies, plant, q):
    """Potential energy by placing every centre of mass by hand."""
    pose, energy = np.tile(np.eye(4), (len(q), 1, 1)), np.zeros(len(q))
    for k, step in enumerate(np.moveaxis(bodies.steps(q), 1, 0)):
        pose = pose @ step
        com = plant.masses.com[k] - plant.geometry.points[k]
        energy += plant.masses.link[k] * 9.81 * (pose[:, 2, :3] @ com + pose[:, 2, 3])
    flange = pose @ bodies.flange
    return energy + plant.masses.tool * 9.81 * (flange[:, 2, :3] @ plant.masses.tool_com + flange[:, 2, 3])


def test_zero_pose_of_the_nominal_robot(robot):
    bodies = Bodies(nominal_geometry(robot), nominal_masses(robot))
    np.testing.assert_allclose(
        flange_poses(bodies, np.zeros((1, 6)), _rigid(np.zeros((1, 6))))[0], robot.flange, atol=1e-15
    )


def test_joint_two_lowers_the_arm(robot):
    bodies = Bodies(nominal_geometry(robot), nominal_masses(robot))
    q = np.zeros((1, 6))
    q[0, 1] = 0.1
    assert flange_poses(bodies, q, _rigid(q))[0, 2, 3] < 0.67
    assert bodies.gravity(q)[0, 1] < 0  # +dV/dq: turning further down gains energy


def test_gravity_torque_is_the_slope_of_the_energy(bodies, plant, q):
    slope = np.empty_like(q)
    for i in range(6):
        step = 1e-6 * np.eye(6)[i]
        slope[:, i] = (_height_of_masses(bodies, plant, q + step) - _height_of_masses(bodies, plant, q - step)) / 2e-6
    np.testing.assert_allclose(bodies.gravity(q), slope, atol=1e-5)


def test_power_of_a_motion_is_the_rate_of_its_energy(bodies, plant):
    t = np.linspace(0.0, 1.0, 2001)[:, None]
    a = np.array([0.3, -0.5, 0.4, 0.6, -0.7, 0.5])
    q, qd, qdd = a * np.sin(t), a * np.cos(t), -a * np.sin(t)
    power = np.sum(bodies.torque(q, qd, qdd) * qd, axis=1)
    work = np.sum((power[1:] + power[:-1]) / 2) * (t[1, 0] - t[0, 0])
    still = np.zeros_like(qd[[0]])
    # Kinetic energy ½ q̇'M q̇ from torques that only accelerate: M q̇ = tau(q, 0, q̇) − tau(q, 0, 0).
    kinetic = [
        0.5 * float(((bodies.torque(q[[k]], still, qd[[k]]) - bodies.torque(q[[k]], still, still)) @ qd[[k]].T)[0, 0])
        for k in (0, -1)
    ]
    potential = _height_of_masses(bodies, plant, q[[0, -1]])
    assert work == pytest.approx(kinetic[1] - kinetic[0] + potential[1] - potential[0], rel=1e-6)


def test_jacobian_is_the_slope_of_the_flange(bodies, q):
    J = bodies.jacobian(q[0])
    for i in range(6):
        step = 1e-6 * np.eye(6)[i]
        pair = np.array([q[0] + step, q[0] - step])
        pose = flange_poses(bodies, pair, _rigid(pair))
        np.testing.assert_allclose((pose[0, :3, 3] - pose[1, :3, 3]) / 2e-6, J[:3, i], atol=1e-8)
        spin = (pose[0, :3, :3] - pose[1, :3, :3]) / 2e-6 @ pose[0, :3, :3].T
        np.testing.assert_allclose([spin[2, 1], spin[0, 2], spin[1, 0]], J[3:, i], atol=1e-5)


def test_bearing_load_about_the_axis_is_the_gravity_torque(bodies, plant, q):
    load = bodies.wrenches(q)
    about = np.einsum("nij,ij->ni", load.moment, plant.geometry.axes)
    np.testing.assert_allclose(-about, bodies.gravity(q), atol=1e-9)
    np.testing.assert_allclose(load.force[:, 0, 2], -9.81 * (plant.masses.link.sum() + plant.masses.tool))


def test_cantilever_is_a_beam_of_many_pieces():
    v, F, M = np.array([0.5, 0.2, -0.1]), np.array([[3.0, -7.0, 20.0]]), np.array([[4.0, 1.0, -6.0]])
    turn, sag = _cantilever(2e-3, v, F, M)
    s = (np.arange(4000) + 0.5) / 4000
    L = np.linalg.norm(v)
    u = v / L
    moment = M + np.cross((1 - s)[:, None] * v, F)  # bending moment along the beam
    across = moment - (moment @ u)[:, None] * u
    angle = 2e-3 * np.cumsum(across, axis=0) * L / 4000
    np.testing.assert_allclose(turn[0], angle[-1], rtol=1e-3)
    np.testing.assert_allclose(sag[0], np.sum(np.cross(angle, u), axis=0) * L / 4000, rtol=2e-3)


def test_a_baseline_robot_is_rigid_between_its_joints(bodies, plant, q):
    shape = deformation(plant, bodies, q, np.full_like(q, 35.0))
    assert not shape.rotation.any()
    assert not shape.shift.any()
    assert not shape.base.any()
