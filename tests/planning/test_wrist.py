"""The wrist: what T promises holds to rounding, what it does not allow is said, and friction comes apart."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from clampid.identification.identify import identify
from clampid.planning.logs import torque_noise_of
from clampid.planning.program import LogWishes
from clampid.planning.scene import Scene
from clampid.planning.wrist import SWING_STOPS, Decoupled, decoupled_motions, plan_wrist, swing_directions
from clampid.stages import log_facts
from clampid.stages.motion_choice import Way
from experiments.campaign import read_campaign
from experiments.plans import Cell, Limits, Plan, PlanError, cell_of, limits_of
from experiments.plans.limits import motion_faults
from experiments.plans.virtual import VirtualRobot, run_virtually
from kinematics.description import load_robot
from kinematics.transmission import Transmission

ALLOWED = {Decoupled("motor", 4), Decoupled("joint", 4), Decoupled("motor", 5), Decoupled("joint", 5)}


@pytest.fixture(scope="module")
def wrist(cell: Cell, limits: Limits) -> Plan:
    return plan_wrist(cell, limits, torque_noise_of(cell, None, None)[0], LogWishes(time=300.0))


def swings(plan: Plan) -> list[tuple[np.ndarray, np.ndarray]]:
    """Give centre and reach of every swing."""
    found = []
    for run in plan.runs:
        knots = run.course.knots
        for start in range(0, len(knots) - 1, SWING_STOPS):
            found.append((knots[start], knots[start + 3] - knots[start]))
    return found


def test_joints_at_rest_stay_at_rest_through_the_transmission(wrist: Plan) -> None:
    gears = Transmission(np.asarray(wrist.cell.robot.transmission))
    seen = set()
    for run in wrist.runs:
        course = run.course
        for start in range(0, len(course.duration), SWING_STOPS):
            reach = course.knots[start + 3] - course.knots[start]
            begin, end = course.starts[start + 2], course.starts[start + 4] + course.duration[start + 4]
            q, _, _ = course.at(np.linspace(begin, end, 400))
            motor = gears.motor_from_joint(q)
            for fact in decoupled_motions(wrist.cell.robot, np.where(np.abs(reach) < 1e-12, 0.0, reach)):
                j = fact.joint
                seen.add(fact)
                if fact.kind == "motor":
                    assert np.ptp(gears.joint_from_motor(motor)[:, j]) < 1e-12
                    assert np.ptp(motor[:, j]) > 0.1
                else:
                    assert np.ptp(motor[:, j]) * abs(gears.T[j, j]) < 1e-12
                    assert np.ptp(q[:, j]) > 1e-3
    assert seen == ALLOWED


def test_limits_time_and_scene_are_kept(wrist: Plan, cell: Cell, limits: Limits) -> None:
    assert 200.0 < wrist.duration <= 300.0
    scene = Scene.floor_only(cell)
    for run in wrist.runs:
        assert motion_faults(cell.robot, limits, run.course) is None
        assert scene.clear(run.course.at(np.arange(0.0, run.course.length, 0.1))[0]).all()
    moved = np.ptp(np.vstack([run.course.knots - run.course.knots[0] for run in wrist.runs]), axis=0)
    assert np.all(moved[:3] == 0)


def test_friction_is_set_to_a_side_before_every_swing(wrist: Plan) -> None:
    for run in wrist.runs:
        moves = np.diff(run.course.knots, axis=0)[:, 3:]
        before = moves[1::SWING_STOPS]
        assert np.all(np.abs(before) > 0.1)
        assert np.all(run.course.duration[1::SWING_STOPS] >= 1.2 - 1e-9)


@given(st.integers(0, 10_000))
@settings(max_examples=10, deadline=None)
def test_facts_are_what_T_says_of_every_direction(seed: int) -> None:
    robot = load_robot("kuka_kr20_r1810")
    T = np.asarray(robot.transmission)
    for d in swing_directions(robot, np.random.default_rng(seed)):
        assert set(decoupled_motions(robot, d)) <= ALLOWED
        motor = d @ np.linalg.inv(T) * np.abs(np.diag(T))
        for fact in decoupled_motions(robot, d):
            still, turning = (d, motor) if fact.kind == "motor" else (motor, d)
            assert abs(still[fact.joint]) < 1e-12
            assert abs(turning[fact.joint]) > 1e-3


def test_what_the_transmission_does_not_allow_is_said(wrist: Plan) -> None:
    assert wrist.expected is not None
    said = wrist.expected.not_identified
    assert any(s.startswith("joints 1, 2, 3: motor and joint only turn together") for s in said)
    assert "motor 4 turning with joint 4 still: the transmission does not allow it" in said
    known = {p.name: p.identified for p in wrist.expected.parameters}
    assert known["wrist_coupling_friction.F@joint5"]
    assert known["wrist_coupling_friction.F@joint6"]
    assert not known["wrist_coupling_friction.F@joint4"]


@pytest.mark.parametrize("name", ["kuka_kr16_2", "ur10"])
def test_a_robot_without_coupling_has_no_wrist_program(name: str) -> None:
    cell = cell_of(name)[0]
    noise, _ = torque_noise_of(cell, None, [1000.0] * 6)
    with pytest.raises(PlanError, match=r"no motor can turn with its joint still.*no wrist program"):
        plan_wrist(cell, limits_of(cell.robot)[0], noise)


@pytest.mark.slow
def test_too_little_time_says_how_much_it_takes(cell: Cell, limits: Limits) -> None:
    with pytest.raises(PlanError, match=r"expected at least \d+ s, to show once everything"):
        plan_wrist(cell, limits, torque_noise_of(cell, None, None)[0], LogWishes(time=20.0))


def identified(plan: Plan, folder: Path, seed: int) -> list[float]:
    """Give deviations of friction in units of the promised errors."""
    assert plan.expected is not None
    campaign = read_campaign(run_virtually(plan, folder, seed=seed))
    stage = identify(campaign, str(plan.wished["effects"]).split(", ")).stages["free_air"]
    friction = VirtualRobot(plan.cell.robot, seed=seed).session.plant.friction
    truth = {"Fc": friction.coulomb, "Fv": friction.viscous, "F": friction.arm}
    return [
        (stage.theta[k] - truth[slot.parameter][int(slot.place[-1]) - 1]) / promised.std
        for k, (slot, promised) in enumerate(zip(stage.slots, plan.expected.parameters, strict=True))
        if slot.parameter in truth
    ]


@pytest.mark.parametrize("seed", [1, 2])
def test_promised_errors_hold_on_the_virtual_robot(wrist: Plan, tmp_path: Path, seed: int) -> None:
    deviations = identified(wrist, tmp_path / "arm", seed)
    assert np.sqrt(np.mean(np.square(deviations))) < 1.5
    assert np.max(np.abs(deviations)) < 3.5


def test_joints_that_stand_do_not_decide_which_rows_count(
    wrist: Plan, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As trapezoids of speed their accelerations are rounding, beside which any misfit is large."""
    chosen = log_facts.chosen_way

    def with_moves(default: Way, candidates: Sequence[Sequence[Way]], score: Callable[[Way], Any]) -> tuple[Way, Any]:
        last = candidates[-1][-1] if candidates else default
        return (last, score(last)) if last.in_moves else chosen(default, candidates, score)

    monkeypatch.setattr(log_facts, "chosen_way", with_moves)
    deviations = identified(wrist, tmp_path / "arm", 1)
    assert np.sqrt(np.mean(np.square(deviations))) < 1.5
