"""The error of a robot as it is described: larger than a model's, and of what was rejected not spoiled."""

from __future__ import annotations

from dataclasses import replace
from types import MappingProxyType

import numpy as np
import pytest

from clampid.comparison.nominal import nominal_errors
from clampid.identification.identify import identify
from clampid.models.model import Model
from experiments.campaign import Campaign


@pytest.fixture(scope="module")
def fitted(simulated) -> tuple[Campaign, Model]:
    campaign = simulated(seed=2, poses=40, tables=("free_air", "poses"))
    return campaign, identify(campaign)


def test_a_nominal_robot_is_worse_than_its_model(fitted: tuple[Campaign, Model]) -> None:
    campaign, model = fitted
    nominal = nominal_errors(model, campaign)
    last = {entry.stage: entry for entry in model.ledger}
    assert set(nominal) == {"free_air", "poses"}
    for stage, error in nominal.items():
        assert error > 3.0 * last[stage].rms


@pytest.mark.slow
def test_rejected_rows_and_the_base_do_not_count(fitted: tuple[Campaign, Model]) -> None:
    campaign, model = fitted
    before = nominal_errors(model, campaign)["poses"]
    poses = model.stages["poses"]
    marked = replace(model, stages={**model.stages, "poses": replace(poses, outliers=((0, "poses", 5),))})
    table = campaign.tables["poses"].copy()
    table.loc[4, "x_m"] += 0.5
    spoiled = replace(campaign, tables=MappingProxyType({**campaign.tables, "poses": table}))
    assert nominal_errors(marked, spoiled)["poses"] == pytest.approx(before, rel=0.05)
    moved = campaign.tables["poses"].assign(x_m=lambda f: f["x_m"] + 0.01)
    elsewhere = replace(campaign, tables=MappingProxyType({**campaign.tables, "poses": moved}))
    assert nominal_errors(model, elsewhere)["poses"] == pytest.approx(before, rel=1e-6)
    assert np.isfinite(before)
