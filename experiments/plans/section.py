"""A table of a TOML file whose every key is accounted for: reads values strictly and refuses what nobody asked for."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from difflib import get_close_matches
from typing import Any

import numpy as np

from experiments.plans.errors import PlanError
from experiments.plans.motion import Array

__all__ = ["Section"]


class Section:
    """A table, where it is (for messages), and which of its keys have been read."""

    def __init__(self, content: Any, file: str, place: str) -> None:
        self.file, self.place = file, place
        if not isinstance(content, Mapping):
            raise self.fault("", "a table", repr(content))
        self.content = content
        self._read: dict[str, None] = {}

    def fault(self, key: str, expected: str, found: str) -> PlanError:
        """The error that says file, place, what was expected and what was found."""
        where = ", ".join(part for part in (self.file, self.place, f"key {key}" if key else "") if part)
        return PlanError(f"{where}: expected {expected}, found {found}")

    def has(self, key: str) -> bool:
        """Whether an optional key is there; it counts as known either way."""
        self._read[key] = None
        return key in self.content

    def _value(self, key: str, expected: str) -> Any:
        if not self.has(key):
            raise self.fault(key, expected, "no such key" + self._hint(key, list(self.content)))
        return self.content[key]

    @staticmethod
    def _hint(key: str, known: Sequence[str]) -> str:
        near = get_close_matches(key, known, n=1)
        return f"; {near[0]} is probably meant" if near else ""

    def text(self, key: str, among: Sequence[str] = ()) -> str:
        """A text, one of some."""
        expected = f"one of {', '.join(among)}" if among else "text"
        value = self._value(key, expected)
        if not isinstance(value, str) or (among and value not in among):
            raise self.fault(key, expected, repr(value))
        return value

    def texts(self, key: str) -> tuple[str, ...]:
        """A list of texts."""
        value = self._value(key, "a list of texts")
        if not isinstance(value, list) or not all(isinstance(v, str) for v in value):
            raise self.fault(key, "a list of texts", repr(value))
        return tuple(value)

    def flag(self, key: str) -> bool:
        """True or false."""
        value = self._value(key, "true or false")
        if not isinstance(value, bool):
            raise self.fault(key, "true or false", repr(value))
        return value

    def integer(self, key: str, lower: int = 1, upper: int | None = None) -> int:
        """An integer within bounds."""
        expected = f"an integer from {lower}" + ("" if upper is None else f" to {upper}")
        value = self._value(key, expected)
        if (
            isinstance(value, bool)
            or not isinstance(value, int)
            or value < lower
            or (upper is not None and value > upper)
        ):
            raise self.fault(key, expected, repr(value))
        return value

    def number(self, key: str, lower: float = -math.inf, *, above: bool = False) -> float:
        """A finite number, not below (or, with ``above``, above) a bound."""
        bound = "" if lower == -math.inf else f" above {lower:g}" if above else f" not below {lower:g}"
        value = self._value(key, f"a finite number{bound}")
        if not _is_number(value) or value < lower or (above and value <= lower):
            raise self.fault(key, f"a finite number{bound}", repr(value))
        return float(value)

    def vector(self, key: str, length: int | None, lower: float = -math.inf) -> Array:
        """Finite numbers ``(length,)``, not below a bound; as many as there are without a length."""
        many = "a list of" if length is None else str(length)
        expected = f"{many} finite numbers" + ("" if lower == -math.inf else f" not below {lower:g}")
        value = self._value(key, expected)
        if not isinstance(value, list) or (length is not None and len(value) != length) or not value:
            raise self.fault(key, expected, repr(value) if not isinstance(value, list) else f"{len(value)} of them")
        for number in value:
            if not _is_number(number) or number < lower:
                raise self.fault(key, expected, repr(number))
        return np.array(value, dtype=np.float64)

    def section(self, key: str, *, optional: bool = False) -> Section:
        """A table in this one."""
        content = {} if optional and not self.has(key) else self._value(key, f"a table [{key}]")
        return Section(content, self.file, ", ".join(p for p in (self.place, f"[{key}]") if p))

    def sections(self, key: str) -> list[Section]:
        """A list of tables, numbered from 1."""
        value = self._value(key, f"tables [[{key}]]")
        if not isinstance(value, list) or not value:
            raise self.fault(key, f"at least one table [[{key}]]", repr(value))
        place = f"{self.place}, " if self.place else ""
        return [Section(item, self.file, f"{place}{key} {number}") for number, item in enumerate(value, 1)]

    def keys(self) -> tuple[str, ...]:
        """Every key; all count as known from then on."""
        self._read |= dict.fromkeys(self.content)
        return tuple(self.content)

    def done(self) -> None:
        """Refuse keys that nobody asked for."""
        for key in self.content:
            if key not in self._read:
                known = ", ".join(self._read)
                raise self.fault(key, f"one of {known}", "an unknown key" + self._hint(key, list(self._read)))


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
