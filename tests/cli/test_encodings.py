"""Streams that are not UTF-8: nothing is lost, and results for programs are UTF-8 all the same."""

from __future__ import annotations

import ast
import json
import os
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from clampid.verbs.streams import spelt
from kinematics.escaping import has_controls

ROOT = Path(__file__).parents[2]
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


@pytest.mark.slow
@pytest.mark.parametrize("place", PLACES, ids=lambda place: "-".join(place.values()))
def test_every_encoding_gives_results(place: dict[str, str], poses_only: Path, model: Path, tmp_path: Path) -> None:
    told = ran(place, "compare", model, poses_only)
    assert told.returncode == 0, told.stderr
    assert told.stdout
    alone = ran(place, "compare", model, poses_only, "--json", "-")
    assert json.loads(alone.stdout.decode("utf-8"))["tables"]["poses"]["rows"]
    table = ran(place, "export", "dh", model)
    assert table.stdout.decode("utf-8").startswith("row,")


@pytest.mark.slow
def test_signs_that_are_missing_are_spelt(poses_only: Path, tmp_path: Path) -> None:
    told = ran({"PYTHONIOENCODING": "ascii"}, "identify", poses_only, "-o", tmp_path / "m.json")
    assert told.returncode == 0, told.stderr
    assert b" um" in told.stdout
    assert b"?" not in told.stdout


@pytest.mark.parametrize("encoding", ["idna", "punycode", "utf-16"])
def test_an_encoding_that_takes_no_text_loses_none(encoding: str) -> None:
    told = ran({"PYTHONIOENCODING": encoding}, "robots")
    assert told.returncode == 0, told.stderr
    text = told.stdout.decode(encoding if encoding == "utf-16" else "utf-8", "replace")
    assert "robots are bundled" in text


@pytest.mark.slow
def test_a_complaint_in_another_encoding_is_one_line(tmp_path: Path) -> None:
    told = ran({"PYTHONIOENCODING": "ascii"}, "check", tmp_path / "Prüfstand")
    assert told.returncode == 2
    assert len(told.stderr.splitlines()) == 1
    assert b"Traceback" not in told.stderr


@pytest.mark.parametrize(
    ("signs", "plain"),
    [("10⁻⁶", "10^-6"), ("m²", "m^2"), ("χ² of σ", "chi^2 of sigma"), ("Λ", "Lambda"), ("Stäubli", "Staubli"),
     ("x̄", "x"), ("──", "--"), ("→ 5 µm", "-> 5 um"), ("世", "?")],
)  # fmt: skip
def test_spelling(signs: str, plain: str) -> None:
    assert spelt(signs) == plain


@pytest.mark.slow
def test_every_sign_that_the_program_prints_is_spelt() -> None:
    """In all its texts; what nobody may see is refused or escaped before it is printed."""
    signs: set[str] = set()
    for package in ("clampid", "experiments", "kinematics", "offline_ik"):
        for file in (ROOT / package).rglob("*.py"):
            texts = (n.value for n in ast.walk(ast.parse(file.read_text("utf-8"))) if isinstance(n, ast.Constant))
            signs |= {sign for text in texts if isinstance(text, str) for sign in text}
    for file in (ROOT / "appendix_data").rglob("*.toml"):
        signs |= set(file.read_text("utf-8"))
    kept = {sign for sign in signs if not has_controls(sign)}
    assert len(kept) > 100
    assert not {sign for sign in kept - {"?"} if "?" in spelt(sign)}


@pytest.mark.slow
def test_a_table_keeps_its_rules(poses_only: Path, tmp_path: Path) -> None:
    told = ran({"PYTHONIOENCODING": "ascii"}, "identify", poses_only, "-o", tmp_path / "m.json", "--verbose")
    assert told.returncode == 0, told.stderr
    assert b"-----" in told.stdout
    assert b"?" not in told.stdout


@pytest.mark.slow
@pytest.mark.parametrize("stream", ["2>&-", "2>/dev/full", ">&- 2>&-"])
def test_a_complaint_that_cannot_be_printed_is_a_code_all_the_same(stream: str, tmp_path: Path) -> None:
    if "full" in stream and not Path("/dev/full").exists():
        pytest.skip("no /dev/full")
    program = Path(sys.executable).with_name("clampid")
    called = f"{shlex.quote(str(program))} check {shlex.quote(str(tmp_path / 'nowhere'))} {stream}"
    assert subprocess.run(["sh", "-c", called], check=False, timeout=60).returncode == 2


@pytest.mark.slow
@pytest.mark.parametrize("columns", ["0", "-5", "1", "wide", "9" * 30, "\u0667"])
def test_a_width_that_is_none_is_not_used(columns: str, poses_only: Path) -> None:
    told = ran({"COLUMNS": columns}, "check", poses_only)
    assert told.returncode == 0, told.stderr
    assert told.stdout
