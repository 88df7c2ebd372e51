"""The columns of each table of a campaign, for a robot of n joints, and what a misnamed one was probably meant to be.

This is ``CAMPAIGN_FORMAT.md`` as a value, with the table ``distances`` beside it; nothing else in the program lists
column names.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from typing import Literal

__all__ = [
    "LOGS",
    "OF_OTHER_USE",
    "POSES",
    "TABLES",
    "Column",
    "TableFormat",
    "further_columns",
    "is_further",
    "joint_columns",
    "lookalike",
    "parted",
    "table_format",
    "temperature_columns",
]

LOGS = ("free_air", "wrist")
TABLES = ("free_air", "wrist", "clamped", "poses", "distances", "verification", "inclination")
POSES = ("poses", "distances", "verification")
QUATERNION = ("qw", "qx", "qy", "qz")
POSITION = ("x_m", "y_m", "z_m")

_TEMPERATURE = re.compile(r"temp_\w+_C")
OF_OTHER_USE = ("temp_", "std_")
"""How names begin that are never further columns: a temperature, though misnamed, or a reading's standard deviation."""
# A name that ends in a unit, as the contract asks of every column.
_FURTHER = re.compile(
    rf"(?!{'|'.join(OF_OTHER_USE)})(?P<what>[A-Za-z]\w*?)"
    r"_(?P<unit>rad_s2|rad_s|rad|m_s2|m_s|m|s|Nm|N|kg|K|C|A|V|W|Hz|Pa|percent)"
)


@dataclass(frozen=True)
class Column:
    """One column of the contract: its name, what its cells may hold, and whether they may be empty."""

    name: str
    kind: Literal["integer", "number", "text"] = "number"
    lower: float | None = None
    upper: float | None = None
    gaps: bool = False

    @property
    def expected(self) -> str:
        """What a cell of this column must hold, in words."""
        if self.kind == "text":
            return "text"
        what = "an integer" if self.kind == "integer" else "a finite number"
        if self.upper is not None:
            return f"{what} from {self.lower:g} to {self.upper:g}"
        if self.lower is not None:
            return f"{what} not below {self.lower:g}"
        return what


@dataclass(frozen=True)
class TableFormat:
    """What the contract says of one table.

    Attributes
    ----------
    name
        The table's key in ``[tables]``.
    required
        Columns that must be there.
    optional
        Groups of columns; a group is there as a whole or not at all.
    run
        The column that numbers the runs within which time increases, for logs.
    """

    name: str
    required: tuple[Column, ...]
    optional: tuple[tuple[Column, ...], ...]
    run: str | None

    def known(self) -> dict[str, Column]:
        """Every column of the contract by name, required or optional."""
        return {c.name: c for group in (self.required, *self.optional) for c in group}


def joint_columns(pattern: str, n: int) -> tuple[str, ...]:
    """Names of the n columns of one signal.

    Parameters
    ----------
    pattern
        The name with ``{}`` for the joint's number, such as ``"q{}_rad"``.
    n
        Number of joints.

    Returns
    -------
    tuple of str
        ``("q1_rad", …)``; joints count from 1, as in the contract.
    """
    return tuple(pattern.format(i) for i in range(1, n + 1))


def temperature_columns(names: Iterable[str]) -> tuple[str, ...]:
    """Those of the names that are temperature sensors (``temp_<where>_C``), in their order."""
    return tuple(name for name in names if _TEMPERATURE.fullmatch(name))


def is_further(name: str) -> bool:
    """Whether a column that the contract does not know has a name that it allows: one that ends in an SI unit."""
    return bool(parted(name)[1])


def parted(name: str) -> tuple[str, str]:
    """The name of a further column without its unit, and the unit; the name itself without a unit."""
    found = _FURTHER.fullmatch(name)
    return (name, "") if found is None else (found["what"], found["unit"])


