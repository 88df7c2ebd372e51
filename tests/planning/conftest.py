"""Fixtures of the planners' tests."""

from __future__ import annotations

from pathlib import Path

import pytest

from clampid.planning.free_air import plan_free_air
from clampid.planning.logs import torque_noise_of
from clampid.planning.program import LogWishes
from experiments.plans import Cell, Limits, Plan, cell_of, limits_of, write_plan


@pytest.fixture(scope="session")
def cell() -> Cell:
    return cell_of("kuka_kr20_r1810")[0]


@pytest.fixture(scope="session")
def limits(cell: Cell) -> Limits:
    return limits_of(cell.robot)[0]


@pytest.fixture(scope="session")
def free_air(cell: Cell, limits: Limits) -> Plan:
    return plan_free_air(cell, limits, torque_noise_of(cell, None, None)[0], LogWishes(time=300.0))


@pytest.fixture
def free_air_file(free_air: Plan, tmp_path: Path) -> Path:
    return write_plan(free_air, tmp_path / "plan.toml")
