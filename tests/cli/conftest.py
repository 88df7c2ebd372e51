"""Fixtures of the command line's tests: campaigns and models that several files read."""

from __future__ import annotations

from pathlib import Path

import pytest
from cli_runner import Clampid, runs_of
from program_server import INSTALLED

from experiments.simulate import simulate


@pytest.fixture(scope="session")
def clampid(program: Path) -> Clampid:
    """Run the command in a process of its own, which another one has imported for it."""
    return runs_of(program)


@pytest.fixture(scope="session")
def installed() -> Clampid:
    """Run the installed entry point itself, as a user does: modules, hashes of strings and signals are its own."""
    return runs_of(INSTALLED)


@pytest.fixture(scope="session")
def poses_only(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Give a small campaign of poses and verification alone, with an eccentric gear hidden."""
    folder = tmp_path_factory.mktemp("campaigns") / "arm"
    tables = ("poses", "verification")
    return simulate(folder, "ur10", ["gear_eccentricity@joint2:3"], seed=3, poses=80, tables=tables)


@pytest.fixture(scope="session")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Give a campaign with all tables and nothing hidden."""
    return simulate(tmp_path_factory.mktemp("campaigns") / "whole", seed=4, poses=60)


@pytest.fixture(scope="session")
def model(poses_only: Path, clampid: Clampid) -> Path:
    """Give a model identified from the campaign of poses."""
    path = poses_only.with_name("model.json")
    ran = clampid("identify", poses_only, "-o", path, "-q")
    assert ran.code == 0, ran.err
    return path
