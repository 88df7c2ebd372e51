"""Poses: seen, clear, balanced, short, and worth more than as many random ones when they are measured."""

from __future__ import annotations

import json
from dataclasses import replace
from itertools import permutations
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from typer.testing import CliRunner

from clampid.identification.identify import identify
from clampid.planning.direction_balance import balance_of
from clampid.planning.directions import balanced, confounded, covariates_of
from clampid.planning.pose_bench import PoseBench
from clampid.planning.poses import PoseWishes, plan_poses
from clampid.planning.reach import reaching
from clampid.planning.region import Box, SpherePart, box_of, sphere_part_of
from clampid.planning.sampling import configurations
from clampid.planning.scene import Scene
from clampid.planning.sight import sight_of
from clampid.planning.tour import short_tour, tour_length
from clampid.verbs.errors import is_wrong_input
from clampid.verbs.plan import plan as plan_verb
from experiments.campaign import read_campaign
from experiments.checks.check import check_campaign
from experiments.plans import Cell, Limits, Plan, PlanError, Visit, cell_of, read_plan, write_plan
from experiments.plans.limits import course_of
from experiments.plans.validate import visit_course
from experiments.plans.virtual import run_virtually
from kinematics.collision.obstacles import Obstacle
from kinematics.description import load_robot
from kinematics.poe import forward

WISHES = PoseWishes(poses=40, replicates=4, verification=10)


@pytest.fixture(scope="module")
def poses(cell: Cell, limits: Limits) -> Plan:
    return plan_poses(cell, limits, WISHES)


def of_table(plan: Plan, table: str) -> list[Visit]:
    return [visit for visit in plan.visits if visit.table == table]


def points_of(plan: Plan, visits: list[Visit]) -> tuple[np.ndarray, np.ndarray]:
    """Tracked points ``(v, t, 3)`` and flange rotations, by the robot's own forward kinematics."""
    robot = plan.cell.robot
    pose = forward(robot.screws, robot.flange, np.array([v.q for v in visits]) @ np.asarray(robot.linkage).T)
    targets = np.array(list(plan.cell.targets.values()))
    return np.einsum("nij,tj->nti", pose[:, :3, :3], targets) + pose[:, None, :3, 3], pose[:, :3, :3]


def test_visits_are_what_was_asked_for(poses: Plan, cell: Cell) -> None:
    own, other = of_table(poses, "poses"), of_table(poses, "verification")
    assert len({v.pose for v in own}) == WISHES.poses
    assert len(own) == WISHES.poses + 3 * WISHES.replicates
    assert len(other) == WISHES.verification
    for pose in {v.pose for v in own if v.visit > 1}:
        again = sorted((v for v in own if v.pose == pose), key=lambda v: v.visit)
        assert [v.visit for v in again] == [1, 2, 3, 4]
        first = again[0].direction
        assert np.all(np.abs(first) == 1)
        for visit, side in zip(again, (1, -1, 1, -1), strict=True):
            assert np.array_equal(visit.direction, side * first)
    scene, before = Scene.floor_only(cell), None
    for visit in poses.visits:
        course = visit_course(visit, before)
        for a, b in zip(course.knots[:-1], course.knots[1:], strict=True):
            assert scene.way_clear(a, b)
        assert scene.clear(course.knots).all()
        before = visit.q


def box_at(size: tuple[float, float, float], centre: tuple[float, float, float]) -> Obstacle:
    pose = np.eye(4)
    pose[:3, 3] = centre
    return Obstacle("wall", "box", size, pose)


def test_a_hand_that_slides_at_the_end_of_the_forearm_does_not_hit_it() -> None:
    """Radians in the place of its metres would take the two for parts that are seldom close together."""
    scara = cell_of(str(Path(__file__).parents[2] / "benchmarks" / "scara.toml"))[0]
    rng, robot = np.random.default_rng(0), scara.robot
    clear = Scene.around(scara, floor=None).clear(rng.uniform(robot.lower, robot.upper, (50, robot.n)))
    assert clear.mean() > 0.5
    wall = box_at((0.1, 4.0, 4.0), (0.6, 0.0, 0.0))
    assert Scene.around(scara, (wall,), floor=None).clear(np.zeros((1, robot.n))).tolist() == [False]


