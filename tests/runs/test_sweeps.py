"""Sweeps over sockets: limits, an open clamp, a clamp that shifts, and a break in the middle of a sweep."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from run_controller import CLAMPED, Controller, clamping_plan

from experiments.campaign import read_campaign
from experiments.plans import Cell, Limits, Plan
from experiments.plans.press import motor_torques
from experiments.runs.errors import RunStopped
from experiments.runs.runner import run
from experiments.runs.slips import SweepRows, find_shift


def test_sweeps_become_a_table_and_the_clamp_is_opened(controller: Controller, clamping: Plan, tmp_path: Path) -> None:
    run(replace(clamping, sweeps=clamping.sweeps[:1]), tmp_path / "C", controller.asked())
    table = read_campaign(tmp_path / "C").tables["clamped"]
    assert table["sweep"].value_counts().to_dict() == {1: 64}
    assert not controller.operate("state")["clamped"]
    for number, sweep in enumerate(clamping.sweeps[:1], 1):
        rows = table[table["sweep"] == number]
        q = rows[[f"motor{i}_rad" for i in range(1, 7)]].to_numpy() @ clamping.cell.robot.transmission
        np.testing.assert_allclose(q[:, sweep.joint] - sweep.posture[sweep.joint], sweep.offset, atol=3e-5)
    own = table[table["sweep"] == 1]
    slope = np.polyfit(own["motor2_rad"], own["tau2_Nm"], 1)[0]
    assert 0.7 < slope / (clamping.stiffness[1] / 1.6) < 1.5


@pytest.mark.parametrize("stiffer", [1.6])
def test_a_sweep_beyond_a_limit_exceeds_it_by_one_step_and_unwinds(
    controller: Controller, cell: Cell, limits: Limits, tmp_path: Path, stiffer: float
) -> None:
    """The plan believes in springs softer by 1.6 than the robot has, so that its limit comes early."""
    plan = clamping_plan(cell, limits, [(1, 1, CLAMPED), (1, 2, CLAMPED)], share=0.45, margin=1 / stiffer)
    tight = plan.limits.motor_torque.copy()
    with pytest.raises(RunStopped, match=r"sweep \d, step \d+: .* expected at most .*; the drives were unwound"):
        run(plan, tmp_path / "C", controller.asked())
    from experiments.runs.folder import work_folder
    from experiments.runs.journal import whole_lines

    entries = whole_lines((work_folder(tmp_path / "C") / "journal.jsonl").read_bytes())[0]
    rows = [e["row"] for e in entries if e["what"] == "row"]
    cut = next(e for e in entries if e["what"] == "cut")
    sweep = plan.sweeps[cut["sweep"] - 1]
    beyond = [k for k, row in enumerate(rows) if any(abs(row[f"tau{i + 1}_Nm"]) > tight[i] for i in range(6))]
    assert beyond == [len(rows) - 1]  # the reading that stopped it is the only one beyond
    back = [
        e["to"][sweep.joint] - sweep.posture[sweep.joint]
        for e in entries
        if e["what"] == "move" and "unwinding" in e["step"]
    ]
    assert back[-1] == pytest.approx(0.0, abs=1e-9)
    assert np.max(np.abs(np.diff([sweep.offset[cut["step"] - 1], *back]))) < 1.01 * sweep.offset[0]
    assert np.all(np.diff(np.abs(back)) < 0)  # on the way it came, step by step


def test_an_open_clamp_is_found_within_its_first_loop(controller: Controller, clamping: Plan, tmp_path: Path) -> None:
    asked = controller.asked()
    asked.person.clamp = lambda where: None
    with pytest.raises(RunStopped, match=r"sweep 1: joint 2 .*torque did not rise: the clamp is open"):
        run(clamping, tmp_path / "C", asked)
    assert not controller.operate("state")["clamped"]


@pytest.mark.slow
def test_a_clamp_that_slips_in_sweep_3_is_named_before_sweep_5(
    controller: Controller, cell: Cell, limits: Limits, tmp_path: Path
) -> None:
    plan = clamping_plan(cell, limits, [(1, j, CLAMPED) for j in (1, 2, 1, 2, 1)])
    asked, begun, slipped = controller.asked(), [], []

    def progress(done: float, text: str) -> None:
        begun.append(text)
        if text.startswith("sweep 3") and "step 33" in text and not slipped:
            slipped.append(controller.operate("slip 0.06 0.06 0.06"))

    asked.progress = progress
    with pytest.raises(RunStopped, match=r"shifted by about 0\.\d+ mm in sweep 3.*sweep.* 3.* again; sweeps 1, 2 of"):
        run(plan, tmp_path / "C", asked)
    assert slipped
    assert not any(text.startswith("sweep 5") for text in begun)


@pytest.mark.slow
def test_a_break_amid_a_sweep_goes_on_in_it_or_makes_it_again(own: Controller, clamping: Plan, tmp_path: Path) -> None:
    def broken(asked, where: str, how) -> None:
        asked.progress = lambda done, text: how() if text.endswith(where) else None
        with pytest.raises(RunStopped):
            run(clamping, tmp_path / "C", asked)

    def stop() -> None:
        raise RunStopped("enough for a test")

    broken(own.asked(), "joint 2, step 33", stop)
    state = own.operate("state")
    assert state["clamped"]
    again = own.asked(resume=True)
    broken(again, "joint 3, step 17", lambda: own.operate("restart"))
    assert any("Is it still clamped" in line for line in again.said)
    last = own.asked(resume=True)
    assert run(clamping, tmp_path / "C", last).rows == {"clamped": 128}
    assert any("Sweep 2 is made again from its start" in line for line in last.said)
    assert set(own.executions().values()) == {1}


def sweeps_with(shift: float, seed: int, robot, jacobian, stiffness) -> list[SweepRows]:
    """Four sweeps of white noise of the usual size; in the third one the flange shifts."""
    rng = np.random.default_rng(seed)
    offset = np.tile(np.concatenate([np.arange(1, 17), np.arange(15, -17, -1), np.arange(-15, 1)]), 2) * 7e-5
    found = []
    wound = -np.linalg.pinv(jacobian)[:, :3] @ np.full(3, shift / np.sqrt(3))
    step = motor_torques(robot, stiffness, np.zeros(6), wound[None])[0]
    for number in range(1, 5):
        tau = 0.07 * np.array([1.4, 0.9, 0.7, 0.3, 0.3, 0.2]) * rng.standard_normal((len(offset), 6))
        if number == 3:
            tau[64:] += step
        elif number == 4:
            tau += step
        turned = np.arange(6) == (1 if number % 2 else 2)
        direction = np.sign(np.diff(np.r_[0.0, offset]))
        found.append(SweepRows(number, number * 200.0 + np.arange(len(offset)) * 1.2, offset, direction, tau, turned))
    return found


def test_a_shift_of_a_tenth_of_a_millimetre_is_found_and_none_where_there_is_none(cell: Cell) -> None:
    from experiments.plans.press import flange_jacobian, rated_motor_torque
    from experiments.runs.load import loaded

    robot = cell.robot
    jacobian = flange_jacobian(robot, CLAMPED)
    stiffness = np.array([9.9, 14.2, 18.7, 2.1, 1.3, 0.6])
    for seed in range(20):
        found = find_shift(sweeps_with(1e-4, seed, robot, jacobian, stiffness)[:3], robot, stiffness, jacobian)
        assert found is not None
        assert (found.sweep, abs(found.step - 65) <= 3) == (3, True)
        assert 3e-5 < found.size < 3e-4
        assert find_shift(sweeps_with(0.0, seed, robot, jacobian, stiffness), robot, stiffness, jacobian) is None
    assert rated_motor_torque(robot).shape == (6,)
    motor = np.arange(16) * 0.01
    assert loaded(motor, 14.0 * motor, 14.0) is True
    assert loaded(motor, 0.5 + 0 * motor, 14.0) is False
    assert loaded(motor[:5], motor[:5], 14.0) is None
    assert replace(found, size=0.0).size == 0.0
