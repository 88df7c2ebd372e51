"""Where results go: never onto an input or something of another kind, into devices and through links, whole or not."""

from __future__ import annotations

import json
import os
import stat
import subprocess
import sys
import threading
from pathlib import Path

import pytest
from cli_runner import Clampid

from clampid.cli import run
from experiments.outputs import new_file, write_bytes, write_text
from experiments.targets import OutputError, check_output, one_call


def contents(folder: Path) -> dict[str, bytes]:
    return {p.name: p.read_bytes() for p in folder.iterdir() if p.is_file()}


@pytest.mark.parametrize(
    ("call", "says"),
    [
        ("identify ARM -o ARM/poses.parquet", "expected a file outside"),
        ("identify ARM -o ARM/campaign.toml", "expected a file outside"),
        ("identify ARM -o ARM/wrist.csv", "expected a file outside"),
        ("identify ARM -o model.json --json ARM/poses.parquet", "expected a file outside"),
        ("auto ARM -o MODEL --report ARM/poses.parquet", "expected a file outside"),
        ("compare MODEL ARM --json MODEL", "found an input of this call"),
        ("compare MODEL ARM --report MODEL", "found an input of this call"),
        ("compare MODEL ARM --json same --report same", "expected two files"),
        ("diagnose MODEL ARM --plan MODEL", "found an input of this call"),
        ("add geometry MODEL ARM -o MODEL", "found an input of this call"),
        ("add geometry MODEL ARM -o LINK", "found an input of this call"),
        ("undo MODEL ARM -o MODEL", "found an input of this call"),
        ("export dh MODEL -o MODEL", "found an input of this call"),
        ("export urdf MODEL -o notes.md", "expected a URDF to replace, found plain text (--force replaces it)"),
        ("identify ARM -o notes.md", "expected a model to replace, found plain text"),
        ("identify ARM -o table.toml", "expected a model to replace, found TOML"),
        ("identify ARM -o picture.png", "expected a model to replace, found binary data"),
        ("export dh MODEL -o other.json", "expected a DH table to replace, found JSON"),
        ("effects --json notes.md", "expected JSON to replace, found plain text"),
        ("robots ur10 --svg other.json", "expected a picture (SVG) to replace, found JSON"),
        ("robots ur10 --svg x --json x", "expected two files"),
        ("report MODEL ARM -o other.json", "expected HTML to replace, found JSON"),
        ("report MODEL ARM -o ARM/campaign.toml", "expected a file outside"),
        ("base ARM --json ARM/poses.parquet", "expected a file outside"),
        ("check ARM --json ARM/campaign.toml", "expected a file outside"),
    ],
)
def test_no_output_goes_onto_an_input_or_another_kind(
    call: str, says: str, poses_only: Path, model: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "notes.md").write_text("# Notes\n")
    (tmp_path / "table.toml").write_text("[table]\na = 1\n")
    (tmp_path / "picture.png").write_bytes(b"\x89PNG\r\n\x1a\n\0\0")
    (tmp_path / "other.json").write_text("[1, 2]\n")
    (tmp_path / "LINK").symlink_to(model)
    before = contents(tmp_path), contents(poses_only), model.read_bytes()
    assert run(call.replace("ARM", str(poses_only)).replace("MODEL", str(model)).split()) == 2
    said = capsys.readouterr().err
    assert says in said
    assert len(said.splitlines()) == 1  # before any work, which would have told of its progress
    assert before == (contents(tmp_path), contents(poses_only), model.read_bytes())


def test_force_replaces_another_kind_but_no_input(model: Path, tmp_path: Path, capsys) -> None:
    notes = tmp_path / "notes.md"
    notes.write_text("# Notes\n")
    assert run(["export", "urdf", str(model), "-o", str(notes), "--force", "-q"]) == 0
    assert notes.read_text().startswith("<?xml")
    assert run(["export", "urdf", str(model), "-o", str(model), "--force", "-q"]) == 2