def test_every_joint_is_approached_from_both_sides_whatever_the_posture(poses: Plan) -> None:
    balance = balance_of(poses)
    assert np.all(np.abs(balance.plus - balance.minus) <= 1)
    assert np.all(balance.confounded < 0.1)
    signs = np.array([v.direction for v in of_table(poses, "poses") if v.visit == 1])

    def alike(s: np.ndarray) -> float:
        return float(np.square(s.T @ s / len(s) - np.eye(6)).sum())

    chance = [alike(np.random.default_rng(k).choice([-1.0, 1.0], signs.shape)) for k in range(200)]
    assert alike(signs) < np.mean(chance)


@given(st.integers(0, 10_000))
@settings(max_examples=15, deadline=None)
def test_balancing_undoes_the_worst_confounding(seed: int) -> None:
    rng = np.random.default_rng(seed)
    q = rng.uniform(-2, 2, (60, 6))
    covariates = covariates_of(q)
    start = np.where(q > 0, 1.0, -1.0)  # told by posture altogether
    signs = balanced(start, covariates)
    assert set(np.unique(signs)) == {-1.0, 1.0}
    assert np.all(np.abs(signs.sum(axis=0)) <= 1)
    assert confounded(start, covariates).min() > 0.5
    assert confounded(signs, covariates).max() < 0.05
    only = balanced(start, covariates, lambda pose, s: pose != 7)
    assert np.array_equal(only[7], start[7])


@given(st.integers(0, 10_000))
@settings(max_examples=15, deadline=None)
def test_a_tour_is_near_the_shortest_and_never_longer_than_the_nearest_neighbour(seed: int) -> None:
    places = np.random.default_rng(seed).uniform(0, 1, (7, 2))
    cost = np.linalg.norm(places[:, None] - places[None], axis=2)
    order = short_tour(cost)
    assert sorted(order) == list(range(7))
    assert order[0] == 0
    best = min(tour_length(cost, [0, *rest]) for rest in permutations(range(1, 7)))
    assert tour_length(cost, order) <= 1.25 * best
    free = short_tour(cost, fixed=False)
    assert sorted(free) == list(range(7))
    shortest = min(tour_length(cost, list(some)) for some in permutations(range(7)))
    assert tour_length(cost, free) <= 1.25 * shortest


def test_the_order_is_short(poses: Plan, cell: Cell, limits: Limits) -> None:
    q = np.array([v.q for v in of_table(poses, "poses") if v.visit == 1])
    rng = np.random.default_rng(0)
    chance = [course_of(cell.robot, limits, q[rng.permutation(len(q))]).duration.sum() for _ in range(200)]
    assert course_of(cell.robot, limits, q).duration.sum() < 0.85 * np.mean(chance)
    assert course_of(cell.robot, limits, q).duration.sum() < min(chance)


def test_region_sight_and_obstacles_are_kept(cell: Cell, limits: Limits) -> None:
    station = np.array([3.0, 0.5, 1.0])
    sight = sight_of(station, view=(-1.0, 0.0, 0.0, 0.6), facing=(0.0, 0.0, 1.0, 0.9), tolerance=0.05)
    region = box_of((0.4, -0.9, 0.3, 1.6, 0.9, 1.8))
    wall = box_at((0.1, 2.0, 0.6), (2.2, 0.0, 0.3))
    scene = Scene.around(cell, (wall,))
    plan = plan_poses(
        cell, limits, PoseWishes(poses=20, replicates=2, verification=6, region=region, sight=sight), scene=scene
    )
    points, rotation = points_of(plan, list(plan.visits))
    assert np.all((points >= region.lower) & (points <= region.upper))
    ray = station - points
    ray /= np.linalg.norm(ray, axis=-1, keepdims=True)
    assert np.all(-ray[..., 0] * -1.0 >= np.cos(0.55))
    assert np.all(np.einsum("ntk,nk->nt", ray, rotation[:, :, 2]) >= np.cos(0.85))
    # Nothing of the wall between instrument and target, by stepping along the ray.
    for point in points.reshape(-1, 3):
        along = point + np.linspace(0, 1, 400)[:, None] * (station - point)
        assert not np.any(np.all(np.abs(along - wall.pose[:3, 3]) <= np.array(wall.size) / 2, axis=1))


