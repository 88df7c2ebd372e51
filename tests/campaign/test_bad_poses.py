"""Poses that no fit should be given without a word: renamed targets, too few poses, what a joint cannot move."""

from __future__ import annotations

from dataclasses import replace
from types import MappingProxyType

import numpy as np
import pandas as pd
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from experiments.campaign import Campaign, read_campaign
from experiments.checks.check import Finding, check_campaign
from experiments.checks.points import enough_poses
from experiments.simulate import simulate
from kinematics.poe import forward


@pytest.fixture(scope="module")
def campaign(tmp_path_factory: pytest.TempPathFactory) -> Campaign:
    folder = tmp_path_factory.mktemp("bad") / "arm"
    return read_campaign(simulate(folder, poses=40, seed=4, tables=("poses",)))


def told(campaign: Campaign, table: pd.DataFrame, **fields: object) -> list[Finding]:
    changed = replace(campaign, tables=MappingProxyType({"poses": table.reset_index(drop=True)}), **fields)
    return [f for f in check_campaign(changed) if f.severity != "note"]


def test_good_poses_are_passed_without_a_word(campaign: Campaign) -> None:
    assert told(campaign, campaign.tables["poses"]) == []


@pytest.mark.parametrize("count", [1, 2, 3, 4])
def test_few_poses_are_not_said_to_be_of_another_robot(campaign: Campaign, count: int) -> None:
    """After the first pose of a run, with targets 0.1 m off, "wrong robot, joint order or sign?" was said."""
    table = campaign.tables["poses"]
    poses = sorted(table["pose"].unique())[:count]
    targets = {name: np.array([0.1, 0.2, 0.3]) * (k - 1.0) for k, name in enumerate(sorted(campaign.targets))}
    words = [f.message for f in told(campaign, table[table["pose"].isin(poses)], targets=MappingProxyType(targets))]
    assert any("wrong robot" in w for w in words) == (count >= 4), words


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


def test_a_row_in_millimetres_is_a_wrong_row_and_many_are_an_error_that_says_where(campaign: Campaign) -> None:
    table = campaign.tables["poses"].copy()
    table.loc[10, "x_m"] *= 1000.0
    findings = told(campaign, table)
    assert {f.severity for f in findings} == {"warning"}
    assert any("1 of" in f.message and f.row == 11 for f in findings), findings
    table.loc[20:39, "x_m"] *= 1000.0
    (error,) = [f for f in told(campaign, table) if f.severity == "error"]
    assert "cannot be of this robot in metres" in error.message
    assert error.row is not None
    assert error.row == 11 or 21 <= error.row <= 40


@pytest.mark.parametrize("joint", range(1, 7))
def test_a_joint_of_the_wrong_sign_is_named(campaign: Campaign, joint: int) -> None:
    table = campaign.tables["poses"]
    found = told(campaign, table.assign(**{f"q{joint}_rad": -table[f"q{joint}_rad"]}))
    (error,) = [f for f in found if f.severity == "error"]
    assert f"they fit with the sign of joint {joint} turned" in error.message


def test_a_wrong_sign_that_errs_by_millimetres_is_named(campaign: Campaign) -> None:
    """A target 8 mm off joint 6's axis moves by as much when its sign is wrong."""
    table = campaign.tables["poses"].query("target == 'T1'").reset_index(drop=True)
    robot, near = campaign.robot, np.array([0.008, 0.0, 0.12])
    q = table[[f"q{i + 1}_rad" for i in range(6)]].to_numpy()
    place = forward(robot.screws, robot.flange, q @ robot.linkage.T) @ np.r_[near, 1.0]
    one = table.assign(**dict(zip(("x_m", "y_m", "z_m"), place[:, :3].T, strict=True)), q6_rad=-table["q6_rad"])
    targets = MappingProxyType({"T1": near})
    assert any("the sign of joint 6 turned" in f.message for f in told(campaign, one, targets=targets))
    right = one.assign(q6_rad=table["q6_rad"])
    assert not any("turned" in f.message for f in told(campaign, right, targets=targets))


def test_two_joints_exchanged_are_named(campaign: Campaign) -> None:
    table = campaign.tables["poses"].rename(columns={"q2_rad": "q3_rad", "q3_rad": "q2_rad"})
    found = told(campaign, table[campaign.tables["poses"].columns])
    assert any("they fit with joints 2 and 3 exchanged" in f.message and f.severity == "error" for f in found), found


@pytest.mark.parametrize(("poses", "few"), [(4, "4 poses are fewer than"), (7, "7 poses are hardly more than")])
def test_too_few_poses_with_orientations(campaign: Campaign, poses: int, few: str) -> None:
    table = campaign.tables["poses"].query("target == 'T1' and pose <= @poses").reset_index(drop=True)
    robot = campaign.robot
    q = table[[f"q{i + 1}_rad" for i in range(6)]].to_numpy()
    place = forward(robot.screws, robot.flange, q @ robot.linkage.T)
    quaternion = Rotation.from_matrix(place[:, :3, :3]).as_quat()[:, [3, 0, 1, 2]]
    full = table.assign(target="flange", **dict(zip(("x_m", "y_m", "z_m"), place[:, :3, 3].T, strict=True)))
    full = full.assign(**dict(zip(("qw", "qx", "qy", "qz"), quaternion.T, strict=True)))
    words = f"{few} the 5 that the geometry of 6 joints and the flange needs (30 parameters)"
    assert any(words in f.message for f in told(campaign, full)), told(campaign, full)
    fitted = check_campaign(replace(campaign, tables={**campaign.tables, "poses": full}), fits=True)
    assert any(words in f.message and f.severity == "error" for f in fitted), fitted
    assert any(f.message.endswith("measure 25 or more") for f in fitted)


