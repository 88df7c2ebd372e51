"""A tool that is another in the poses than in the logs is found there; without logs there is nothing to differ from."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

import numpy as np
import pytest

from clampid.diagnosis.diagnose import diagnose
from clampid.identification.identify import identify
from experiments.campaign import Campaign, read_campaign
from experiments.simulate import simulate
from experiments.virtual_robot import Plant

HEAVIER, FARTHER = 10.0, np.array([0.0, 0.03, 0.05])  # kg, m


def other_tool(plant: Plant) -> Plant:
    masses = plant.masses
    return replace(plant, masses=replace(masses, tool=masses.tool + HEAVIER, tool_com=masses.tool_com + FARTHER))


def campaign_of(folder: Path, seed: int) -> Campaign:
    """Logs with the tool that is declared, poses of the same arm with another one."""
    simulate(folder / "logs", seed=seed, tables=("free_air", "wrist"))
    simulate(folder / "poses", seed=seed, poses=80, tables=("poses",), alter=other_tool)
    logs, poses = (read_campaign(folder / name) for name in ("logs", "poses"))
    return replace(logs, tables=MappingProxyType({**logs.tables, **poses.tables}))


@pytest.mark.slow
@pytest.mark.parametrize("seed", [2, 5])
def test_another_tool_in_the_poses_than_in_the_logs_is_named(seed: int, tmp_path: Path):
    campaign = campaign_of(tmp_path, seed)
    found = diagnose(identify(campaign), campaign, stages=["poses"]).stages["poses"]
    assert found.verdict == "missing"
    assert [(c["effect"], c["where"]) for c in found.candidates] == [("payload", ["tool"])]
    told = {p["name"].partition(".")[2].partition("@")[0]: p for p in found.candidates[0]["parameters"]}
    assert abs(told["m"]["value"] - HEAVIER) < 4.0 * told["m"]["std"]
    assert found.after < 0.75 * found.before


def test_poses_alone_have_no_logs_to_differ_from(tmp_path: Path):
    simulate(tmp_path / "arm", seed=2, poses=40, tables=("poses",))
    campaign = read_campaign(tmp_path / "arm")
    found = diagnose(identify(campaign), campaign).stages["poses"]
    names = {t["name"] for t in found.testability}
    assert "payload" in names
    assert "pose_payload" not in names
