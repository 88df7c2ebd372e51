"""One section of a mapping file: takes keys out of it and words what is wrong with them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

from experiments.columns import lookalike
from experiments.errors import fault
from experiments.foreign.units import units_of

__all__ = ["Section"]


@dataclass(frozen=True)
class Section:
    """Keys and values, with the file and what its keys are called from there: ``prefix`` such as ``tables[2].``."""

    path: Path
    prefix: str
    raw: dict[str, Any]

    def only(self, known: Sequence[str]) -> None:
        """Refuse keys that are not known."""
        for key in self.raw:
            if key not in known:
                near = lookalike(key, known)
                hint = f"; {near} is probably meant" if near else ""
                self.refuse(key, f"one of {', '.join(known)}", f"an unknown key{hint}")

    def refuse(self, key: str, expected: str, found: object) -> NoReturn:
        """Raise a `CampaignError` about one key."""
        raise fault(self.path, expected=expected, found=str(found), column=f"{self.prefix}{key}")

    def section(self, key: str) -> dict[str, Any]:
        """A table in it that is not empty."""
        value = self.raw.get(key)
        if not isinstance(value, dict) or not value:
            self.refuse(key, f"a table [{key}]", repr(value))
        return dict(value)

    def text(self, key: str, default: str, known: Sequence[str] = ()) -> str:
        """A text, one of those known if there are any."""
        value = self.raw.get(key, default)
        if not isinstance(value, str) or (known and value not in known):
            listed = " or ".join(map(repr, known)) if len(known) < 3 else f"one of {', '.join(known)}"
            self.refuse(key, listed or "text", repr(value))
        return str(value)

    def texts(self, key: str) -> tuple[str, ...]:
        """One text or several."""
        value = self.raw.get(key, [])
        value = [value] if isinstance(value, str) else value
        if not isinstance(value, list) or not all(isinstance(v, str) for v in value):
            self.refuse(key, "text, or a list of texts", repr(value))
        return tuple(value)

    def count(self, key: str) -> int:
        """A number that is not negative."""
        value = self.raw.get(key, 0)
        if isinstance(value, bool) or not isinstance(value, int) or value < 0:
            self.refuse(key, "a number of lines", repr(value))
        return int(value)

    def flag(self, key: str) -> bool:
        """True or false."""
        value = self.raw.get(key, False)
        if not isinstance(value, bool):
            self.refuse(key, "true or false", repr(value))
        return bool(value)

    def columns(self, key: str, count: int | None = None) -> tuple[str | int, ...]:
        """Columns of a file, by name or number."""
        value = self.raw.get(key)
        found = value if isinstance(value, list) else [value]
        right = all(isinstance(v, str | int) and not isinstance(v, bool) for v in found) and found
        if not right or (count is not None and len(found) != count):
            what = "a column" if count == 1 else f"a list of {count} columns" if count else "a column or a list of them"
            self.refuse(key, f"{what}, by name or number", repr(value))
        return tuple(found)

    def unit(self, key: str, kind: str, defaults: dict[str, str]) -> str:
        """A unit of a kind of number."""
        value = self.raw.get(key, defaults.get(kind, ""))
        if value not in units_of(kind):
            self.refuse(key, f"a unit, one of {', '.join(units_of(kind))}", repr(value))
        return str(value)
