"""A file is replaced by one of its own kind only, whichever verb writes; --force replaces any but an input."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from clampid.cli import run
from experiments.file_kinds import kind_of
from experiments.outputs import write_text
from experiments.targets import OutputError, one_call

POSITION = "--gamma 0.3 --delta 0.2 --r 0.8 -q"
CALLS = {
    "effects --json X": "JSON",
    "check ARM --json X": "JSON",
    "history MODEL --json X": "JSON",
    "compare MODEL ARM --json X -q": "JSON",
    "identify ARM -o X -q": "a model",
    "robots ur10 --svg X": "a picture (SVG)",
    "export dh MODEL -o X -q": "a DH table",
    "export dh MODEL --convention standard -o X -q": "a DH table",
    "export dh MODEL --layout thesis -o X -q": "a printed table",
    "export urdf MODEL -o X -q": "a URDF",
    "report MODEL ARM -o X -q": "HTML",
    f"ik MODEL --picture X {POSITION}": "a picture (SVG)",
    f"ik MODEL --poni X --pixels 9,9 {POSITION}": "a geometry for pyFAI",
    "plan fixed-point --robot ur10 --like ARM --floor none --posture 0,-1.5,1.5,0.1,0.1,0.1 -o X.toml -q": "a plan",
}
"""Calls that write a file, and of which kind it is."""
LIKE_OTHERS = ("export dh MODEL --convention standard -o X -q", "export dh MODEL --layout thesis -o X -q")


@pytest.mark.slow
@pytest.mark.parametrize("call", [pytest.param(c, marks=pytest.mark.study) if c in LIKE_OTHERS else c for c in CALLS])
def test_an_older_file_of_its_kind_is_replaced_and_no_other(
    call: str, poses_only: Path, model: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys
) -> None:
    monkeypatch.chdir(tmp_path)
    for other in tmp_path.iterdir():
        other.unlink()
    given = call.replace("ARM", str(poses_only)).replace("MODEL", str(shutil.copy(model, tmp_path / "m.json"))).split()
    target = tmp_path / ("X.toml" if "X.toml" in call else "X")
    assert run(given) == 0, capsys.readouterr().err
    assert kind_of(target.read_bytes()[:65536]) == CALLS[call]
    assert run(given) == 0, capsys.readouterr().err
    others = {
        "a model": model.read_bytes(),
        "the header of a campaign": (poses_only / "campaign.toml").read_bytes(),
        "plain text": b"# Notes\n\nMine.\n",
        "a Parquet table": (poses_only / "poses.parquet").read_bytes(),
        "Python": b"import os\n\nEFFECT = 1\n",
        "a table whose first column is 'pose'": b"pose,x_m\n1,2.0\n",
        "a URDF": b'<?xml version="1.0"?>\n<!-- mine -->\n<robot name="a"/>\n',
        "a picture (SVG)": b'<svg xmlns="http://www.w3.org/2000/svg"/>',
    }
    for kind, content in others.items():
        if kind == CALLS[call]:
            continue
        target.write_bytes(content)
        capsys.readouterr()
        assert run(given) == 2, kind
        said = capsys.readouterr().err
        assert f"expected {CALLS[call]} to replace, found {kind} (--force replaces it)" in said
        assert len(said.splitlines()) == 1, said  # before the work
        assert target.read_bytes() == content
    assert run([*given, "--force"]) == 0
    assert kind_of(target.read_bytes()[:65536]) == CALLS[call]


def test_what_is_written_beside_a_result_replaces_no_other_kind(
    poses_only: Path, model: Path, tmp_path: Path, capsys
) -> None:
    mine = shutil.copy(model, tmp_path / "m.json")
    for beside, call in (
        ("arm.hidden.json", ["simulate", "--robot", "ur10", "-o", str(tmp_path / "arm"), "--poses", "8"]),
        ("m.diagnosis.json", ["diagnose", str(mine), str(poses_only), "-q"]),
    ):
        shutil.copy(model, tmp_path / beside)
        assert run(call) == 2
        assert "found a model (--force replaces it)" in capsys.readouterr().err
        assert (tmp_path / beside).read_bytes() == model.read_bytes()
    assert not (tmp_path / "arm").exists()


def test_a_demo_replaces_no_campaign_that_was_measured(poses_only: Path, model: Path, tmp_path: Path, capsys) -> None:
    shutil.copytree(poses_only, tmp_path / "campaign")
    before = {p.name: p.read_bytes() for p in (tmp_path / "campaign").iterdir()}
    assert run(["demo", "--out", str(tmp_path), "-q"]) == 2
    assert "expected a folder without campaign, or one of an older demo" in capsys.readouterr().err
    shutil.move(tmp_path / "campaign", tmp_path / "mine")
    shutil.copy(model, tmp_path / "model.json")
    assert run(["demo", "--out", str(tmp_path), "-q"]) == 2
    assert "expected a folder without model.json" in capsys.readouterr().err
    assert {p.name: p.read_bytes() for p in (tmp_path / "mine").iterdir()} == before


def test_whatever_writes_in_a_call_is_looked_at_when_it_writes(tmp_path: Path) -> None:
    path = tmp_path / "x"
    write_text(path, "# Notes\n")
    with one_call([]), pytest.raises(OutputError, match="expected JSON to replace, found plain text"):
        write_text(path, "{}\n")
    with one_call([], force=True):
        write_text(path, "{}\n")
    assert path.read_text() == "{}\n"


@pytest.mark.parametrize(
    ("start", "kind"),
    [
        (b"", None),
        (b" \n\xef\xbb\xbf", "plain text"),
        (b"\xef\xbb\xbf{}", "JSON"),
        (b'{"b": 1, "format": "clampid-model/1"}', "a model"),
        (b'format = "clampid-campaign/1"\n', "the header of a campaign"),
        (b'# mine\n[a]\nformat="clampid-new/9"\n', "a file of the format clampid-new"),
        (b"# mine\n[robot]\nname = 1\n", "TOML"),
        (b"[1, 2]\n", "JSON"),
        (b"\xff\xfe{\0}\0", "binary data"),
        (b"\x89PNG\r\n", "binary data"),
        (b"\xc3\xa4\xc3", "binary data"),
        (b"\xc3\xa4" * 32767 + b"a\xc3", "plain text"),  # cut in a character
        (b"<!DOCTYPE html>\n<html>", "HTML"),
        (b"<!-- <robot/> --><svg/>", "a picture (SVG)"),
        (b"<", "XML"),
        (b"Dear all, this is, as I said, a letter!\n", "plain text"),
    ],
)
def test_kinds(start: bytes, kind: str | None) -> None:
    assert kind_of(start) == kind
