"""What the tests of the documentation share."""

from __future__ import annotations

from pathlib import Path

import pytest
from recorded_runs import RecordedRuns


@pytest.fixture(scope="session")
def recorded(program: Path, tmp_path_factory: pytest.TempPathFactory) -> RecordedRuns:
    """Commands of the recorded screens, each run once from equal folders."""
    return RecordedRuns(program, tmp_path_factory.mktemp("recorded"))
