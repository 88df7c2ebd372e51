"""All eight analytic branches: FK∘IK = 1, singularities, borders, and two independent solvers."""

from __future__ import annotations

import numpy as np
import pytest
from ik_arms import postures
from scipy.spatial.transform import RigidTransform

from kinematics.description import load_robot, robot_names
from kinematics.poe import forward
from kinematics.robot import RobotDescription
from offline_ik.arm.identified import nominal_arm
from offline_ik.inverse.ortho import SIGNS, ortho_arm, signs_of
from offline_ik.inverse.solver import Solver

ORTHO = [name for name in robot_names() if ortho_arm(load_robot(name)) is not None]


def turned(a: np.ndarray) -> np.ndarray:
    return np.abs((a + np.pi) % (2 * np.pi) - np.pi)


def solved(name: str, q: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, Solver]:
    solver = Solver(nominal_arm(load_robot(name)), np.eye(4))
    robot = solver.arm.robot
    T = forward(robot.screws, robot.flange, q @ solver.linkage.T)
    found, quality = solver.branches(T)
    return T, found, quality, solver


def test_which_arms_are_ortho_parallel() -> None:
    assert "ur10" not in ORTHO  # no spherical wrist
    assert {"kuka_kr20_r1810", "abb_irb4600_40_255", "staubli_tx40"} <= set(ORTHO)


@pytest.mark.parametrize("name", ORTHO)
def test_every_branch_leads_back_to_the_pose_and_one_is_where_it_came_from(name: str) -> None:
    q = np.random.default_rng(0).uniform(-np.pi, np.pi, (20_000, 6))
    T, found, quality, solver = solved(name, q)
    closes = (quality[..., :2] <= 0).all(axis=2)
    robot = solver.arm.robot
    back = forward(robot.screws, robot.flange, found @ solver.linkage.T)
    assert np.abs(back - T[:, None]).max(axis=(2, 3))[closes].max() < 1e-9
    chain, asked = found @ solver.linkage.T, q @ solver.linkage.T
    assert (turned(chain - asked[:, None]).max(axis=2).min(axis=1) < 1e-6).all()
    assert (
        signs_of(solver.ortho, chain)[closes] == np.broadcast_to(SIGNS, (*chain.shape[:2], 3))[closes]
    ).mean() > 0.9999


@pytest.mark.parametrize("size", [1e-3, 1e-6, 1e-9, 0.0])
def test_singular_wrist_and_stretched_elbow(size: float) -> None:
    rng = np.random.default_rng(1)
    q = rng.uniform(-1.5, 1.5, (400, 6))
    arm = ortho_arm(load_robot("kuka_kr20_r1810"))
    q[:200, 4] = size * rng.normal(size=200)
    q[200:, 2] = arm.stretched + size * rng.normal(size=200)
    T, found, quality, solver = solved("kuka_kr20_r1810", q)
    closes = (quality[..., :2] <= 1e-9).all(axis=2)
    robot = solver.arm.robot
    back = forward(robot.screws, robot.flange, found)
    assert closes.any(axis=1).all()
    assert np.abs(back - T[:, None]).max(axis=(2, 3))[closes].max() < 1e-9
    assert (quality[:200, :, 2].min(axis=1) < 3 * size * 4 + 1e-9).all()  # and it is said that the wrist is singular


def test_beyond_the_border_it_says_by_how_much() -> None:
    solver = Solver(nominal_arm(load_robot("kuka_kr20_r1810")), np.eye(4))
    pose = np.eye(4)
    pose[:3, :3] = np.diag([1.0, -1.0, -1.0])
    pose[:3, 3] = [0.160, 0.0, 0.520 - 0.153]  # the wrist at the shoulder's point: both arms folded cannot reach it
    pose[2, 3] += 0.780 + np.hypot(0.860, 0.150) + 0.1
    _, quality = solver.branches(pose[None])
    assert quality[0, :, 1].min() == pytest.approx(0.1, abs=1e-9)