def further_columns(names: Iterable[str], table: str, n: int) -> tuple[str, ...]:
    """Those of a table's names that the contract does not know and that end in a unit: what else was recorded."""
    known = table_format(table, n).known()
    return tuple(name for name in names if name not in known and is_further(name))


def table_format(table: str, n: int) -> TableFormat:
    """Give the columns of one table for a robot of n joints.

    Parameters
    ----------
    table
        One of `TABLES`.
    n
        Number of joints.

    Returns
    -------
    TableFormat
        Required and optional columns.

    Raises
    ------
    KeyError
        If the contract knows no such table.
    """
    q, qd, tau, motor = (
        tuple(map(Column, joint_columns(p, n))) for p in ("q{}_rad", "qd{}_rad_s", "tau{}_Nm", "motor{}_rad")
    )
    time = Column("time_s")
    if table in ("free_air", "wrist"):
        return TableFormat(table, (_count("run"), time, *q, *tau), (qd,), run="run")
    if table == "clamped":
        driven = Column("joint", "integer", lower=1, upper=n)
        # Position and rotation of the fixture are two groups: a dial gauge or a camera may give one without the other.
        fixture = tuple(
            tuple(Column(f"fixture_{axis}_{unit}") for axis in axes)
            for axes, unit in ((("x", "y", "z"), "m"), (("rx", "ry", "rz"), "rad"))
        )
        return TableFormat(table, (_count("sweep"), driven, time, *motor, *tau), fixture, run="sweep")
    if table in POSES:
        directions = tuple(Column(name, "integer", lower=-1, upper=1) for name in joint_columns("dir{}", n))
        stop = (_count("pose"), _count("visit"), time, *q, *directions, Column("target", "text"))
        if table == "distances":
            measured = (Column("anchor", "text"), Column("distance_m", lower=0.0))
            return TableFormat(table, (*stop, *measured), (), run=None)
        return TableFormat(table, (*stop, *map(Column, POSITION)), (tuple(map(Column, QUATERNION)),), run=None)
    if table == "inclination":
        turned = (Column("at", "text"), Column("about_x_rad"), Column("about_y_rad"))
        return TableFormat(table, (time, *q, *turned), (), run=None)
    raise KeyError(f"no table {table!r} in the contract; known: {', '.join(TABLES)}")


def _count(name: str) -> Column:
    # Programs number from 0 or from 1; both are in use, and nothing depends on it.
    return Column(name, "integer", lower=0)


def lookalike(wanted: str, candidates: Sequence[str]) -> str | None:
    """Find what was probably meant as a wanted name: another unit, case or spacing, or a slip of spelling.

    Parameters
    ----------
    wanted
        A name of the contract, such as ``q1_rad``.
    candidates
        Names found that the contract does not know, such as ``q1_deg``.

    Returns
    -------
    str or None
        The likeliest candidate, if any is near.
    """
    stem = _stem(wanted)
    for candidate in candidates:
        if _stem(candidate) == stem:
            return candidate
    # 0.8 lets one or two letters differ in names of this length.
    # Digits must agree: q2_rad is not a slip for q1_rad.
    near = [c for c in candidates if re.findall(r"\d", c) == re.findall(r"\d", wanted)]
    matches = get_close_matches(wanted, near, n=1, cutoff=0.8)
    return matches[0] if matches else None


_UNITS = re.compile(
    r"[_\s(\[]+(m_s2|m/s2|rad_s|rad/s|deg_s|deg/s|rpm|rad|degrees?|deg|mrad|nmm|nm|mm|cm|um|m|inch|ms|us|s|c|k|f|degc|kg|g|lb|a|pct|percent)"
    r"[)\]]*$"
)


def _stem(name: str) -> str:
    """Strip a name of its unit, case, spaces and separators: ``q1`` for ``q1_rad``, ``Q1 (deg)`` and ``q_1``."""
    return re.sub(r"[\W_]+", "", _UNITS.sub("", name.strip().lower()))
