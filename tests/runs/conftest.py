"""Virtual controllers and small plans, as fixtures."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from run_controller import CLAMPED, Controller, clamping_plan, free_air_plan, poses_plan

from experiments.plans import Cell, Limits, Plan, cell_of, limits_of


@pytest.fixture(scope="session")
def shared(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Controller]:
    found = Controller(tmp_path_factory.mktemp("controller") / "truth.json", ("--speed", "50", "--seed", "3")).start()
    yield found
    found.stop()


@pytest.fixture
def controller(shared: Controller) -> Iterator[Controller]:
    """The one of all fast tests, in EXT, with its flange free; the robot stands where the last test left it."""
    yield shared
    for line in ("speed 50", "sight lost 0", "estop off", "drives on", "mode EXT", "release"):
        shared.operate(line)


@pytest.fixture
def own(tmp_path: Path) -> Iterator[Controller]:
    """One that may be killed."""
    found = Controller(tmp_path / "truth.json", ("--speed", "50", "--seed", "3")).start()
    yield found
    found.stop()


@pytest.fixture(scope="session")
def cell() -> Cell:
    return cell_of("kuka_kr20_r1810")[0]


@pytest.fixture(scope="session")
def limits(cell: Cell) -> Limits:
    return limits_of(cell.robot)[0]


@pytest.fixture(scope="session")
def poses(cell: Cell, limits: Limits) -> Plan:
    return poses_plan(cell, limits)


@pytest.fixture(scope="session")
def free_air(cell: Cell, limits: Limits) -> Plan:
    return free_air_plan(cell, limits)


@pytest.fixture(scope="session")
def clamping(cell: Cell, limits: Limits) -> Plan:
    return clamping_plan(cell, limits, [(1, 1, CLAMPED), (1, 2, CLAMPED)])