def same_sets(ours: np.ndarray, theirs: np.ndarray) -> bool:
    """Whether two sets of postures ``(8, 6)`` are one, whatever their order and turns."""
    apart = turned(ours[:, None] - theirs[None]).max(axis=2)
    return bool((apart.min(axis=0) < 1e-7).all() and (apart.min(axis=1) < 1e-7).all())


@pytest.mark.parametrize("name", ORTHO)
def test_the_branches_are_those_of_eaik(name: str) -> None:
    eaik = pytest.importorskip("eaik.IK_HP", reason="EAIK is not installed (pip install EAIK)")
    robot = load_robot(name)
    points = np.array([np.zeros(3), *(j.point for j in robot.joints), robot.flange[:3, 3]])
    theirs = eaik.HPRobot(np.array([j.axis for j in robot.joints]), np.diff(points, axis=0))
    q = postures(nominal_arm(robot), 300)
    T, found, quality, solver = solved(name, q)
    checked = 0
    for pose, ours, lacks in zip(T, found @ solver.linkage.T, quality, strict=True):
        if (lacks[:, :2] > -1e-3).any() or (lacks[:, 2] < 1e-3).any():
            continue  # near a border the two need not agree on what closes
        pose = pose.copy()  # noqa: PLW2901
        pose[:3, :3] = pose[:3, :3] @ robot.flange[:3, :3].T
        assert same_sets(ours, np.array(theirs.IK(pose).Q))
        checked += 1
    assert checked > 30


def of_opw(robot: RobotDescription) -> tuple[dict[str, object], np.ndarray]:
    """Parameters of their model, read off the points and axes of ours, and where in it our zero pose is."""
    points = np.array([*(j.point for j in robot.joints[:5]), robot.flange[:3, 3]])
    axes = np.array([j.axis for j in robot.joints])
    upper, fore, hand = points[2] - points[1], points[4] - points[2], points[5] - points[4]
    q2 = np.arctan2(upper[0], upper[2])  # how far the arm leans forward at our zero pose; upright in theirs
    q3 = np.arctan2(hand[0], hand[2]) - q2
    along = np.array([np.sin(q2 + q3), 0.0, np.cos(q2 + q3)])
    across = np.array([along[2], 0.0, -along[0]])
    their_axes = np.array([[0, 0, 1], [0, 1, 0], [0, 1, 0], along, [0, 1, 0], along])
    model = {
        "a1": points[1][0], "a2": fore @ across, "b": points[4][1], "c1": points[1][2],
        "c2": float(np.hypot(upper[0], upper[2])), "c3": fore @ along,
        "c4": float(np.linalg.norm(hand)), "offsets": (0.0,) * 6,
        "flip_axes": tuple(bool(a @ b < 0) for a, b in zip(axes, their_axes, strict=True)),
    }  # fmt: skip
    return model, np.array([0.0, q2, q3, 0.0, 0.0, 0.0])


@pytest.mark.parametrize("name", ORTHO)
def test_the_branches_are_those_of_opw_kinematics(name: str) -> None:
    opw = pytest.importorskip("py_opw_kinematics", reason="py-opw-kinematics is not installed")
    robot = load_robot(name)
    parameters, at_zero = of_opw(robot)
    theirs = opw.Robot(opw.KinematicModel(**parameters), degrees=False)
    T, found, quality, solver = solved(name, postures(nominal_arm(robot), 300))
    tool = np.linalg.inv(theirs.forward(tuple(at_zero)).as_matrix()) @ robot.flange
    checked = 0
    for pose, ours, lacks in zip(T, found @ solver.linkage.T, quality, strict=True):
        if (lacks[:, :2] > -1e-3).any() or (lacks[:, 2] < 1e-3).any():
            continue  # near a border the two need not agree on what closes
        answers = np.array(theirs.inverse(RigidTransform.from_matrix(pose @ np.linalg.inv(tool))))
        assert same_sets(ours, answers - at_zero)
        checked += 1
    assert checked > 30
