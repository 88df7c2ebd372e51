"""The posture of least torque: preload is searched away, within bounds, and a break does not lose what was found."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from run_controller import CLAMPED, Controller, clamping_plan

from clampid.planning.least_torque import search_for
from clampid.planning.press import Press, stiffness_of
from experiments.plans import Cell, Limits, Plan, read_plan, write_plan
from experiments.plans.press import rated_motor_torque
from experiments.runs.errors import RunStopped
from experiments.runs.folder import work_folder
from experiments.runs.journal import whole_lines
from experiments.runs.runner import run


@pytest.fixture(scope="module")
def searching(cell: Cell, limits: Limits) -> Plan:
    rated = rated_motor_torque(cell.robot)
    search = search_for(cell.robot, Press(np.full(6, 0.2), rated, stiffness_of(cell.robot, rated)[0], 1.6, 0.4))
    plan = clamping_plan(cell, limits, [(1, 1, CLAMPED)])
    return replace(plan, least_torque=search)


def test_a_plan_keeps_its_search(searching: Plan, tmp_path: Path) -> None:
    found = read_plan(write_plan(searching, tmp_path / "plan.toml")).least_torque
    np.testing.assert_array_equal(found.step, searching.least_torque.step)
    np.testing.assert_array_equal(found.within, searching.least_torque.within)


@pytest.mark.slow
def test_the_preload_is_searched_away_and_a_break_keeps_what_was_found(
    controller: Controller, searching: Plan, tmp_path: Path
) -> None:
    def broken(asked, where: str) -> None:
        def stop() -> None:
            raise RunStopped("enough for a test")

        moves = []

        def progress(done: float, text: str) -> None:
            moves.append(text)
            if where in text:
                stop()

        asked.progress = progress
        with pytest.raises(RunStopped, match="enough for a test"):
            run(searching, tmp_path / "C", asked)

    broken(controller.asked(), "step 17")
    entries = whole_lines((work_folder(tmp_path / "C") / "journal.jsonl").read_bytes())[0]
    found = next(e for e in entries if e["what"] == "least_torque")
    rated = rated_motor_torque(searching.cell.robot)
    before, after = (np.abs(np.array(found[k])) / rated for k in ("before", "after"))
    assert before.max() > 0.03  # a clamp presses in about 5 % of the rated torques
    assert after.max() < 0.02
    shift = np.array(found["posture"]) - searching.sweeps[0].posture
    assert np.all(np.abs(shift) <= searching.least_torque.within + 1e-9)
    assert run(searching, tmp_path / "C", controller.asked(resume=True)).rows == {"clamped": 64}
    kept = whole_lines(next((tmp_path / "C" / "journals").glob("*.jsonl")).read_bytes())[0]
    assert sum(e["what"] == "least_torque" for e in kept) == 1
    places = [e["to"] for e in kept if e["what"] == "move" and e["step"].startswith("sweep 1")]
    assert np.max(np.abs(np.array(places)[:, [0, 2, 3, 4, 5]] - np.array(found["posture"])[[0, 2, 3, 4, 5]])) < 1e-9


@pytest.mark.slow
def test_a_search_that_was_cut_goes_on(controller: Controller, searching: Plan, tmp_path: Path) -> None:
    asked, sent = controller.asked(), []

    def say_nothing(text: str) -> None:
        sent.append(text)

    asked.say = say_nothing
    asked.progress = lambda done, text: controller.operate("drives off") if "least torque" in text else None
    with pytest.raises(RunStopped):
        run(searching, tmp_path / "C", asked)
    controller.operate("drives on")
    again = controller.asked(resume=True)
    assert run(searching, tmp_path / "C", again).rows == {"clamped": 64}
    assert any("Is it still clamped" in line for line in again.said)
    assert any(line.startswith("Least torque in place 1") for line in again.said)


@pytest.mark.slow
def test_a_preload_beyond_the_bounds_ends_the_search_with_the_clamp_open(
    controller: Controller, searching: Plan, tmp_path: Path
) -> None:
    tight = replace(searching, least_torque=replace(searching.least_torque, within=searching.least_torque.step * 0.5))
    with pytest.raises(RunStopped, match=r"least torque: joint \d: expected it within .* the clamp was opened"):
        run(tight, tmp_path / "C", controller.asked())
    assert not controller.operate("state")["clamped"]