def test_a_robot_description_that_a_model_names_is_no_output(model: Path, tmp_path: Path, capsys) -> None:
    assert run(["export", "urdf", str(model), "-o", str(tmp_path / "arm.urdf"), "-q"]) == 0
    description = tmp_path / "arm.urdf"
    text = description.read_text().replace('robot name="ur10"', 'robot name="mine"')
    description.write_text(text)
    data = json.loads(model.read_text())
    (tmp_path / "mine.json").write_text(json.dumps({**data, "robot": "mine", "robot_file": str(description)}))
    run(["export", "urdf", str(tmp_path / "mine.json"), "-o", str(description), "-q"])
    assert "found one that this call reads" in capsys.readouterr().err
    assert description.read_text() == text


def test_an_old_result_is_replaced_and_keeps_its_mode(model: Path, tmp_path: Path) -> None:
    table = tmp_path / "table.csv"
    for _ in range(2):
        assert run(["export", "dh", str(model), "-o", str(table), "-q"]) == 0
        assert table.read_text().startswith("row,")
        table.chmod(0o640)
    assert stat.S_IMODE(table.stat().st_mode) == 0o640


def test_a_link_is_followed(model: Path, tmp_path: Path) -> None:
    (tmp_path / "far").mkdir()
    (tmp_path / "table.csv").symlink_to("far/real.csv")
    assert run(["export", "dh", str(model), "-o", str(tmp_path / "table.csv"), "-q"]) == 0
    assert (tmp_path / "table.csv").is_symlink()
    assert (tmp_path / "far" / "real.csv").read_text().startswith("row,")
    assert [p.name for p in (tmp_path / "far").iterdir()] == ["real.csv"]


def test_a_loop_of_links_is_refused(model: Path, tmp_path: Path, capsys) -> None:
    (tmp_path / "a.csv").symlink_to("b.csv")
    (tmp_path / "b.csv").symlink_to("a.csv")
    assert run(["export", "dh", str(model), "-o", str(tmp_path / "a.csv"), "-q"]) == 2
    assert "a.csv: cannot be written" in capsys.readouterr().err


def test_a_device_is_written_to(model: Path) -> None:
    before = os.stat("/dev/null")
    assert run(["export", "dh", str(model), "-o", "/dev/null", "-q"]) == 0
    assert run(["effects", "--json", "/dev/null"]) == 0
    after = os.stat("/dev/null")
    assert (before.st_mode, before.st_rdev, before.st_ino) == (after.st_mode, after.st_rdev, after.st_ino)


