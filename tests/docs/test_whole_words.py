"""Every screen that README.md and docs/ show: at most 24 lines of 80 columns, and no word is broken where a line ends.

Two tests hold the words. What stands at the ends of a shown line is a word of the program. And each line that the
program prints at 80 columns stands, word for word, in what it prints on a screen on which no line has to end.
"""

from __future__ import annotations

import re
import shlex
import shutil
from collections.abc import Callable
from functools import cache
from pathlib import Path

import pytest
from recorded_runs import RecordedRuns
from recorded_screens import PAGE

from clampid import screen
from clampid.cli import run
from clampid.screen import HEIGHT, WIDTH, laid_out

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
BLOCK = re.compile(r"^```(?:console|text)\n(?P<text>\$ .*?)^```$", re.DOTALL | re.MULTILINE)
TYPED = re.compile(r"\$ (?:.*\\\n)*.*\n")
LETTERS = re.compile(r"[^\W\d_]+")
ENDLESS = 10_000  # columns and lines: more than any screen of ours has


def screens(markdown: str) -> list[tuple[str, str]]:
    """Give each command that a page shows, and what it prints; commands below which nothing stands are left out."""
    found = []
    for block in BLOCK.finditer(markdown):
        for part in re.split(r"^(?=\$ )", block["text"], flags=re.MULTILINE):
            typed = TYPED.match(part)
            if typed is not None and part[typed.end() :].strip():
                found.append((typed[0][2:].replace("\\\n", ""), part[typed.end() :]))
    return found


@cache
def words_of_the_program() -> frozenset[str]:
    """Give every run of letters in the code of the program and in the data that it comes with."""
    folders = ("clampid", "experiments", "kinematics", "offline_ik", "appendix_data")
    files = [file for folder in folders for file in (ROOT / folder).rglob("*") if file.suffix in (".py", ".toml")]
    return frozenset(word for file in files for word in LETTERS.findall(file.read_text(encoding="utf-8")))


def broken(command: str, text: str) -> list[str]:
    """Give what stands at an end of a line and is a word neither of the program nor of the command that was typed."""
    known = words_of_the_program() | set(LETTERS.findall(command))
    ends = [token for line in text.splitlines() if line.strip() for token in (line.split()[0], line.split()[-1])]
    parts = [part for token in ends for part in LETTERS.findall(token)]
    return [part for part in parts if not {part, part[0].lower() + part[1:]} & known]


SHOWN = [page for page in PAGES if screens(page.read_text(encoding="utf-8"))]


@pytest.mark.parametrize("page", SHOWN, ids=[page.stem for page in SHOWN])
def test_a_shown_screen_has_24_lines_of_80_columns_and_no_broken_word(page: Path) -> None:
    for command, text in screens(page.read_text(encoding="utf-8")):
        lines = text.splitlines()
        assert len(lines) <= HEIGHT, command
        assert [line for line in lines if len(line) > WIDTH] == [], command
        assert broken(command, text) == [], command


def test_a_broken_word_is_found() -> None:
    shown = "Gear eccentricity at joint 2 was missing; with it\nthe held-out error falls from 107 µm."
    assert broken("clampid diagnose", shown) == []
    assert broken("clampid diagnose", shown.replace("eccentricity", "eccentri\ncity")) != []
    assert broken("clampid diagnose", shown.replace("missing", "miss\ning")) != []


def test_screens_cut_without_regard_to_words_are_found() -> None:
    """All that is shown, cut every 40 characters: each of them has a broken word."""
    for command, text in screens(PAGE.read_text(encoding="utf-8")):
        flat = " ".join(text.split())
        assert broken(command, "\n".join(flat[at : at + 40] for at in range(0, len(flat), 40))) != [], command


def on_a_line(text: str) -> str:
    """Give the words of a text, one space before and after each."""
    return f" {' '.join(text.split())} "


Wide = Callable[[str, Path], str]


@pytest.fixture
def wide(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Wide:
    """Give what a command prints in a folder on a screen on which no line has to end."""

    def printed(command: str, folder: Path) -> str:
        monkeypatch.chdir(folder)
        monkeypatch.setenv("COLUMNS", str(ENDLESS))
        monkeypatch.setattr(screen, "WIDTH", ENDLESS)
        monkeypatch.setattr(laid_out, "__defaults__", (ENDLESS, ENDLESS))
        capsys.readouterr()
        assert run(shlex.split(command)[1:]) == 0, command
        return capsys.readouterr().out

    return printed


def lines_not_of_whole_words(command: str, folder: Path, recorded: RecordedRuns, wide: Wide) -> list[str]:
    """Give the lines of a command's screen that do not stand in it where no line has to end."""
    copy = shutil.copytree(folder, folder.with_name("copy"), symlinks=True)
    narrow, whole = recorded(command, folder), on_a_line(wide(command, copy))
    shutil.rmtree(copy)
    joined = narrow.replace(",\\\n", ",")  # a list of terms goes on in the first column
    lines = [line.removesuffix(" \\") for line in joined.splitlines() if line.strip()]
    return [line for line in lines if on_a_line(line) not in whole and not line.endswith("more: --verbose")]


@pytest.mark.parametrize(
    "command",
    ["clampid robots staubli_tx40", "clampid effects", "clampid effects gear_eccentricity", "clampid robots"],
)
def test_each_line_stands_in_the_text_before_it_was_wrapped(
    command: str, recorded: RecordedRuns, wide: Wide, tmp_path: Path
) -> None:
    folder = tmp_path / "folder"
    folder.mkdir()
    assert lines_not_of_whole_words(command, folder, recorded, wide) == []


@pytest.mark.study
@pytest.mark.timeout(1800)
def test_each_line_of_the_recorded_screens_stands_in_the_text_before_it_was_wrapped(
    recorded: RecordedRuns, wide: Wide, simulated: tuple[str, Path]
) -> None:
    shown, folder = simulated
    commands = [command for command, _ in screens(shown) if not command.startswith("clampid serve")]
    assert len(commands) > 10
    for command in commands:
        assert lines_not_of_whole_words(command, folder, recorded, wide) == [], command
