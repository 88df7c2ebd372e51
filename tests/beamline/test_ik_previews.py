"""``clampid ik`` draws the move, says what a pixel sees, and writes pyFAI's file."""

from __future__ import annotations

import json
from pathlib import Path
from xml.etree import ElementTree

import pytest
from typer.testing import CliRunner

from clampid.cli import app
from clampid.verbs.units import Units
from offline_ik.errors import DetectorError
from offline_ik.inverse.detector import Detector
from offline_ik.motion.simulation import Position, simulate_move
from offline_ik.verbs.previews import Preview, previewed

PLACE = ["--gamma", "0.35", "--delta", "0.2", "--r", "0.8", "--near", "0.1,-1.2,1.2,0.1,0.4,0"]


def test_ik_previews(model_file: Path, cell_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CLAMPID_COMPILER", "none")  # the verb asks for it in its process, which is this one
    svg, poni, out = tmp_path / "move.svg", tmp_path / "detector.poni", tmp_path / "ik.json"
    wanted = ["--picture", str(svg), "--poni", str(poni), "--pixel", "256.5,514.5", "--json", str(out)]
    done = CliRunner().invoke(app(), ["ik", str(model_file), "--cell", str(cell_file), *PLACE, *wanted])
    assert done.exit_code == 0, done.output
    assert "Pixel (256.5, 514.5) sees gamma" in " ".join(done.output.split())
    assert ElementTree.parse(svg).getroot().tag.endswith("svg")
    assert "Poni1: " in poni.read_text()
    data = json.loads(out.read_text())
    assert data["pixel"]["gamma_rad"] == pytest.approx(0.35, abs=1e-9)
    assert data["path"]["safe"]


@pytest.mark.parametrize(
    ("pixel", "pixels", "says"),
    [
        ("1", None, "--pixel: expected I,J"),
        ("9999,0", None, "i: expected a pixel from 0 to 513"),
        ("0,0", "3", "--pixels: expected ROWS,COLUMNS"),
        ("0,x", None, "--pixel: expected numbers"),
    ],
)
def test_what_cannot_be_meant_is_refused(pixel: str, pixels: str | None, says: str, detector: Detector) -> None:
    found = simulate_move(detector, Position(0.35, 0.2, 0.8))
    with pytest.raises(DetectorError, match=says):
        previewed(detector, found, Preview(None, None, pixel, pixels), Units(False, False))