def test_a_pipe_is_written_to(model: Path, tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    got: list[bytes] = []
    reader = threading.Thread(target=lambda: got.append((tmp_path / "pipe").read_bytes()))
    reader.start()
    assert run(["export", "dh", str(model), "-o", str(tmp_path / "pipe"), "-q"]) == 0
    reader.join(10)
    assert got[0].startswith(b"row,")
    assert stat.S_ISFIFO((tmp_path / "pipe").stat().st_mode)


@pytest.mark.parametrize("name", ["/dev/stdout", "/dev/fd/1", "/proc/self/fd/1"])
def test_json_to_standard_output_by_any_name_is_alone(name: str, clampid: Clampid) -> None:
    assert clampid("effects", "--json", name).json == clampid("effects", "--json", "-").json


def test_standard_output_into_a_file_is_not_replaced(model: Path, tmp_path: Path) -> None:
    program = Path(sys.executable).with_name("clampid")
    with open(tmp_path / "all.txt", "w") as file:
        file.write("before\n")
        file.flush()
        subprocess.run([program, "export", "dh", model, "-o", "/dev/stdout"], stdout=file, check=True, timeout=60)
    lines = (tmp_path / "all.txt").read_text().splitlines()
    assert lines[:1] == ["before"]
    assert any(line.startswith("row,") for line in lines)


@pytest.mark.parametrize(
    ("path", "says"),
    [
        ("folder", "found a folder"),
        ("file/below", "expected {}/file to be a folder, found a file"),
        ("file/be/low", "expected {}/file to be a folder, found a file"),
        ("x" * 300, "File name too long"),
        ("new/" + "x" * 300, "File name too long"),
        ("a\0b", "cannot be written"),
        ("/proc/nothing/here", "cannot be written"),
    ],
)
def test_what_cannot_be_written_is_said_before_the_work(path: str, says: str, tmp_path: Path) -> None:
    (tmp_path / "folder").mkdir()
    (tmp_path / "file").touch()
    with pytest.raises(OutputError) as raised:
        check_output(tmp_path / path)
    assert says.format(tmp_path) in str(raised.value)
    assert str(tmp_path / path) in str(raised.value) or path.startswith("/")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["file", "folder"]


FOLDERS = {
    "simulate": ["--robot", "ur10", "-o", "{}"],
    "import": ["map.toml", "table.csv", "-o", "{}"],
    "link-files": ["-o", "{}"],
    "run": ["plan.toml", "--link", "eki://127.0.0.1:1", "--yes", "-o", "{}"],
    "worked-example": ["--out", "{}"],
}
"""Verbs that make a folder; of those that read, no input is there, so that work would be refused otherwise."""


@pytest.mark.slow
@pytest.mark.parametrize("place", ["mounted", "file", "file/below", "full"])
@pytest.mark.parametrize("verb", FOLDERS)
def test_a_folder_that_cannot_be_made_is_said_before_the_work(
    verb: str, place: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mounted").mkdir()
    (tmp_path / "file").touch()
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "mine").touch()
    if verb == "run":
        make_plan(tmp_path / "plan.toml")
    monkeypatch.setattr(os.path, "ismount", lambda path: Path(path).name == "mounted")
    for work in ("experiments.simulate.measure", "experiments.runs.runner._finish", "kinematics.description._parse"):
        if verb not in ("run", "worked-example") or "_parse" not in work:
            monkeypatch.setattr(work, lambda *_, **__: pytest.fail("it works before it looks"))
    assert run([verb, *(part.format(place) for part in FOLDERS[verb])]) == 2
    said = capsys.readouterr().err
    assert place in said
    wanted = {"mounted": "found a mount point", "file": "found", "file/below": "to be a folder, found a file"}
    assert wanted.get(place, "found") in said
    assert "No such file" not in said
    assert sorted(p.name for p in tmp_path.iterdir()) == [
        "file",
        "full",
        "mounted",
        *(["plan.toml"] if verb == "run" else []),
    ]


def make_plan(file: Path) -> None:
    from clampid.planning.free_air import plan_free_air
    from clampid.planning.logs import torque_noise_of
    from clampid.planning.program import LogWishes
    from experiments.plans import cell_of, limits_of, write_plan
    from kinematics.description import load_robot

    cell, robot = cell_of("kuka_kr20_r1810")[0], load_robot("kuka_kr20_r1810")
    write_plan(
        plan_free_air(cell, limits_of(robot)[0], torque_noise_of(cell, None, None)[0], LogWishes(time=60.0)), file
    )


@pytest.mark.parametrize("writer", ["bytes", "new_file"])
def test_a_full_disk_names_the_file_and_leaves_the_old_one(
    writer: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "m.json"
    write_text(path, "old")

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device", ".m.partial")

    monkeypatch.setattr(os, "fsync", full)

    def write() -> None:
        if writer == "bytes":
            write_bytes(path, b"new")
            return
        with new_file(path) as partial:
            partial.write_text("new")

    with pytest.raises(OSError, match="No space") as raised:
        write()
    assert raised.value.filename == str(path)
    assert contents(tmp_path) == {"m.json": b"old"}


def test_without_nameless_files_it_is_the_same(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delattr(os, "O_TMPFILE", raising=False)
    write_text(tmp_path / "a.txt", "µ")
    assert (tmp_path / "a.txt").read_text(encoding="utf-8") == "µ"
    assert stat.S_IMODE((tmp_path / "a.txt").stat().st_mode) == 0o666 & ~_mask()
    assert [p.name for p in tmp_path.iterdir()] == ["a.txt"]


def _mask() -> int:
    mask = os.umask(0o22)
    os.umask(mask)
    return mask


def test_outside_a_call_a_file_that_was_read_may_be_replaced(tmp_path: Path) -> None:
    path = tmp_path / "m.json"
    write_text(path, "{}")
    with one_call([path]), pytest.raises(OutputError, match="input of this call"):
        write_text(path, "[]")
    write_text(path, "[]")
    assert path.read_text() == "[]"
