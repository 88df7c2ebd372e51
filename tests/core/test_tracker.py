"""A laser tracker's errors grow with distance and differ along and across the beam; the fit weighs them so."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

import numpy as np
import pytest

from clampid.catalogue import catalogue
from clampid.fitting.noise import initial_noise
from clampid.identification.identify import identify
from clampid.stages.fit_problem import fit_problem
from clampid.stages.layout import layout_of
from clampid.stages.pose_rows import join_rows, pose_rows
from experiments.campaign import Campaign, CampaignError, Instrument, read_campaign, write_campaign
from experiments.header import Tracker

Simulated = Callable[..., Campaign]
TRACKER = Tracker(1e-5, 2e-6, 6e-5)


@pytest.fixture(scope="module")
def plain(simulated: Simulated) -> Campaign:
    return simulated(seed=11, poses=80, tables=("poses",))


def spoilt(points: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Read points as a tracker does: range, azimuth and elevation, each with its own error."""
    r = np.linalg.norm(points, axis=1)
    azimuth, elevation = np.arctan2(points[:, 1], points[:, 0]), np.arcsin(points[:, 2] / r)
    level = np.cos(elevation)
    azimuth = azimuth + TRACKER.angle_std / level * rng.standard_normal(len(r))
    elevation = elevation + TRACKER.angle_std * rng.standard_normal(len(r))
    r = r + (TRACKER.range_std + TRACKER.range_rate * r) * rng.standard_normal(len(r))
    level = np.cos(elevation)
    return r[:, None] * np.c_[level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)]


@pytest.fixture(scope="module")
def ideal(plain: Campaign) -> Campaign:
    """The same poses of a robot without any error, read without noise."""
    rows = pose_rows([plain], layout_of([plain]), "poses")
    residual, _ = fit_problem(rows, catalogue(), ()).residual(np.zeros(0))
    return with_points(plain, rows.measured - residual, None)


def with_points(campaign: Campaign, points: np.ndarray, tracker: Tracker | None) -> Campaign:
    table = campaign.tables["poses"].copy()
    table[["x_m", "y_m", "z_m"]] = points
    instrument = Instrument("tracker", 1e-4, None, tracker)
    return replace(campaign, instrument=instrument, tables=MappingProxyType({"poses": table}))


def read_by(campaign: Campaign, tracker: Tracker | None, seed: int) -> Campaign:
    """Give the campaign as a tracker reads it, its errors stated or not."""
    points = campaign.tables["poses"][["x_m", "y_m", "z_m"]].to_numpy()
    return with_points(campaign, spoilt(points, np.random.default_rng(seed)), tracker)


def test_whitened_errors_of_a_tracker_are_independent_and_of_size_one(plain: Campaign) -> None:
    layout = layout_of([plain])
    clean = pose_rows([plain], layout, "poses")
    rng, drawn = np.random.default_rng(0), []
    stated = replace(plain, instrument=Instrument("tracker", None, None, TRACKER))
    rows = pose_rows([stated], layout, "poses")
    for _ in range(60):
        error = spoilt(clean.measured, rng) - clean.measured
        white = initial_noise(rows).whiten(rows, error, np.zeros((*error.shape, 1)))
        drawn.append(white.residual.reshape(3, -1).T)
    found = np.concatenate(drawn)
    assert np.allclose(np.cov(found.T), np.eye(3), atol=0.03)


def test_columns_are_turned_as_residuals_are(plain: Campaign) -> None:
    stated = replace(plain, instrument=Instrument("tracker", None, None, TRACKER))
    rows = pose_rows([stated], layout_of([plain]), "poses")
    rng = np.random.default_rng(1)
    columns = rng.standard_normal((len(rows), 3, 4))
    white = initial_noise(rows).whiten(rows, columns[:, :, 2], columns)
    assert np.allclose(white.residual, white.jacobian[:, 2])
    beam = rows.measured / np.linalg.norm(rows.measured, axis=1, keepdims=True)
    r = np.linalg.norm(rows.measured, axis=1)
    C = np.einsum("ni,nj->nij", beam, beam)
    S = ((TRACKER.range_std + TRACKER.range_rate * r) ** 2)[:, None, None] * C
    S += ((TRACKER.angle_std * r) ** 2)[:, None, None] * (np.eye(3) - C)
    information = np.einsum("nip,nij,njq->pq", columns, np.linalg.inv(S), columns)
    assert np.allclose(white.jacobian.T @ white.jacobian, information, rtol=1e-9)


def test_a_stated_tracker_gives_smaller_errors_that_hold(ideal: Campaign) -> None:
    told, untold = (identify(read_by(ideal, t, 3), ["geometry"]).stages["poses"] for t in (TRACKER, None))
    assert told.slots == untold.slots
    assert np.exp(np.mean(np.log(told.std / untold.std))) < 0.9
    robot = np.array(["link" in slot.place for slot in told.slots])  # the base follows from an alignment
    off = [identify(read_by(ideal, TRACKER, seed), ["geometry"]).stages["poses"].theta for seed in range(4, 12)]
    z = np.array(off)[:, robot] / told.std[robot]
    assert 0.85 < np.sqrt(np.mean(z**2)) < 1.15


def test_sessions_with_and_without_a_tracker_go_together(plain: Campaign) -> None:
    stated = replace(plain, instrument=Instrument("tracker", None, None, TRACKER))
    layout = layout_of([plain, stated])
    rows = pose_rows([plain, stated], layout, "poses")
    assert rows.constants.noise_axes.shape == (len(rows), 3, 3)
    first = rows.take(rows.session == 0)
    assert np.array_equal(first.in_noise_axes(first.measured), first.measured)
    assert len(join_rows([first, first]).constants.noise_axes) == 2 * len(first)


@pytest.mark.parametrize(
    ("instrument", "words"),
    [
        ({"range_std_m": 1e-5}, "expected instrument.angle_std_rad with range_std_m, found none"),
        ({"range_std_m": 10.0, "angle_std_rad": 1e-6}, "range_std_m: expected .* m above 0 and not above 0.005"),
        ({"range_std_m": 1e-5, "angle_std_rad": 0.0}, "angle_std_rad: expected .* rad above 0"),
        ({"range_std_m": 1e-5, "angle_std_rad": 1e-6, "range_std_m_m": -1e-6}, "range_std_m_m: expected .* m/m from 0"),
    ],
)
def test_a_tracker_that_cannot_be_is_refused(plain: Campaign, tmp_path: Path, instrument: dict, words: str) -> None:
    header = {**plain.header, "instrument": {"name": "tracker", **instrument}}
    write_campaign(tmp_path / "arm", header, dict(plain.tables))
    with pytest.raises(CampaignError, match=words):
        read_campaign(tmp_path / "arm")


def test_a_stated_tracker_is_read(plain: Campaign, tmp_path: Path) -> None:
    stated = {"name": "tracker", "range_std_m": 1e-5, "range_std_m_m": 2e-6, "angle_std_rad": 6e-5}
    write_campaign(tmp_path / "arm", {**plain.header, "instrument": stated}, dict(plain.tables))
    assert read_campaign(tmp_path / "arm").instrument.tracker == TRACKER
