"""Streams that are not UTF-8: nothing is lost, and results for programs are UTF-8 all the same."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

PLACES = [
    {"PYTHONIOENCODING": "cp1252"},
    {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"},
]


def ran(place: dict[str, str], *arguments: str | Path) -> subprocess.CompletedProcess[bytes]:
    program = Path(sys.executable).with_name("clampid")
    env = {k: v for k, v in os.environ.items() if k not in ("PYTHONUTF8", "PYTHONIOENCODING", "LC_ALL")}
    return subprocess.run(
        [program, *map(str, arguments)], env=env | place, capture_output=True, check=False, timeout=120
    )


@pytest.mark.parametrize("place", PLACES, ids=lambda place: "-".join(place.values()))
def test_every_encoding_gives_results(place: dict[str, str], poses_only: Path, model: Path, tmp_path: Path) -> None:
    told = ran(place, "compare", model, poses_only)
    assert told.returncode == 0, told.stderr
    assert told.stdout
    alone = ran(place, "compare", model, poses_only, "--json", "-")
    assert json.loads(alone.stdout.decode("utf-8"))["tables"]["poses"]["rows"]
    table = ran(place, "export", "dh", model)
    assert table.stdout.decode("utf-8").startswith("row,")


def test_signs_that_are_missing_are_spelt(poses_only: Path, tmp_path: Path) -> None:
    told = ran({"PYTHONIOENCODING": "ascii"}, "identify", poses_only, "-o", tmp_path / "m.json")
    assert told.returncode == 0, told.stderr
    assert b" um" in told.stdout
    assert b"?" not in told.stdout


def test_a_complaint_in_another_encoding_is_one_line(tmp_path: Path) -> None:
    told = ran({"PYTHONIOENCODING": "ascii"}, "check", tmp_path / "Prüfstand")
    assert told.returncode == 2
    assert len(told.stderr.splitlines()) == 1
    assert b"Traceback" not in told.stderr
