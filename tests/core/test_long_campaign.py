"""A campaign whose log is not held: the model of the log held whole, what it holds, and what is wrong with it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from clampid.identification.identify import identify
from clampid.stages.layout import layout_of
from clampid.stages.torques import torque_rows
from experiments import long_log
from experiments.campaign import Campaign, CampaignError, read_campaign, write_campaign
from experiments.checks.check import check_campaign, holdings
from experiments.virtual_robot import measure
from kinematics.description import load_robot


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    measured = measure(load_robot("kuka_kr20_r1810"), seed=4, tables=("free_air", "wrist"))
    return write_campaign(tmp_path_factory.mktemp("long") / "arm", measured.header, measured.tables)


@pytest.fixture(scope="module")
def whole(folder: Path) -> Campaign:
    return read_campaign(folder)


@pytest.fixture(scope="module")
def pieces(folder: Path) -> Campaign:
    return read_campaign(folder, rows_in_memory=1000)


@pytest.mark.parametrize("effects", [None, ("gravity", "coulomb_friction", "viscous_friction", "stribeck_friction")])
def test_the_model_is_that_of_the_log_held(whole: Campaign, pieces: Campaign, effects: tuple[str, ...] | None) -> None:
    assert set(pieces.long) == {"free_air", "wrist"}
    in_memory, read = identify(whole, effects, holdout=0.2, seed=3), identify(pieces, effects, holdout=0.2, seed=3)
    a, b = in_memory.stages["free_air"], read.stages["free_air"]
    assert (a.slots, a.held_out, a.outliers, a.identified) == (b.slots, b.held_out, b.outliers, b.identified)
    np.testing.assert_allclose(a.theta, b.theta, atol=1e-12)
    np.testing.assert_allclose(a.covariance, b.covariance, atol=1e-12)
    assert in_memory.sessions == read.sessions


@pytest.mark.slow
def test_rows_that_have_to_be_held_are_those_of_the_file_and_not_of_the_extract(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(long_log, "STRETCH_ROWS", 500)
    path = repeated(folder, tmp_path, "none", 20_000)
    expected, found = (
        torque_rows([c], layout_of([c])) for c in (read_campaign(path), read_campaign(path, rows_in_memory=1000))
    )
    np.testing.assert_array_equal(found.measured, expected.measured)
    np.testing.assert_array_equal(found.used, expected.used)
    np.testing.assert_array_equal(found.signals["link_temperature"], expected.signals["link_temperature"])


def test_it_holds_what_the_log_held_holds(whole: Campaign, pieces: Campaign) -> None:
    assert holdings(pieces) == holdings(whole)
    notes = [f.message for f in check_campaign(pieces) if f not in check_campaign(whole)]
    assert any("all of them follow the contract" in note for note in notes)


def repeated(folder: Path, to: Path, change: str, rows: int = 140_000) -> Path:
    """A copy of the folder with a long log and one thing wrong far down in it."""
    campaign = read_campaign(folder)
    one = campaign.tables["free_air"]
    times = rows // len(one) + 1
    table = pd.concat([one.assign(run=one["run"] + 100 * k) for k in range(times)], ignore_index=True)
    row = 70_000
    if change == "late":
        table.loc[row, "time_s"] = table.loc[row - 1, "time_s"] - 0.0137
    elif change == "again":  # a run's number comes again, pieces later
        table.loc[130_000:130_100, "run"] = table.loc[0, "run"]
        table.loc[130_000:130_100, "time_s"] -= 1e5
    elif change == "fraction":
        table["run"] = table["run"].astype(float)
        table.loc[row, "run"] = 1.5
    elif change == "renamed":
        table = table.rename(columns={"tau6_Nm": "tau6_nm"})
    elif change != "none":
        table.loc[row, "tau2_Nm"] = np.nan
    return write_campaign(to / change, campaign.header, {"free_air": table})


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ("late", r"row 70001, column time_s: expected time increasing within run \d+, found [\d.]+ s after"),
        ("again", r"row 130001, column time_s: expected time increasing within run \d+, found -[\d.]+ s after"),
        ("empty", r"row 70001, column tau2_Nm: expected a finite number, found"),
        ("fraction", r"row 70001, column run: expected an integer"),
        ("renamed", r"expected a column 'tau6_Nm', found no such column, but 'tau6_nm'"),
    ],
)
def test_bad_rows_far_down_are_named(folder: Path, tmp_path: Path, change: str, message: str) -> None:
    with pytest.raises(CampaignError, match=message):
        read_campaign(repeated(folder, tmp_path, change), rows_in_memory=1000)


def test_the_extract_is_of_stretches_spread_over_the_log(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(long_log, "STRETCH_ROWS", 1000)
    path = repeated(folder, tmp_path, "none")
    log = read_campaign(path, rows_in_memory=1000)
    table, whole = log.tables["free_air"], read_campaign(path).tables["free_air"]
    expected = np.concatenate([np.arange(a, a + k) for a, k in log.long["free_air"].stretches])
    assert len(table) == len(expected) == long_log.STRETCHES * 1000
    pd.testing.assert_frame_equal(
        table.drop(columns="run"), whole.drop(columns="run").iloc[expected].reset_index(drop=True)
    )
    for _, part in table.groupby("run"):  # no run has parts of two stretches
        assert np.all(np.diff(expected[part.index]) == 1)


def test_a_damaged_file_is_named_as_ever(folder: Path, tmp_path: Path) -> None:
    campaign = read_campaign(folder)
    broken = write_campaign(tmp_path / "broken", campaign.header, {"wrist": campaign.tables["wrist"]})
    (broken / "wrist.parquet").write_bytes(b"PAR1 no")
    with pytest.raises(CampaignError, match="truncated or damaged"):
        read_campaign(broken, rows_in_memory=1000)
