"""A folder of Parquet logs fitted in pieces gives the model of the campaign read whole; bad files are named."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from clampid.effect import EffectError
from clampid.identification.identify import identify
from clampid.identification.identify_folder import identify_folder
from clampid.stages.log_facts import LogPart, log_parts
from clampid.stages.steady_share import steady_share
from experiments.campaign import CampaignError, read_campaign, write_campaign
from experiments.fingerprint import fingerprint
from experiments.log_windows import LogTable
from experiments.virtual_robot import measure
from kinematics.description import load_robot


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    measured = measure(load_robot("kuka_kr20_r1810"), seed=4, tables=("free_air", "wrist"))
    return write_campaign(tmp_path_factory.mktemp("log") / "arm", measured.header, measured.tables)


@pytest.mark.slow
@pytest.mark.parametrize("effects", [None, ("gravity", "coulomb_friction", "viscous_friction@joint2", "inertia")])
def test_the_model_is_that_of_the_campaign_read_whole(folder: Path, effects: tuple[str, ...] | None) -> None:
    whole, pieces = (f(c, effects, holdout=0.2, seed=3) for f, c in
                     ((identify, read_campaign(folder)), (identify_folder, folder)))  # fmt: skip
    a, b = whole.stages["free_air"], pieces.stages["free_air"]
    assert (a.terms, a.slots, a.identified, a.held_out, a.outliers) == (
        b.terms, b.slots, b.identified, b.held_out, b.outliers
    )  # fmt: skip
    np.testing.assert_allclose(a.theta, b.theta, atol=1e-12)
    np.testing.assert_allclose(a.covariance, b.covariance, atol=1e-12)
    assert whole.sessions == pieces.sessions
    assert whole.ledger[0].heldout_rms == pytest.approx(pieces.ledger[0].heldout_rms, rel=1e-9)


@pytest.mark.slow
def test_share_of_steady_motion_and_fingerprint_are_those_of_the_tables(folder: Path) -> None:
    campaign = read_campaign(folder)
    parts = [LogPart(campaign, 0, name, LogTable.of(folder / f"{name}.parquet")) for name in ("free_air", "wrist")]
    assert steady_share(parts, window=900) == pytest.approx(steady_share(log_parts([campaign])), abs=1e-12)
    files = {part.name: folder / f"{part.name}.parquet" for part in parts}
    assert fingerprint(campaign.header, files) == campaign.fingerprint


def test_effects_with_a_state_or_that_act_elsewhere_are_refused(folder: Path) -> None:
    with pytest.raises(EffectError, match="a state of friction"):
        identify_folder(folder, ["gravity", "presliding_friction"])
    with pytest.raises(EffectError, match="geometry does not act in free_air"):
        identify_folder(folder, ["geometry"])


def spoilt(folder: Path, to: Path, change: str) -> Path:
    """A copy of the folder with one thing wrong in row 70 001 of free_air, repeated so that it is in a later piece."""
    campaign = read_campaign(folder)
    one = campaign.tables["free_air"]
    times = 70_000 // len(one) + 1
    table = pd.concat([one.assign(run=one["run"] + 100 * k) for k in range(times)], ignore_index=True)
    if change == "late":
        table.loc[70_000, "time_s"] = table.loc[69_999, "time_s"] - 1.0
    elif change == "missing":
        table = table.drop(columns="tau6_Nm")
    else:
        table.loc[70_000, "tau2_Nm"] = np.nan
    return write_campaign(to / change, campaign.header, {"free_air": table})


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ("late", r"row 70001, column time_s: expected time increasing within run \d+, found [\d.]+ s after"),
        ("empty", r"row 70001, column tau2_Nm: expected a finite number, found an empty cell"),
        ("missing", r"expected a column tau6_Nm, found no such column"),
    ],
)
def test_bad_rows_are_named(folder: Path, tmp_path: Path, change: str, message: str) -> None:
    with pytest.raises(CampaignError, match=message):
        identify_folder(spoilt(folder, tmp_path, change))


def test_logs_that_are_not_parquet_are_refused(folder: Path, tmp_path: Path) -> None:
    campaign = read_campaign(folder)
    text = write_campaign(tmp_path / "text", campaign.header, {"wrist": campaign.tables["wrist"]}, "csv")
    with pytest.raises(CampaignError, match=r"expected a table ending in .parquet"):
        identify_folder(text)
    broken = write_campaign(tmp_path / "broken", campaign.header, {"wrist": campaign.tables["wrist"]})
    (broken / "wrist.parquet").write_bytes(b"PAR1 no")
    with pytest.raises(CampaignError, match="whole Parquet file"):
        identify_folder(broken)
