"""Moves are checked along their whole length: limits, speeds, the arm with itself and with what stands around."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from ik_arms import drawn_arm

from kinematics.collision.moves import LongCheckError
from kinematics.collision.obstacles import Obstacle
from kinematics.description import load_robot
from offline_ik.arm.identified import nominal_arm
from offline_ik.cell.cell import Cell, default_cell
from offline_ik.collision.safety import check_path, move_time
from offline_ik.collision.world import world_of
from offline_ik.errors import CellError
from offline_ik.inverse.detector import Detector

START = np.array([-0.8, -1.2, 1.3, 0.0, 0.5, 0.0])
END = np.array([0.8, -1.2, 1.3, 0.0, 0.5, 0.0])


def placed(*obstacles: Obstacle, **changes: object) -> Detector:
    arm = drawn_arm(effects=("geometry",))
    cell: Cell = replace(default_cell(arm.robot), obstacles=obstacles, size=(0.2, 0.2, 0.1), **changes)  # type: ignore[arg-type]
    return Detector(arm, cell)


def holding(size: tuple[float, float, float], ahead: float, **changes: object) -> Detector:
    """A detector with its plane ``ahead`` of the flange, m."""
    cell = replace(placed().cell, mount=at(np.array([0.0, 0.0, ahead])), size=size, **changes)  # type: ignore[arg-type]
    return Detector(placed().arm, cell)


def at(point: np.ndarray) -> np.ndarray:
    out = np.eye(4)
    out[:3, 3] = point
    return out


def in_the_way(detector: Detector, share: float = 0.5) -> np.ndarray:
    """Where the flange is on the way from START to END."""
    return detector.pose((START + share * (END - START))[None])[0][:3, 3]


def test_an_empty_cell_lets_a_usual_move_pass() -> None:
    report = check_path(placed(), [START, END])
    assert report.safe, report.reasons
    assert report.clearance > 0.02
    assert report.base_distance > 0


@pytest.mark.parametrize("size", [0.05, 0.005, 0.0005])
def test_a_thin_post_in_the_middle_is_found_though_both_ends_are_free(size: float) -> None:
    free = placed()
    post = Obstacle("post", "cylinder", (size, 0.6), at(in_the_way(free, 0.4531)))
    detector = placed(post, clearance=0.0)
    assert check_path(detector, START).safe
    assert check_path(detector, END).safe
    report = check_path(detector, [START, END])
    assert not report.safe
    assert "post" in report.between
    assert any("post" in reason for reason in report.reasons)
    assert 0 < report.at < 1


def test_what_is_checked_between_samples_is_what_fine_sampling_finds() -> None:
    """On random moves past a ball the verdict is that of two thousand places on the way."""
    rng = np.random.default_rng(3)
    free = placed()
    ball = Obstacle("ball", "sphere", (0.15,), at(in_the_way(free)))
    detector = placed(ball, clearance=0.0)
    world, verdicts = world_of(detector), []
    for _ in range(12):
        start, end = START + rng.normal(size=6) * 0.5, END + rng.normal(size=6) * 0.5
        start, end = (np.clip(q, detector.lower, detector.upper) for q in (start, end))
        least = world.distances(start + np.linspace(0, 1, 400)[:, None] * (end - start)).min()
        safe = check_path(detector, [start, end]).safe
        assert safe <= (least > 0)
        if least > 5e-3:
            assert safe
        verdicts.append(safe)
    assert len(set(verdicts)) == 2


def test_spheres_around_the_bodies_bound_their_distances_from_below(tmp_path: Path) -> None:
    mesh = tmp_path / "tetra.obj"
    mesh.write_text("v 1 0 0\nv 1.1 0 0\nv 1 0.1 0\nv 1 0 0.1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n", encoding="utf-8")
    where = at(in_the_way(placed()))
    things = [
        Obstacle("box", "box", (0.1, 0.2, 0.3), where),
        Obstacle("capsule", "capsule", (0.05, 0.4), where),
        Obstacle("cylinder", "cylinder", (0.3, 0.05), where),
        Obstacle("tetra", "mesh", (), where, mesh),
    ]
    detector = placed(*things)
    world, rng = world_of(detector), np.random.default_rng(8)
    q = rng.uniform(detector.lower, detector.upper, (40, 6))
    exact, bounds = world.distances(q), world.at(q).bounds()
    assert (bounds <= exact + 1e-9).all()
    assert (bounds > 0.5 * exact).any(axis=1).all()


def test_the_least_distance_is_that_of_the_pair_it_names() -> None:
    detector = placed(Obstacle("ball", "sphere", (0.1,), at(in_the_way(placed()) + np.array([0.0, 0.0, 0.5]))))
    world, rng, looked_at = world_of(detector), np.random.default_rng(5), 0
    forearm = [k for k, (a, b) in enumerate(world.pairs) if a.kind == "base" and b.link in (4, 5)]
    for _ in range(12):
        q = np.array([START, END]) + rng.normal(size=(2, 6)) * 0.3
        report = check_path(detector, np.clip(q, detector.lower, detector.upper))
        if not report.safe:
            continue
        start, end = np.clip(q, detector.lower, detector.upper)
        there = world.distances((start + report.at * (end - start))[None])[0]
        pair = [k for k, (a, b) in enumerate(world.pairs) if (a.name, b.name) == report.between]
        assert min(there[pair]) == pytest.approx(report.clearance, abs=1e-9)
        dense = world.distances(start + np.linspace(0, 1, 301)[:, None] * (end - start))
        assert dense.min() > detector.cell.clearance
        for seen, every in ((report.clearance, dense), (report.base_distance, dense[:, forearm])):
            assert every.min() - 1e-3 <= seen <= every[150].min() + 1e-9
        looked_at += 1
    assert looked_at > 3


def test_each_shape_stands_in_the_way() -> None:
    where = at(in_the_way(placed()))
    shapes = [("box", (0.1, 0.1, 0.1)), ("sphere", (0.05,)), ("capsule", (0.05, 0.1)), ("cylinder", (0.05, 0.1))]
    for shape, size in shapes:
        assert not check_path(placed(Obstacle("thing", shape, size, where)), [START, END]).safe


def test_a_mesh_stands_in_the_way_and_a_file_that_is_none_is_refused(tmp_path: Path) -> None:
    mesh = tmp_path / "tetra.obj"
    mesh.write_text("v 0 0 0\nv 0.1 0 0\nv 0 0.1 0\nv 0 0 0.1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n", encoding="utf-8")
    where = at(in_the_way(placed()))
    assert not check_path(placed(Obstacle("tetra", "mesh", (), where, mesh)), [START, END]).safe
    mesh.write_text("this is no mesh", encoding="utf-8")
    with pytest.raises(CellError, match="tetra"):
        placed(Obstacle("tetra", "mesh", (), where, mesh))


def test_the_arm_does_not_fold_into_itself() -> None:
    detector = placed()
    folded = np.array([0.0, -1.2, 2.9, 0.0, 1.5, 0.0])
    report = check_path(detector, [START, folded])
    assert not report.safe
    assert all(name.startswith(("link", "base", "detector")) for name in report.between)


@pytest.mark.parametrize(
    ("size", "radius", "bent", "safe"),
    [
        (0.2, None, 1.5, True),
        (0.2, None, 2.2, False),  # the capsule of the forearm by 9 mm
        (0.5, None, 1.5, True),
        (0.5, 0.01, 2.2, False),  # a forearm of 1 cm, too
        (0.2, 0.01, 2.2, True),
    ],
)
def test_the_wrist_does_not_fold_the_detector_into_the_forearm(
    size: float, radius: float | None, bent: float, safe: bool
) -> None:
    thin = {} if radius is None else {"radius": np.array([0.1, 0.1, 0.1, radius, 0.01, 0.01])}
    detector = holding((size, size, 0.1), 0.12, **thin)
    straight = np.array([0.0, -1.2, 1.2, 0.0, 0.0, 0.0])
    report = check_path(detector, [straight, straight + np.array([0, 0, 0, 0, bent, 0])])
    assert report.safe is safe, report.reasons
    assert safe or report.between == ("link 4", "detector")


@pytest.mark.parametrize("name", ["abb_irb1200_5_09", "kuka_kr16_2", "kuka_kr20_r1810", "staubli_tx40"])
def test_a_detector_close_to_the_wrist_is_kept_off_the_forearm_only_where_the_wrist_bends(name: str) -> None:
    robot = load_robot(name)
    reach = float(np.linalg.norm(robot.flange[:3, 3] - np.asarray(robot.joints[5].point)))
    cell = replace(default_cell(robot), size=(6 * reach, 6 * reach, 0.9 * reach))
    detector = Detector(nominal_arm(robot), cell)
    straight = np.zeros(6)  # of every description here
    assert check_path(detector, straight).safe
    bent = straight + np.array([0.0, 0.0, 0.0, 0.0, 0.9 * detector.upper[4], 0.0])
    assert "detector" in check_path(detector, bent).between
    assert not check_path(detector, bent).safe


def test_a_wall_beside_the_first_link_is_checked_and_what_the_robot_stands_on_is_not() -> None:
    upright = np.array([0.0, -np.pi / 2, 0.3, 0.0, 0.5, 0.0])
    turned = upright + np.array([-np.pi / 2, 0, 0, 0, 0, 0])  # axis 1 points down: the shoulder goes to +y
    pedestal = Obstacle("pedestal", "box", (0.6, 0.6, 0.5), at(np.array([0.0, 0.0, -0.25])))
    assert check_path(placed(pedestal), [upright, turned]).safe
    wall = Obstacle("wall", "box", (1.0, 0.02, 0.3), at(np.array([0.0, 0.28, 0.25])))
    assert check_path(placed(pedestal, wall), upright).safe
    report = check_path(placed(pedestal, wall), [upright, turned])
    assert not report.safe
    assert report.between == ("wall", "link 1")


def test_a_limit_and_a_number_that_is_none_are_named() -> None:
    detector = placed()
    beyond = END.copy()
    beyond[4] = 2.6
    assert any("130" in r for r in check_path(detector, [START, beyond]).reasons)
    beyond[4] = np.nan
    assert any("not a finite angle" in r for r in check_path(detector, [START, beyond]).reasons)


def test_the_time_is_that_of_the_slowest_joint() -> None:
    detector = placed(speed=0.5)
    fastest = detector.robot.joints[0].max_speed
    assert fastest is not None
    assert move_time(detector, np.array([START, END])) == pytest.approx(1.6 / (0.5 * fastest))
    assert move_time(detector, np.array([START, END, START])) == pytest.approx(3.2 / (0.5 * fastest))


def test_a_sample_in_an_obstacle_is_refused_unless_it_may_be_there() -> None:
    sample = np.array(default_cell(drawn_arm(effects=("geometry",)).robot).convention.sample)
    stage = Obstacle("stage", "box", (0.3, 0.3, 0.3), at(sample))
    with pytest.raises(CellError, match="inside stage"):
        placed(stage)
    assert placed(replace(stage, holds_sample=True)).cell.obstacles[0].holds_sample


def about(sample: tuple[float, float, float], *obstacles: Obstacle, **changes: object) -> Detector:
    cell = placed(*obstacles, **changes).cell
    return Detector(placed().arm, replace(cell, convention=cell.convention.with_sample(sample)))


@pytest.mark.parametrize("height", [0.45, 0.0, -0.3, -5.0])
def test_a_sample_in_the_robots_column_is_refused(height: float) -> None:
    with pytest.raises(CellError, match="the robot's base"):
        about((0.05, 0.0, height))


def test_a_sample_under_the_base_is_one_where_the_cell_says_what_is_there() -> None:
    plate = Obstacle("plate", "box", (0.6, 0.6, 0.1), at(np.array([0.0, 0.0, -0.05])))
    under = (0.05, 0.0, -0.3)
    assert about(under, plate).cell.convention.sample == under
    with pytest.raises(CellError, match="inside plate"):
        about((0.05, 0.0, -0.05), plate)
    with pytest.raises(CellError, match="the robot's base"):
        about((0.05, 0.0, 0.1), plate)


def test_under_a_hung_robot_there_is_no_pedestal() -> None:
    under = (0.05, 0.0, -0.3)
    assert about(under, gravity=(0.0, 0.0, 9.81)).cell.convention.sample == under
    with pytest.raises(CellError, match="the robot's base"):
        about((0.05, 0.0, 0.45), gravity=(0.0, 0.0, 9.81))


def test_a_check_that_may_look_at_few_places_says_that_they_do_not_decide() -> None:
    detector = placed(Obstacle("post", "cylinder", (0.05, 0.6), at(in_the_way(placed()) + np.array([0.0, 0.0, 0.5]))))
    with pytest.raises(LongCheckError):
        check_path(detector, [START, END], 4)
    assert check_path(detector, [START, END], 1000) == check_path(detector, [START, END])
