"""Fixtures of the tests of inverse kinematics: models, cells and detectors."""

from __future__ import annotations

from pathlib import Path

import pytest
from ik_arms import CELL, drawn_model

from clampid.models.model import save_model
from offline_ik.inverse.detector import Detector
from offline_ik.inverse.opening import open_detector


@pytest.fixture(scope="session")
def model_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("ik") / "model.json"
    save_model(drawn_model(), path)
    return path


@pytest.fixture(scope="session")
def cell_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("ik") / "cell.toml"
    path.write_text(CELL, encoding="utf-8")
    return path


@pytest.fixture(scope="session")
def detector(model_file: Path, cell_file: Path) -> Detector:
    return open_detector(model_file, cell_file)
