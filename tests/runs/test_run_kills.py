"""Runner, controller, network and instrument killed at random moments; the controller's own journal is the truth."""

from __future__ import annotations

from pathlib import Path

import pytest
from run_controller import CLAMPED, Controller, clamping_plan
from run_kills import kill_and_resume

from experiments.campaign import read_campaign
from experiments.plans import Cell, Limits, Plan


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["poses", "free_air", "clamping"])
def test_nothing_is_lost_twice_or_moved_unasked(
    kind: str, own: Controller, poses: Plan, free_air: Plan, cell: Cell, limits: Limits, tmp_path: Path
) -> None:
    plan = {
        "poses": poses,
        "free_air": free_air,
        "clamping": clamping_plan(cell, limits, [(1, 1, CLAMPED), (1, 2, CLAMPED)]),
    }[kind]
    counts = kill_and_resume(own, plan, tmp_path / "C", 5, 11, longest=0.6 if kind == "poses" else 1.5)
    assert counts.kills
    assert counts.harm() == 0, counts
    read_campaign(tmp_path / "C")
