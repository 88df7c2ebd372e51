"""What a run of the command gave."""

from __future__ import annotations

import json
import os
import subprocess
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any


@dataclass(frozen=True)
class Ran:
    code: int
    out: str
    err: str

    @property
    def json(self) -> Any:
        """What stdout holds, all of it."""
        return json.loads(self.out)

    @property
    def complaint(self) -> str:
        """The one line that an error consists of."""
        assert "Traceback" not in self.err
        lines = [line for line in self.err.splitlines() if line.startswith("clampid: ")]
        assert len(lines) == 1, self.err
        assert self.err.splitlines()[-1] == lines[0]
        return lines[0]


Clampid = Callable[..., Ran]


def runs_of(program: Path) -> Clampid:
    """Give a function that runs a command at 120 columns with the arguments that it is given."""

    def run(*arguments: str | Path, cwd: Path | None = None) -> Ran:
        done = subprocess.run(
            [program, *map(str, arguments)],
            cwd=cwd, capture_output=True, text=True, timeout=600, check=False, env={**os.environ, "COLUMNS": "120"},
        )  # fmt: skip
        return Ran(done.returncode, done.stdout, done.stderr)

    return run
