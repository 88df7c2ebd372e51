"""Mechanics of the second world: chain, statics, dynamics and springs against pinocchio, energy and closed forms."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from experiments.second_world import ROBOTS, draw_robot
from experiments.second_world.arms import ARMS
from experiments.second_world.arrays import exp_so3, rpy_of, rpy_rotation
from experiments.second_world.chain import Bend, forward, loads_of, points_in_base
from experiments.second_world.climate import lagged
from experiments.second_world.dynamics import rigid_body_model, rigid_torques
from experiments.second_world.equilibrium import rest
from experiments.second_world.friction import coulomb, dahl, viscous
from experiments.second_world.inverse import reach
from experiments.second_world.log_programs import LOG_PROGRAMS, run_log
from experiments.second_world.pose_programs import POSE_PROGRAMS, run_poses

RNG = np.random.default_rng(5)


def postures(robot, rows=4):
    return RNG.uniform(*robot.nominal.limits(), (rows, robot.n))


@pytest.mark.parametrize("name", ROBOTS)
def test_forward_kinematics_and_gravity_agree_with_pinocchio(name):
    robot = draw_robot(name, 2)
    q = postures(robot)
    frames = forward(robot.arm, q, Bend.none(*q.shape))
    loads = loads_of(robot.arm, robot.tool, robot.gravity_m_s2, frames)
    model = rigid_body_model(robot.arm, robot.tool, robot.gravity_m_s2)
    data = model.createData()
    for k in range(len(q)):
        pin.framesForwardKinematics(model, data, q[k])
        flange = data.oMf[model.getFrameId("tool0")]
        np.testing.assert_allclose(frames.flange_m[k], flange.translation, atol=1e-10)
        np.testing.assert_allclose(frames.flange[k], flange.rotation, atol=1e-10)
        gravity = pin.computeGeneralizedGravity(model, data, q[k])
        np.testing.assert_allclose(loads.torque_Nm[k], gravity, atol=1e-7 * np.abs(gravity).max())


def test_the_work_of_the_drives_is_the_gain_of_energy():
    robot = draw_robot("offset6", 3)
    log = run_log(robot, replace(LOG_PROGRAMS["fourier_1khz"], speeds=(0.5,), worked_before_s=(0.0,), size=4.0), 1)
    model = rigid_body_model(robot.arm, robot.tool, robot.gravity_m_s2)
    data = model.createData()
    tau = rigid_torques(model, np.zeros(robot.n), log.q, log.qd, log.qdd)
    energy = [pin.computeMechanicalEnergy(model, data, q, qd) for q, qd in zip(log.q, log.qd, strict=True)]
    work = np.concatenate([[0.0], np.cumsum(((tau * log.qd).sum(1)[1:] + (tau * log.qd).sum(1)[:-1]) / 2) * 1e-3])
    np.testing.assert_allclose(energy - np.array(energy[0]), work, atol=1e-3 * np.ptp(energy))


@pytest.mark.parametrize("name", ["trapezoids_250hz", "fourier_100hz"])
def test_speeds_are_the_derivatives_of_angles_and_keep_the_limits(name):
    robot = draw_robot("seven7", 3)
    log = run_log(robot, LOG_PROGRAMS[name], 1)
    same = (np.diff(log.run) == 0)[1:] & (np.diff(log.run) == 0)[:-1]
    numeric = (log.q[2:] - log.q[:-2]) / (log.time_s[2:] - log.time_s[:-2])[:, None]
    assert np.abs(numeric - log.qd[1:-1])[same].max() < 0.02 * robot.nominal.max_speeds().max()
    assert (np.abs(log.qd) <= robot.nominal.max_speeds()).all()
    low, high = robot.nominal.limits()
    assert ((log.q >= low) & (log.q <= high)).all()


@pytest.mark.parametrize("program", ["line24", "plane", "near"])
@pytest.mark.parametrize("name", ROBOTS)
def test_programs_keep_the_limits_and_tell_directions(name, program):
    robot = draw_robot(name, 4)
    visits = run_poses(robot, POSE_PROGRAMS[program], 4, "poses", 0.0, 1)
    low, high = robot.nominal.limits()
    assert ((visits.q >= low) & (visits.q <= high)).all()
    assert set(np.unique(visits.dirs)) == {-1.0, 1.0}
    assert (np.diff(visits.time_s) > 0).all()


def test_a_line_is_straight_and_driven_out_and_back():
    robot = draw_robot("big6", 4)
    visits = run_poses(robot, POSE_PROGRAMS["line24"], 4, "poses", 0.0, 1)
    frames = forward(robot.nominal, visits.q, Bend.none(*visits.q.shape))
    points = points_in_base(frames, robot.nominal_targets_m[:1])[:, 0]
    off = np.linalg.svd(points - points.mean(0))[1]
    assert len(points) == 48
    assert off[1] < 1e-2 * off[0]
    np.testing.assert_allclose(points[:24], points[24:][::-1], atol=1e-9)
    moving = np.abs(np.diff(visits.q[:24], axis=0)).min(0) > 1e-3
    out, back = visits.dirs[1:23], visits.dirs[25:47][::-1]
    assert (out[:, moving] == -back[:, moving]).mean() > 0.9


def test_inverse_kinematics_reaches_the_places():
    arm = ARMS["uncoupled6"]
    f = forward(arm, arm.home_rad[None], Bend.none(1, arm.n))
    target = np.array([0.02, 0.01, 0.1])
    places = (f.flange_m + f.flange @ target) + 0.1 * RNG.uniform(-1, 1, (5, 3))
    q = reach(arm, target, places, arm.home_rad)
    g = forward(arm, q, Bend.none(*q.shape))
    np.testing.assert_allclose(g.flange_m + g.flange @ target, places, atol=1e-6)


def test_a_resting_arm_is_in_equilibrium_with_its_springs():
    robot = draw_robot("big6", 6, backlash=False)
    visits = run_poses(robot, POSE_PROGRAMS["few"], 1, "poses", 0.0, 1)
    resting = rest(robot, visits, [])
    loads = loads_of(robot.arm, robot.tool, robot.gravity_m_s2, resting)
    bend = Bend.none(*visits.q.shape)
    bend.angle_rad[:] = -robot.compliance_rad_Nm * loads.torque_Nm
    np.testing.assert_allclose(forward(robot.arm, visits.q, bend).flange_m, resting.flange_m, atol=1e-9)
    assert (
        resting.flange_m[:, 2] < rest(replace(robot, compliance_rad_Nm=np.zeros(6)), visits, []).flange_m[:, 2]
    ).all()


def test_clearances_follow_the_load_or_the_approach():
    robot = draw_robot("uncoupled6", 6, compliance=False)
    visits = run_poses(robot, POSE_PROGRAMS["few"], 1, "poses", 0.0, 1)
    plain = forward(robot.arm, visits.q, Bend.none(*visits.q.shape))
    seen = rest(robot, visits, [])
    gap_1 = replace(robot, clearance_rad=np.array([3e-4, 0, 0, 0, 0, 0.0]))
    turned = np.cross(plain.flange_m, rest(gap_1, visits, []).flange_m)[:, 2] / (plain.flange_m[:, :2] ** 2).sum(1)
    np.testing.assert_allclose(turned, -1.5e-4 * visits.dirs[:, 0], atol=5e-7)
    assert np.abs(seen.flange_m - plain.flange_m).max() < 5e-4


def test_friction_loses_energy_and_levels_off():
    w = np.linspace(-2, 2, 401)[:, None]
    top, level = np.array([2.0]), np.array([3.0])
    assert (coulomb(w, top, level) * w >= 0).all()
    assert (viscous(w, top, level, 0.7) * w >= 0).all()
    way = np.concatenate([np.linspace(0, 0.1, 50), np.linspace(0.1, 0, 50), np.zeros(5)])[:, None]
    force = dahl(way, level, 1e-3)
    np.testing.assert_allclose(force[[49, 98, 104], 0], [3.0, -3.0, -3.0], rtol=0.2)
    assert np.abs(force).max() <= 3.0


def test_rotations_and_lags():
    rpy = RNG.uniform(-1.2, 1.2, 3)
    np.testing.assert_allclose(rpy_of(rpy_rotation(rpy)), rpy, atol=1e-12)
    R = exp_so3(RNG.standard_normal((5, 3)))
    np.testing.assert_allclose(R @ np.swapaxes(R, 1, 2), np.broadcast_to(np.eye(3), R.shape), atol=1e-12)
    time = np.linspace(0, 10, 200)
    np.testing.assert_allclose(lagged(np.r_[0.0, np.ones(199)], time, 2.0), 1 - np.exp(-time / 2.0), atol=1e-12)


@pytest.mark.parametrize("name", ROBOTS)
def test_individuals_differ_by_the_stated_amounts(name):
    one, same, other = draw_robot(name, 1), draw_robot(name, 1), draw_robot(name, 2)
    shift = np.stack([a.xyz_m - b.xyz_m for a, b in zip(one.arm.joints, one.nominal.joints, strict=True)])
    assert ((np.abs(shift) > 0.99e-4) & (np.abs(shift) < 1.01e-3)).all()
    np.testing.assert_array_equal(one.coulomb_Nm, same.coulomb_Nm)
    assert (one.coulomb_Nm != other.coulomb_Nm).all()


def test_the_big_arm_has_its_reach_and_its_clearances():
    arm = ARMS["big6"]
    steps = np.array([j.xyz_m for j in arm.joints])
    assert steps[1, 0] + np.linalg.norm(steps[2]) + np.linalg.norm(steps[3] + steps[4]) == pytest.approx(2.05, abs=0.01)
    gap = draw_robot("big6", 8).clearance_rad
    assert ((gap >= 4e-4) & (gap <= 5e-4)).all()
