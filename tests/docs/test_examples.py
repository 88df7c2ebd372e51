"""The examples of the documentation run: every python and console block of a page, in order, in one folder.

A file that a page prints lies in that folder, too, if a remark before it names it. What a page shows as printed by a
command is what the command prints: the same words, and numbers that differ by little.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from recorded_screens import PAGE
from shown_text import unlike

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
# An optional remark before a block: "not run: …" leaves it out, "first: …" is run before it, "file: …" writes it there,
# "printed" says that a text block is what the console block before it prints.
BLOCK = re.compile(
    r"(?:<!--(?P<remark>[^>]*?)-->\n)?```(?P<kind>python|console|toml|csv|text)\n(?P<text>.*?)^```$",
    re.DOTALL | re.MULTILINE,
)


@dataclass(frozen=True)
class Block:
    kind: str
    text: str
    line: int


def blocks(page: Path) -> list[Block]:
    found = []
    content = page.read_text(encoding="utf-8")
    for match in BLOCK.finditer(content):
        remark = (match["remark"] or "").strip()
        line = content[: match.start("text")].count("\n") + 1
        if match["kind"] == "text":
            if remark == "printed":
                found.append(Block("text", match["text"], line))
            elif remark.startswith("file:"):
                found.append(Block(remark.removeprefix("file:").strip(), match["text"], line))
            continue
        if remark.startswith("not run") or (page.name == "README.md" and "make demo" in match["text"]):
            continue
        if match["kind"] in ("toml", "csv"):
            if remark.startswith("file:"):
                found.append(Block(remark.removeprefix("file:").strip(), match["text"], line))
            continue
        if remark.startswith("first:"):
            found.append(Block("console", f"$ {remark.removeprefix('first:').strip()}", line))
        found.append(Block(match["kind"], match["text"], line))
    return found


def commands(text: str) -> str:
    """Give what is typed in a console block, without what is printed."""
    return "\n".join(line[2:] for line in text.splitlines() if line.startswith("$ "))


def printed(text: str) -> str:
    """Give what a console block shows as printed, an ellipsis for what is typed."""
    return "\n".join("…" if line.startswith("$ ") else line for line in text.splitlines())


LONG = (
    "plan-measurements.md",
    "point-the-detector.md",
    "repeat-and-warm-up.md",
    "locate-the-sample.md",
    "bring-your-own-robot.md",
    "fit-special-cases.md",
    "what-positions-are-worth.md",
    "use-from-python.md",
    "add-an-effect.md",
    "import-tables.md",
    "README.md",
    "export.md",
    "export-to-kuka.md",
    "export-masses.md",
    "find-what-is-missing.md",
    "measure-accuracy.md",
    "describe-an-unknown-effect.md",
    "read-a-verdict.md",
    "the-loop.md",
)  # of the better part of a minute


@pytest.mark.parametrize(
    "page",
    [
        pytest.param(page, id=page.stem, marks=[pytest.mark.slow] if page.name in LONG else [])
        for page in PAGES
        if blocks(page) and page != PAGE  # whose commands test_screens runs, too
    ],
)
def test_examples_run(page: Path, program: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    path = os.pathsep.join([str(program.parent), str(Path(sys.executable).parent), os.environ["PATH"]])
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / ".config"))  # what a page trusts is its own affair
    names: dict[str, Any] = {"__name__": "example"}
    output = ""
    for block in blocks(page):
        where = f"{page.name}:{block.line}"
        if block.kind == "python":
            exec(compile("\n" * (block.line - 1) + block.text, str(page), "exec"), names)
            continue
        if block.kind == "text":
            assert (wrong := unlike(block.text, output)) is None, f"{where}:\n{wrong}"
            continue
        if block.kind != "console":
            Path(block.kind).write_text(block.text, encoding="utf-8")
            continue
        script = "set -euo pipefail\n" + commands(block.text)
        done = subprocess.run(
            ["bash", "-c", script], env={**os.environ, "PATH": path}, capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, f"{where}:\n{done.stdout[-2000:]}\n{done.stderr[-2000:]}"
        output = done.stdout
        assert (wrong := unlike(printed(block.text), output)) is None, f"{where}:\n{wrong}"


@pytest.mark.parametrize(
    ("shown", "printed_now", "wrong"),
    [
        ("error 107 µm, floor\n46.8 µm. …", "the error 107 µm, floor 46.8 µm. Beyond", None),
        ("error 107 µm", "error 109 µm", None),
        ("link 2 7 kg link 3 8 kg", "link 1 6 kg link 2 7 kg link 3 8 kg", None),
        ("error 107 µm", "error 110 µm", "shown"),
        ("shift −35 ± 3.7 µrad", "shift -34.6 ± 3.8 µrad", None),
        ("shift −35 ± 3.7 µrad", "shift 35 ± 3.7 µrad", "shown"),
        ("error 107 µm", "a fault of 107 µm", "not printed"),
        ("first … third 3", "first second third 5", "shown"),
    ],
)
def test_what_is_shown_is_held_against_what_is_printed(shown: str, printed_now: str, wrong: str | None) -> None:
    found = unlike(shown, printed_now)
    assert (found is None) if wrong is None else (found is not None and found.startswith(wrong))


def test_links_between_pages_lead_somewhere() -> None:
    for page in PAGES:
        for target in re.findall(r"\]\(([^)#:]+)(?:#[^)]*)?\)", page.read_text(encoding="utf-8")):
            assert (page.parent / target).exists(), f"{page.name}: {target}"
