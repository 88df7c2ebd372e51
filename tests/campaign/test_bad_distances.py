"""The table of distances: what breaks the format is refused; what cannot be right, or locate an anchor, is said."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from import_call import call

from experiments.campaign import Campaign, CampaignError, read_campaign, write_campaign
from experiments.checks.check import Finding, check_campaign, holdings
from experiments.measures.lateration import locate
from experiments.simulate import simulate
from experiments.virtual_robot import measure
from kinematics.description import load_robot
from kinematics.poe import forward

Edit = Callable[[pd.DataFrame], pd.DataFrame]


@pytest.fixture(scope="module")
def campaign(tmp_path_factory: pytest.TempPathFactory) -> Campaign:
    folder = tmp_path_factory.mktemp("distances") / "arm"
    return read_campaign(simulate(folder, poses=40, seed=4, tables=("distances",), file_format="csv"))


def told(campaign: Campaign, table: pd.DataFrame) -> list[Finding]:
    changed = replace(campaign, tables=MappingProxyType({"distances": table.reset_index(drop=True)}))
    return [f for f in check_campaign(changed) if f.severity != "note"]


def test_a_good_table_is_read_and_passed(campaign: Campaign) -> None:
    table = campaign.tables["distances"]
    assert told(campaign, table) == []
    assert campaign.instrument.distance_std == 1e-5
    held = holdings(campaign)["tables"]["distances"]
    assert (held["poses"], held["anchors"], held["targets"]) == (40, ["A1", "A2", "A3"], ["T1", "T2", "T3"])
    (note,) = [f for f in check_campaign(campaign) if f.table == "distances" and f.column == "anchor"]
    assert "do not determine where the robot's base stands" in note.message


@pytest.mark.parametrize(
    ("edit", "words"),
    [
        (lambda t: t.drop(columns="anchor"), "a column 'anchor'"),
        (lambda t: t.rename(columns={"distance_m": "distance_mm"}), "'distance_mm' in place of 'distance_m'"),
        (lambda t: t.assign(distance_m=-t["distance_m"]), "expected a finite number not below 0"),
        (lambda t: t.assign(distance_m=t["distance_m"].where(t.index != 4)), "row 5 (line 6), column distance_m"),
        (
            lambda t: t.assign(anchor=t["anchor"].where(t.index != 2)),
            "row 3 (line 4), column anchor: expected text, found an empty cell",
        ),
        (lambda t: t.assign(target="elsewhere"), "expected a target of [targets_m]"),
        (lambda t: pd.concat([t, t.iloc[[7]]], ignore_index=True), "expected every measurement once"),
    ],
)
def test_what_breaks_the_format_is_refused(campaign: Campaign, tmp_path: Path, edit: Edit, words: str) -> None:
    table = edit(campaign.tables["distances"].copy())
    write_campaign(tmp_path / "arm", dict(campaign.header), {"distances": table}, "csv")
    with pytest.raises(CampaignError) as error:
        read_campaign(tmp_path / "arm")
    assert words in str(error.value)


def test_a_stated_error_in_millimetres_is_refused(campaign: Campaign, tmp_path: Path) -> None:
    header = {**campaign.header, "instrument": {"name": "ballbar", "distance_std_m": 0.01}}
    write_campaign(tmp_path / "arm", header, dict(campaign.tables))
    with pytest.raises(
        CampaignError, match=r"instrument\.distance_std_m: expected .* of m above 0 and not above 0.005.*millimetres"
    ):
        read_campaign(tmp_path / "arm")


@pytest.mark.parametrize(("factor", "unit"), [(1e3, "millimetres"), (1 / 0.0254, "inches"), (100.0, "centimetres")])
def test_another_unit_is_named(campaign: Campaign, factor: float, unit: str) -> None:
    table = campaign.tables["distances"]
    (error,) = told(campaign, table.assign(distance_m=factor * table["distance_m"]))
    assert (error.severity, error.column) == ("error", "distance_m")
    assert f"distances look like {unit}" in error.message


def test_a_distance_of_nothing_is_an_error(campaign: Campaign) -> None:
    table = campaign.tables["distances"].copy()
    table.loc[8, "distance_m"] = 0.0
    assert [(f.severity, f.row) for f in told(campaign, table)] == [("error", 9)]


def test_an_anchor_that_few_poses_see_is_named(campaign: Campaign) -> None:
    table = campaign.tables["distances"]
    (found,) = told(campaign, table[(table["anchor"] != "A2") | (table["pose"] <= 3)])
    assert "anchor A2 is seen from 3 poses: three are needed to locate the anchor itself" in found.message


def test_too_few_distances_are_said(campaign: Campaign) -> None:
    table = campaign.tables["distances"]
    words = " ".join(f.message for f in told(campaign, table[table["pose"] <= 10]))
    assert "30 distances are fewer than the 36 numbers" in words


def flat(campaign: Campaign, anchor: np.ndarray, plane: bool) -> pd.DataFrame:
    """Distances to one target at poses in which it stays in a plane, or on a line."""
    robot, rng = campaign.robot, np.random.default_rng(0)
    q = np.tile([0.0, -1.2, 1.5, 0.0, 0.5, 0.0], (40, 1))
    q[:, 0] = rng.uniform(-1.5, 1.5, 40)
    if plane:  # joint 1 turns; the plane of the circle
        q[:, 5] = 0.0
    pose = forward(robot.screws, robot.flange, q)
    at = pose[:, :3, :3] @ campaign.targets["T1"] + pose[:, :3, 3]
    table = pd.DataFrame({"pose": np.arange(40), "visit": 1, "time_s": np.arange(40.0)})
    table[[f"q{i + 1}_rad" for i in range(6)]] = q
    table[[f"dir{i + 1}" for i in range(6)]] = 0
    return table.assign(target="T1", anchor="A1", distance_m=np.linalg.norm(at - anchor, axis=1))


def test_points_in_a_plane_leave_two_places(campaign: Campaign) -> None:
    words = [f.message for f in told(campaign, flat(campaign, np.array([0.3, 0.2, 0.1]), plane=True))]
    assert any("lie in a plane: it may be on either side" in w for w in words), words


@pytest.mark.parametrize(
    ("edit", "column", "words"),
    [
        *(
            (lambda t, c=f"q{j}_rad": t.assign(**{c: -t[c]}), f"q{j}_rad", f"the sign of joint {j} turned")
            for j in (1, 3, 6)
        ),
        (lambda t: t.assign(q2_rad=t["q3_rad"], q3_rad=t["q2_rad"]), "q2_rad", "joints 2 and 3 exchanged"),
        (
            lambda t: t.assign(target=t["target"].replace({"T1": "T2", "T2": "T1"})),
            "target",
            "targets T1 and T2 swapped",
        ),
        (
            lambda t: t.assign(target=t["target"].replace({"T1": "T2", "T2": "T3", "T3": "T1"})),
            "target",
            "targets renamed: T1 is T3, T2 is T1, T3 is T2",
        ),
    ],
)
def test_a_mistake_that_explains_all_distances_is_named(
    campaign: Campaign, edit: Edit, column: str, words: str
) -> None:
    first = campaign.tables["distances"].query("anchor == 'A1'")
    found = [f for f in told(campaign, edit(first)) if f.severity == "error"]
    assert [(f.column, f.message.partition("they fit with ")[2]) for f in found] == [(column, words)]


@pytest.mark.slow
def test_an_anchor_moved_or_misnamed_is_said(campaign: Campaign) -> None:
    table = campaign.tables["distances"].copy()
    table.loc[table["pose"] % 2 == 0, "anchor"] = "A1"
    (found,) = told(campaign, table)
    assert "41 of 88 distances to anchor A1 are far from where the others say" in found.message
    other = campaign.tables["distances"].assign(q3_rad=0.9 * table["q3_rad"] + 0.2)  # no mistake of signs or names
    assert [f.message[:28] for f in told(campaign, other) if "wrong robot" in f.message][:1] == [
        "distances to anchor A1 stay "
    ]
    table = campaign.tables["distances"].copy()
    table.loc[30, "distance_m"] += 0.2
    (found,) = told(campaign, table)
    assert "1 of" in found.message
    assert found.row == 31


@pytest.mark.parametrize(("constant", "which"), [(0.06, "long"), (-0.03, "short")])
def test_a_zero_elsewhere_is_said(campaign: Campaign, constant: float, which: str) -> None:
    table = campaign.tables["distances"]
    wire = np.where(table["anchor"] == "A2", constant, 0.0)
    (found,) = told(campaign, table.assign(distance_m=table["distance_m"] + wire))
    assert found.severity == "warning"
    assert f"distances to anchor A2 are all too {which} by about" in found.message
    assert "additive_constant" in found.message


def test_measured_twice_within_a_visit_is_said(campaign: Campaign) -> None:
    table = campaign.tables["distances"]
    again = table.iloc[[6]].assign(distance_m=table["distance_m"].iloc[6] + 1e-5)
    (found,) = told(campaign, pd.concat([table, again], ignore_index=True))
    assert "measure a target again within one visit" in found.message
    assert f"anchor {table['anchor'].iloc[6]}" in found.message


@settings(derandomize=True, deadline=None, max_examples=30)
@given(
    place=st.tuples(*[st.floats(-5.0, 5.0)] * 3),
    middle=st.tuples(*[st.floats(-3.0, 3.0)] * 3),
    seed=st.integers(0, 1000),
)
def test_an_anchor_is_located_wherever_it_is(place: tuple, middle: tuple, seed: int) -> None:
    rng = np.random.default_rng(seed)
    points = np.array(middle) + rng.uniform(-0.8, 0.8, (30, 3))
    distances = np.linalg.norm(points - place, axis=1)
    assert np.allclose(locate(points, distances).place, place, atol=1e-6)
    distances[[3, 17, 20]] += [0.2, -0.1, 0.5]  # wrong rows
    found = locate(points, distances)
    assert np.allclose(found.place, place, atol=1e-3 / found.spread[0])  # less sharp from afar


@pytest.mark.parametrize("constant", [0.3, -0.05, 0.0])
def test_an_anchor_is_located_whatever_its_distances_are_too_long_by(constant: float) -> None:
    rng = np.random.default_rng(2)
    points = rng.uniform(-0.8, 0.8, (40, 3))
    found = locate(points, np.linalg.norm(points - [1.2, -0.9, 0.7], axis=1) + constant + 1e-4 * rng.normal(size=40))
    assert np.allclose(found.place, [1.2, -0.9, 0.7], atol=2e-3)
    assert found.constant == pytest.approx(constant, abs=2e-3)
    assert found.size < 2e-4


def test_a_mirror_image_is_reported() -> None:
    points = np.c_[np.random.default_rng(0).uniform(-1, 1, (40, 2)), np.zeros(40)]
    found = locate(points, np.linalg.norm(points - [0.4, 0.9, 1.3], axis=1))
    assert found.mirrored is not None
    assert np.allclose(sorted([found.place[2], found.mirrored[2]]), [-1.3, 1.3], atol=1e-6)
    inside = locate(points, np.linalg.norm(points - [0.4, 0.9, 0.0], axis=1))
    assert np.allclose(inside.place, [0.4, 0.9, 0.0], atol=1e-3)
    assert inside.spread[0] < 1e-3


def test_distances_leave_the_other_tables_as_they_are() -> None:
    robot = load_robot("kuka_kr20_r1810")
    plain = measure(robot, seed=6, poses=10)
    more = measure(robot, seed=6, poses=10, tables=(*plain.tables, "distances"))
    assert "distances" not in plain.tables
    for name, table in plain.tables.items():
        pd.testing.assert_frame_equal(table, more.tables[name])
    off = more.tables["distances"]["distance_m"].to_numpy() - more.truth.noise_free["distances"][:, 0]
    assert 5e-6 < np.std(off) < 3e-4  # the instrument's and the robot's own


def test_a_file_of_another_program_is_imported(campaign: Campaign, tmp_path: Path) -> None:
    table = campaign.tables["distances"]
    out = pd.DataFrame(
        {"Pos": table["pose"], "Visit": table["visit"], "Ball": table["target"], "Foot": table["anchor"]}
    )
    out[[f"A{i + 1}" for i in range(6)]] = np.rad2deg(table[[f"q{i + 1}_rad" for i in range(6)]])
    out["L"] = (1e3 * table["distance_m"]).round(9).astype(str)
    lost = out.iloc[[5]].assign(L="-", Visit=9)
    pd.concat([out, lost]).to_csv(tmp_path / "bar.csv", index=False)
    joints = "\n".join(f'q{i + 1} = {{from = "A{i + 1}"}}' for i in range(6))
    targets = ", ".join(f"{name} = {list(map(float, at))}" for name, at in campaign.targets.items())
    (tmp_path / "m.toml").write_text(
        f"""format = "clampid-mapping/1"
units = {{angle = "deg", length = "mm"}}
table = "distances"
files = "bar.csv"
lost = "-"
[columns]
pose = {{from = "Pos"}}
visit = {{from = "Visit"}}
target = {{from = "Ball"}}
anchor = {{from = "Foot"}}
distance = {{from = "L"}}
{joints}
[campaign]
robot = "kuka_kr20_r1810"
gravity_m_s2 = [0.0, 0.0, -9.81]
targets_m = {{{targets}}}
instrument = {{name = "ballbar", distance_std_m = 2e-6}}
""",
        encoding="utf-8",
    )
    ran = call(tmp_path / "m.toml", "-o", tmp_path / "arm")
    assert ran.exit_code == 0, ran.output
    back = read_campaign(tmp_path / "arm")
    assert back.instrument.distance_std == 2e-6
    got = back.tables["distances"]
    assert len(got) == len(table)
    np.testing.assert_allclose(got["distance_m"], table["distance_m"], atol=1e-11)
    assert got["anchor"].tolist() == table["anchor"].tolist()
