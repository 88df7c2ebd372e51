"""Poses that no fit should be given without a word: renamed targets, too few poses, what a joint cannot move."""

from __future__ import annotations

from dataclasses import replace
from types import MappingProxyType

import numpy as np
import pandas as pd
import pytest

from experiments.campaign import Campaign, read_campaign
from experiments.check import Finding, check_campaign
from experiments.simulate import simulate


@pytest.fixture(scope="module")
def campaign(tmp_path_factory: pytest.TempPathFactory) -> Campaign:
    folder = tmp_path_factory.mktemp("bad") / "arm"
    return read_campaign(simulate(folder, poses=40, seed=4, tables=("poses",)))


def told(campaign: Campaign, table: pd.DataFrame, **fields: object) -> list[Finding]:
    changed = replace(campaign, tables=MappingProxyType({"poses": table.reset_index(drop=True)}), **fields)
    return [f for f in check_campaign(changed) if f.severity != "note"]


def test_good_poses_are_passed_without_a_word(campaign: Campaign) -> None:
    assert told(campaign, campaign.tables["poses"]) == []


def test_three_targets_renamed_everywhere(campaign: Campaign) -> None:
    table = campaign.tables["poses"].copy()
    table["target"] = table["target"].map({"T1": "T2", "T2": "T3", "T3": "T1"})
    words = [f.message for f in told(campaign, table)]
    assert any("they fit with targets renamed: T1 is T3, T2 is T1, T3 is T2" in w for w in words), words


def test_three_targets_swapped_at_some_poses(campaign: Campaign) -> None:
    table = campaign.tables["poses"].copy()
    some = table["pose"].isin([3, 7])
    table.loc[some, "target"] = table.loc[some, "target"].map({"T1": "T2", "T2": "T3", "T3": "T1"})
    (error,) = [f for f in told(campaign, table) if f.severity == "error"]
    assert "targets are swapped at poses 3, 7: " in error.message
    for named, is_ in (("T2", "T1"), ("T3", "T2"), ("T1", "T3")):
        assert f"{named} lies where {is_} should" in error.message
    assert error.row == int(np.flatnonzero(some)[0]) + 1


def test_a_point_that_is_just_wrong_is_not_called_swapped(campaign: Campaign) -> None:
    table = campaign.tables["poses"].copy()
    table.loc[10, "x_m"] += 0.3
    findings = told(campaign, table)
    assert not any("swapped at" in f.message for f in findings)
    assert any("1 of" in f.message and f.row == 11 for f in findings)


@pytest.mark.parametrize(
    ("poses", "words"), [(4, "4 poses are fewer than the 5"), (9, "9 poses are hardly more than the 5")]
)
def test_too_few_poses(campaign: Campaign, poses: int, words: str) -> None:
    table = campaign.tables["poses"]
    found = told(campaign, table[table["pose"] <= poses])
    assert any(words in f.message and f.severity == "warning" for f in found), found
    assert not any("takes at the least" in f.message for f in told(campaign, table[table["pose"] <= 10]))


def test_a_target_on_the_last_joints_axis(campaign: Campaign) -> None:
    table = campaign.tables["poses"]
    middle = table.groupby(["pose", "visit"])[["x_m", "y_m", "z_m"]].transform("mean")  # of three around the axis
    one = table.assign(**{axis: middle[axis] for axis in middle})[table["target"] == "T1"]
    targets = MappingProxyType({"T1": np.array([0.0, 0.0, 0.12])})
    found = told(campaign, one, targets=targets)
    words = "T1: within 5 mm of joint 6's axis, which hardly moves it: zero offset, clearance and compliance of joint 6"
    assert any(words in f.message for f in found), found
