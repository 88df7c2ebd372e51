"""The page of recorded screens."""

from __future__ import annotations

import re
from pathlib import Path

__all__ = ["PAGE", "simulated_part"]

PAGE = Path(__file__).parents[2] / "docs" / "reference" / "screens.md"


def simulated_part() -> tuple[str, str]:
    """Give the part of the page on the simulated campaign, and the command that makes the campaign."""
    text = PAGE.read_text(encoding="utf-8").partition("\n## A real robot")[0]
    first = re.search("<!-- first: (.*) -->", text)
    assert first is not None
    return text, first[1]
