"""How sure the held-out error is: intervals that hold the truth as often as they say, and changes that are told."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from clampid.identification.identify import identify
from clampid.identification.model_on_campaign import on_campaign
from clampid.report.spread import HeldOut, Spread, held_out, spread_of, spread_sentences, spread_table
from clampid.report.stage_data import stage_data
from experiments.campaign import read_campaign, write_campaign
from experiments.virtual_robot import measure
from kinematics.description import load_robot

POSES, POINTS = 60, 3


def held(rng: np.random.Generator, sigma: float, shared: float) -> HeldOut:
    """Errors of points, of which those of one pose share a part."""
    error = sigma * rng.normal(size=(POSES, POINTS)) + shared * rng.normal(size=(POSES, 1))
    return HeldOut(error.ravel() ** 2, np.ones(POSES * POINTS, dtype=bool), np.repeat(np.arange(POSES), POINTS))


@pytest.mark.parametrize("shared", [0.0, 2.0])
def test_intervals_hold_the_true_error_95_times_of_100(shared: float) -> None:
    rng = np.random.default_rng(3)
    true = np.sqrt(1.0 + shared**2)
    inside = []
    for k in range(200):
        found = spread_of(held(rng, 1.0, shared), None, k)
        assert found is not None
        inside.append(found.now[1] < true < found.now[2])
    assert 0.88 < np.mean(inside) < 0.99


def test_a_change_is_known_better_than_the_errors_because_the_poses_are_the_same() -> None:
    rng = np.random.default_rng(4)
    before = held(rng, 1.0, 1.0)
    now = HeldOut(before.squares * 0.9**2, before.counts, before.fold)
    found = spread_of(now, before, 0)
    assert found is not None
    assert found.before is not None
    assert found.fall is not None
    assert found.fall[0] == pytest.approx(0.1 * found.before[0])
    assert found.fall[1] > 0.0
    assert found.before[1] < found.now[0]  # though the intervals of the two overlap
    assert (
        "fell by 173 mm (95 % interval"
        in spread_sentences({"poses": Spread(9, (1, 1, 1), (1, 1, 1), (0.173, 0.1, 0.2))})[0]
    )


def test_a_change_within_the_scatter_is_said_not_significant() -> None:
    rng = np.random.default_rng(5)
    before, now = held(rng, 1e-4, 1e-4), held(rng, 1e-4, 1e-4)
    found = spread_of(now, before, 0)
    assert found is not None
    (sentence,) = spread_sentences({"poses": found})
    assert "not significant" in sentence
    table = spread_table({"poses": found})
    assert table is not None
    assert table.rows[0][-1] == f"{POSES} poses"
    assert " µm)" in table.rows[0][1]


def test_rows_that_do_not_count_are_left_out_and_few_poses_say_nothing() -> None:
    rng = np.random.default_rng(6)
    good = held(rng, 1.0, 0.0)
    squares, counts = good.squares.copy(), good.counts.copy()
    squares[0], counts[0] = 1e6, False
    found = spread_of(HeldOut(squares, counts, good.fold), None, 0)
    assert found is not None
    assert found.now[0] < 2.0
    few = good.fold < 5
    assert spread_of(HeldOut(good.squares[few], good.counts[few], good.fold[few]), None, 0) is None
    assert spread_table({}) is None


def test_what_is_held_out_is_what_the_ledger_counts(tmp_path: Path) -> None:
    """Wrong rows of a verification table are left out, measured by the rows that the fit has kept."""
    made = measure(load_robot("ur10"), seed=2, poses=60, tables=("poses", "verification"))
    made.tables["poses"].loc[5, "x_m"] += 0.05  # refused by the fit: no yardstick
    made.tables["verification"].loc[[3, 9], "z_m"] += 0.01
    write_campaign(tmp_path / "arm", made.header, made.tables)
    campaign = read_campaign(tmp_path / "arm")
    model = identify(campaign, ("geometry",))
    data = stage_data(on_campaign(model, campaign))["poses"]
    found = held_out(data)
    assert found is not None
    assert not found.counts[[3, 9]].any()
    assert found.counts.mean() > 0.95
    assert np.sqrt(found.squares[found.counts].mean()) == pytest.approx(model.ledger[-1].heldout_rms, rel=1e-6)
    spread = spread_of(found, None, 0)
    assert spread is not None
    assert spread.now[0] == pytest.approx(model.ledger[-1].heldout_rms, rel=1e-6)
    assert spread.now[1] < spread.now[0] < spread.now[2]
