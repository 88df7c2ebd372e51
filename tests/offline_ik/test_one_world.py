"""Plans, `ik` and the server hold one world: what is clear for one of them is clear for the others."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import appendix_data
from clampid.planning.free_air import plan_free_air
from clampid.planning.logs import torque_noise_of
from clampid.planning.obstacle_files import read_obstacles
from clampid.planning.poses import PoseWishes, plan_poses
from clampid.planning.program import LogWishes
from clampid.planning.scene import Scene
from clampid.planning.wrist import plan_wrist
from experiments.plans import Plan, cell_of, limits_of
from experiments.plans.errors import PlanError
from experiments.plans.validate import visit_course
from kinematics.description import load_robot
from offline_ik.arm.identified import nominal_arm
from offline_ik.cell.cell import default_cell, read_cell
from offline_ik.collision.safety import check_path
from offline_ik.inverse.detector import Detector

ROBOTS = ("kuka_kr20_r1810", "abb_irb2400_12_155", "staubli_tx40")
DESCRIBED = sorted(path.stem for path in (Path(appendix_data.__file__).parent / "robots").glob("*.toml"))
CELLS = {name: cell_of(name)[0] for name in ROBOTS}
ARMS = {name: nominal_arm(load_robot(name)) for name in ROBOTS}
SIZES = {"box": 3, "sphere": 1, "cylinder": 2, "capsule": 2, "half_space": 0}


def number(low: float, high: float) -> st.SearchStrategy[float]:
    return st.floats(low, high, allow_nan=False).map(lambda x: round(x, 4))


def numbers(count: int, low: float, high: float) -> st.SearchStrategy[list[float]]:
    return st.lists(number(low, high), min_size=count, max_size=count)


@st.composite
def worlds(draw: Any) -> tuple[str, str]:
    """A robot and the text of its cell file: obstacles, links' radii, clearance and detector, or none of these."""
    robot = draw(st.sampled_from(ROBOTS))
    n, reach = CELLS[robot].robot.n, CELLS[robot].robot.reach
    text = [f'robot = "{robot}"', f"[safety]\nclearance_m = {draw(number(0.0, 0.1))}"]
    if draw(st.booleans()):
        radii = draw(numbers(n, 0.01 * reach, 0.1 * reach))
        text.append(f"[robot_shape]\nradius_m = {radii}\nbase_radius_m = {draw(number(0.02 * reach, 0.2 * reach))}")
    if draw(st.booleans()):
        ahead, size = draw(number(0.02, 0.2)), draw(numbers(3, 0.02, 0.3))
        text.append(f"[detector]\nposition_m = [0.0, 0.0, {ahead}]\nsize_m = {size}")
    for _ in range(draw(st.integers(0, 3))):
        shape = draw(st.sampled_from(sorted(SIZES)))
        text.append(f'[[obstacle]]\nshape = "{shape}"\nholds_sample = true')
        if SIZES[shape]:
            text.append(f"size_m = {draw(numbers(SIZES[shape], 0.02, 0.5))}")
            text.append(f"position_m = {draw(numbers(3, -1.2 * reach, 1.2 * reach))}")
        else:
            text.append(f"position_m = [0.0, 0.0, {draw(number(-reach, 0.3 * reach))}]")
    return robot, "\n".join(text)


def both(folder: Path, robot: str, text: str) -> tuple[Scene, Detector]:
    """The world of one file as a plan reads it and as the server does."""
    path = folder / "cell.toml"
    path.write_text(text, encoding="utf-8")
    arm = ARMS[robot]
    return Scene.of_cell_file(CELLS[robot], path), Detector(arm, read_cell(path, arm.robot))


def postures(detector: Detector, seed: int, count: int) -> np.ndarray:
    return np.random.default_rng(seed).uniform(detector.lower, detector.upper, (count, detector.robot.n))


@pytest.mark.slow
@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(world=worlds(), seed=st.integers(0, 2**32 - 1))
def test_a_posture_or_move_is_clear_for_a_plan_just_where_it_is_for_the_server(
    tmp_path: Path, world: tuple[str, str], seed: int
) -> None:
    scene, detector = both(tmp_path, *world)
    q = postures(detector, seed, 8)
    assert scene.clear(q).tolist() == [check_path(detector, posture).safe for posture in q]
    near = q + 0.2 * (postures(detector, seed + 1, 8) - q)
    for a, b in [*zip(q, near, strict=True), *pairwise(q)]:
        assert scene.way_clear(a, b) == check_path(detector, [a, b]).safe == scene.way_clear(b, a)


@pytest.mark.parametrize("robot", DESCRIBED)
def test_every_described_arm_has_postures_that_are_clear(robot: str) -> None:
    """A UR10's points lie so that its links 4 and 6 always overlap: drawn so, not built so."""
    cell, arm = cell_of(robot)[0], nominal_arm(load_robot(robot))
    detector = Detector(arm, default_cell(arm.robot))
    q = postures(detector, 7, 60)
    assert Scene.around(cell, floor=None).clear(q).any()
    assert any(check_path(detector, posture).safe for posture in q)


BOTH_VERDICTS = """
robot = "kuka_kr20_r1810"
[convention]
sample_m = [1.4, 0.0, 0.6]
[detector]
position_m = [0.0, 0.0, 0.12]
size_m = [0.2, 0.2, 0.1]
[[obstacle]]
name = "floor"
shape = "half_space"
[[obstacle]]
name = "post"
shape = "cylinder"
size_m = [0.1, 2.0]
position_m = [1.0, 0.5, 1.0]
[[obstacle]]
name = "ball"
shape = "sphere"
size_m = [0.2]
position_m = [0.3, -0.9, 1.0]
holds_sample = true
"""


