"""From (gamma, delta, r) to joint angles: what is answered, what is refused, and what each answer says of itself."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from ik_arms import drawn_model

from kinematics.description import load_robot
from offline_ik.cell.cell import default_cell
from offline_ik.cell.coordinates import detector_angles
from offline_ik.errors import CellError, DetectorError, TargetError
from offline_ik.inverse.branches import parse_choice, status_and_turn
from offline_ik.inverse.detector import Detector
from offline_ik.inverse.opening import open_detector
from offline_ik.inverse.ortho import ortho_arm
from offline_ik.inverse.uncertainty import Uncertainty
from offline_ik.motion.approach import approach_through

HERE = (0.3, 0.2, 0.8)


def test_the_identified_arm_is_where_it_was_asked_to_be(detector: Detector) -> None:
    rng = np.random.default_rng(0)
    for gamma, delta in rng.uniform(0.1, 1.2, (30, 2)).tolist():
        answer = detector.locate(gamma, delta, 0.8)
        assert answer.reachable
        first = answer.solutions[0]
        at = detector_angles(detector.cell.convention, detector.pose(first.q[None])[0])
        assert np.allclose([at.gamma, at.delta, at.r, at.roll, *at.tilt], [gamma, delta, 0.8, 0, 0, 0], atol=3e-9)
        assert first.position_error <= 1e-9
        assert first.angle_error <= 1e-9
        assert np.allclose(detector.robot.transmission.T @ first.motor, first.q, atol=1e-12)
        assert ((first.q >= detector.lower) & (first.q <= detector.upper)).all()


def test_the_one_kernel_and_the_long_way_agree(detector: Detector) -> None:
    for direction in (None, "moved", np.array([1, -1, 1, 1, -1, 1.0])):
        quick = detector.locate(*HERE, near=detector.rest + 0.1, direction=direction).solutions[0]
        long = detector.locate(*HERE, near=detector.rest + 0.1, branch="all", direction=direction).solutions[0]
        assert np.allclose(quick.q, long.q, atol=2e-9)
        assert np.allclose(quick.direction, long.direction)
        assert (quick.status, quick.turn, quick.singular) == (long.status, long.turn, long.singular)
        assert quick.uncertainty.std_m == pytest.approx(long.uncertainty.std_m, rel=1e-6)
        assert quick.uncertainty.tangential_m == pytest.approx(long.uncertainty.tangential_m, rel=1e-6)
        assert quick.uncertainty.approach_m == pytest.approx(long.uncertainty.approach_m, rel=1e-6)


def test_branches_as_they_are_asked_for(detector: Detector) -> None:
    everything = detector.locate(*HERE, branch="all").solutions
    assert len(everything) >= 2
    assert all(np.abs(detector.pose(s.q[None])[0] - detector.pose(everything[0].q[None])[0]).max() < 3e-9
               for s in everything)  # fmt: skip
    for sign in "+-":
        q5 = detector.locate(*HERE, branch=f"axis5{sign}").solutions[0].q[4]
        assert (q5 >= 0) == (sign == "+")
    wanted = everything[-1]
    found = detector.locate(*HERE, branch=f"S{wanted.status}T{wanted.turn}").solutions[0]
    assert (found.status, found.turn) == (wanted.status, wanted.turn)
    nearest = detector.locate(*HERE, near=wanted.q + 0.01).solutions[0]
    assert np.allclose(nearest.q, wanted.q, atol=2e-3)  # the flanks are those of no direction in both


def test_status_and_turn_of_the_zero_pose_and_of_known_ones() -> None:
    arm = ortho_arm(load_robot("kuka_kr20_r1810"))
    assert status_and_turn(arm, np.array([0, -1.57, 1.57, 0, 0.5, 0])) == (2, 0b000010)
    assert status_and_turn(arm, np.array([0.1, -1.57, 1.57, -0.1, -0.5, 0])) == (2 | 4, 0b011010)
    overhead = np.array([0.0, -2.6, -0.5, 0.0, 0.5, 0.0])
    assert status_and_turn(arm, overhead)[0] & 1


@pytest.mark.parametrize("text", ["axis6+", "S8", "S2T64", "", "T3"])
def test_a_branch_that_is_none_is_refused(text: str) -> None:
    with pytest.raises(TargetError, match="branch"):
        parse_choice(text)


def test_a_free_roll_moves_the_joints_least(detector: Detector) -> None:
    near = detector.locate(*HERE, 1.0).solutions[0].q
    free = detector.locate(*HERE, None, near=near).solutions[0]
    fixed = detector.locate(*HERE, 0.0, near=near).solutions[0]
    assert free.distance <= fixed.distance
    assert free.roll == pytest.approx(1.0, abs=2 * np.pi / 24)


def test_out_of_reach_is_said_with_the_nearest_position(detector: Detector) -> None:
    answer = detector.locate(0.3, 0.2, 3.0)
    assert not answer.reachable
    assert any("out of reach by" in reason for reason in answer.reasons)
    nearest = answer.nearest
    assert nearest is not None
    there = detector.locate(nearest["gamma_rad"], nearest["delta_rad"], nearest["r_m"])
    assert there.reachable
    off = np.linalg.norm(there.target[:3, 3] - answer.target[:3, 3])
    assert off == pytest.approx(nearest["distance_m"], abs=1e-9)
    # Half a step back towards what was asked for is out of reach: it is the nearest, as far as a search can tell.
    closer = 0.5 * there.target[:3, 3] + 0.5 * answer.target[:3, 3]
    pose = there.target.copy()
    pose[:3, 3] = closer
    at = detector_angles(detector.cell.convention, pose)
    assert not detector.locate(at.gamma, at.delta, at.r).reachable


@pytest.mark.slow
def test_a_limit_is_named(detector: Detector) -> None:
    near = detector.locate(*HERE).solutions[0].q
    lowers = [j.lower for j in detector.robot.joints]
    lowers[1] = near[1] + 0.5
    joints = tuple(replace(j, lower=low) for j, low in zip(detector.robot.joints, lowers, strict=True))
    tight = replace(detector.robot, joints=joints)
    other = Detector(replace(detector.arm, robot=tight), detector.cell)
    answer = other.locate(*HERE, branch="all")
    assert not any(abs(s.q[1] - near[1]) < 0.4 for s in answer.solutions)
    none = Detector(replace(detector.arm, robot=replace(tight, joints=tuple(
        replace(j, lower=j.upper - 1e-3) for j in joints))), detector.cell)  # fmt: skip
    answer = none.locate(*HERE)
    assert not answer.reachable
    assert any(f"beyond the limits of {joints[1].name}" in r or joints[1].name in r for r in answer.reasons)


@pytest.mark.slow
def test_a_singular_wrist_is_reported(detector: Detector) -> None:
    q = np.array([0.2, -1.2, 1.3, 0.4, 1e-4, 0.3])
    at = detector_angles(detector.cell.convention, detector.pose(q[None])[0])
    moved = replace(detector.cell, convention=detector.cell.convention)
    pose = detector.pose(q[None])[0]
    # A sample on the detector's normal, so that the posture's own place is a place on the sphere.
    sample = pose[:3, 3] + 0.5 * pose[:3, 2]
    other = Detector(detector.arm, replace(moved, convention=moved.convention.with_sample(sample), obstacles=()))
    at = detector_angles(other.cell.convention, pose)
    found = other.locate(at.gamma, at.delta, at.r, at.roll, near=q)
    assert found.reachable
    assert "wrist" in found.solutions[0].singular


def test_covariance_is_that_of_parameters_drawn_from_it(detector: Detector) -> None:
    arm, q = detector.arm, detector.locate(*HERE).solutions[0].q
    given = replace(detector.still, direction=np.ones(6))
    stated = detector.propagation.at(q, given, np.eye(3))
    rng = np.random.default_rng(0)
    fixed = detector.propagation.fixed
    drawn = rng.multivariate_normal(np.zeros(len(arm.theta)), arm.covariance, 3000, method="eigh") * fixed
    J, _ = detector.propagation.jacobian(q, given)
    for draw in drawn[:3]:  # linear: one small step of the model itself for each of some draws
        small = 1e-3 * draw
        moved = Detector(arm.with_theta(arm.theta + small), detector.cell).pose(q[None], given)[0]
        assert np.allclose(moved[:3, 3] - detector.pose(q[None], given)[0][:3, 3], J[:3] @ small, rtol=1e-3, atol=1e-12)
    spread = (drawn @ J.T).std(axis=0)
    assert np.allclose(spread, np.sqrt(np.diag(stated.covariance)), rtol=0.06)


def test_the_radius_of_95_percent_holds_95_percent() -> None:
    rng = np.random.default_rng(1)
    for shape in (np.eye(3), np.diag([1.0, 0.1, 0.01]), np.diag([4.0, 3.0, 0.0])):
        turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        C = np.zeros((6, 6))
        C[:3, :3] = 1e-10 * turn @ shape @ turn.T
        drawn = rng.multivariate_normal(np.zeros(3), C[:3, :3], 200_000, method="eigh")
        inside = np.mean(np.linalg.norm(drawn, axis=1) <= Uncertainty(C, 0, 55e-6).radius95_m)
        assert inside == pytest.approx(0.95, abs=0.012)
    assert Uncertainty(np.zeros((6, 6)), 0, 55e-6).radius95_m == 0


def test_an_unknown_direction_costs_and_an_approach_gains(detector: Detector) -> None:
    answer = detector.locate(*HERE)
    way = approach_through(detector, answer)
    assert set(way.direction.tolist()) <= {-1.0, 1.0}
    end = way.answer.solutions[0]
    assert np.allclose(np.sign(end.q - way.through), way.direction)
    assert ((way.through >= detector.lower) & (way.through <= detector.upper)).all()
    assert way.gain > 0
    assert end.uncertainty.approach_m == 0.0
    assert answer.solutions[0].uncertainty.approach_m > 0
    # The gain is that of where the arm would stand: half the way between coming from below and from above.
    sides = [detector.pose(end.q[None], replace(detector.still, direction=s * way.direction))[0] for s in (1.0, -1.0)]
    assert np.linalg.norm(sides[0][:3, 3] - sides[1][:3, 3]) > way.gain
    assert way.gain == pytest.approx(way.spread - end.uncertainty.std_m, rel=1e-9)
    with pytest.raises(ValueError, match="nothing to approach"):
        approach_through(detector, detector.locate(0.3, 0.2, 3.0))


def test_temperature_now_moves_the_answer(detector: Detector) -> None:
    warm = detector.at_temperature(np.full(6, 45.0))
    moved = np.abs(warm.locate(*HERE).solutions[0].q - detector.locate(*HERE).solutions[0].q).max()
    assert 1e-7 < moved < 1e-2
    assert detector.cell.link_temperature is not None
    assert detector.cell.link_temperature[0] == 28.0


def test_the_answer_carries_its_convention_and_is_json(detector: Detector) -> None:
    told = json.loads(json.dumps(detector.locate(*HERE).to_json(), allow_nan=False))
    assert told["convention"]["order"] == "gamma_outer"
    assert told["convention"]["sample_m"] == [1.4, 0.0, 0.0]
    assert told["convention"]["frame"] == "base"
    assert {"q_rad", "motor_rad", "position_error_m", "angle_error_rad", "std_m", "std_rad"} <= told["solutions"][
        0
    ].keys()


@pytest.mark.parametrize(
    ("asked", "says"),
    [((30.0, 0.2, 0.8), "degrees"), ((0.3, 0.2, 800.0), "mm"), ((float("nan"), 0.2, 0.8), "finite")],
)
def test_no_joint_angles_for_what_cannot_be_meant(detector: Detector, asked: tuple, says: str) -> None:
    with pytest.raises(TargetError, match=says):
        detector.locate(*asked)


@pytest.mark.parametrize("near", [[0.0] * 5, [float("nan")] * 6, [90.0, 0, 0, 0, 0, 0]])
def test_a_posture_that_is_none_is_refused(detector: Detector, near: list[float]) -> None:
    with pytest.raises(TargetError, match="near"):
        detector.locate(*HERE, near=near)


@pytest.mark.parametrize("wrong", [[1, 1], [np.nan] * 6, [5.0] * 6, "there"])
def test_directions_that_are_none_are_refused(detector: Detector, wrong: object) -> None:
    for ask in (detector.locate, detector.at_once):
        with pytest.raises(TargetError, match="direction: expected 6 numbers"):
            ask(*HERE, direction=wrong)


@pytest.mark.parametrize("wrong", [[300.0] * 6, [np.nan] * 6, [20.0] * 2])
def test_temperatures_that_are_none_are_refused(detector: Detector, wrong: list[float]) -> None:
    for name in ("link", "motor"):
        with pytest.raises(TargetError, match=f"{name}: expected 6 temperatures in degC"):
            detector.at_temperature(**{name: np.array(wrong)})


def test_numbers_of_numpy_are_numbers(detector: Detector) -> None:
    found = detector.locate(np.float32(0.25), 0.25, np.float32(0.75))
    assert found.solutions[0].q.tolist() == detector.locate(0.25, 0.25, 0.75).solutions[0].q.tolist()
    assert not detector.locate(np.int64(0), 0.2, np.int64(4), nearest=False).reachable


def test_a_sample_inside_the_pedestal_is_refused() -> None:
    model = drawn_model()
    cell = default_cell(load_robot(model.robot))
    with pytest.raises(CellError, match="inside the robot's base"):
        open_detector(model, replace(cell, convention=cell.convention.with_sample([0.0, 0.0, 0.1])))


def test_an_arm_on_a_rail_and_one_of_four_joints_are_refused(detector: Detector) -> None:
    joints = detector.robot.joints
    on_rail = replace(detector.robot, joints=(replace(joints[0], kind="prismatic"), *joints[1:]))
    with pytest.raises(DetectorError, match="revolute joints only"):
        Detector(replace(detector.arm, robot=on_rail), detector.cell)
    short = replace(detector.robot, joints=joints[:4], links=detector.robot.links[:4], transmission=np.eye(4),
                    linkage=np.eye(4))  # fmt: skip
    with pytest.raises(DetectorError, match="at least six joints, found 4"):
        Detector(replace(detector.arm, robot=short), detector.cell)


@pytest.mark.slow
def test_an_arm_without_a_spherical_wrist_is_served_as_well() -> None:
    model = drawn_model("ur10", ("geometry", "joint_compliance"))
    cell = default_cell(load_robot("ur10"))
    detector = open_detector(model, replace(cell, obstacles=()))
    q = np.array([0.3, -1.9, -1.2, -0.8, 1.1, 0.2])
    pose = detector.pose(q[None])[0]
    placed = replace(cell, convention=cell.convention.with_sample(pose[:3, 3] + 0.4 * pose[:3, 2]))
    there = Detector(detector.arm, placed)
    at = detector_angles(placed.convention, pose)
    answer = there.locate(at.gamma, at.delta, at.r, at.roll, near=q + 0.05)
    assert answer.reachable
    assert np.abs(there.pose(answer.solutions[0].q[None])[0] - pose).max() < 3e-9
