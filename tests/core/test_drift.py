"""Noise that goes on from visit to visit raises a warning, and independent noise does not."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from clampid.catalogue import catalogue
from clampid.diagnosis import scoring, stage
from clampid.diagnosis.candidate_scores import standing_out_of
from clampid.diagnosis.diagnose import diagnose
from clampid.diagnosis.drift import blocks_of_visits, drift_of
from clampid.diagnosis.folds import Folds
from clampid.diagnosis.scoring import scores_of
from clampid.diagnosis.search import Searched, search
from clampid.diagnosis.trial import Bench
from clampid.diagnosis.wandering import level_beside
from clampid.identification.fitted_stage import FittedStage
from clampid.identification.identify import identify
from clampid.identification.model_on_campaign import on_campaign
from experiments.campaign import Campaign
from experiments.checks.check import check_campaign

NOISE = 6e-5  # m


def drifting(campaign: Campaign, correlation: float, seed: int) -> Campaign:
    """The campaign with a wandering instrument: AR(1) from visit to visit, by coordinate."""
    rng = np.random.default_rng(seed)
    table = campaign.tables["poses"].copy()
    time = table.groupby(["pose", "visit"])["time_s"].transform("mean").to_numpy()
    times, visit = np.unique(time, return_inverse=True)
    wander, now = np.zeros((len(times), 3)), rng.normal(size=3)
    for k in range(len(times)):
        now = correlation * now + np.sqrt(1 - correlation**2) * rng.normal(size=3)
        wander[k] = now
    table[["x_m", "y_m", "z_m"]] += NOISE * wander[visit]
    return replace(campaign, tables={**campaign.tables, "poses": table})


def clean(simulated, seed: int) -> Campaign:
    return simulated(seed=seed, poses=150, tables=("poses",), robot="ur10")


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, *(pytest.param(s, marks=pytest.mark.study) for s in (2, 3))])
def test_wandering_noise_is_warned_of(simulated, seed: int):
    campaign = drifting(clean(simulated, seed), 0.9, seed)
    verdict = diagnose(identify([campaign]), campaign).stages["poses"]
    assert "second run in another order" in verdict.warnings[0]
    assert verdict.summary.endswith(verdict.warnings[0])


def walking(campaign: Campaign, step: float, seed: int) -> Campaign:
    """The campaign with an instrument that walks: independent steps from visit to visit, by coordinate."""
    rng = np.random.default_rng(seed)
    table = campaign.tables["poses"].copy()
    _, visit = np.unique(table.groupby(["pose", "visit"])["time_s"].transform("mean"), return_inverse=True)
    walk = np.cumsum(rng.normal(size=(visit.max() + 1, 3)), axis=0)
    table[["x_m", "y_m", "z_m"]] += step * walk[visit]
    return replace(campaign, tables={**campaign.tables, "poses": table})


def test_a_walk_that_is_known_leaves_no_drift_and_is_sought_once(simulated, monkeypatch: pytest.MonkeyPatch):
    """Poses were searched again, with blocks of visits, though the noise by which they were judged was the walk."""
    campaign = walking(clean(simulated, 1), 0.5 * NOISE, 1)
    opened = on_campaign(identify([campaign]), campaign)
    estimate = opened.refit("poses").estimate
    wander = level_beside(estimate, [])
    assert wander is not None
    assert drift_of(estimate) is not None
    assert drift_of(estimate, wander) is None
    blocks = list[int]()

    def searched(bench: Bench, fitted: FittedStage) -> Searched | Folds:
        blocks.append(bench.block)
        return search(bench, fitted)

    monkeypatch.setattr(stage, "search", searched)
    found = diagnose(identify([campaign]), campaign).stages["poses"]
    assert blocks == [1]
    assert "second run in another order" in found.warnings[0]


def swinging(campaign: Campaign, size: float, turns: float) -> Campaign:
    """The campaign with readings that swing along a direction of the room, so many times in all."""
    table = campaign.tables["poses"].copy()
    share = (table["time_s"] - table["time_s"].min()) / np.ptp(table["time_s"])
    swing = size * np.sin(2.0 * np.pi * turns * share + 0.4).to_numpy()
    table[["x_m", "y_m", "z_m"]] += swing[:, None] * np.array([0.6, -0.3, 0.7])
    return replace(campaign, tables={**campaign.tables, "poses": table})


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_swing_beside_a_walk_is_no_part_of_it(simulated, seed: int):
    """The walk was taken to be as large as both. Beside it no probe of time was significant."""
    walks = walking(clean(simulated, seed), 0.1 * NOISE, seed)
    both = swinging(walks, 3.0 * NOISE, 4.3)
    fits = [on_campaign(identify([c]), c).refit("poses").estimate for c in (walks, both)]
    alone, beside = (scores_of(estimate, catalogue(), 199, 0) for estimate in fits)
    of_time = [{s.candidate.depends_on for s in standing_out_of(x.free, x.free_null)} for x in (alone, beside)]
    assert ("time",) not in of_time[0]
    assert ("time",) in of_time[1]
    levels = [0.0 if s.wander is None else s.wander.variance for s in (alone, beside)]
    assert levels[1] < 3.0 * max(levels[0], 0.1)


@pytest.mark.slow
def test_visits_alike_by_a_swing_alone_are_not_flipped_in_blocks(simulated):
    """In blocks as long as the swing is slow, the verdict was `adequate`."""
    campaign = swinging(clean(simulated, 1), 2.0 * NOISE, 2.6)
    found = diagnose(identify([campaign]), campaign).stages["poses"]
    assert found.verdict == "unknown"
    assert "time" in found.depends_on


def test_poses_that_are_scored_again_are_taken_to_wander_as_before(simulated, monkeypatch: pytest.MonkeyPatch):
    campaign = walking(clean(simulated, 1), 0.5 * NOISE, 1)
    opened = on_campaign(identify([campaign]), campaign)
    fitted = opened.refit("poses")
    estimate = fitted.estimate
    first = scores_of(estimate, catalogue(), 199, 0)
    assert first.wandering is not None
    monkeypatch.setattr(scoring, "level_beside", None)  # not sought again
    again = scores_of(estimate, catalogue(), 199, 0, seen=first.wandering)
    assert again.wandering == first.wandering
    np.testing.assert_allclose([s.explained for s in again.named], [s.explained for s in first.named])
    assert [s.state for s in again.named] == [s.state for s in first.named]
    assert any(s.state == "absorbed" for s in first.named)


@pytest.mark.slow
def test_independent_noise_is_not(simulated):
    """Of forty fits one in a hundred may: at most three."""
    warned = 0
    for seed in range(1, 5):
        base = clean(simulated, seed)
        for k in range(10):
            campaign = drifting(base, 0.0, 100 * seed + k)
            warned += drift_of(on_campaign(identify([campaign]), campaign).refit("poses").estimate) is not None
    assert warned <= 3


def test_blocks_are_consecutive_visits(simulated):
    campaign = clean(simulated, 1)
    rows = on_campaign(identify([campaign]), campaign).rows("poses")
    block = blocks_of_visits(rows, 5)
    for b in np.unique(block)[:-1]:
        assert len(np.unique(rows.unit[block == b])) == 5
    time = rows.constants.time
    ends = [(time[block == b].min(), time[block == b].max()) for b in np.unique(block)]
    assert all(a[1] < b[0] for a, b in pairwise(ends))
    assert blocks_of_visits(rows, 1) is rows.unit


def test_what_is_printed_is_the_clearest_of_ten_lags(simulated):
    """Noise that comes again after four visits: the first lag, 0.01, was printed."""
    base = clean(simulated, 1)
    table = base.tables["poses"].copy()
    visit = table.groupby(["pose", "visit"])["time_s"].transform("mean").rank(method="dense").to_numpy().astype(int)
    rng = np.random.default_rng(3)
    wander = rng.normal(size=(visit.max() + 1, 3))
    for k in range(4, len(wander)):
        wander[k] = 0.8 * wander[k - 4] + 0.6 * wander[k]
    table[["x_m", "y_m", "z_m"]] += 2 * NOISE * wander[visit]
    campaign = replace(base, tables={**base.tables, "poses": table})
    found = drift_of(on_campaign(identify([campaign]), campaign).refit("poses").estimate)
    assert found is not None
    assert found.lag == 4
    assert found.correlation > 0.3
    assert f"visits 4 apart are correlated ({found.correlation:.2f}, p = " in found.sentence


def test_a_time_that_counts_rows_is_no_clock(simulated):
    campaign = drifting(clean(simulated, 1), 0.9, 1)
    table = campaign.tables["poses"].sort_values("time_s").reset_index(drop=True)
    counted = replace(campaign, tables={**campaign.tables, "poses": table.assign(time_s=np.arange(float(len(table))))})
    for known, expected in ((campaign, True), (counted, False)):
        found = drift_of(on_campaign(identify([known]), known).refit("poses").estimate)
        assert found is not None
        assert found.clocked is expected
        assert ("robot or instrument have drifted. Without a second run" in found.sentence) is expected
        assert ("time_s only counts them and is no clock" in found.sentence) is not expected
        notes = [f for f in check_campaign(known) if f.column == "time_s" and "is no clock" in f.message]
        assert bool(notes) is not expected
