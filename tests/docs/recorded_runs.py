"""What commands of the recorded screens print, each run once from equal folders.

A command prints the same and leaves the same in folders that hold the same. Several tests run the page's commands, and
screens offer commands that the page runs next, so that most are wanted more than once.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import subprocess
from pathlib import Path

from clampid.screen import WIDTH

__all__ = ["RecordedRuns"]


class RecordedRuns:
    """Runs commands as they are printed, at 80 columns; ``kept``: a folder for what they leave."""

    def __init__(self, program: Path, kept: Path) -> None:
        self._env = {**os.environ, "PATH": f"{program.parent}{os.pathsep}{os.environ['PATH']}", "COLUMNS": str(WIDTH)}
        self._kept = kept
        self._known: dict[tuple[str, str], tuple[str, Path]] = {}

    def __call__(self, command: str, folder: Path) -> str:
        """Give what a command prints in a folder, and leave there what it leaves; its exit code is 0."""
        key = command, contents(folder)
        if key in self._known:
            printed, left = self._known[key]
            shutil.rmtree(folder)
            shutil.copytree(left, folder, symlinks=True)
            return printed
        done = subprocess.run(
            ["bash", "-c", command], cwd=folder, env=self._env, capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, f"{command}\n{done.stdout[-2000:]}\n{done.stderr[-2000:]}"
        wide = [line for line in (done.stdout + done.stderr).splitlines() if len(line) > WIDTH]
        assert wide == [], command
        left = self._kept / f"after {len(self._known)}"
        self._known[key] = done.stdout, shutil.copytree(folder, left, symlinks=True)
        return done.stdout


def contents(folder: Path) -> str:
    """A hash of every file's name and content below a folder, and of every link's target."""
    found = hashlib.sha256()
    for path in sorted(folder.rglob("*")):
        if path.is_symlink() or path.is_file():
            content = os.fsencode(os.readlink(path)) if path.is_symlink() else path.read_bytes()
            found.update(f"{path.relative_to(folder)}\0{len(content)}\0".encode() + content)
    return found.hexdigest()
