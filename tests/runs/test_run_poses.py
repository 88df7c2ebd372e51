"""Poses over sockets: rows as planned, in a folder that identify reads; after every break it goes on where it stood."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from run_controller import Controller

from experiments.campaign import read_campaign
from experiments.instruments import Sample, connect_instrument
from experiments.plans import Plan, PlanError, Visit
from experiments.runs import poses as poses_module
from experiments.runs.context import Context
from experiments.runs.errors import RunStopped
from experiments.runs.folder import work_folder
from experiments.runs.runner import run


def test_every_planned_row_is_in_the_folder(controller: Controller, poses: Plan, tmp_path: Path) -> None:
    asked = controller.asked()
    outcome = run(poses, tmp_path / "C", asked)
    campaign = read_campaign(tmp_path / "C")
    assert outcome.rows == {"poses": 21, "verification": 3} == {k: len(v) for k, v in campaign.tables.items()}
    assert not work_folder(tmp_path / "C").exists()
    first = campaign.tables["poses"].iloc[0]
    visit = poses.visits[0]
    np.testing.assert_allclose([first[f"q{i}_rad"] for i in range(1, 7)], visit.q, atol=2e-5)
    np.testing.assert_array_equal([first[f"dir{i}"] for i in range(1, 7)], visit.direction)
    assert np.all(np.diff(campaign.tables["poses"]["time_s"]) > 0)
    assert set(controller.executions().values()) == {1}
    assert {"temp_motor1_C", "temp_ambient_C"} <= set(campaign.tables["poses"].columns)
    with pytest.raises(PlanError, match="expected no table poses yet"):
        run(poses, tmp_path / "C", controller.asked())


def test_a_hidden_target_is_tried_again_then_skipped_and_listed(
    controller: Controller, poses: Plan, tmp_path: Path
) -> None:
    controller.operate("sight lost 2")  # found at the third attempt
    asked = controller.asked()
    asked.progress = lambda done, text: controller.operate("sight lost 3") if "pose 2, visit 1" in text else None
    outcome = run(poses, tmp_path / "C", asked)
    assert outcome.skipped == (
        f"T1 at pose 2: instrument at {controller.tracker.removeprefix('tcp://')}: line of sight lost",
    )
    assert outcome.rows == {"poses": 20, "verification": 3}


def test_distances_become_a_table_of_their_own(controller: Controller, poses: Plan, tmp_path: Path) -> None:
    station = np.array([4.0, 1.0, 0.5])

    class Interferometer:
        """Measures how far a target is, by means of the tracker."""

        def __init__(self) -> None:
            self.tracker = connect_instrument(controller.tracker)
            self.targets = self.tracker.targets
            self.truth: list[float] = []

        def measure(self, target: str, count: int, patience: float) -> Sample:
            seen = self.tracker.measure(target, count, patience)
            self.truth.append(float(np.linalg.norm(seen.point_m - station)))
            return Sample(np.array([self.truth[-1], np.nan, np.nan]), np.full(3, np.nan), 1, seen.time_s)

        def temperatures(self) -> dict[str, float]:
            return {}

        def close(self) -> None:
            self.tracker.close()

    made: list[Interferometer] = []
    asked = controller.asked()
    asked.instrument = lambda: made.append(Interferometer()) or made[0]
    plan = replace(poses, visits=tuple(v for v in poses.visits if v.table == "poses"))
    assert run(plan, tmp_path / "C", asked).rows == {"distances": 21}
    table = read_campaign(tmp_path / "C").tables["distances"]
    np.testing.assert_allclose(table["distance_m"], made[0].truth)
    assert set(table["anchor"]) == {"instrument"}
    with pytest.raises(PlanError, match="expected no table distances yet"):
        run(plan, tmp_path / "C", controller.asked())
    again = controller.asked()
    again.instrument = Interferometer
    with pytest.raises(RunStopped, match="verification: expected points, found an instrument that measures distances"):
        run(replace(poses, visits=poses.visits[-1:]), tmp_path / "D", again)


@pytest.mark.slow
def test_a_silent_instrument_stops_the_run_and_resume_goes_on(
    controller: Controller, poses: Plan, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("experiments.runs.poses.PATIENCE", 0.3)
    asked = controller.asked()
    arrive = poses_module._arrive

    def arrive_and_fall_silent(context: Context, visit: Visit, before: np.ndarray | None, name: str) -> None:
        arrive(context, visit, before, name)
        if visit.pose == 4:
            controller.operate("sight silent 3")

    monkeypatch.setattr(poses_module, "_arrive", arrive_and_fall_silent)
    with pytest.raises(RunStopped, match=r"no answer to .* within"):
        run(poses, tmp_path / "C", asked)
    with pytest.raises(PlanError, match="--resume"):
        run(poses, tmp_path / "C", controller.asked())
    monkeypatch.setattr("experiments.runs.poses.PATIENCE", 10.0)
    monkeypatch.setattr(poses_module, "_arrive", arrive)
    again = controller.asked(resume=True)
    assert run(poses, tmp_path / "C", again).rows == {"poses": 21, "verification": 3}
    assert any("Recorded so far: 9 rows of poses" in line for line in again.said)
    assert not any("No plan has checked" in line for line in again.said)  # it stood on the planned way
    assert set(controller.executions().values()) == {1}


def test_without_a_person_nothing_moves_after_a_break(controller: Controller, poses: Plan, tmp_path: Path) -> None:
    asked = controller.asked()
    asked.finished = lambda block: (_ for _ in ()).throw(RunStopped("enough for a test"))
    with pytest.raises(RunStopped, match="enough"):
        run(poses, tmp_path / "C", asked)
    moved = len(controller.executions())

    class Nobody:
        def confirm(self, facts: str, question: str) -> None:
            assert "The robot stands at" in facts
            raise RunStopped("a person said no")

    again = controller.asked(resume=True)
    again.person = Nobody()
    with pytest.raises(RunStopped, match="said no"):
        run(poses, tmp_path / "C", again)
    assert len(controller.executions()) == moved


def test_a_stop_at_the_controller_ends_the_run_safely(controller: Controller, poses: Plan, tmp_path: Path) -> None:
    asked = controller.asked()
    asked.progress = lambda done, text: controller.operate("mode T1") if "pose 3" in text else None
    with pytest.raises(RunStopped, match="mode"):
        run(poses, tmp_path / "C", asked)
    controller.operate("mode EXT")
    assert run(poses, tmp_path / "C", controller.asked(resume=True)).rows["poses"] == 21


def test_another_plan_does_not_go_on_with_a_stopped_run(controller: Controller, poses: Plan, tmp_path: Path) -> None:
    asked = controller.asked()
    asked.finished = lambda block: (_ for _ in ()).throw(RunStopped("enough for a test"))
    with pytest.raises(RunStopped, match="enough"):
        run(poses, tmp_path / "C", asked)
    with pytest.raises(PlanError, match="expected the plan whose run was stopped"):
        run(replace(poses, measure_time=1.0), tmp_path / "C", controller.asked(resume=True))
