"""
What a file may say: each key read once, by its kind, range and unit; what nobody asked for is an error.

Files that a person writes (robot, cell, plan, obstacles, mapping, campaign) and the model are read by this one class,
so that the same mistake has the same words everywhere: unknown keys with the one that was probably meant, truth values
and text in the place of numbers, numbers in another unit. TOML and JSON refuse a key that comes twice.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from difflib import get_close_matches
from typing import Any, Final

import numpy as np

from kinematics.escaping import has_controls, is_formula
from kinematics.reading import fraction_of
from kinematics.typing_ import Array, frozen_array

__all__ = ["Migration", "Section", "migrated", "shown"]

Raw = Mapping[str, Any]
Migration = Callable[[dict[str, Any]], dict[str, Any]]
"""Makes of the content of one version that of the next one."""

LONGEST_TEXT = 200  # characters of a text that names something
LARGEST_COMPONENT = 1e100  # of a vector: its length is finite
SHOWN_OF_A_VALUE = 80  # characters of what was found
_MISTAKEN = {"m": "millimetres", "rad": "degrees", "rad/s": "degrees per second", "°C": "kelvin", "kg": "grams"}
"""The unit that a number too large is probably in."""
_NEEDED: Final = object()


def migrated(raw: Raw, stated: str, migrations: Mapping[int, Migration], *, needed: bool = False) -> dict[str, Any]:
    """
    Bring the content of a file to its kind's newest version.

    Parameters
    ----------
    raw
        With ``format = "KIND/VERSION"``; without a version, or without the key, it is version 1.
    stated
        Kind and newest version, such as ``clampid-model/2``.
    migrations
        For each older version, what makes the next one of it.
    needed
        The key has to be there.

    Returns
    -------
    dict
        The content, its ``format`` the newest.

    Raises
    ------
    ValueError
        It is of another kind, or of a version that this program does not know. The message has no file.
    """
    kind, _, newest = stated.partition("/")
    found = raw.get("format", None if needed else kind)
    name, slash, version = found.partition("/") if isinstance(found, str) else ("", "", "")
    number = 1 if not slash else int(version) if version.isascii() and version.isdigit() and len(version) < 6 else 0
    if name != kind or not 1 <= number <= int(newest):
        newer = " (of a newer clampid)" if name == kind and number else ""
        raise ValueError(f"key format: expected {stated!r}, found {shown(found) if found else 'no such key'}{newer}")
    content = dict(raw)
    for step in range(number, int(newest)):
        content = migrations[step](content)
    return {**content, "format": stated}


def shown(value: Any) -> str:
    """A value as a message shows it."""
    text = repr(value) if not isinstance(value, list | Mapping) else _short(value)
    return text if len(text) <= SHOWN_OF_A_VALUE else f"{text[: SHOWN_OF_A_VALUE - 1]}…"


def _short(value: Any) -> str:
    text = repr(value)
    kind = "a list" if isinstance(value, list) else "a table"
    return text if len(text) <= SHOWN_OF_A_VALUE else f"{kind} of {len(value)}"


class Section:
    """
    A table of a file, where it stands, and which of its keys have been read.

    Parameters
    ----------
    content
        The table.
    file
        For messages; empty where the caller adds it.
    place
        Keys that lead to it, such as ``detector`` or ``obstacle[2]``; empty for the whole file.
    error
        What is raised.

    Raises
    ------
    ValueError
        The content is no table; or, from its methods, a key is missing, or its value is of another kind or size: always
        of the kind ``error``.
    """

    def __init__(self, content: Any, file: str, place: str = "", error: type[ValueError] = ValueError) -> None:
        self.file, self.place, self.error = file, place, error
        if not isinstance(content, Mapping):
            raise self.fault("", f"a table [{place}]" if place else "a table", shown(content))
        self.content = content
        self._read: dict[str, None] = {}

    def path(self, key: str) -> str:
        """The key with those that lead to it."""
        return ".".join(part for part in (self.place, key) if part)

    def fault(self, key: str, expected: str, found: str) -> ValueError:
        """The error that says file and key, what was expected and what was found."""
        path = self.path(key)
        where = ", ".join(part for part in (self.file, f"key {path}" if path else "") if part)
        return self.error(f"{where}: expected {expected}, found {found}" if where else f"expected {expected}")

    def has(self, key: str) -> bool:
        """Whether an optional key is there; it counts as known either way. JSON's null is as if it were not."""
        self._read[key] = None
        return self.content.get(key) is not None

    def value(self, key: str, expected: str, default: Any = _NEEDED) -> Any:
        """What stands there, whatever it is."""
        if self.has(key):
            return self.content[key]
        if default is _NEEDED:
            near = _near(key, [k for k in self.content if k != key])
            raise self.fault(key, expected, f"no such key, but {near!r}" if near else "no such key")
        return default

    def text(self, key: str, among: Sequence[str] = (), default: Any = _NEEDED, longest: int = LONGEST_TEXT) -> Any:
        """A text of printable characters on one line, one of some."""
        expected = f"one of {', '.join(among)}" if among else f"printable text of at most {longest} characters"
        value = self.value(key, expected, default)
        if value is default:
            return value
        if not isinstance(value, str) or (among and value not in among):
            raise self.fault(key, expected, shown(value) + (_hint(str(value), among) if among else ""))
        if not among and (has_controls(value) or len(value) > longest):
            raise self.fault(key, expected, shown(value))
        return value

    def texts(
        self, key: str, default: Any = _NEEDED, *, longest: int | None = None, once: bool = False, alone: bool = False
    ) -> Any:
        """Texts: a list of them, or ``alone`` one that is no list."""
        expected = "a text, or a list of texts" if alone else "a list of texts"
        value = self.value(key, expected, default)
        if value is default:
            return value
        value = [value] if alone and isinstance(value, str) else value
        if not isinstance(value, list) or not all(isinstance(v, str) for v in value):
            raise self.fault(key, expected, shown(value))
        for text in value if longest is not None else ():
            if has_controls(text) or len(text) > (longest or 0):
                raise self.fault(key, f"printable text of at most {longest} characters", shown(text))
        twice = next((text for text in value if value.count(text) > 1), None) if once else None
        if twice is not None:
            raise self.fault(key, "names that differ", f"{shown(twice)} twice")
        return tuple(value)

    def flag(self, key: str, default: Any = _NEEDED) -> Any:
        """True or false."""
        value = self.value(key, "true or false", default)
        if value is not default and not isinstance(value, bool):
            raise self.fault(key, "true or false", shown(value))
        return value

    def integer(self, key: str, lower: int = 1, upper: int | None = None, default: Any = _NEEDED) -> Any:
        """An integer within bounds."""
        expected = f"an integer from {lower}" + ("" if upper is None else f" to {upper}")
        value = self.value(key, expected, default)
        if value is default:
            return value
        if type(value) is not int or value < lower or (upper is not None and value > upper):
            raise self.fault(key, expected, shown(value))
        return value

    def number(
        self, key: str, lower: float = -math.inf, upper: float = math.inf, unit: str = "", default: Any = _NEEDED, *,
        above: bool = False,
    ) -> Any:  # fmt: skip
        """A finite number from ``lower`` (with ``above``: above it) to ``upper``, of a unit."""
        expected = _range("a finite number", lower, upper, unit, above)
        value = self.value(key, expected, default)
        if value is default:
            return value
        self._check(key, value, value, expected, lower, upper, unit, above)
        return float(value)

    def vector(
        self, key: str, length: int | None = 3, lower: float = -math.inf, upper: float = math.inf, unit: str = "",
        default: Any = _NEEDED, *, above: bool = False, infinite: bool = False,
    ) -> Any:  # fmt: skip
        """Numbers ``(length,)`` within a range (or infinite), of a unit; as many as there are without a length."""
        expected = _range(f"{'some' if length is None else length} finite numbers", lower, upper, unit, above)
        value = self.value(key, expected, default)
        if value is default:
            return value
        if not isinstance(value, list) or (length is not None and len(value) != length) or not value:
            raise self.fault(key, expected, shown(value) if not isinstance(value, list) else f"{len(value)} of them")
        for one in value:
            if infinite and isinstance(one, float) and math.isinf(one):
                continue
            self._check(
                key, one, value, expected, max(lower, -LARGEST_COMPONENT), min(upper, LARGEST_COMPONENT), unit, above
            )
        return frozen_array(value)

    def three(self, key: str, upper: float, unit: str, *, infinite: bool = False) -> Array:
        """One number for three axes, or three ``(3,)``: above 0 and not above ``upper``, or infinite."""
        above = _range("one number or three", 0.0, upper, unit, True) + (", or inf" if infinite else "")
        value = self.value(key, above)
        values = value if isinstance(value, list) else [value] * 3
        if len(values) != 3:
            raise self.fault(key, above, f"{len(values)} of them")
        for one in values:
            if not (infinite and isinstance(one, float) and one == math.inf):
                self._check(key, one, value, above, 0.0, upper, unit, True)
        return frozen_array(values)

    def rows(self, key: str, default: Any = _NEEDED) -> Array:
        """A matrix of numbers, or of fractions as text."""
        expected = "rows of numbers, or fractions as text, of one length"
        value = self.value(key, expected, default)
        if not isinstance(value, list | tuple) or not all(isinstance(row, list) for row in value):
            raise self.fault(key, expected, shown(value))
        try:
            return np.array([[fraction_of(entry) for entry in row] for row in value], dtype=np.float64)
        except ValueError as error:
            raise self.fault(key, expected, str(error)) from None

    def section(self, key: str, *, optional: bool = False) -> "Section":
        """A table in this one; with ``optional`` an empty one where there is none."""
        return self.part(key, self.value(key, f"a table [{self.path(key)}]", {} if optional else _NEEDED))

    def part(self, key: str, content: Any) -> "Section":
        """A table that stands at ``key``, with a content made of what stands there."""
        return type(self)(content, self.file, self.path(key), self.error)

    def sections(self, key: str, *, optional: bool = False) -> list["Section"]:
        """Tables in a list, numbered from 1."""
        value = self.value(key, f"tables [[{key}]]", [] if optional else _NEEDED)
        if not isinstance(value, list) or not (value or optional):
            raise self.fault(key, f"at least one table [[{key}]]" if value == [] else f"tables [[{key}]]", shown(value))
        return [type(self)(one, self.file, f"{self.path(key)}[{i}]", self.error) for i, one in enumerate(value, 1)]

    def keys(self) -> tuple[str, ...]:
        """Every key, which are names that the file chooses; all count as known from then on."""
        for key in self.content:
            if has_controls(key) or not 0 < len(key) <= LONGEST_TEXT:
                raise self.fault("", f"names of 1 to {LONGEST_TEXT} printable characters on one line", shown(key))
            if is_formula(key):
                raise self.fault("", "names that no spreadsheet takes for a formula", shown(key))
        self._read |= dict.fromkeys(self.content)
        return tuple(self.content)

    def only(self, known: Sequence[str]) -> None:
        """Refuse keys that are none of these, before one that is misspelt is missed."""
        unread, self._read = self._read, dict.fromkeys(known)
        self.done()
        self._read = unread

    def done(self) -> None:
        """Refuse keys that nobody asked for."""
        for key in self.content:
            if key not in self._read:
                known = ", ".join(self._read)
                hint = _hint(key, list(self._read))
                raise self.fault(key, f"one of {known}", f"the unknown key {shown(key)}{hint}")

    def _check(
        self, key: str, value: Any, whole: Any, expected: str, lower: float, upper: float, unit: str, above: bool
    ) -> None:
        number = isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < math.inf
        if not number or not lower <= value <= upper or (above and value <= lower):
            mistaken = _MISTAKEN.get(unit, "") if number and (value > upper or value < lower < 0) else ""
            raise self.fault(key, expected, shown(whole) + (f" (is it in {mistaken}?)" if mistaken else ""))


def _near(name: str, known: Sequence[str]) -> str | None:
    folded = {one.lower(): one for one in known}
    return folded.get(name.lower()) or next(iter(get_close_matches(name, known, n=1)), None)


def _hint(name: str, known: Sequence[str]) -> str:
    near = _near(name, known)
    return f"; did you mean {near!r}?" if near else ""


def _range(what: str, lower: float, upper: float, unit: str, above: bool) -> str:
    of = f" of {unit}" if unit else ""
    if math.isinf(upper):
        return what + of + ("" if math.isinf(lower) else f" {'above' if above else 'not below'} {lower:g}")
    return what + of + (f" above {lower:g} and not above {upper:g}" if above else f" from {lower:g} to {upper:g}")
