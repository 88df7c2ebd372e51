"""Single wrong rows of a verification table change no verdict, and are listed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from clampid.comparison.compare import compare
from clampid.diagnosis.diagnose import diagnose
from clampid.identification.identify import identify
from experiments.campaign import Campaign

SHARE, OFF = 0.02, 5e-3  # of the rows, and m


@pytest.fixture(scope="module")
def campaign(simulated) -> Campaign:
    return simulated(seed=7, poses=120, tables=("poses", "verification"), robot="ur10")


def spoilt(campaign: Campaign) -> tuple[Campaign, list[int]]:
    """The campaign with some points of its verification table elsewhere, and which rows they are, from 1."""
    rng = np.random.default_rng(1)
    table = campaign.tables["verification"].copy()
    rows = np.sort(rng.choice(len(table), max(3, round(SHARE * len(table))), replace=False))
    for k in rows:
        table.loc[table.index[k], ["x_m", "y_m", "z_m"]] += OFF * rng.normal(size=3)
    return replace(campaign, tables={**campaign.tables, "verification": table}), [int(k) + 1 for k in rows]


@pytest.mark.slow
def test_wrong_rows_change_no_verdict_and_are_listed(campaign: Campaign):
    bad, rows = spoilt(campaign)
    model = identify([campaign])
    found, clean = (diagnose(model, c).stages["poses"] for c in (bad, campaign))
    assert found.verdict == clean.verdict
    assert found.before == pytest.approx(clean.before, rel=0.1)
    assert sorted(o["row"] for o in found.outliers if o["table"] == "verification") == rows
    assert not [o for o in clean.outliers if o["table"] == "verification"]


def test_compare_and_the_ledger_leave_them_out(campaign: Campaign):
    bad, rows = spoilt(campaign)
    model, clean = identify([bad]), identify([campaign])
    assert model.ledger[-1].heldout_rms == pytest.approx(clean.ledger[-1].heldout_rms, rel=0.1)
    table = compare(model, bad).tables["poses"]["heldout"]
    assert table["outliers"] == rows
    assert table["rms_with_outliers"] > 2 * table["rms"]
    assert "outliers" not in compare(clean, campaign).tables["poses"]["heldout"]


def test_a_whole_visit_is_no_single_wrong_row(campaign: Campaign):
    """What a model lacks moves all points of a visit: such rows count, however far off they are."""
    table = campaign.tables["verification"].copy()
    first = table.index[table["pose_id"] == table["pose_id"].iloc[0]] if "pose_id" in table else table.index[:3]
    table.loc[first, ["x_m", "y_m", "z_m"]] += OFF
    bad = replace(campaign, tables={**campaign.tables, "verification": table})
    model = identify([campaign])
    held = compare(model, bad).tables["poses"]["heldout"]
    assert "outliers" not in held
    assert held["max"] > OFF
