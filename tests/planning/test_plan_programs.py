"""Cycles of ISO 9283, lines, fixed points and warm-ups: places, directions, times, and what is refused."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from clampid.planning.returns import Cube, ReturnWishes, line_deviation, plan_cube, plan_fixed, plan_line
from clampid.planning.scene import Scene
from clampid.planning.visiting import Approach
from clampid.planning.warm_up import WarmUp, plan_warm_up
from experiments.plans import Cell, Limits, Plan, PlanError, Visit, read_plan, write_plan
from experiments.plans.model import Steady
from experiments.plans.runner import run_plan
from experiments.plans.virtual import VirtualRobot
from kinematics.collision.obstacles import Obstacle
from kinematics.poe import forward

DOWN = np.array([0.0, 0.0, -1.0])
CENTRE = np.array([1.1, 0.0, 1.0])
ENDS = np.array([[0.9, -0.3, 1.0], [0.9, 0.3, 1.0]])
HOME = np.array([0.0, -1.3, 1.5, 0.3, 0.8, 0.0])


@pytest.fixture(scope="module")
def scene(cell: Cell) -> Scene:
    return Scene.floor_only(cell)


def wanted(**more: object) -> ReturnWishes:
    return replace(ReturnWishes(DOWN, ("T1",), True), **more)  # type: ignore[arg-type]


def places(plan: Plan) -> dict[int, np.ndarray]:
    """Where T1 is at each pose, by forward kinematics; the flange must look down there."""
    robot, found = plan.cell.robot, {}
    for visit in plan.visits:
        T = np.asarray(forward(robot.screws, robot.flange, np.asarray(robot.linkage) @ visit.q))
        np.testing.assert_allclose(T[:3, 2], DOWN, atol=1e-5)
        found[visit.pose] = T[:3, :3] @ plan.cell.targets["T1"] + T[:3, 3]
    return found


def test_five_poses_of_the_cube(cell: Cell, limits: Limits, scene: Scene) -> None:
    plan = plan_cube(cell, limits, scene, wanted(), Cube(CENTRE, 0.4), cycles=3)
    assert [(v.pose, v.visit) for v in plan.visits] == [(p, c) for c in (1, 2, 3) for p in (1, 5, 4, 3, 2)]
    # Plane C1-C2-C7-C8: x and y as in the cube, z falls with y; corners at 0.8 of half an edge.
    expected = {1: (0, 0, 0), 2: (-1, -1, 1), 3: (1, -1, 1), 4: (1, 1, -1), 5: (-1, 1, -1)}
    for pose, place in places(plan).items():
        np.testing.assert_allclose(place, CENTRE + 0.16 * np.array(expected[pose]), atol=5e-6)


def test_every_cycle_comes_from_the_same_side(cell: Cell, limits: Limits, scene: Scene) -> None:
    plan = plan_cube(cell, limits, scene, wanted(), Cube(CENTRE, 0.4), cycles=4)
    for pose in range(1, 6):
        directions = np.array([v.direction for v in plan.visits if v.pose == pose])
        assert np.all(directions == directions[0])
        assert np.all(directions != 0)
    both = plan_cube(cell, limits, scene, wanted(one_side=False), Cube(CENTRE, 0.4), cycles=4)
    for pose in range(1, 6):
        directions = np.array([v.direction for v in both.visits if v.pose == pose])
        assert np.array_equal(directions[0::2], -directions[1::2])


def test_a_line_out_and_back(cell: Cell, limits: Limits, scene: Scene) -> None:
    plan = plan_line(cell, limits, scene, wanted(one_side=False), ENDS, stops=7, repetitions=2)
    once = [*range(1, 8), *range(7, 0, -1)]
    assert [v.pose for v in plan.visits] == once * 2
    found = places(plan)
    for k in range(7):
        np.testing.assert_allclose(found[k + 1], ENDS[0] + k / 6 * (ENDS[1] - ENDS[0]), atol=5e-6)
    for visit in plan.visits:  # odd visits are on the way out, along it
        out = next(v for v in plan.visits if v.pose == visit.pose and v.visit == 1)
        assert np.array_equal(visit.direction, out.direction * (1 if visit.visit % 2 else -1))
    travel = plan.visits[3].q - plan.visits[2].q
    assert np.all(plan.visits[3].direction[np.abs(travel) > 1e-4] == np.sign(travel)[np.abs(travel) > 1e-4])
    fine = plan_line(cell, limits, scene, wanted(), ENDS, stops=24, repetitions=1)
    coarse, travelled = line_deviation(plan, "T1")
    assert line_deviation(fine, "T1")[0] < coarse / 8  # the sagitta falls with the square of the distance
    assert travelled == pytest.approx(farthest_off(plan), abs=1e-5)  # as near as the stops are on the line


def farthest_off(plan: Plan) -> float:
    """How far T1 is off the line at the corners of its way and half way between them, visit by visit."""
    corners = [q for visit in plan.visits for q in (visit.via, visit.q)][1:]
    ways = [a + share * (b - a) for a, b in pairwise(corners) for share in np.linspace(0, 1, 9)]
    robot = plan.cell.robot
    T = forward(robot.screws, robot.flange, np.array(ways) @ np.asarray(robot.linkage).T)
    p = T[:, :3, :3] @ plan.cell.targets["T1"] + T[:, :3, 3] - ENDS[0]
    along = (ENDS[1] - ENDS[0]) / np.linalg.norm(ENDS[1] - ENDS[0])
    return float(np.linalg.norm(np.cross(p, along), axis=1).max())


def test_from_one_side_on_the_way_back_too(cell: Cell, limits: Limits, scene: Scene) -> None:
    plan = plan_line(cell, limits, scene, wanted(), ENDS, stops=5, repetitions=2)
    for pose in range(1, 6):
        directions = np.array([v.direction for v in plan.visits if v.pose == pose])
        assert np.all(directions == directions[0])


def test_a_slow_last_move_is_said_where_a_controller_cannot(cell: Cell, limits: Limits, scene: Scene) -> None:
    slow = Approach(np.radians(0.15), 1.0, 0.5)
    plan = plan_line(cell, limits, scene, wanted(approach=slow), ENDS, stops=5, repetitions=1)
    for visit in plan.visits:
        assert visit.duration[1] == pytest.approx(1.0)
        np.testing.assert_allclose(np.abs(visit.q - visit.via), np.radians(0.15), atol=1e-6)
    assert any("whole per cents" in sentence for sentence in plan.assumed)
    fast = plan_line(cell, limits, scene, wanted(), ENDS, stops=5, repetitions=1)
    assert not any("whole per cents" in sentence for sentence in fast.assumed)


def test_a_fixed_point_is_measured_without_motion(cell: Cell, limits: Limits, scene: Scene) -> None:
    plan = plan_fixed(cell, limits, scene, wanted(), HOME, readings=4, pause=20.0)
    assert [(v.pose, v.visit) for v in plan.visits] == [(1, 1), (1, 2), (1, 3), (1, 4)]
    assert all(np.array_equal(v.via, HOME) and v.wait == 20.0 for v in plan.visits[1:])
    assert plan.duration == pytest.approx(60.0 + 4 * 3.0, abs=2.0)


def test_a_warm_up_swings_what_it_should_for_as_long_as_it_should(cell: Cell, limits: Limits, scene: Scene) -> None:
    warm = WarmUp((0, 2), swing=0.3, hours=1.0, every=300.0)
    plan = plan_warm_up(cell, limits, scene, wanted(approach=Approach(share=0.5)), warm, HOME)
    assert plan.duration == pytest.approx(3600.0, rel=0.03)
    swings = [v for v in plan.visits if v.times > 1]
    assert len(swings) == 12
    for visit in swings:
        np.testing.assert_allclose(visit.q - visit.via, np.array([0.6, 0, 0.6, 0, 0, 0]), atol=1e-9)
        assert visit.targets == ()
        peak = np.abs(visit.q - visit.via) / (visit.duration[1] - visit.ramp[1])
        assert np.max(peak / limits.speed) <= 0.5 + 1e-9
    measured = [v for v in plan.visits if v.targets]
    assert len(measured) == 13
    assert all(np.array_equal(v.q, HOME) and np.array_equal(v.direction, np.ones(6)) for v in measured)


def test_one_joint_after_the_other_interruptions_and_cooling(cell: Cell, limits: Limits, scene: Scene) -> None:
    warm = WarmUp((0, 1), False, 0.3, 0.5, every=300.0, interrupt=(900.0, 600.0), cool=0.5)
    plan = plan_warm_up(cell, limits, scene, wanted(), warm, HOME)
    moved = [tuple(np.flatnonzero(v.q != v.via)) for v in plan.visits if v.times > 1]
    assert moved == [(0,)] * 6 + [(1,)] * 6
    rests = [v.wait for v in plan.visits if v.wait]
    assert rests == [600.0, 600.0] + [297.0] * 6
    assert plan.duration == pytest.approx(2 * 1800.0 + 1200.0 + 1800.0, rel=0.03)
    counted = plan_warm_up(cell, limits, scene, wanted(), WarmUp((0,), repetitions=5), HOME)
    assert sum(v.times > 1 for v in counted.visits) == 5


def test_swings_rests_and_warmth_read_back(cell: Cell, limits: Limits, scene: Scene, tmp_path: Path) -> None:
    warm = WarmUp((0,), swing=0.3, hours=0.2, interrupt=(300.0, 60.0), steady=Steady(0.5, 3600.0))
    plan = plan_warm_up(cell, limits, scene, wanted(), warm, HOME)
    file = write_plan(plan, tmp_path / "plan.toml")
    back = read_plan(file)
    assert [(v.times, v.wait, v.targets) for v in back.visits] == [(v.times, v.wait, v.targets) for v in plan.visits]
    assert back.steady == Steady(0.5, 3600.0)
    text = file.read_text()
    times = next(v.times for v in plan.visits if v.times > 1)
    for old, new, said in (
        (f"times = {times}", "times = 0", "times: expected an integer from 1"),
        (f"times = {times}", "times = 2.5", "times: expected an integer from 1"),
        ("wait_s = 60.0", "wait_s = -1", "wait_s: expected a finite number of s from 0"),
        ("steady_K_h = 0.5", "steady_K_h = 0", "steady_K_h: expected a finite number above 0"),
        ("steady_for_s = 3600.0", "", "steady_for_s"),
        ("targets = []", 'targets = ["T1"]', "expected no targets of"),
    ):
        assert old in text
        file.write_text(text.replace(old, new))
        with pytest.raises(PlanError, match=said):
            read_plan(file)


def test_the_runner_in_one_process_refuses_what_it_cannot(
    cell: Cell, limits: Limits, scene: Scene, tmp_path: Path
) -> None:
    plan = plan_warm_up(cell, limits, scene, wanted(), WarmUp((0,), swing=0.3, hours=0.2), HOME)
    with pytest.raises(PlanError, match="clampid run"):
        run_plan(plan, VirtualRobot(cell.robot, (), seed=1), tmp_path / "C")


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda c, k, s: plan_cube(c, k, s, wanted(), Cube(CENTRE, 3.0)), "place 2 at -0.1, -1.2, 2.2 m out of reach"),
        (lambda c, k, s: plan_cube(c, k, s, wanted(), Cube(np.full(3, 9.0), 0.4)), "place 1 at 9, 9, 9 m out of reach"),
        (lambda c, k, s: plan_cube(c, k, s, wanted(), Cube(CENTRE, -0.4)), "an edge above 0 m"),
        (lambda c, k, s: plan_cube(c, k, s, wanted(), Cube(CENTRE, 0.4, "e")), "plane: expected one of a, b, c, d"),
        (lambda c, k, s: plan_cube(c, k, s, wanted(), Cube(CENTRE, 0.4), cycles=0), "cycles: expected 1 or more"),
        (lambda c, k, s: plan_cube(c, k, s, wanted(targets=("T9",)), Cube(CENTRE, 0.4)), "expected some of T1, T2, T3"),
        (
            lambda c, k, s: plan_cube(c, k, s, wanted(z_axis=np.zeros(3)), Cube(CENTRE, 0.4)),
            "a direction for the flange",
        ),
        (lambda c, k, s: plan_line(c, k, s, wanted(), ENDS, stops=1), "stops: expected 2 or more"),
        (lambda c, k, s: plan_line(c, k, s, wanted(), ENDS[[0, 0]]), "two different ends"),
        (lambda c, k, s: plan_line(c, k, s, wanted(), ENDS, repetitions=10_000), "at most 20000 visits"),
        (lambda c, k, s: plan_line(c, k, s, wanted(approach=Approach(0.0)), ENDS), "approach: expected rad above 0"),
        (lambda c, k, s: plan_line(c, k, s, wanted(approach=Approach(share=2.0)), ENDS), "speed: expected a share"),
        (lambda c, k, s: plan_fixed(c, k, s, wanted(), HOME, readings=1), "readings: expected 2 or more"),
        (lambda c, k, s: plan_fixed(c, k, s, wanted(), HOME, pause=-1.0), "pause: expected seconds"),
        (lambda c, k, s: plan_warm_up(c, k, s, wanted(), WarmUp((0,), hours=np.nan), HOME), "hours: expected above 0"),
        (lambda c, k, s: plan_warm_up(c, k, s, wanted(), WarmUp((1,), swing=3.0), HOME), "expected it clear|joint 2"),
        (
            lambda c, k, s: plan_warm_up(c, k, s, wanted(), WarmUp((0,), cool=1.0, steady=Steady(1, 1)), HOME),
            "cool-down: expected none",
        ),
    ],
)
def test_what_cannot_be_run_is_refused(
    cell: Cell, limits: Limits, scene: Scene, make: Callable[[Cell, Limits, Scene], Plan], said: str
) -> None:
    with pytest.raises(PlanError, match=said) as error:
        make(cell, limits, scene)
    assert "\n" not in str(error.value)


def test_a_way_through_an_obstacle_is_refused(cell: Cell, limits: Limits) -> None:
    pose = np.eye(4)
    pose[:3, 3] = 0.9, 0.05, 1.1
    wall = Obstacle("wall", "box", (0.2, 0.05, 0.2), pose)
    scene = Scene.around(cell, (wall,), None, 0.08)
    with pytest.raises(PlanError, match="clear of floor, arm and obstacles"):
        plan_line(cell, limits, scene, wanted(), ENDS, stops=3, repetitions=1)


def test_a_visit_takes_the_time_of_its_moves() -> None:
    visit = Visit("poses", 1, 1, np.zeros(6), np.ones(6), np.array([2.0, 3.0]), np.ones(2), (), 4, 5.0)
    assert visit.length(7.0) == 2.0 + 7 * 3.0 + 5.0
