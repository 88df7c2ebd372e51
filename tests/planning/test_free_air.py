"""Free air: within limits and time, better than chance, and the errors it promises hold on the virtual robot."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from clampid.catalogue import catalogue
from clampid.identification.identify import identify
from clampid.planning import log_det
from clampid.planning.expected import prior_precision
from clampid.planning.free_air import plan_free_air
from clampid.planning.logs import LogBench, torque_noise_of
from clampid.planning.program import LogWishes
from clampid.planning.sampling import configurations
from clampid.planning.scene import Scene
from clampid.standard_sets import STANDARD
from experiments.campaign import read_campaign
from experiments.checks.check import check_campaign
from experiments.plans import Cell, Limits, Plan, PlanError, cell_of, limits_of
from experiments.plans.limits import course_of, motion_faults
from experiments.plans.virtual import VirtualRobot, run_virtually


def test_it_keeps_limits_time_and_clearance(free_air: Plan, cell: Cell, limits: Limits) -> None:
    scene = Scene.floor_only(cell)
    assert free_air.duration <= 300.0
    assert free_air.duration > 250.0  # what is given is used
    assert free_air.duration == pytest.approx(sum(r.course.length for r in free_air.runs))
    for run in free_air.runs:
        assert motion_faults(cell.robot, limits, run.course) is None
        q, qd, _ = run.course.at(np.arange(0.0, run.course.length, 0.05))
        assert np.all(np.abs(qd) <= run.speed_share * limits.speed * (1 + 1e-9))
        assert scene.clear(q).all()
    first, second = free_air.runs
    assert np.array_equal(first.course.knots, second.course.knots)


def test_every_joint_moves_both_ways(free_air: Plan) -> None:
    moves = np.diff(free_air.runs[0].course.knots, axis=0)
    assert np.all((moves > 0.1).sum(axis=0) >= 3)
    assert np.all((moves < -0.1).sum(axis=0) >= 3)


def test_it_tells_more_than_random_stops_in_the_same_time(free_air: Plan, cell: Cell, limits: Limits) -> None:
    noise, _ = torque_noise_of(cell, None, None)
    bench = LogBench(cell, catalogue(), STANDARD["free_air"], noise, 10.0)
    size = np.outer(bench.size, bench.size)
    prior = prior_precision(bench.problem) * size

    def value(plans: list) -> float:
        return log_det(prior + sum(t.information.sum(axis=0) * size for t in bench.evaluate(plans)))

    planned = value([run.course for run in free_air.runs])
    pool = configurations(limits, 100, Scene.floor_only(cell).clear, 5)
    rng = np.random.default_rng(0)
    for _ in range(5):
        knots = pool[rng.permutation(len(pool))]
        courses = []
        for count in range(4, 80):
            trial = [course_of(cell.robot, limits, knots[:count], speed_share=r.speed_share) for r in free_air.runs]
            if sum(c.length for c in trial) > free_air.duration:
                break
            courses = trial
        assert planned > value(courses) + 1.0


@pytest.mark.parametrize("seed", [1, 2])
def test_promised_errors_hold_on_the_virtual_robot(free_air: Plan, tmp_path: Path, seed: int) -> None:
    campaign = read_campaign(run_virtually(free_air, tmp_path / "arm", seed=seed))
    assert not [f for f in check_campaign(campaign) if f.severity == "error"]
    stage = identify(campaign).stages["free_air"]
    friction = VirtualRobot(free_air.cell.robot, seed=seed).session.plant.friction
    truth = {"Fc": friction.coulomb, "Fv": friction.viscous, "F": friction.arm}
    achieved = np.sqrt(np.diag(stage.covariance))
    assert free_air.expected is not None
    deviations = []
    for k, (slot, promised) in enumerate(zip(stage.slots, free_air.expected.parameters, strict=True)):
        assert slot.label == promised.name
        assert 0.4 < achieved[k] / promised.std < 1.5  # the virtual robot's noise is a little other than assumed
        if slot.parameter in truth:
            deviations.append((stage.theta[k] - truth[slot.parameter][int(slot.place[-1]) - 1]) / promised.std)
    assert np.sqrt(np.mean(np.square(deviations))) < 1.5
    assert np.max(np.abs(deviations)) < 3.5


def test_what_cannot_be_known_is_said(free_air: Plan) -> None:
    assert free_air.expected is not None
    said = " ".join(free_air.expected.not_identified)
    assert "gravity.mz@link1" in said  # nothing about a vertical axis
    open_ = {p.name for p in free_air.expected.parameters if not p.identified}
    assert "gravity.m@link1" in open_
    assert "coulomb_friction.Fc@joint1" not in open_


@pytest.mark.slow
def test_wanted_effects_decide_the_information_of_the_plan(cell: Cell, limits: Limits) -> None:
    noise, _ = torque_noise_of(cell, 0.02, None)
    plan = plan_free_air(
        cell, limits, noise, LogWishes(time=120.0, effects=("coulomb_friction@joint2", "viscous_friction@joint2"))
    )
    assert plan.expected is not None
    assert [p.name for p in plan.expected.parameters] == ["coulomb_friction.Fc@joint2", "viscous_friction.Fv@joint2"]


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"time": -5.0}, "time: expected seconds above 0, at most 86400, found -5"),
        ({"time": 1e9}, "time: expected seconds above 0, at most 86400, found 1e"),
        ({"time": 3.0}, "time: expected enough for at least 4 stops"),
        ({"speeds": (0.1,)}, "speeds: expected two or more different shares"),
        ({"speeds": (0.1, 1.5)}, "at most 1, found 1.5"),
        ({"effects": ("backlash",)}, "backlash does not act in free_air"),
    ],
)
def test_wrong_wishes_are_refused(cell: Cell, limits: Limits, options: dict, words: str) -> None:
    noise, _ = torque_noise_of(cell, None, None)
    with pytest.raises(PlanError, match=words):
        plan_free_air(cell, limits, noise, LogWishes(**{"time": 60.0, **options}))


def test_a_scene_that_leaves_no_room_is_refused(cell: Cell, limits: Limits) -> None:
    noise, _ = torque_noise_of(cell, None, None)
    with pytest.raises(PlanError, match="clear of floor and obstacles, found"):
        plan_free_air(cell, limits, noise, LogWishes(time=60.0), scene=Scene.around(cell, floor=5.0))


def test_missing_data_are_asked_for() -> None:
    with pytest.raises(PlanError, match="no_robot"):
        cell_of("no_robot")
    bare = cell_of("kuka_kr16_2")[0]
    with pytest.raises(PlanError, match=r"expected rated torques.*--rated-torque"):
        torque_noise_of(bare, None, None)
    assert torque_noise_of(bare, None, [1000.0] * 6)[0].sigma.shape == (6,)
    assert limits_of(bare.robot)[1]
