"""Sweeps that went wrong: a joint never loaded, a clamp that was open, angles of the wrong side, a sweep cut off."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from clampid.catalogue import catalogue
from clampid.identification.fitted_stage import fit_stage
from clampid.identification.identify import stage_rows
from clampid.models.model import StageModel
from clampid.slots import Term
from clampid.stages.layout import layout_of
from experiments.campaign import Campaign
from experiments.checks.check import check_campaign
from experiments.checks.finding import Finding
from experiments.virtual_robot import measure

Simulated = Callable[..., Campaign]
N = 6
MOTOR = [f"motor{i + 1}_rad" for i in range(N)]
TAU = [f"tau{i + 1}_Nm" for i in range(N)]


@pytest.fixture(scope="module")
def sweeps(simulated: Simulated) -> Campaign:
    return simulated(seed=2, tables=("clamped",))


def with_table(campaign: Campaign, frame: pd.DataFrame) -> Campaign:
    return replace(campaign, tables={"clamped": frame.reset_index(drop=True)})


def complaints(campaign: Campaign) -> list[Finding]:
    return [f for f in check_campaign(campaign) if f.severity != "note"]


def rows_of(frame: pd.DataFrame, sweep: int) -> tuple[np.ndarray, int]:
    rows = np.flatnonzero(frame["sweep"] == sweep)
    return rows, int(frame["joint"].iloc[rows[0]]) - 1


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("hidden", [(), ("fixture_compliance",)])
def test_good_sweeps_are_not_complained_of(simulated: Simulated, seed: int, hidden: tuple[str, ...]) -> None:
    assert [f.message for f in complaints(simulated(seed=seed, tables=("clamped",), hidden=hidden))] == []


@pytest.mark.parametrize("sweep", [1, 3, 5, 6, 12])
def test_an_open_clamp_is_free_motion(sweeps: Campaign, sweep: int) -> None:
    frame = sweeps.tables["clamped"].copy()
    rows, j = rows_of(frame, sweep)
    T = np.asarray(sweeps.robot.transmission)
    # The arm goes with its motors: no spring winds up, and what is left of the torque is friction and weight.
    wound = frame[MOTOR].to_numpy()[rows]
    wound = wound - wound[0]
    plant = measure(sweeps.robot, seed=2, tables=("clamped",)).truth.plant
    tau = frame[TAU].to_numpy().copy()
    tau[rows] -= wound * plant.drive.spring
    # Free sweeps go as far as one likes; here far enough to be no clearance.
    factor = max(1.0, 5e-3 / (np.ptp(wound[:, j]) * T[j, j]))
    motor = frame[MOTOR].to_numpy().copy()
    motor[rows] = motor[rows[0]] + factor * wound
    frame[TAU], frame[MOTOR] = tau, motor
    found = [f for f in complaints(with_table(sweeps, frame)) if f.severity == "error"]
    assert len(found) == 1
    assert f"in sweep {sweep}, joint {j + 1} moves freely" in found[0].message
    assert "the clamp was open" in found[0].message
    assert found[0].row == rows[0] + 1


@pytest.mark.parametrize("sweep", [2, 4, 10])
def test_a_sweep_that_never_loads_its_joint_is_said(sweeps: Campaign, sweep: int) -> None:
    frame = sweeps.tables["clamped"].copy()
    rows, j = rows_of(frame, sweep)
    # Steps so small that noise is all there is.
    rng = np.random.default_rng(1)
    motor, tau = frame[MOTOR].to_numpy().copy(), frame[TAU].to_numpy().copy()
    level = motor[rows, j] - motor[rows[0], j]
    motor[rows, j] = motor[rows[0], j] + 1e-4 * level
    tau[rows, j] = 0.2 * np.sign(np.gradient(level)) + 0.02 * rng.standard_normal(len(rows))
    frame[MOTOR], frame[TAU] = motor, tau
    found = complaints(with_table(sweeps, frame))
    assert any(f.severity == "warning" and f"sweep {sweep} never loads joint {j + 1}" in f.message for f in found)
    assert not any(f.severity == "error" for f in found)


def test_joint_angles_for_motor_angles_are_found(sweeps: Campaign) -> None:
    frame = sweeps.tables["clamped"].copy()
    frame[MOTOR] = frame[MOTOR].to_numpy() @ np.asarray(sweeps.robot.transmission)
    found = [f for f in complaints(with_table(sweeps, frame)) if f.severity == "error"]
    assert any("these look like joint angles, motor angles are expected" in f.message for f in found)


def fitted(campaign: Campaign) -> StageModel:
    terms = [Term(name) for name in ("joint_compliance", "backlash", "coulomb_friction")]
    rows = stage_rows([campaign], layout_of([campaign]), "clamped")
    return fit_stage(rows, catalogue(), terms, {}).model


@pytest.mark.slow
def test_of_a_sweep_cut_off_the_rest_is_used(sweeps: Campaign) -> None:
    frame = sweeps.tables["clamped"]
    rows, joint = rows_of(frame, 4)
    cut = with_table(sweeps, frame.drop(index=rows[75:]))
    assert not [f for f in complaints(cut) if f.severity == "error"]
    whole, part, without = (fitted(c) for c in (sweeps, cut, with_table(sweeps, frame.drop(index=rows))))
    # Estimates from all and from a part of the rows differ by what the difference of their variances allows.
    spread = np.sqrt(np.maximum(part.std**2 - whole.std**2, 0.0) + (0.5 * whole.std) ** 2)
    assert np.all(np.abs(part.theta - whole.theta)[:12] < 4 * spread[:12])
    assert part.std[joint] < without.std[joint]


@pytest.mark.parametrize("kept", [1, 2, 9])
def test_a_sweep_of_a_few_rows_is_looked_at_too(sweeps: Campaign, kept: int) -> None:
    frame = sweeps.tables["clamped"]
    rows, _ = rows_of(frame, 4)
    keep = np.r_[np.arange(rows[0] - 320, rows[0] + kept)]
    cut = with_table(sweeps, frame.iloc[keep])
    assert not [f for f in complaints(cut) if f.severity == "error"]
    assert np.all(np.isfinite(fitted(cut).theta))
