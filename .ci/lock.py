"""Writes ``lock/*.txt``: what is installed, with the SHA-256 of every file that the index has of each pinned version.

``constraints.txt`` says the versions, ``pyproject.toml`` what is needed; uv resolves for every system and every Python
from the oldest that the project names. What is needed and not pinned is pinned there at its newest version, and what is
pinned and not needed goes; both are printed. No host stands in a lock: any index serves that has the same files.
"""

from __future__ import annotations

import re
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path

ROOT = Path(__file__).parents[1]
HEAD = "# Made by `make lock` of constraints.txt and pyproject.toml; pip install --require-hashes -r this file\n"
_PIN = re.compile(r"^([A-Za-z0-9._-]+)==(\S+)(?: ; (.+?))?(?: \\)?$", re.MULTILINE)


def pins(text: str) -> dict[str, str]:
    """Versions by name, as PEP 503 compares it, of pinned lines."""
    return {re.sub(r"[-_.]+", "-", name).lower(): version for name, version, _ in _PIN.findall(text)}


def locked(uv: str, extras: Sequence[str], root: Path = ROOT) -> str:
    """The lock of the project with some extras and what builds it.

    Raises
    ------
    subprocess.CalledProcessError
        The versions contradict one another, or the index cannot be reached.
    """
    project = tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))
    oldest = project["project"]["requires-python"].removeprefix(">=")
    with tempfile.TemporaryDirectory() as place:
        builds = Path(place) / "builds.in"
        builds.write_text("\n".join(project["build-system"]["requires"]) + "\n", encoding="utf-8")
        options = ["--universal", "--python-version", oldest, "--generate-hashes", "--no-annotate", "--no-header", "-q"]
        chosen = [part for extra in extras for part in ("--extra", extra)]
        command = [uv, "pip", "compile", "pyproject.toml", str(builds), "-c", "constraints.txt", *options, *chosen]
        ran = subprocess.run(command, cwd=root, stdout=subprocess.PIPE, text=True, check=True)
    return HEAD + ran.stdout


def tidied(text: str, needed: Mapping[str, str]) -> str:
    """``constraints.txt`` with every pin that is needed, and no other; names as they stand there."""
    lines = text.splitlines()
    kept = {next(iter(pins(line))): line for line in lines if pins(line)}
    new = [kept.get(name, f"{name}=={version}") for name, version in needed.items()]
    return "\n".join([*(line for line in lines if line.startswith("#")), *sorted(new, key=str.lower), ""])


def main(arguments: Sequence[str]) -> int:
    """Write both locks, and ``constraints.txt`` where it is not what they need."""
    uv, extras = arguments
    pinned, before = ROOT / "constraints.txt", (ROOT / "constraints.txt").read_text(encoding="utf-8")
    locks = {"run": locked(uv, ()), "develop": locked(uv, extras.split(","))}
    (ROOT / "lock").mkdir(exist_ok=True)
    for name, text in locks.items():
        (ROOT / "lock" / f"{name}.txt").write_text(text, encoding="utf-8")
    after = tidied(before, pins(locks["develop"]) | pins(locks["run"]))
    for sign, lines, others in (("+", after, before), ("-", before, after)):
        changed = [line for line in lines.splitlines() if line and line not in others.splitlines()]
        print(*(f"constraints.txt: {sign}{line}" for line in changed), sep="\n", end="\n" if changed else "")
    pinned.write_text(after, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
