"""One rule for what tells the noise floor: what ``check`` announces is what ``compare`` uses."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from clampid.fitting.accuracy import QUIET_S, _spread, noise_floor
from clampid.identification.identify import stage_rows
from clampid.stages.layout import layout_of
from clampid.stages.pose_rows import pose_rows
from experiments.campaign import Campaign
from experiments.checks.motion import motion_findings
from experiments.measures.returns import ENOUGH_RETURNS, comparable_returns, freedom_of

SCATTER = 200e-6  # m, one axis; the instrument states less
STD_NM = 1e-3  # of a torque: less than what runs and a regression say, so that these do not count


@pytest.fixture(scope="module")
def base(simulated: Callable[..., Campaign]) -> Campaign:
    return simulated(seed=5, poses=30, tables=("poses",))


def returned(base: Campaign, count: int) -> Campaign:
    """The first visits, and of ``count`` rows of them a second one that differs by scatter only."""
    table = base.tables["poses"]
    first = table[table["visit"] == 1].reset_index(drop=True)
    again = first.iloc[:count].assign(visit=2, time_s=first["time_s"].max() + 100.0 + np.arange(count))
    xyz = ["x_m", "y_m", "z_m"]
    again[xyz] += np.sqrt(2) * SCATTER * np.random.default_rng(1).standard_normal((count, 3))
    return replace(base, tables={"poses": pd.concat([first, again], ignore_index=True)})


@pytest.mark.parametrize("count", [0, ENOUGH_RETURNS - 1, ENOUGH_RETURNS])
def test_check_and_the_floor_say_the_same(base: Campaign, count: int) -> None:
    campaign = returned(base, count)
    rows = pose_rows([campaign], layout_of([campaign]), "poses")
    floor = noise_floor(rows, np.zeros_like(rows.measured))
    (said,) = (f.message for f in motion_findings(campaign, frozenset()) if f.column == "visit")
    if count < ENOUGH_RETURNS:
        assert floor.source == "instrument"
        assert floor.most > floor.norm  # nobody has measured how well the robot repeats
        assert said.startswith(f"{count} repeated points")
        assert said.endswith(f"fewer than {ENOUGH_RETURNS}: the noise floor is the instrument's stated noise")
        return
    assert floor.source == "replicates"
    assert floor.most == floor.norm
    assert floor.norm == pytest.approx(np.sqrt(3) * SCATTER, rel=0.25)
    assert said.startswith(f"{count} repeated points")
    assert said.endswith("give the noise floor")


def test_the_floor_of_a_log_has_the_freedom_that_it_says(simulated: Callable[..., Campaign]) -> None:
    """White noise of 300 draws: the mean square over all motors, in units of their floors, scatters as it says."""
    campaign = simulated(seed=5, tables=("free_air",))
    rows = stage_rows([campaign], layout_of([campaign]), "free_air")
    rng, squares, freedom = np.random.default_rng(3), [], set()
    for _ in range(300):
        floor = noise_floor(rows, STD_NM * rng.standard_normal(rows.measured.shape))
        squares.append(np.average((floor.sigma / STD_NM) ** -2.0, weights=rows.used.sum(axis=0)))
        freedom.add(floor.freedom)
    (said,) = freedom
    assert said < rows.used.sum() / 1.5  # fewer than as many independent rows would give
    assert np.var(squares) == pytest.approx(2.0 / said, rel=0.35)  # four standard errors of a variance of 300


def test_points_of_single_visits_may_scatter_more_than_the_instrument_is_said_to(base: Campaign) -> None:
    """An instrument twice as noisy as stated; each fifth pose 1 mm off, which moves the points of a visit alike."""
    rows = pose_rows([base], layout_of([base]), "poses")
    rng = np.random.default_rng(2)
    stated = float(np.sqrt(np.sum(rows.sigma[0, :3] ** 2)))
    errors = 2.0 * rows.sigma * rng.standard_normal(rows.measured.shape)
    _, visit = np.unique(rows.unit, return_inverse=True)
    off = 1e-3 * rng.standard_normal((visit.max() + 1, 3)) * (np.arange(visit.max() + 1) % 5 == 0)[:, None]
    errors[:, :3] += off[visit]
    floor = noise_floor(rows, errors)
    assert floor.source == "instrument"
    assert floor.norm == pytest.approx(stated)
    assert floor.in_visits == pytest.approx(2.0 * stated, rel=0.1)
    assert floor.most == pytest.approx(np.hypot(floor.in_visits, floor.repeats))
    alone = rows.take(np.unique(rows.unit, return_index=True)[1])  # one point a visit tells nothing
    assert noise_floor(alone, errors[: len(alone)]).in_visits == 0.0


def test_returns_with_another_approach_do_not_count() -> None:
    place = np.zeros((6, 1))
    visit = np.array([1, 1, 2, 3, 4, 5])
    direction = np.array([[1.0], [1.0], [1.0], [-1.0], [0.0], [1.0]])
    warmth = np.array([[20.0], [20.0], [20.4], [20.0], [20.0], [20.6]])
    found = comparable_returns(place, visit, direction, warmth)
    assert [members.tolist() for members in found] == [[0, 2]]  # not: same visit, other side, unknown side, warmer
    assert freedom_of(found) == 1
    assert freedom_of(comparable_returns(place, visit, direction, np.zeros((6, 0)))) == 2


def test_a_wrong_row_is_no_noise(base: Campaign) -> None:
    campaign = returned(base, ENOUGH_RETURNS + 5)
    clean = pose_rows([campaign], layout_of([campaign]), "poses")
    spoilt = campaign.tables["poses"].copy()
    spoilt.loc[2, "x_m"] += 0.01
    rows = pose_rows([replace(campaign, tables={"poses": spoilt})], layout_of([campaign]), "poses")
    wrong = rows.row == 3
    residual = np.zeros_like(rows.measured)
    assert noise_floor(rows, residual).norm > 3 * noise_floor(clean, residual).norm
    left_out = noise_floor(rows.without(wrong), residual)
    assert left_out.source == "replicates"
    assert left_out.norm == pytest.approx(noise_floor(clean, residual).norm, rel=0.2)


@pytest.mark.parametrize("rows", [500, 20_000])
def test_a_smooth_misfit_is_no_noise_however_short_the_log(rows: int) -> None:
    rng, step = np.random.default_rng(2), 1e-3
    noise, misfit = rng.standard_normal(rows), np.linspace(-5.0, 5.0, rows)
    run, used = np.zeros(rows, dtype=np.int64), np.ones(rows, dtype=bool)
    found = _spread(run, noise + misfit, used, round(QUIET_S / step)).std
    assert found == pytest.approx(1.0, rel=0.15)
    assert _spread(run, noise + misfit, ~used, 10).std == 1.0
