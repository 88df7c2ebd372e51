"""The recorded screens: at most 24 lines of 80 columns, no word broken, and next commands that the program takes.

That the simulated ones are what is printed today is held by test_examples; the real robot's are made again here. The
next commands that they offer are run, too.
"""

from __future__ import annotations

import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import typer
from recorded_screens import PAGE, simulated_part

from clampid.cli import app
from clampid.screen import HEIGHT, WIDTH

ROOT = Path(__file__).parents[2]
BLOCK = re.compile(r"^```console\n\$ (?P<command>.*)\n(?P<text>(?:.*\n)*?)```$", re.MULTILINE)
REAL = ROOT.parent / "shared" / "real" / "ur10_series_d"
SCREENS = [(match["command"], match["text"]) for match in BLOCK.finditer(PAGE.read_text(encoding="utf-8"))]
VERBS = ("check", "identify", "compare", "diagnose", "auto", "ik")


def commands(text: str) -> list[str]:
    """Give the commands that a screen offers, as a shell joins their lines."""
    joined = text.replace("\\\n", "")
    return [line.strip() for line in joined.splitlines() if line.startswith("  clampid ")]


def parses(command: str) -> bool:
    """Say whether the program takes a command's options and arguments; nothing is run."""
    program: Any = typer.main.get_command(app())
    words = shlex.split(command)[1:]
    context = program.make_context("clampid", list(words))
    try:
        while hasattr(program, "resolve_command"):
            name, program, words = program.resolve_command(context, words)
            context = program.make_context(name, list(words), parent=context)
    except Exception as error:
        if not hasattr(error, "format_message"):  # typer's own: a wrong command, option or argument
            raise
        return False
    return True


def test_every_verb_is_recorded_on_both_campaigns() -> None:
    said = [command.split() for command, _ in SCREENS]
    for campaign in ("arm", "ur10_series_d"):
        verbs = {
            words[1]
            for words in said
            if campaign in words or (words[1] == "ik" and ("ur10" in words[2]) == ("ur10" in campaign))
        }
        assert set(VERBS) <= verbs, campaign


@pytest.mark.parametrize(("command", "text"), SCREENS, ids=[command for command, _ in SCREENS])
def test_a_recording_is_one_screen_whose_next_commands_parse(command: str, text: str) -> None:
    lines = text.splitlines()
    assert len(lines) <= HEIGHT
    assert max(map(len, lines)) <= WIDTH
    offered = commands(text)
    assert offered or command.split()[1] in ("history", "serve")
    for one in offered:
        assert parses(one), one


@pytest.mark.parametrize("wrong", ["clampid diagnos m.json arm", "clampid diagnose", "clampid check arm --fast"])
def test_a_wrong_command_does_not_parse(wrong: str) -> None:
    assert not parses(wrong)


def run(command: str, folder: Path) -> str:
    """Run a command as it is printed, at 80 columns; its exit code is 0. Give what it prints."""
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    env = {**os.environ, "PATH": path, "COLUMNS": str(WIDTH)}
    done = subprocess.run(["bash", "-c", command], cwd=folder, env=env, capture_output=True, text=True, check=False)
    assert done.returncode == 0, f"{command}\n{done.stdout[-2000:]}\n{done.stderr[-2000:]}"
    wide = [line for line in (done.stdout + done.stderr).splitlines() if len(line) > WIDTH]
    assert wide == [], command
    return done.stdout


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_every_next_command_of_the_simulated_campaign_runs(tmp_path: Path) -> None:
    """After each command of the page, what its screen offers is run in a copy of the folder, in the order offered."""
    simulated, first = simulated_part()
    folder = tmp_path / "folder"
    folder.mkdir()
    run(first, folder)
    needs_an_address, tried = [], 0
    for number, match in enumerate(BLOCK.finditer(simulated)):
        if match["command"].startswith("clampid serve"):  # runs until interrupted
            continue
        printed = run(match["command"], folder)
        copy = shutil.copytree(folder, tmp_path / f"copy{number}")
        for offered in commands(printed):
            if "HOST:" in offered:
                needs_an_address.append(match["command"])
                continue
            assert len(run(offered, copy).splitlines()) <= HEIGHT
            tried += 1
    assert tried > len(VERBS)
    assert needs_an_address == ["clampid run line.toml -o measured --dry-run"]


@pytest.mark.slow
@pytest.mark.timeout(1800)
@pytest.mark.skipif(not REAL.is_dir(), reason="the real robot's campaign is not here")
@pytest.mark.parametrize("verb", VERBS)
def test_what_is_printed_of_the_real_robot_is_one_screen(verb: str, tmp_path: Path) -> None:
    (tmp_path / REAL.name).symlink_to(REAL)
    wanted = {command.split()[1]: (command, text) for command, text in SCREENS if "ur10" in command}
    if verb in ("compare", "diagnose", "ik"):
        run(wanted["identify"][0], tmp_path)
    command, text = wanted[verb]
    printed = run(command, tmp_path)
    assert len(printed.splitlines()) <= HEIGHT
    plain = re.compile(r"[-−+]?\d[\d.\u202f]*")
    assert plain.sub("#", " ".join(printed.split())) == plain.sub("#", " ".join(text.split()))
    for offered in commands(printed):
        if offered != wanted["diagnose"][0]:  # which has a test of its own
            assert len(run(offered, tmp_path).splitlines()) <= HEIGHT
