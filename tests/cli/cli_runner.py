"""What a run of the command gave."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
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
