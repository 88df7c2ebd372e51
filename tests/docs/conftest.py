"""What the tests of the documentation share."""

from __future__ import annotations

from pathlib import Path

import pytest
from recorded_runs import RecordedRuns
from recorded_screens import simulated_part


@pytest.fixture(scope="session")
def recorded(program: Path, tmp_path_factory: pytest.TempPathFactory) -> RecordedRuns:
    """Commands of the recorded screens, each run once from equal folders."""
    return RecordedRuns(program, tmp_path_factory.mktemp("recorded"))


@pytest.fixture
def simulated(recorded: RecordedRuns, tmp_path: Path) -> tuple[str, Path]:
    """The part of the page of screens on the simulated campaign, and a folder with that campaign."""
    text, first = simulated_part()
    folder = tmp_path / "folder"
    folder.mkdir()
    recorded(first, folder)
    return text, folder