def test_the_arm_hides_what_is_behind_it(cell: Cell) -> None:
    scene = Scene.floor_only(cell)
    q = np.zeros((1, 6))
    bench = PoseBench(cell, ("geometry",), np.zeros(3))
    points, _ = bench.points(q)
    ahead = points[0].mean(axis=0) * [3.0, 1.0, 1.0]
    behind = points[0].mean(axis=0) * [-3.0, 1.0, 1.0]
    assert scene.unhidden(q, points, ahead)[0]
    assert not scene.unhidden(q, points, behind)[0]


def test_the_verification_grid_lies_on_the_sphere_and_faces_its_centre(cell: Cell, limits: Limits) -> None:
    part = sphere_part_of((1.3, 0.0, 0.9, 0.5, 0.5, -1.0, 0.0, 0.3, 0.9))
    plan = plan_poses(cell, limits, PoseWishes(poses=20, replicates=0, verification=12, part=part))
    visits = of_table(plan, "verification")
    assert len(visits) >= 8
    points, rotation = points_of(plan, visits)
    middle = points.mean(axis=1)
    assert np.allclose(np.linalg.norm(middle - part.centre, axis=1), 0.5, atol=2e-5)
    towards = (part.centre - middle) / 0.5
    assert np.linalg.norm(np.cross(towards, rotation[:, :, 2]), axis=1).max() < 1e-5  # angles are rounded to 1e-6
    assert np.all(np.arccos(-towards @ part.axis) <= 0.9 + 1e-6)


@given(st.integers(0, 10_000))
@settings(max_examples=10, deadline=None)
def test_inverse_kinematics_gives_back_what_it_was_asked_for(seed: int) -> None:
    robot = load_robot("kuka_kr20_r1810")
    rng = np.random.default_rng(seed)
    q = rng.uniform(-1.2, 1.2, (1, 6))
    point, normal = np.array([0.03, -0.02, 0.1]), np.array([0.0, 0.6, 0.8])
    pose = forward(robot.screws, robot.flange, q @ np.asarray(robot.linkage).T)[0]
    place, way = pose[:3, :3] @ point + pose[:3, 3], pose[:3, :3] @ normal
    found = reaching(robot, place, way, q + rng.uniform(-0.3, 0.3, (10, 6)), point=point, normal=normal)
    assert len(found)
    there = forward(robot.screws, robot.flange, found @ np.asarray(robot.linkage).T)
    assert np.allclose(there[:, :3, :3] @ point + there[:, :3, 3], place, atol=2e-6)
    assert np.allclose(there[:, :3, :3] @ normal, way, atol=2e-6)


@given(st.integers(0, 10_000), st.floats(0.05, 3.1))
@settings(max_examples=25, deadline=None)
def test_the_grid_is_in_its_part_and_even(seed: int, angle: float) -> None:
    rng = np.random.default_rng(seed)
    axis = rng.standard_normal(3)
    part = SpherePart(rng.uniform(-1, 1, 3), 0.4, 0.7, axis / np.linalg.norm(axis), angle)
    grid = part.grid(300)
    wide = replace(part, inner=0.4 - 1e-9, outer=0.7 + 1e-9, half_angle=min(angle + 1e-9, np.pi))
    assert wide.contains(grid).all()
    half = np.arccos((1 + np.cos(angle)) / 2)  # the cap of half the area
    inside = ((grid - part.centre) @ part.axis >= np.cos(half) * np.linalg.norm(grid - part.centre, axis=1)).mean()
    assert inside == pytest.approx(0.5, abs=0.01)
    assert not Box(np.zeros(3), np.ones(3)).contains(np.array([[0.5, 0.5, 1.5]]))[0]


def random_plan(plan: Plan, cell: Cell, limits: Limits, seed: int) -> Plan:
    """As many visits, targets and returns as a plan has, at random configurations from random sides."""
    rng = np.random.default_rng(seed)
    inner = replace(limits, lower=limits.lower + 0.1, upper=limits.upper - 0.1)
    pool = configurations(inner, 400, Scene.floor_only(cell).clear, seed + 50)
    of = {key: k for k, key in enumerate(dict.fromkeys((v.table, v.pose) for v in plan.visits))}
    q = pool[rng.permutation(len(pool))[: len(of)]]
    signs = rng.choice([-1.0, 1.0], q.shape)
    visits, before = [], None
    for v in plan.visits:
        k = of[v.table, v.pose]
        via = np.round(q[k] - 0.05 * (signs[k] if v.visit % 2 else -signs[k]), 6)
        slow = np.array([30.0, 5.0])
        visits.append(replace(v, via=via, q=q[k], duration=slow, ramp=slow / 3))
        before = q[k]
    assert before is not None
    return replace(plan, visits=tuple(visits), expected=None)


