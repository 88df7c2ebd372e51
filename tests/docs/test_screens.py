"""The recorded screens: at most 24 lines of 80 columns, no word broken, and next commands that the program takes.

All are printed again here, and the next commands that they offer are run, too.
"""

from __future__ import annotations

import re
import shlex
import shutil
from pathlib import Path
from typing import Any

import pytest
import typer
from recorded_runs import RecordedRuns
from recorded_screens import PAGE
from shown_text import unlike

from clampid.cli import app
from clampid.screen import HEIGHT, WIDTH

ROOT = Path(__file__).parents[2]
BLOCK = re.compile(r"^```console\n\$ (?P<command>.*)\n(?P<text>(?:.*\n)*?)```$", re.MULTILINE)
REAL = ROOT.parent / "shared" / "real" / "ur10_series_d"
SCREENS = [(match["command"], match["text"]) for match in BLOCK.finditer(PAGE.read_text(encoding="utf-8"))]
VERBS = ("check", "identify", "compare", "diagnose", "auto", "ik")
LONGEST = ("diagnose", "auto")  # of the real robot's poses; what they find is tested elsewhere


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


@pytest.mark.slow
def test_an_equal_folder_gives_what_was_recorded_and_another_does_not(recorded: RecordedRuns, tmp_path: Path) -> None:
    """Told by files that a command leaves and that no equal run would leave again."""
    first, second = tmp_path / "first", tmp_path / "second"
    command = "head -c 12 /dev/urandom | base64 > drawn; clampid robots ur10"
    for folder in (first, second):
        folder.mkdir()
        (folder / "same").write_text("a")
    assert recorded(command, first) == recorded(command, second)
    drawn = (first / "drawn").read_text()
    assert (second / "drawn").read_text() == drawn
    (second / "drawn").unlink()
    (second / "same").write_text("b")
    recorded(command, second)
    assert (second / "drawn").read_text() != drawn


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_the_simulated_screens_are_what_is_printed_today(recorded: RecordedRuns, simulated: tuple[str, Path]) -> None:
    shown, folder = simulated
    for match in BLOCK.finditer(shown):
        if not match["command"].startswith("clampid serve"):
            wrong = unlike(match["text"], recorded(match["command"], folder))
            assert wrong is None, f"{match['command']}:\n{wrong}"


@pytest.mark.study
@pytest.mark.timeout(1800)
def test_every_next_command_of_the_simulated_campaign_runs(
    recorded: RecordedRuns, simulated: tuple[str, Path], tmp_path: Path
) -> None:
    """After each command of the page, what its screen offers is run in a copy of the folder, in the order offered."""
    shown, folder = simulated
    needs_an_address, tried = [], 0
    for number, match in enumerate(BLOCK.finditer(shown)):
        if match["command"].startswith("clampid serve"):  # runs until interrupted
            continue
        printed = recorded(match["command"], folder)
        copy = shutil.copytree(folder, tmp_path / f"copy{number}")
        for offered in commands(printed):
            if "HOST:" in offered:
                needs_an_address.append(match["command"])
                continue
            assert len(recorded(offered, copy).splitlines()) <= HEIGHT
            tried += 1
    assert tried > len(VERBS)
    assert needs_an_address == ["clampid run line.toml -o measured --dry-run"]


@pytest.mark.timeout(1800)
@pytest.mark.skipif(not REAL.is_dir(), reason="the real robot's campaign is not here")
@pytest.mark.parametrize(
    "verb", [pytest.param(v, marks=pytest.mark.study if v in LONGEST else pytest.mark.slow) for v in VERBS]
)
def test_what_is_printed_of_the_real_robot_is_one_screen(verb: str, recorded: RecordedRuns, tmp_path: Path) -> None:
    folder = tmp_path / "folder"
    folder.mkdir()
    (folder / REAL.name).symlink_to(REAL)
    wanted = {command.split()[1]: (command, text) for command, text in SCREENS if "ur10" in command}
    if verb in ("compare", "diagnose", "ik"):
        recorded(wanted["identify"][0], folder)
    command, text = wanted[verb]
    printed = recorded(command, folder)
    assert len(printed.splitlines()) <= HEIGHT
    plain = re.compile(r"[-−+]?\d[\d.\u202f]*")
    assert plain.sub("#", " ".join(printed.split())) == plain.sub("#", " ".join(text.split()))
    for offered in commands(printed):
        # It takes minutes here. The page's has a test of its own; that of a mended model is run on the simulated
        # campaign.
        if offered.split()[1] != "diagnose":
            assert len(recorded(offered, folder).splitlines()) <= HEIGHT
