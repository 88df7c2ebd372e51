"""What only mapping files say, read by the one reader: columns of a file, by name or number, and units."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from experiments.foreign.units import units_of
from kinematics.section import Section, shown

__all__ = ["columns_of", "unit_of"]


def columns_of(at: Section, key: str, counts: Sequence[int] = ()) -> tuple[str | int, ...]:
    """Columns of a file, by name or number from 1; as many as one of ``counts``, if there are any."""
    many = [count for count in counts if count > 1]
    several = f"a list of {many[0]} columns" if many else "" if counts else "a list of them"
    one = "" if counts and 1 not in counts else "a column"
    expected = f"{' or '.join(part for part in (one, several) if part)}, by name or number"
    value = at.value(key, expected)
    found = value if isinstance(value, list) else [value]
    right = all(isinstance(name, str | int) and not isinstance(name, bool) for name in found) and found
    if not right or (counts and len(found) not in counts):
        raise at.fault(key, expected, shown(value))
    return tuple(found)


def unit_of(at: Section, key: str, kind: str, defaults: Mapping[str, str]) -> str:
    """A unit of a kind of number."""
    value = at.value(key, "a unit", defaults.get(kind, ""))
    if value not in units_of(kind):
        raise at.fault(key, f"a unit, one of {', '.join(units_of(kind))}", shown(value))
    return str(value)