def test_the_worlds_that_are_compared_refuse_some_moves_and_not_others(tmp_path: Path) -> None:
    scene, detector = both(tmp_path, "kuka_kr20_r1810", BOTH_VERDICTS)
    q = postures(detector, 5, 100)
    assert 0.2 < scene.clear(q).mean() < 0.8
    touched = scene.world.distances(q).min(axis=0) < detector.cell.clearance
    bodies = {shape.name for pair, met in zip(scene.world.pairs, touched, strict=True) if met for shape in pair}
    assert bodies >= {"floor", "post", "ball", "detector", "base", "link 4"}


def test_every_move_of_a_plan_of_poses_is_one_that_the_server_makes(tmp_path: Path) -> None:
    scene, detector = both(tmp_path, "kuka_kr20_r1810", BOTH_VERDICTS)
    cell = CELLS["kuka_kr20_r1810"]
    plan = plan_poses(cell, limits_of(cell.robot)[0], PoseWishes(poses=15, replicates=2, verification=4), scene=scene)
    before = None
    for visit in plan.visits:
        report = check_path(detector, visit_course(visit, before).knots)
        assert report.safe, report.reasons
        before = visit.q


@pytest.mark.slow
@pytest.mark.parametrize(("make", "seconds"), [(plan_free_air, 60.0), (plan_wrist, 300.0)])
def test_every_move_of_a_log_is_one_that_the_server_makes(
    tmp_path: Path, make: Callable[..., Plan], seconds: float
) -> None:
    scene, detector = both(tmp_path, "kuka_kr20_r1810", BOTH_VERDICTS)
    cell = CELLS["kuka_kr20_r1810"]
    noise = torque_noise_of(cell, None, None)[0]
    plan = make(cell, limits_of(cell.robot)[0], noise, LogWishes(time=seconds), scene=scene)
    assert plan.runs
    for run in plan.runs:
        report = check_path(detector, run.course.knots)
        assert report.safe, report.reasons


def test_a_link_that_the_cell_file_makes_thicker_is_thicker_for_a_plan(tmp_path: Path) -> None:
    thin, _ = both(tmp_path, "kuka_kr20_r1810", BOTH_VERDICTS)
    shape = "[robot_shape]\nradius_m = [0.3, 0.3, 0.3, 0.3, 0.1, 0.1]\n[[obstacle]]\nname"
    thick, detector = both(tmp_path, "kuka_kr20_r1810", BOTH_VERDICTS.replace("[[obstacle]]\nname", shape, 1))
    q = postures(detector, 6, 100)
    assert thick.clear(q).sum() < thin.clear(q).sum()


def test_a_floor_is_the_same_from_an_option_and_from_a_cell_file(tmp_path: Path) -> None:
    cell = CELLS["kuka_kr20_r1810"]
    path = tmp_path / "cell.toml"
    path.write_text('robot = "kuka_kr20_r1810"\n', encoding="utf-8")
    bare = Scene.of_cell_file(cell, path)
    assert any("no floor" in said for said in bare.assumed)
    path.write_text(
        'robot = "kuka_kr20_r1810"\n[[obstacle]]\nshape = "half_space"\nposition_m = [0, 0, -0.4]\n', encoding="utf-8"
    )
    stated, given_ = Scene.of_cell_file(cell, path), Scene.of_cell_file(cell, path, floor=0.1)
    q = np.random.default_rng(2).uniform(cell.robot.lower, cell.robot.upper, (200, 6))
    assert bare.clear(q).sum() > stated.clear(q).sum() > given_.clear(q).sum()


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ('robot = "ur10"', "key robot: expected 'kuka_kr20_r1810', which the plan is of, found 'ur10'"),
        ('robot = "kuka_kr20_r1810"\n[[obstacle]]\nshape = "ball"', "obstacle[1].shape: expected one of box"),
        ('robot = "kuka_kr20_r1810"\n[robot_shape]\nradius = 0.1', "robot_shape.radius: expected one of"),
        ("robot = ", "expected a cell as TOML"),
    ],
)
def test_a_wrong_cell_file_is_refused_by_a_plan_in_one_line(tmp_path: Path, text: str, says: str) -> None:
    path = tmp_path / "cell.toml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(PlanError) as caught:
        Scene.of_cell_file(CELLS["kuka_kr20_r1810"], path)
    assert says in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_file_of_obstacles_says_the_same_bodies_as_a_cell_file(tmp_path: Path) -> None:
    cell, obstacles = CELLS["kuka_kr20_r1810"], tmp_path / "obstacles.toml"
    obstacles.write_text("[[cylinder]]\ncentre_m = [1.0, 0.5, 1.0]\nradius_m = 0.1\nlength_m = 2.0\n", encoding="utf-8")
    path = tmp_path / "cell.toml"
    stated = 'shape = "cylinder"\nsize_m = [0.1, 2.0]\nposition_m = [1.0, 0.5, 1.0]\n'
    path.write_text(f'robot = "kuka_kr20_r1810"\n[[obstacle]]\n{stated}', encoding="utf-8")
    with_cell = Scene.of_cell_file(cell, path)
    path.write_text('robot = "kuka_kr20_r1810"\n', encoding="utf-8")
    beside = Scene.of_cell_file(cell, path, read_obstacles(obstacles))
    q = np.random.default_rng(3).uniform(cell.robot.lower, cell.robot.upper, (200, 6))
    clear = with_cell.clear(q)
    assert clear.tolist() == beside.clear(q).tolist()
    assert 0 < clear.sum() < len(q)
