"""Further measurements: put behind the plan, on the disk before they are run, and no more than the budget."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from run_controller import CLAMPED, Controller, clamping_plan

from clampid.diagnosis.next_measurement import COOLING, NextPlan
from clampid.diagnosis.pools import cell_of as limits_for_proposals
from clampid.loop.adaptive import Adaptive, rested
from experiments.campaign import Campaign, CampaignError, read_campaign
from experiments.plans import Cell, Limits, Plan, PlanError, limits_of
from experiments.plans.virtual import run_virtually
from experiments.runs.errors import RunStopped
from experiments.runs.extension import extended
from experiments.runs.runner import run


def test_a_plan_goes_on_with_numbers_of_its_own(poses: Plan, free_air: Plan, cell: Cell, limits: Limits) -> None:
    grown = extended(poses, poses, 3)
    assert [v.pose for v in grown.visits[-3:]] == [7, 8, 9]
    assert len({(v.table, v.pose, v.visit) for v in grown.visits}) == len(poses.visits) + 3
    assert grown.duration == pytest.approx(poses.duration * (1.0 + 3 / len(poses.visits)))  # not the whole plan's time
    assert len(extended(free_air, free_air, 1).runs) == 3
    clamping = clamping_plan(cell, limits, [(1, 1, CLAMPED)])
    assert [s.clamping for s in extended(clamping, clamping, 5).sweeps] == [1, 2]
    with pytest.raises(PlanError, match="expected poses of"):
        extended(poses, free_air, 1)


def test_what_was_decided_is_run_and_survives_a_break(controller: Controller, poses: Plan, tmp_path: Path) -> None:
    short = replace(poses, visits=poses.visits[:2])
    asked = controller.asked()
    grown = extended(short, poses, 2)
    asked.more = lambda plan, entries: (grown, "a reason") if len(plan.visits) == 2 else (None, "enough")
    asked.progress = lambda done, text: controller.operate("drives off") if "pose 4" in text else None
    with pytest.raises(RunStopped):
        run(short, tmp_path / "C", asked)
    controller.operate("drives on")
    again = controller.asked(resume=True)
    again.more = asked.more
    outcome = run(short, tmp_path / "C", again)
    assert outcome.rows == {"poses": 12}
    assert outcome.notes == ("a reason", "enough")
    assert read_campaign(tmp_path / "C").tables["poses"]["pose"].unique().tolist() == [1, 2, 3, 4]
    assert (tmp_path / "C" / "journals" / "poses-1-2.toml").is_file()


def test_nothing_is_added_where_nothing_is_ambiguous_or_the_budget_is_used_up(poses: Plan) -> None:
    said: list[str] = []
    adaptive = Adaptive(poses, None, 2, said.append)
    assert adaptive.more(extended(poses, poses, 2), []) == (None, said[-1])
    assert "the budget of 2 is used up" in said[-1]
    assert adaptive.more(poses, []) == (None, said[-1])
    assert "diagnose cannot judge" in said[-1]
    rows = []
    rng = np.random.default_rng(1)
    for visit in poses.visits[:3]:
        for target in visit.targets:
            row = {"pose": visit.pose, "visit": visit.visit, "time_s": float(len(rows)), "target": target}
            row |= {f"q{i + 1}_rad": float(v) for i, v in enumerate(visit.q)}
            row |= {f"dir{i + 1}": int(v) for i, v in enumerate(visit.direction)}
            row |= dict(zip(("x_m", "y_m", "z_m"), rng.normal(size=3), strict=True))
            rows.append({"what": "row", "table": "poses", "row": row})
    assert adaptive.more(poses, rows)[0] is None
    assert said[-1].startswith("Adaptive: nothing more is measured")


def test_a_cold_robot_is_one_that_has_rested(poses: Plan) -> None:
    def proposed(state: str) -> NextPlan:
        return NextPlan("parting", (0,), 9, state, ("pose", "poses"), "", poses)

    cold, warm = rested(proposed("cold")), rested(proposed("warm"))
    assert [v.wait for v in cold.visits] == [COOLING] + [0.0] * (len(poses.visits) - 1)
    assert cold.duration == poses.duration + COOLING
    assert warm is poses


def test_what_is_proposed_keeps_to_the_ranges_of_the_plan(
    free_air: Plan, cell: Cell, limits: Limits, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Diagnose takes its limits from the campaign's robot: that one reaches no farther than the plan lets it."""
    import clampid.loop.separating as separating

    narrow = replace(free_air, limits=limits_of(cell.robot, share=0.5)[0])
    table = read_campaign(run_virtually(free_air, tmp_path / "C", seed=3)).tables["free_air"]
    seen = []

    def stopped(model: object, campaign: Campaign, **more: object) -> None:
        seen.append(limits_for_proposals(campaign)[1])
        raise CampaignError("enough for a test")

    monkeypatch.setattr(separating, "diagnose", stopped)
    log = {"what": "log", "table": "free_air", "columns": {name: values.tolist() for name, values in table.items()}}
    for plan, wanted in ((free_air, limits), (narrow, narrow.limits)):
        assert Adaptive(plan, None, 20, lambda text: None).more(plan, [log])[0] is None
        assert np.all((seen[-1].lower >= wanted.lower) & (seen[-1].upper <= wanted.upper))
    assert np.all((seen[0].lower < narrow.limits.lower) & (seen[0].upper > narrow.limits.upper))
