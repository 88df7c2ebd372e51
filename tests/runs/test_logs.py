"""Logs in free air over sockets: speeds as planned, one even clock from move to move, gaps said."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from run_controller import Controller

from experiments.campaign import read_campaign
from experiments.plans import Plan, PlanError
from experiments.runs.errors import RunStopped
from experiments.runs.robot import share_of
from experiments.runs.runner import run


def test_moves_are_logged_at_the_plan_s_speeds(controller: Controller, free_air: Plan, tmp_path: Path) -> None:
    controller.operate("speed 10")
    asked = controller.asked()
    asked.instrument = None
    run(free_air, tmp_path / "C", asked)
    table = read_campaign(tmp_path / "C").tables["free_air"]
    for number, planned in enumerate(free_air.runs, 1):
        rows = table[table["run"] == number]
        q = rows[[f"q{i}_rad" for i in range(1, 7)]].to_numpy()
        steps = np.diff(rows["time_s"])
        np.testing.assert_allclose(steps, 0.096, atol=1e-6)
        reached = np.max(np.abs(np.diff(q, axis=0)) / 0.096, axis=0)
        wanted = np.max(np.abs(planned.course.at(np.arange(0, planned.course.length, 0.05))[1]), axis=0)
        assert np.all(reached < 1.01 * wanted)
        assert np.all(reached > 0.8 * wanted)
        for knot in planned.course.knots:
            assert np.min(np.max(np.abs(q - knot), axis=1)) < 1e-4
    assert np.ptp(table["tau2_Nm"]) > 1.0


def test_a_broken_network_leaves_no_hole_in_the_log(controller: Controller, free_air: Plan, tmp_path: Path) -> None:
    controller.operate("speed 10")
    asked = controller.asked()
    asked.instrument = None
    asked.progress = lambda done, text: controller.operate("kill-link") if "move 2" in text else None
    before = len(controller.executions())
    try:
        outcome = run(free_air, tmp_path / "C", asked)
    except RunStopped:
        asked = controller.asked(resume=True)
        asked.instrument = None
        outcome = run(free_air, tmp_path / "C", asked)
    assert not outcome.notes
    steps = np.concatenate(
        [np.diff(rows["time_s"]) for _, rows in read_campaign(tmp_path / "C").tables["free_air"].groupby("run")]
    )
    assert np.median(steps) == pytest.approx(0.096, abs=1e-6)
    assert set(controller.executions().values()) == {1}
    assert len(controller.executions()) > before


def test_torques_of_an_unknown_unit_are_refused(controller: Controller, free_air: Plan, tmp_path: Path) -> None:
    from experiments.links.address import open_link

    asked = controller.asked()
    asked.link = lambda: open_link(controller.link.partition("?")[0])
    with pytest.raises(PlanError, match=r"add \?torque=Nm"):
        run(free_air, tmp_path / "C", asked)


def test_a_share_is_rounded_down_and_never_below_a_percent(cell) -> None:
    top = np.array([joint.max_speed for joint in cell.robot.joints])
    assert share_of(cell.robot, 0.1999 * top, 1.5, 0.5) == 0.19
    assert share_of(cell.robot, 0.2 * top, 1.5, 0.5) == 0.2
    assert share_of(cell.robot, 0.001 * top, 1.5, 0.5) == 0.01
    assert share_of(cell.robot, 5.0 * top, 1.5, 0.5) == 1.0


def test_several_plans_fill_one_folder(controller: Controller, free_air: Plan, poses: Plan, tmp_path: Path) -> None:
    short = replace(poses, visits=poses.visits[:2])
    run(short, tmp_path / "C", controller.asked())
    asked = controller.asked()
    asked.instrument = None
    run(replace(free_air, runs=free_air.runs[:1]), tmp_path / "C", asked)
    campaign = read_campaign(tmp_path / "C")
    assert set(campaign.tables) == {"poses", "free_air"}
    assert len(campaign.tables["poses"]) == 6
    assert {p.name for p in (tmp_path / "C" / "journals").iterdir()} == {
        "poses-1.jsonl", "poses-1.toml", "free_air-1.jsonl", "free_air-1.toml",
    }  # fmt: skip
    other = replace(free_air, cell=replace(free_air.cell, tool_mass=3.0))
    with pytest.raises(PlanError, match="campaign of the plan's cell: tool"):
        run(replace(other, kind="wrist"), tmp_path / "C", controller.asked())
