"""Missing temperatures: short gaps are bridged, long ones are said, and none is 20 °C by itself."""

from __future__ import annotations

from dataclasses import replace
from types import MappingProxyType

import numpy as np
import pandas as pd
import pytest

from clampid.slots import Layout
from clampid.stages.pose_rows import pose_rows
from experiments.campaign import Campaign, read_campaign
from experiments.checks.check import Finding, check_campaign
from experiments.simulate import simulate
from experiments.temperatures import filled, readings

LINKS = [f"temp_link{i + 1}_C" for i in range(6)]


@pytest.fixture(scope="module")
def campaign(tmp_path_factory: pytest.TempPathFactory) -> Campaign:
    folder = tmp_path_factory.mktemp("warm") / "arm"
    return read_campaign(simulate(folder, poses=20, seed=4, tables=("poses", "verification")))


def changed(campaign: Campaign, **tables: pd.DataFrame) -> Campaign:
    return replace(campaign, tables=MappingProxyType({**campaign.tables, **tables}))


def told(campaign: Campaign, column: str) -> list[Finding]:
    return [f for f in check_campaign(campaign) if f.column == column]


def ramp(lost: slice, step: float = 20.0, rows: int = 60) -> pd.DataFrame:
    time = step * np.arange(rows)
    frame = pd.DataFrame({"pose": np.arange(rows), "time_s": time, "temp_link1_C": 22.0 + time / 600.0})
    frame.loc[lost, "temp_link1_C"] = np.nan
    return frame


def test_a_short_gap_is_the_line_between_its_ends() -> None:
    values, known = readings(ramp(slice(10, 20)), "temp_link1_C")  # 240 s from reading to reading
    assert known.all()
    np.testing.assert_allclose(values, 22.0 + 20.0 * np.arange(60) / 600.0, atol=1e-12)


@pytest.mark.parametrize(("lost", "unknown"), [(slice(10, 30), 21), (slice(0, 2), 0), (slice(50, 59), 7)])
def test_a_long_gap_and_a_long_end_are_not_known(lost: slice, unknown: int) -> None:
    frame = ramp(lost)
    values, known = readings(frame, "temp_link1_C")
    assert int((~known).sum()) == unknown
    assert np.isnan(values[~known]).all()
    whole = filled(frame)["temp_link1_C"].to_numpy()
    np.testing.assert_allclose(whole[~known], values[known].mean())
    np.testing.assert_allclose(whole[known], values[known])


def test_rows_in_any_order_and_runs_of_their_own_clocks() -> None:
    frame = ramp(slice(10, 20)).sample(frac=1.0, random_state=0).reset_index(drop=True)
    np.testing.assert_allclose(readings(frame, "temp_link1_C")[0], 22.0 + frame["time_s"] / 600.0, atol=1e-12)
    runs = ramp(slice(60, 61)).drop(columns="pose").assign(run=np.repeat([1, 2], 30))
    runs.loc[29:30, "temp_link1_C"] = np.nan  # the end of one run and the begin of another: held, not interpolated
    values = readings(runs, "temp_link1_C")[0]
    np.testing.assert_allclose(values[29:31], values[[28, 31]])


def test_a_clock_that_counts_rows_does_not_say_how_long_a_gap_is() -> None:
    assert int((~readings(ramp(slice(10, 12), step=1.0), "temp_link1_C")[1]).sum()) == 3


def test_a_sensor_that_only_the_other_table_read_has_its_mean_there() -> None:
    table, other = ramp(slice(0, 60)), ramp(slice(60, 61))
    np.testing.assert_allclose(filled(table, [other])["temp_link1_C"], other["temp_link1_C"].mean())
    assert "temp_link1_C" not in filled(table)


def test_no_row_is_taken_for_20_degrees(campaign: Campaign) -> None:
    poses = campaign.tables["poses"].copy()
    poses.loc[5:40, LINKS[1]] = np.nan
    poses = poses.drop(columns=LINKS[2])
    broken = changed(campaign, poses=poses)
    layout = Layout(6, tuple(campaign.targets))
    rows = pose_rows([broken], layout, "poses")
    warm = rows.signals["link_temperature"]
    assert warm[:, 1].min() > 0.5 * (campaign.tables["poses"][LINKS[1]].min() - 20.0)
    assert not rows.pose.link_recorded[:, 1].all()
    np.testing.assert_allclose(warm[:, 2] + 20.0, campaign.tables["verification"][LINKS[2]].mean())
    assert not rows.pose.link_recorded[:, 2].any()


def test_check_says_what_is_missing(campaign: Campaign) -> None:
    poses = campaign.tables["poses"].copy()
    poses.loc[5:7, LINKS[0]] = np.nan
    poses.loc[20:, LINKS[1]] = np.nan
    poses[LINKS[2]] = np.nan
    broken = changed(campaign, poses=poses)
    (short,) = told(broken, LINKS[0])
    assert short.severity == "note"
    assert short.message.startswith("3 rows have no reading, first row 6; interpolated in time over gaps up to 300 s")
    (long,) = [f for f in told(broken, LINKS[1]) if f.severity == "warning"]
    assert f"of {len(poses)} rows have no reading within 300 s" in long.message
    (never,) = told(broken, LINKS[2])
    assert (never.severity, never.message) == (
        "warning", f"{LINKS[2]} has no reading: the column is ignored",
    )  # fmt: skip
    assert told(campaign, LINKS[0]) == []


def test_fahrenheit_and_kelvin_are_refused_and_ambient_alone_is_said(campaign: Campaign) -> None:
    names = [*LINKS, "temp_ambient_C"]
    poses = campaign.tables["poses"]
    hot = changed(campaign, poses=poses.assign(**{c: poses[c] * 9 / 5 + 32 for c in names}))
    (ambient,) = told(hot, "temp_ambient_C")
    assert (ambient.severity, "look like Fahrenheit" in ambient.message) == ("error", True)
    assert "is it in Fahrenheit?" in told(hot, LINKS[0])[0].message
    kelvin = changed(campaign, poses=poses.assign(**{c: poses[c] + 273.15 for c in names}))
    assert [f.severity for f in told(kelvin, LINKS[0])] == ["error"]
    alone = changed(campaign, poses=poses[[c for c in poses if c == "temp_ambient_C" or not c.startswith("temp_")]])
    assert any("no temperature sensor is on a link (temp_ambient_C is not)" in f.message for f in
               told(alone, "temp_ambient_C"))  # fmt: skip


def test_returns_without_a_reading_are_never_fewer_than_none(campaign: Campaign) -> None:
    from experiments.checks.motion import replicates

    poses = campaign.tables["poses"].copy()
    ambient = poses.drop(columns=[c for c in poses if c.startswith("temp_") and c != "temp_ambient_C"])
    whole = replicates(changed(campaign, poses=ambient))
    assert whole > 0
    assert replicates(changed(campaign, poses=ambient.assign(temp_ambient_C=np.nan))) >= whole
