"""Clamping: the load on the clamp is bounded at every step, refused when planned and stopped when run."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from typer.testing import CliRunner

from clampid.identification.identify import identify
from clampid.planning.clamping import ClampingWishes, plan_clamping
from clampid.planning.logs import torque_noise_of
from clampid.planning.press import Press, press_limits, stiffness_of
from clampid.verbs.errors import is_wrong_input
from clampid.verbs.plan import plan as plan_verb
from experiments.campaign import read_campaign
from experiments.plans import Cell, Limits, Plan, PlanError, PlanStopped, cell_of, limits_of, read_plan, write_plan
from experiments.plans.press import flange_jacobian, holding_torque, motor_torques, rated_motor_torque, wrench, wrenches
from experiments.plans.runner import run_plan, work_folder
from experiments.plans.validate import validate_plan
from experiments.plans.virtual import VirtualRobot, run_virtually
from kinematics.description import load_robot

SHARE = 0.3


def press_of(cell: Cell, share: float = SHARE) -> Press:
    rated = rated_motor_torque(cell.robot)
    return Press(np.full(6, share), rated, stiffness_of(cell.robot, rated)[0])


@pytest.fixture(scope="module")
def held(cell: Cell, limits: Limits) -> Limits:
    return press_limits(limits, rated_motor_torque(cell.robot))


@pytest.fixture(scope="module")
def clamping(cell: Cell, held: Limits) -> Plan:
    return plan_clamping(cell, held, torque_noise_of(cell, None, None)[0], press_of(cell), ClampingWishes(time=3000.0))


def test_every_step_keeps_the_limits_worked_out_by_virtual_work(clamping: Plan, cell: Cell) -> None:
    limits = clamping.limits
    assert clamping.stiffness is not None
    assert limits.motor_torque is not None
    assert limits.force is not None
    assert limits.moment is not None
    T = np.asarray(cell.robot.transmission)
    C = T.T @ np.diag(1 / clamping.stiffness) @ T  # joint compliance, as ROBOT_FACTS has it
    for sweep in clamping.sweeps:
        load = holding_torque(cell.robot, sweep.posture, cell.gravity, cell.tool_mass, cell.tool_com)
        J = flange_jacobian(cell.robot, sweep.posture)
        for step, offset in enumerate(sweep.offset):
            tau = np.linalg.solve(C, offset * np.eye(6)[sweep.joint])
            W = np.linalg.solve(J.T, tau)
            assert np.linalg.norm(W[:3]) <= limits.force
            assert np.linalg.norm(W[3:]) <= limits.moment
            assert np.linalg.norm(W[:3]) == pytest.approx(sweep.force[step], rel=1e-9, abs=1e-9)
            assert np.linalg.norm(W[3:]) == pytest.approx(sweep.moment[step], rel=1e-9, abs=1e-9)
            assert np.all(np.abs(T @ (tau + load)) <= limits.motor_torque)


@given(st.integers(0, 10_000))
@settings(max_examples=25, deadline=None)
def test_wrench_and_torques_are_in_balance(seed: int) -> None:
    robot = load_robot("kuka_kr20_r1810")
    rng = np.random.default_rng(seed)
    q, joint = rng.uniform(-1.5, 1.5, 6), int(rng.integers(6))
    k = np.asarray(robot.motor_spring)
    load = rng.uniform(-100, 100, 6)
    dq = 1e-3 * rng.standard_normal((4, 6))
    tau = motor_torques(robot, k, load, dq)
    J = flange_jacobian(robot, q)
    W = wrench(robot, J, load, tau)
    # Power: what the joints' torques beyond the load do in a small motion, the wrench does at the flange.
    motion = rng.standard_normal(6)
    joint_tau = tau @ np.linalg.inv(np.asarray(robot.transmission)).T - load
    assert np.allclose(joint_tau @ motion, W @ (J @ motion), rtol=1e-6, atol=1e-6)
    small = wrenches(robot, k, q, joint, np.array([1e-4, 2e-4]))
    assert np.allclose(2 * small[1][0], small[1][1])


def test_amplitudes_are_the_share_that_was_asked_for(clamping: Plan, cell: Cell) -> None:
    press = press_of(cell)
    for sweep in clamping.sweeps:
        tau, _, _ = wrenches(cell.robot, press.stiffness, sweep.posture, sweep.joint, sweep.offset)
        assert np.abs(tau[:, sweep.joint]).max() == pytest.approx(SHARE * press.rated[sweep.joint], rel=1e-5)
        steps = np.diff(sweep.offset, prepend=0.0)
        assert np.allclose(np.abs(steps), np.abs(steps[0]), rtol=1e-4)
        assert sweep.offset[-1] == 0.0


def test_order_time_and_coverage(clamping: Plan) -> None:
    assert clamping.duration <= 3000.0
    assert {s.joint for s in clamping.sweeps} == set(range(6))
    numbers = [s.clamping for s in clamping.sweeps]
    assert numbers == sorted(numbers)
    for c in set(numbers):
        loads = [s.force.max() + s.moment.max() for s in clamping.sweeps if s.clamping == c]
        assert loads == sorted(loads)


def test_a_file_beyond_its_limits_is_refused(clamping: Plan, tmp_path: Path) -> None:
    path = write_plan(clamping, tmp_path / "plan.toml")
    assert len(read_plan(path).sweeps) == len(clamping.sweeps)
    text = path.read_text()
    path.write_text(text.replace("force_N = 3000.0", "force_N = 50.0"))
    with pytest.raises(PlanError, match=r"sweep \d+, step \d+: force on the clamp: expected at most 50 N, found"):
        read_plan(path)
    path.write_text(text.replace("stiffness_Nm_rad", "# stiffness_Nm_rad"))
    with pytest.raises(PlanError, match="which bound the load on the clamp, found not all of them"):
        read_plan(path)
    longer = replace(clamping.sweeps[0], offset=clamping.sweeps[0].offset * 1.1)
    with pytest.raises(PlanError, match="which follows from the offset"):
        validate_plan(replace(clamping, sweeps=(longer,)))


def test_a_sweep_that_would_exceed_a_limit_is_refused_when_planned(cell: Cell, limits: Limits) -> None:
    rated = rated_motor_torque(cell.robot)
    noise = torque_noise_of(cell, None, None)[0]
    with pytest.raises(PlanError, match=r"joint 1: expected a posture in which a sweep to 0\.3 .*force on the clamp"):
        plan_clamping(cell, press_limits(limits, rated, force=300.0), noise, press_of(cell))
    with pytest.raises(PlanError, match=r"torque of motor \d"):
        plan_clamping(cell, press_limits(limits, rated, torque=0.3), noise, press_of(cell))


class Stiff(VirtualRobot):
    """A robot whose drives press harder than anyone thought, and which counts its steps."""

    factor, steps, released = 1.0, 0, 0

    def press(self, joint: int, offset: np.ndarray, dwell: float) -> Iterator[Mapping[str, float]]:
        for reading in super().press(joint, offset, dwell):
            self.steps += 1
            yield {k: self.factor * v if k.startswith("tau") else v for k, v in reading.items()}

    def release(self) -> None:
        self.released += 1
        super().release()


def test_a_sweep_that_exceeds_a_limit_is_stopped_when_run(clamping: Plan, tmp_path: Path) -> None:
    robot = Stiff(clamping.cell.robot, seed=1)
    robot.factor = 4.0
    with pytest.raises(
        PlanStopped, match=r"sweep 1, step \d+: .*expected at most .*measured .*; the drives were unwound"
    ):
        run_plan(clamping, robot, tmp_path / "arm")
    assert robot.steps < len(clamping.sweeps[0].offset)
    assert robot.released == 1
    assert not (tmp_path / "arm").exists()
    assert not list(work_folder(tmp_path / "arm").glob("*.parquet"))


def test_stopped_amid_a_sweep_it_starts_that_sweep_again(clamping: Plan, tmp_path: Path) -> None:
    short = replace(clamping, sweeps=tuple(s for s in clamping.sweeps if s.clamping == 1)[:2])
    robot = Stiff(clamping.cell.robot, seed=1)
    half = len(short.sweeps[0].offset) + 5
    with pytest.raises(PlanStopped, match="stopped in sweep 2 before step 6"):
        run_plan(short, robot, tmp_path / "arm", stop=lambda: robot.steps >= half)
    again = Stiff(clamping.cell.robot, seed=1)
    table = read_campaign(run_plan(short, again, tmp_path / "arm")).tables["clamped"]
    assert again.steps == len(short.sweeps[1].offset)
    assert table["sweep"].value_counts().to_dict() == {k: len(s.offset) for k, s in enumerate(short.sweeps, 1)}


def test_promised_errors_hold_on_the_virtual_robot(clamping: Plan, tmp_path: Path) -> None:
    campaign = read_campaign(run_virtually(clamping, tmp_path / "arm", seed=1))
    stage = identify(campaign).stages["clamped"]
    plant = VirtualRobot(clamping.cell.robot, seed=1).session.plant
    truth = {"c": 1 / plant.drive.spring, "gap": plant.drive.gap, "Fc": plant.friction.coulomb}
    assert clamping.expected is not None
    deviations = []
    achieved = np.sqrt(np.diag(stage.covariance))
    for k, (slot, promised) in enumerate(zip(stage.slots, clamping.expected.parameters, strict=True)):
        assert slot.label == promised.name
        assert achieved[k] < 2.0 * promised.std
        deviations.append((stage.theta[k] - truth[slot.parameter][int(slot.place[-1]) - 1]) / promised.std)
    assert np.sqrt(np.mean(np.square(deviations))) < 1.7
    assert np.max(np.abs(deviations)) < 4.0


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"time": -1.0}, "time: expected seconds above 0"),
        ({"time": 700.0}, r"time: expected at least \d+ s, for 2 clampings and a sweep of each joint, found 700 s"),
        ({"effects": ("backlash",)}, "expected joint_compliance among them"),
        ({"effects": ("joint_compliance", "gravity")}, "gravity does not act in clamped"),
    ],
)
def test_wrong_wishes_are_refused(cell: Cell, held: Limits, options: dict, words: str) -> None:
    with pytest.raises(PlanError, match=words):
        plan_clamping(cell, held, torque_noise_of(cell, None, None)[0], press_of(cell), ClampingWishes(**options))


@pytest.mark.slow
def test_a_time_that_is_too_short_is_told_the_least_that_is_not(cell: Cell, held: Limits) -> None:
    """All six joints take two clampings here; what one would take is above none of it."""
    noise, press = torque_noise_of(cell, None, None)[0], press_of(cell)
    with pytest.raises(PlanError, match="and a sweep of each joint") as refused:
        plan_clamping(cell, held, noise, press, ClampingWishes(time=1.01 * press.clamping_time))
    found = re.search(r"expected at least (\d+) s, for (one|\d+) clampings?", str(refused.value))
    assert found is not None
    enough = float(found[1]) + 1.0
    made = plan_clamping(cell, held, noise, press, ClampingWishes(time=enough))
    assert made.duration <= enough
    assert made.sweeps[-1].clamping == (1 if found[2] == "one" else int(found[2]))
    with pytest.raises(PlanError, match=f"at least {found[1]} s.*found {enough - 10:g} s"):
        plan_clamping(cell, held, noise, press, ClampingWishes(time=enough - 10))


def test_wrong_amplitudes_and_limits_are_refused(cell: Cell, limits: Limits, held: Limits) -> None:
    noise = torque_noise_of(cell, None, None)[0]
    with pytest.raises(PlanError, match="amplitude: expected one share of the rated torque above 0 and at most 1"):
        plan_clamping(cell, held, noise, press_of(cell, 1.5))
    with pytest.raises(PlanError, match="force on the clamp: expected a limit above 0, found 0"):
        press_limits(limits, rated_motor_torque(cell.robot), force=0.0)


def test_springs_that_are_not_described_are_assumed_and_said() -> None:
    robot = cell_of("ur10")[0].robot
    rated = rated_motor_torque(robot)
    stiffness, words = stiffness_of(robot, rated)
    assert stiffness.shape == (6,)
    assert "no springs are described" in words[0]
    assert limits_of(robot)[0].force is None


def test_the_verb_drives_what_is_asked_where_it_is_asked(tmp_path: Path) -> None:
    posture = [0.3, -1.2, 1.4, 0.5, 0.9, -0.4]
    where = ",".join(map(str, posture))
    call = ["clamping", "-o", str(tmp_path / "p.toml"), "--joints", "2,5", "--posture", where, "--amplitude", "0.2"]
    ran = CliRunner().invoke(plan_verb, [*call, "--time", "1500", "--quiet", "--json", "-"])
    assert ran.exit_code == 0, ran.output
    assert json.loads(ran.stdout)["kind"] == "clamping"
    plan = read_plan(tmp_path / "p.toml")
    assert {s.joint for s in plan.sweeps} == {1, 4}
    assert all(s.posture.tolist() == posture for s in plan.sweeps)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--joints", "0,2"], r"--joints: expected different numbers from 1 to 6, found '0,2'"),
        (["--joints", "2,2"], "--joints: expected different numbers"),
        (["--posture", "0,1"], "--posture: expected 6 angles in rad, found 2"),
        (["--amplitude", "2"], "amplitude: expected one share of the rated torque above 0 and at most 1"),
        (["--max-force", "0"], "force on the clamp: expected a limit above 0, found 0"),
    ],
)
def test_wrong_calls_of_the_verb_are_refused(tmp_path: Path, options: list[str], words: str) -> None:
    ran = CliRunner().invoke(plan_verb, ["clamping", "-o", str(tmp_path / "p.toml"), "--quiet", *options])
    assert ran.exception is not None
    with pytest.raises(type(ran.exception), match=words):
        raise ran.exception
    assert is_wrong_input(ran.exception)
    assert not (tmp_path / "p.toml").exists()