def errors(plan: Plan, folder: Path, seed: int) -> dict[str, float]:
    """Standard errors that an identification of the measured plan gives, by parameter."""
    campaign = read_campaign(run_virtually(plan, folder, seed=seed))
    assert not [f for f in check_campaign(campaign) if f.severity == "error"]
    stage = identify(campaign, str(plan.wished["effects"]).split(", ")).stages["poses"]
    noise = np.sqrt(np.diag(stage.covariance))
    return {slot.label: float(s) for slot, s in zip(stage.slots, noise, strict=True)}


def test_measured_they_tell_more_than_as_many_random_ones(
    poses: Plan, cell: Cell, limits: Limits, tmp_path: Path
) -> None:
    assert poses.expected is not None
    known = [p.name for p in poses.expected.parameters if p.identified]
    planned = errors(poses, tmp_path / "planned", 1)
    ratios = []
    for seed in (1, 2):
        chance = errors(random_plan(poses, cell, limits, seed), tmp_path / f"random{seed}", 1)
        ratios.append(np.exp(np.mean([np.log(planned[name] / chance[name]) for name in known])))
    print(f"standard errors, planned over random, geometric mean: {', '.join(f'{r:.2f}' for r in ratios)}")
    assert max(ratios) < 0.95  # of standard errors: a tenth less is a fifth of the poses less


def test_what_is_promised_to_be_known_better_is(poses: Plan, tmp_path: Path) -> None:
    assert poses.expected is not None
    measured = errors(poses, tmp_path / "arm", 3)
    known = [p for p in poses.expected.parameters if p.identified]
    found, promised = np.log([(measured[p.name] / p.size, p.std / p.size) for p in known]).T
    # The plan knows the instrument's noise only. What the robot repeats worse and the model lacks comes on top, and
    # differs from parameter to parameter; most of how they differ is the plan's all the same.
    assert np.median(found - promised) > 0.0
    assert np.corrcoef(found, promised)[0, 1] ** 2 > 0.5


def test_what_cannot_be_known_is_said(poses: Plan, tmp_path: Path) -> None:
    assert poses.expected is not None
    assert "joint_compliance.c at joint1, joint6: these rows do not depend on it" in poses.expected.not_identified
    assert {"O1", "O2", "O3", "O4", "O5"} <= set(poses.expected.indices)
    back = read_plan(write_plan(poses, tmp_path / "p.toml"))
    assert [v.direction.tolist() for v in back.visits] == [v.direction.tolist() for v in poses.visits]


@pytest.mark.parametrize(
    ("wishes", "words"),
    [
        ({"poses": 1}, "poses: expected 2 to 5000, found 1"),
        ({"poses": 10**9}, "poses: expected 2 to 5000, found 1000000000"),
        ({"verification": 10**9}, "verification poses: expected 0 to 5000, found 1000000000"),
        ({"replicates": 500}, "replicates: expected at most the 60 poses, found 500"),
        ({"spread": 1.5}, "spread: expected a share from 0 to 1, found 1.5"),
        ({"approach": 0.0}, "approach: expected rad above 0 and below 1, found 0"),
        ({"region": Box(np.full(3, 50.0), np.full(3, 51.0))}, "configurations that are with all targets in the box"),
        (
            {"poses": 10, "verification": 2, "part": SpherePart(np.full(3, 50.0), 1.0, 1.0, np.eye(3)[2], 1.0)},
            "verification: expected configurations",
        ),
    ],
)
def test_wrong_wishes_are_refused(cell: Cell, limits: Limits, wishes: dict, words: str) -> None:
    with pytest.raises(PlanError, match=words):
        plan_poses(cell, limits, replace(PoseWishes(), **wishes))


