"""The examples of the documentation run: every python and console block of a page, in order, in one folder.

A file that a page prints lies in that folder, too, if a remark before it names it.
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

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
# An optional remark before a block: "not run: …" leaves it out, "first: …" is run before it, "file: …" writes it there.
BLOCK = re.compile(
    r"(?:<!--(?P<remark>[^>]*?)-->\n)?```(?P<kind>python|console|toml)\n(?P<text>.*?)^```$", re.DOTALL | re.MULTILINE
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
        if remark.startswith("not run") or (page.name == "README.md" and "make demo" in match["text"]):
            continue
        if match["kind"] == "toml":
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


LONG = ("calibration-engineer.md", "unknown-effect.md")  # of the better part of a minute


@pytest.mark.parametrize(
    "page",
    [
        pytest.param(page, id=page.name, marks=[pytest.mark.slow] if page.name in LONG else [])
        for page in PAGES
        if blocks(page)
    ],
)
def test_examples_run(page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    names: dict[str, Any] = {"__name__": "example"}
    for block in blocks(page):
        where = f"{page.name}:{block.line}"
        if block.kind == "python":
            exec(compile("\n" * (block.line - 1) + block.text, str(page), "exec"), names)
            continue
        if block.kind != "console":
            Path(block.kind).write_text(block.text, encoding="utf-8")
            continue
        script = "set -euo pipefail\n" + commands(block.text)
        done = subprocess.run(
            ["bash", "-c", script], env={**os.environ, "PATH": path}, capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, f"{where}:\n{done.stdout[-2000:]}\n{done.stderr[-2000:]}"


def test_links_between_pages_lead_somewhere() -> None:
    for page in PAGES:
        for target in re.findall(r"\]\(([^)#:]+)(?:#[^)]*)?\)", page.read_text(encoding="utf-8")):
            assert (page.parent / target).exists(), f"{page.name}: {target}"
