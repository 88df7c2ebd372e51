"""One session, from an empty folder to the compensated table, with nothing but commands of this suite."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import run_session


@pytest.mark.study
def test_a_hidden_effect_is_found_and_the_error_falls(
    program: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(run_session, "PROGRAM", (program,))
    found = run_session.session(tmp_path)
    hidden = json.loads((tmp_path / "truth.json").read_text())["hidden"]
    assert [item["effect"] for item in hidden] == ["gear_eccentricity"]
    assert "poses=gear_eccentricity@joint2" in found["found"]
    assert found["after"] < 0.7 * found["before"]
    assert found["after"] < 1.5 * found["noise_floor"]
    assert (tmp_path / "dh.csv").read_text().startswith("row")