def test_the_verb_writes_a_plan_and_says_what_it_is(tmp_path: Path) -> None:
    call = ["poses", "-o", str(tmp_path / "p.toml"), "--poses", "20", "--replicates", "2", "--verification", "4"]
    ran = CliRunner().invoke(plan_verb, [*call, "--quiet", "--json", "-"])
    assert ran.exit_code == 0, ran.output
    said = json.loads(ran.stdout)
    assert said["visits"] == 20 + 6 + 4
    assert [a + b for a, b in zip(said["approaches"]["up"], said["approaches"]["down"], strict=True)] == [26] * 6
    assert read_plan(tmp_path / "p.toml").kind == "poses"


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--box", "0,0,0,1,1,1", "--sphere", "0,0,0,1,2"], "expected one of them, found both"),
        (["--box", "1,2"], "box: expected six numbers"),
        (["--sphere", "0,0,0,2,1"], "sphere: expected radii 0 <= inner <= outer"),
        (["--facing", "0,0,1,0.5"], "expected --instrument"),
        (["--instrument", "1,2"], "instrument: expected x, y, z"),
        (["--instrument", "1,2,3", "--view", "1,0,0,0.01"], "half-angle above the tolerance"),
        (["--effects", "gremlins"], "gremlins"),
        (["--effects", "coulomb_friction"], "does not act in poses"),
    ],
)
def test_wrong_calls_of_the_verb_are_refused(tmp_path: Path, options: list[str], words: str) -> None:
    ran = CliRunner().invoke(plan_verb, ["poses", "-o", str(tmp_path / "p.toml"), "--quiet", *options])
    assert ran.exception is not None
    with pytest.raises(type(ran.exception), match=words):
        raise ran.exception
    assert is_wrong_input(ran.exception)
    assert not (tmp_path / "p.toml").exists()


FEW = ("--poses", "12", "--replicates", "0", "--verification", "6", "--effects", "geometry", "-q")


def planned(folder: Path, *options: str) -> Plan:
    out = folder / "plan.toml"
    ran = CliRunner().invoke(plan_verb, ["poses", "-o", str(out), *FEW, *options])
    assert ran.exit_code == 0, ran.output or ran.exception
    return read_plan(out)


def same(one: Plan, other: Plan) -> bool:
    pairs = zip(one.visits, other.visits, strict=True)
    return all(np.allclose([a.q, a.via], [b.q, b.via], atol=1e-9) for a, b in pairs)


def test_a_plan_in_degrees_and_millimetres_is_the_same_plan(tmp_path: Path) -> None:
    wide, narrow, turn, top = (f"{np.degrees(angle):.12g}" for angle in (1.5, 1.2, 0.04, 2.0))
    si = planned(
        tmp_path, "--sphere", "1.2,0,0.4,0.2,0.5,0,0,1,1.5", "--verification-sphere", "1.2,0,0.4,0.2,0.5,0,0,1,1.5",
        "--floor", "-0.1", "--arm-radius", "0.07", "--instrument", "3.5,0,1", "--view", "-1,0,0,1.2",
        "--facing", "0,0,1,1.2", "--sight-tolerance", "0.04", "--approach", "0.04", "--acceleration", "2",
    )  # fmt: skip
    units = planned(
        tmp_path, "--deg", "--mm", "--sphere", f"1200,0,400,200,500,0,0,1,{wide}",
        "--verification-sphere", f"1200,0,400,200,500,0,0,1,{wide}", "--floor", "-100", "--arm-radius", "70",
        "--instrument", "3500,0,1000", "--view", f"-1,0,0,{narrow}", "--facing", f"0,0,1,{narrow}",
        "--sight-tolerance", turn, "--approach", turn, "--acceleration", top,
    )  # fmt: skip
    assert same(si, units)


def test_defaults_are_the_same_in_every_unit(tmp_path: Path) -> None:
    assert same(
        planned(tmp_path, "--instrument", "3,0,1"), planned(tmp_path, "--mm", "--deg", "--instrument", "3000,0,1000")
    )


@pytest.mark.parametrize("replicates", [2, 3])
def test_other_poses_are_visited_again_where_no_way_through_the_first_choice_is_clear(
    cell: Cell, limits: Limits, replicates: int
) -> None:
    """The bundled robot over its floor: the straight way from the last pose to the first choice goes through it."""
    plan = plan_poses(cell, limits, PoseWishes(poses=40, replicates=replicates, verification=0))
    visits = [visit.visit for visit in plan.visits]
    assert visits.count(1) == 40
    assert [visits.count(number) for number in (2, 3, 4)] == [replicates] * 3
