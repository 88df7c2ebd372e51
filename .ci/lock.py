"""Writes ``lock/*.txt``: what is installed, with the SHA-256 of every file that the index has of each pinned version.

``constraints.txt`` says the versions, ``pyproject.toml`` what is needed; uv resolves for every system and every Python
from the oldest that the project names. A package that is needed and not pinned is an error that prints the line to add;
so is one that is pinned and not needed. No host stands in a lock: any index serves that has the same files.
"""

from __future__ import annotations

import re
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Sequence
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


def main(arguments: Sequence[str]) -> int:
    """Write both locks; 1 where constraints.txt is not what they need."""
    uv, extras = arguments
    run, develop = locked(uv, ()), locked(uv, extras.split(","))
    (ROOT / "lock").mkdir(exist_ok=True)
    (ROOT / "lock" / "run.txt").write_text(run, encoding="utf-8")
    (ROOT / "lock" / "develop.txt").write_text(develop, encoding="utf-8")
    needed, pinned = pins(develop) | pins(run), pins((ROOT / "constraints.txt").read_text(encoding="utf-8"))
    lacking = [f"{name}=={version}" for name, version in needed.items() if name not in pinned]
    unneeded = [name for name in pinned if name not in needed]
    if lacking:
        print("needed and not pinned; add to constraints.txt:", *lacking, sep="\n", file=sys.stderr)
    if unneeded:
        print("pinned and not needed; remove from constraints.txt:", *unneeded, sep="\n", file=sys.stderr)
    return 1 if lacking or unneeded else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