@pytest.mark.parametrize(
    ("poses", "words"), [(4, "4 poses are fewer than the 5"), (9, "9 poses are hardly more than the 5")]
)
def test_too_few_poses(campaign: Campaign, poses: int, words: str) -> None:
    table = campaign.tables["poses"]
    found = told(campaign, table[table["pose"] <= poses])
    assert any(words in f.message and f.severity == "warning" for f in found), found
    between = told(campaign, table[table["pose"] <= 10])
    assert not any("that the geometry of" in f.message for f in between)
    said = "10 poses are few for the geometry of 6 joints and 3 targets (33 parameters): a model fitted to them may"
    assert [f.severity for f in between if f.message.startswith(said)] == ["warning"], between
    enough = enough_poses(table, 33)
    assert not any("for the geometry of" in f.message for f in told(campaign, table[table["pose"] <= enough]))


def test_a_target_on_the_last_joints_axis(campaign: Campaign) -> None:
    table = campaign.tables["poses"]
    middle = table.groupby(["pose", "visit"])[["x_m", "y_m", "z_m"]].transform("mean")  # of three around the axis
    one = table.assign(**{axis: middle[axis] for axis in middle})[table["target"] == "T1"]
    targets = MappingProxyType({"T1": np.array([0.0, 0.0, 0.12])})
    found = told(campaign, one, targets=targets)
    words = "T1: within 5 mm of joint 6's axis, which hardly moves it: zero offset, clearance and compliance of joint 6"
    assert any(words in f.message for f in found), found


def on_a_face(campaign: Campaign, axes: list[int], joints: list[int], noise: float) -> pd.DataFrame:
    """The poses' T1 brought to where its coordinates ``axes`` are as at the first pose, by moving ``joints``."""
    robot, place = campaign.robot, np.r_[campaign.targets["T1"], 1.0]
    table = campaign.tables["poses"].groupby("pose").first().reset_index().assign(target="T1", visit=1)
    names = [f"q{i + 1}_rad" for i in range(robot.n)]
    rng, kept, points = np.random.default_rng(0), [], []
    there = None
    for row, q in enumerate(table[names].to_numpy()):

        def point(at: np.ndarray, q: np.ndarray = q) -> np.ndarray:
            moved = q.copy()
            moved[joints] = at
            return (forward(robot.screws, robot.flange, moved) @ place)[:3]

        if there is None:
            there = point(q[joints])
        found = least_squares(lambda at: (point(at) - there)[axes], q[joints])  # noqa: B023 (run at once)
        if found.cost > 1e-12:
            continue
        table.loc[row, [names[j] for j in joints]] = found.x
        kept.append(row)
        points.append(point(found.x) + noise * rng.standard_normal(3))
    assert len(kept) >= 15
    return (
        table.loc[kept]
        .reset_index(drop=True)
        .assign(**dict(zip(("x_m", "y_m", "z_m"), np.array(points).T, strict=True)))
    )


@pytest.mark.parametrize(
    ("axes", "joints", "words"),
    [([2], [2], "the points lie in a plane"), ([1, 2], [0, 2], "the points lie on a line")],
)
def test_points_in_a_plane_or_on_a_line(campaign: Campaign, axes: list[int], joints: list[int], words: str) -> None:
    flat = [f for f in told(campaign, on_a_face(campaign, axes, joints, 1e-4)) if "the points lie" in f.message]
    assert [f.message.startswith(words) for f in flat] == [True]
    thick = [f for f in told(campaign, on_a_face(campaign, axes, joints, 0.1)) if "the points lie" in f.message]
    assert thick == []


@pytest.mark.parametrize("step", [1, -1])
def test_joint_angles_beside_the_points_of_the_next_stop_are_refused(campaign: Campaign, step: int) -> None:
    table = campaign.tables["poses"]
    stops = table.groupby(["pose", "visit"], sort=False).ngroup().to_numpy()
    angles = table[[f"q{i}_rad" for i in range(1, 7)]].groupby(stops).first().to_numpy()
    shifted = {f"q{i + 1}_rad": np.roll(angles[:, i], step)[stops] for i in range(6)}
    said = told(campaign, table.assign(**shifted))[0]
    assert said.severity == "error"
    other = "next" if step > 0 else "previous"
    assert f"the points of each visit are taken with the joint angles of the {other} one" in said.message
    assert "shifted against each other by one visit" in said.message


@pytest.mark.parametrize("step", [1, -1])
def test_joint_angles_beside_the_points_of_the_next_row_are_refused(campaign: Campaign, step: int) -> None:
    table = campaign.tables["poses"]
    said = told(
        campaign, table.assign(**{q: np.roll(table[q].to_numpy(), step) for q in table.filter(regex="^q._rad")})
    )[0]
    assert said.severity == "error"
    assert "shifted against each other by one row" in said.message


def test_too_few_poses_are_an_error_where_a_geometry_is_fitted_to_them(campaign: Campaign) -> None:
    """Seven poses gave 164 µm fitted, 7.3 mm held out, and not a word."""
    few = campaign.tables["poses"].query("pose <= 7")
    spoiled = replace(campaign, tables={**campaign.tables, "poses": few})
    (found,) = [f for f in check_campaign(spoiled, fits=True) if "that the geometry of" in f.message]
    assert found.severity == "error"
    assert found.message.endswith("measure 27 or more")
    assert all(f.severity != "error" for f in check_campaign(spoiled))
    enough = replace(campaign, tables={**campaign.tables, "poses": campaign.tables["poses"].query("pose <= 10")})
    assert not any("that the geometry of" in f.message for f in check_campaign(enough, fits=True))
