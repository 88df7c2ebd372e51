"""Fixtures of the beamline's tests."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from ik_arms import CELL, drawn_model
from memory_link import MemoryLink
from serving_thread import Serving

from clampid.models.model import save_model
from offline_ik.inverse.detector import Detector
from offline_ik.inverse.opening import open_detector


@pytest.fixture(scope="session")
def model_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("beamline") / "model.json"
    save_model(drawn_model(), path)
    return path


@pytest.fixture(scope="session")
def cell_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("beamline") / "cell.toml"
    pixels = "size_m = [0.2, 0.2, 0.1]\npixels = [514, 1030]\n"
    path.write_text(CELL.replace("size_m = [0.2, 0.2, 0.1]\n", pixels), encoding="utf-8")
    return path


@pytest.fixture(scope="session")
def detector(model_file: Path, cell_file: Path) -> Detector:
    found = open_detector(model_file, cell_file)
    found.warm_up()
    return found


@pytest.fixture
def link() -> MemoryLink:
    return MemoryLink()


@pytest.fixture
def serving(detector: Detector, link: MemoryLink) -> Iterator[Serving]:
    with Serving(detector, link) as found:
        yield found
