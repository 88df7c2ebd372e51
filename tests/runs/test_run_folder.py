"""The folder of a run that is not finished: one that holds anything else is neither written into nor removed."""

from __future__ import annotations

import hashlib
import os
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from clampid.cli import run
from experiments.outputs import _partial_name


@pytest.fixture(scope="module")
def plan(tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("still") / "still.toml"
    assert run(["plan", "fixed-point", "-o", str(file), "-q"]) == 0
    return file


def resumed(plan: Path, folder: Path) -> int:
    """The exit code of a run that would go on, of a robot that nobody answers for."""
    robot = ["--link", "eki://127.0.0.1:9", "--instrument", "tcp://127.0.0.1:9", "--yes"]
    return run(["run", str(plan), "-o", str(folder / "C"), "--resume", *robot])


def hashes(folder: Path) -> dict[str, str]:
    files = (p for p in folder.rglob("*") if p.is_file())
    return {str(p): hashlib.sha256(p.read_bytes()).hexdigest() for p in files}


def a_link(work: Path, plan: Path) -> None:
    (work.parent / "other").mkdir()
    (work.parent / "other" / "mine.txt").write_text("mine")
    work.symlink_to(work.parent / "other")


def a_link_that_leads_nowhere(work: Path, plan: Path) -> None:
    work.symlink_to(work.parent / "nowhere")


def a_file(work: Path, plan: Path) -> None:
    work.write_text("mine")


def files_of_another(work: Path, plan: Path) -> None:
    work.mkdir()
    (work / "mine.txt").write_text("mine")


def a_folder_in_it(work: Path, plan: Path) -> None:
    (work / "mine").mkdir(parents=True)


def a_folder_for_a_journal(work: Path, plan: Path) -> None:
    (work / "journal.jsonl").mkdir(parents=True)


def a_linked_journal(work: Path, plan: Path) -> None:
    work.mkdir()
    shutil.copy(plan, work / "plan.toml")
    (work.parent / "theirs.jsonl").write_text("")
    (work / "journal.jsonl").symlink_to(work.parent / "theirs.jsonl")


def a_pipe(work: Path, plan: Path) -> None:
    work.mkdir()
    os.mkfifo(work / "journal.jsonl")


@pytest.mark.parametrize(
    "made",
    [a_link, a_link_that_leads_nowhere, a_file, files_of_another, a_folder_in_it, a_folder_for_a_journal,
     a_linked_journal, a_pipe],
)  # fmt: skip
def test_what_is_no_folder_of_a_run_is_left_alone(
    made: Callable[[Path, Path], None], plan: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    made(tmp_path / ".C.run", plan)
    before = hashes(tmp_path)
    assert resumed(plan, tmp_path) == 2
    said = capsys.readouterr().err
    assert len(said.splitlines()) == 1
    assert ".C.run: expected nothing, or the folder of a run that was stopped, found" in said
    assert hashes(tmp_path) == before
    assert os.path.lexists(tmp_path / ".C.run")


def test_what_a_kill_left_of_a_write_is_no_obstacle(plan: Path, tmp_path: Path) -> None:
    work = tmp_path / ".C.run"
    work.mkdir()
    for name in ("plan.toml", "plan-2.toml"):
        shutil.copy(plan, work / name)
    (work / "journal.jsonl").write_text("")
    (work / _partial_name(work / "plan.toml")).write_text("half")
    assert resumed(plan, tmp_path) == 3  # nobody answers
    assert not work.exists()
