"""What an arm weighs of which nobody says it: a guess from its size, wide enough to hold the arms that are known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from kinematics.description import load_robot
from kinematics.gravity import gravity_parameters, gravity_regressor
from kinematics.masses import links_of, own_moment, usual_covariance, usual_links

KNOWN = ("kuka_kr20_r1810", "ur10")


def test_described_links_are_taken_as_they_are():
    robot = load_robot("ur10")
    assert links_of(robot) is robot.links
    bare = load_robot("abb_irb1200_5_09")
    assert not bare.has_masses
    assert [link.mass for link in links_of(bare)] == [link.mass for link in usual_links(bare)]


def test_what_moves_beyond_a_joint_weighs_as_the_square_of_the_reach():
    robot = load_robot("abb_irb4600_40_255")
    doubled = replace(
        robot,
        joints=tuple(replace(j, point=2.0 * np.asarray(j.point)) for j in robot.joints),
        flange=np.block([[robot.flange[:3, :3], 2.0 * robot.flange[:3, 3:]], [0.0, 0.0, 0.0, 1.0]]),
    )
    for one, two in zip(usual_links(robot), usual_links(doubled), strict=True):
        assert two.mass == pytest.approx(4.0 * one.mass)
        np.testing.assert_allclose(two.com, 2.0 * np.asarray(one.com))


@pytest.mark.parametrize("name", KNOWN)
def test_gravity_torques_of_described_arms_are_within_what_is_left_open(name: str, rng):
    """Torques at joint 2 of any posture, in standard deviations of the guess."""
    robot = load_robot(name)
    q = rng.uniform(-1.5, 1.5, (200, robot.n))
    Y = gravity_regressor(robot.screws, q, np.array([0.0, 0.0, -9.81]))[:, 1]
    off = Y @ (gravity_parameters(robot.links) - gravity_parameters(usual_links(robot)))
    std = np.sqrt(np.einsum("ni,ij,nj->n", Y, usual_covariance(robot), Y))
    assert np.sqrt(np.mean((off / std) ** 2)) < 2.0


def test_covariance_is_one(rng):
    C = usual_covariance(load_robot("kuka_kr16_2"))
    np.testing.assert_allclose(C, C.T)
    assert np.linalg.eigvalsh(C / np.sqrt(np.outer(np.diag(C), np.diag(C)))).min() > 0.0


@pytest.mark.parametrize("name", ["kuka_kr20_r1810", "ur10", "abb_irb1200_5_09"])
def test_a_joint_carries_the_less_the_further_out_it_is_but_a_tenth_of_the_shoulder(name: str):
    robot = load_robot(name)
    moments = [own_moment(robot, joint) for joint in range(robot.n)]
    assert moments[0] == moments[1] == own_moment(robot)
    assert moments == sorted(moments, reverse=True)
    assert moments[-1] == pytest.approx(0.1 * moments[0])
    assert moments[2] < 0.7 * moments[1]
