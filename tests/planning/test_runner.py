"""The runner: stopped and resumed it measures every step once, and what it must not touch it leaves alone."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from experiments.campaign import read_campaign
from experiments.plans import Course, Plan, PlanError, PlanStopped
from experiments.plans.runner import run_plan, work_folder
from experiments.plans.virtual import VirtualRobot


class Counting(VirtualRobot):
    """A virtual robot that counts what it is told."""

    logs = 0

    def log(self, course: Course, rate: float) -> pd.DataFrame:
        self.logs += 1
        return super().log(course, rate)

    def declared(self) -> Mapping[str, Any]:
        return {**super().declared(), "robot": "another"}


@pytest.fixture
def short(free_air: Plan) -> Plan:
    """Three runs of three moves."""
    run = free_air.runs[0]
    course = run.course
    cut = replace(course, knots=course.knots[:4], duration=course.duration[:3], ramp=course.ramp[:3])
    return replace(free_air, runs=(replace(run, course=cut),) * 3)


def test_stopped_and_resumed_it_is_whole(short: Plan, tmp_path: Path) -> None:
    first = Counting(short.cell.robot)
    with pytest.raises(PlanStopped, match=r"stopped before run 3 \(3 of 3\)"):
        run_plan(short, first, tmp_path / "arm", stop=lambda: first.logs == 2)
    assert not (tmp_path / "arm").exists()
    assert work_folder(tmp_path / "arm").is_dir()
    second = Counting(short.cell.robot)
    folder = run_plan(short, second, tmp_path / "arm")
    assert (first.logs, second.logs) == (2, 1)
    assert not work_folder(folder).exists()
    table = read_campaign(folder).tables["free_air"]
    assert sorted(table["run"].unique()) == [1, 2, 3]
    assert np.all(np.diff(table.groupby("run")["time_s"].min()) > 0)  # the second session's clock began at 0 again


def test_the_same_run_gives_the_same_rows(short: Plan, tmp_path: Path) -> None:
    a, b = (run_plan(short, VirtualRobot(short.cell.robot, seed=4), tmp_path / name) for name in "ab")
    assert read_campaign(a).fingerprint == read_campaign(b).fingerprint


def test_the_header_is_the_cells(short: Plan, tmp_path: Path) -> None:
    campaign = read_campaign(run_plan(short, Counting(short.cell.robot), tmp_path / "arm", file_format="csv"))
    assert campaign.robot.name == "kuka_kr20_r1810"
    assert campaign.instrument.name == "virtual laser tracker"
    assert campaign.tool.mass == 12.0


def test_another_plan_does_not_go_on_in_its_place(short: Plan, tmp_path: Path) -> None:
    robot = Counting(short.cell.robot)
    with pytest.raises(PlanStopped):
        run_plan(short, robot, tmp_path / "arm", stop=lambda: robot.logs == 1)
    with pytest.raises(PlanError, match="expected the plan whose run was stopped"):
        run_plan(replace(short, rate=5.0), robot, tmp_path / "arm")


def test_a_folder_with_something_in_it_is_left_alone(short: Plan, tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(PlanError, match="expected a new or empty folder"):
        run_plan(short, VirtualRobot(short.cell.robot), tmp_path)


def test_nothing_moves_for_a_plan_beyond_its_limits(short: Plan, tmp_path: Path) -> None:
    robot = Counting(short.cell.robot)
    slow = replace(short, limits=replace(short.limits, speed=short.limits.speed / 100))
    with pytest.raises(PlanError, match="run 1, move 1"):
        run_plan(slow, robot, tmp_path / "arm")
    assert robot.logs == 0


def test_unknown_hidden_effects_are_refused(short: Plan) -> None:
    with pytest.raises(PlanError, match="gremlins"):
        VirtualRobot(short.cell.robot, ["gremlins"])
