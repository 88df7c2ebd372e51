"""A log read window by window gives what a log held whole gives, to rounding, however it is cut."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from clampid.catalogue import catalogue
from clampid.fitting.accuracy import StageErrors, stage_errors
from clampid.identification.fitted_stage import FittedStage, fit_stage
from clampid.identification.identify import effects_in, held_out_folds, stage_rows
from clampid.identification.identify_log import FittedLog, LogStage
from clampid.slots import Term
from clampid.stages.counting import folds_of
from clampid.stages.fit_problem import parameter_of
from clampid.stages.layout import layout_of
from clampid.stages.log_facts import LogPart, log_parts
from experiments.campaign import Campaign, Tool
from experiments.log_windows import LogTable, windows
from experiments.simulate import measured_campaign
from experiments.virtual_robot import measure
from kinematics.description import load_robot

STANDARD = ("gravity", "coulomb_friction", "viscous_friction", "wrist_coupling_friction")


def campaign_of(seed: int, tables: Sequence[str]) -> Campaign:
    robot = load_robot("kuka_kr20_r1810")
    return measured_campaign(measure(robot, seed=seed, tables=tables), robot, name=f"session{seed}")


@pytest.fixture(scope="module")
def free_air() -> Campaign:
    return campaign_of(1, ("free_air",))


@pytest.fixture(scope="module")
def both() -> Campaign:
    return campaign_of(2, ("free_air", "wrist"))


def held_whole(
    campaigns: Sequence[Campaign], names: Sequence[str], holdout: float
) -> tuple[FittedStage, StageErrors, tuple[tuple[int, ...], ...]]:
    effects, layout, terms = catalogue(), layout_of(campaigns), [Term(n) for n in names]
    rows = stage_rows(campaigns, layout, "free_air", active=effects_in(terms, effects))
    held_out = held_out_folds(rows, holdout, 0)
    fitted = fit_stage(rows, effects, terms, {}, held_out=held_out)
    return fitted, stage_errors(fitted.estimate, rows, held_out, None, 0), held_out


def by_windows(
    campaigns: Sequence[Campaign],
    names: Sequence[str],
    held_out: Sequence[Sequence[int]] = (),
    window: int = 1 << 14,
    kept: int = 1 << 28,
    parts: Sequence[LogPart] | None = None,
) -> FittedLog:
    effects, terms = catalogue(), [Term(n) for n in names]
    stage = LogStage(
        parts or log_parts(campaigns),
        layout_of(campaigns),
        effects,
        terms,
        window=window,
        kept_bytes=kept,
    )
    return stage.fit(held_out, correlated=True)


def assert_same(found: FittedLog, expected: FittedStage, errors: StageErrors) -> None:
    model = expected.model
    assert found.model.slots == model.slots
    std = np.sqrt(np.diag(model.covariance))
    np.testing.assert_allclose((found.model.theta - model.theta) / std, 0.0, atol=1e-6)
    correlation = (found.model.covariance - model.covariance) / np.outer(std, std)
    np.testing.assert_allclose(correlation, 0.0, atol=1e-6)
    assert found.model.identified == model.identified
    assert found.model.outliers == model.outliers
    assert set(found.model.null_directions) == set(model.null_directions)  # equally open ones have no order
    assert found.model.held_out == model.held_out
    own = found.errors(None, 0)
    assert own.heldout_rows == errors.heldout_rows
    assert own.rms == pytest.approx(errors.rms, rel=1e-8)
    assert own.heldout_rms == pytest.approx(errors.heldout_rms, rel=1e-7)


@pytest.mark.parametrize("holdout", [0.0, 0.3])
@pytest.mark.parametrize(("window", "kept"), [(1 << 14, 1 << 28), (1700, 0)])
def test_two_tables_with_standing_joints(both: Campaign, holdout: float, window: int, kept: int) -> None:
    fitted, errors, held_out = held_whole([both], STANDARD, holdout)
    assert len(fitted.estimate.theta) > len(fitted.model.slots)  # some joints stand still for whole runs
    assert_same(by_windows([both], STANDARD, held_out, window, kept), fitted, errors)


@pytest.mark.slow
def test_accelerated_rows_temperatures_and_loads(free_air: Campaign) -> None:
    names = (*STANDARD, "inertia", "temperature_dependent_friction", "payload")
    fitted, errors, _ = held_whole([free_air], names, 0.0)
    assert_same(by_windows([free_air], names, window=4000), fitted, errors)


@pytest.mark.slow
@pytest.mark.parametrize(("window", "kept", "holdout"), [(1 << 14, 1 << 28, 0.0), (1700, 0, 0.3)])
def test_log_denser_than_its_design_can_follow(free_air: Campaign, window: int, kept: int, holdout: float) -> None:
    """Three rows are one number to the noise, of which windows, folds and outliers begin and end anywhere."""
    table = free_air.tables["free_air"].copy()
    table["time_s"] /= 30.0
    table.loc[[400, 900, 1701], "tau2_Nm"] += 50.0
    dense = replace(free_air, tables={"free_air": table})
    names = (*STANDARD, "inertia")
    fitted, errors, held_out = held_whole([dense], names, holdout)
    assert fitted.estimate.noise.together == 3
    assert fitted.model.outliers
    assert_same(by_windows([dense], names, held_out, window, kept), fitted, errors)


@pytest.mark.slow
def test_outliers_are_the_same(free_air: Campaign) -> None:
    table = free_air.tables["free_air"].copy()
    wrong = np.random.default_rng(3).choice(len(table), 80, replace=False)
    table.loc[wrong, "tau3_Nm"] += 40.0
    spoilt = replace(free_air, tables={"free_air": table})
    fitted, errors, _ = held_whole([spoilt], STANDARD, 0.0)
    assert len(fitted.model.outliers) > 5
    assert_same(by_windows([spoilt], STANDARD, window=3000), fitted, errors)


@pytest.mark.slow
def test_two_sessions_of_one_robot(free_air: Campaign, both: Campaign) -> None:
    other = replace(both, tool=Tool(3.0, np.array([0.0, 0.02, 0.1])))
    fitted, errors, _ = held_whole([free_air, other], STANDARD, 0.0)
    assert_same(by_windows([free_air, other], STANDARD), fitted, errors)


@pytest.mark.slow
def test_one_run_without_speeds(free_air: Campaign) -> None:
    table = free_air.tables["free_air"]
    table = table[table["run"] == 1].reset_index(drop=True)
    alone = replace(free_air, tables={"free_air": table.drop(columns=[f"qd{i + 1}_rad_s" for i in range(6)])})
    fitted, errors, _ = held_whole([alone], STANDARD, 0.0)
    assert_same(by_windows([alone], STANDARD), fitted, errors)
    assert_same(by_windows([alone], STANDARD, window=700), fitted, errors)


@pytest.mark.parametrize("rows", [1, 4, 5, 998, 1001])
def test_fifths_of_a_log_of_one_run_are_counted_without_its_rows(free_air: Campaign, rows: int) -> None:
    table = free_air.tables["free_air"]
    alone = replace(free_air, tables={"free_air": table[table["run"] == 1][:rows].reset_index(drop=True)})
    design = LogStage(log_parts([alone]), layout_of([alone]), catalogue(), [Term("gravity")]).design
    fold = folds_of(design.facts, np.zeros(rows, dtype=np.int64), np.arange(rows))
    np.testing.assert_array_equal(design.fold_rows, np.bincount(fold, minlength=5))


def test_a_parquet_file_is_read_as_it_is_needed(free_air: Campaign, tmp_path: Path) -> None:
    free_air.tables["free_air"].to_parquet(tmp_path / "free_air.parquet", index=False, row_group_size=2500)
    empty = replace(free_air, tables={})
    parts = [LogPart(empty, 0, "free_air", LogTable.of(tmp_path / "free_air.parquet"))]
    fitted, errors, _ = held_whole([free_air], STANDARD, 0.0)
    assert_same(by_windows([empty], STANDARD, window=4000, kept=0, parts=parts), fitted, errors)


def test_every_row_is_of_one_window_and_has_its_neighbours() -> None:
    rows, halo = 1000, 20
    table = pd.DataFrame({"run": np.repeat(np.arange(10), 100), "x": np.arange(rows)})
    seen, cut = [], 0
    for w in windows(LogTable.of(table), ["run", "x"], 130, halo):
        x = w.columns["x"]
        assert w.first == x[0]
        np.testing.assert_array_equal(np.diff(x), 1.0)
        assert w.start == min(halo, int(x[w.start]))
        assert len(x) - w.stop == min(halo, rows - 1 - int(x[w.stop - 1]))
        cut += int(x[w.stop - 1]) % 100 != 99
        seen.append(x[w.start : w.stop])
    np.testing.assert_array_equal(np.concatenate(seen), np.arange(rows))
    assert cut <= 2


@pytest.mark.slow
@pytest.mark.parametrize("holdout", [0.0, 0.3])
@pytest.mark.parametrize(("window", "kept"), [(1 << 14, 1 << 28), (1700, 0)])
def test_shape_parameters_are_those_of_the_log_held(both: Campaign, holdout: float, window: int, kept: int) -> None:
    names = (*STANDARD, "stribeck_friction")
    fitted, errors, held_out = held_whole([both], names, holdout)
    found = by_windows([both], names, held_out, window, kept)
    assert not found.stage.linear
    assert_same(found, fitted, errors)


@pytest.mark.slow
def test_shape_parameters_on_their_bounds(free_air: Campaign, monkeypatch: pytest.MonkeyPatch) -> None:
    """A speed that ends at its bound rests there in cross-validation too."""
    effects = dict(catalogue())
    amplitude, speed = effects["stribeck_friction"].parameters
    narrow = (amplitude, replace(speed, bounds=(5e-4, 0.2)))  # at the joints
    effects["stribeck_friction"] = replace(effects["stribeck_friction"], parameters=narrow)
    monkeypatch.setattr(sys.modules[__name__], "catalogue", lambda: effects)
    names = ("gravity", "viscous_friction", "stribeck_friction")
    fitted, errors, _ = held_whole([free_air], names, 0.0)
    speeds = [k for k, slot in enumerate(fitted.model.slots) if slot.parameter == speed.name]
    most = [parameter_of(fitted.model.slots[k], effects, free_air.robot).bounds[1] for k in speeds]
    assert np.any(fitted.model.theta[speeds] == most)
    assert_same(by_windows([free_air], names, window=4000), fitted, errors)
