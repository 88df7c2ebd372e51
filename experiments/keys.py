"""Checks of the keys of a TOML file: each says what was expected, what was found and what exists."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from difflib import get_close_matches
from pathlib import Path
from typing import Any, TypeGuard

import numpy as np
import numpy.typing as npt

from experiments.columns import lookalike
from experiments.errors import fault

__all__ = ["frozen", "is_number", "missing", "number", "refuse_unknown", "section_of", "vector"]

FloatArray = npt.NDArray[np.float64]


def section_of(raw: Mapping[str, Any], key: str, path: Path) -> Mapping[str, Any]:
    """The section ``[key]``; empty where there is none.

    Raises
    ------
    CampaignError
        The key holds something else.
    """
    section = raw.get(key, {})
    if not isinstance(section, Mapping):
        raise fault(path, expected=f"a section [{key}]", found=repr(section), column=key)
    return section


def refuse_unknown(section: Mapping[str, Any], known: Sequence[str], path: Path, prefix: str = "") -> None:
    """Refuse a key that would be ignored in silence.

    Parameters
    ----------
    section
        The section, or the whole file.
    known
        The keys that exist.
    prefix
        The section's name, for the message; empty for the whole file.

    Raises
    ------
    CampaignError
        Naming the first unknown key, the known ones, and the one that was probably meant.
    """
    for key in section:
        if key in known:
            continue
        near = next((name for name in known if lookalike(name, [key])), None)
        near = near or next(iter(get_close_matches(key, known, n=1, cutoff=0.6)), None)
        meant = f"; did you mean {near}?" if near else ""
        raise fault(
            path,
            expected=f"one of {', '.join(known)}",
            found=f"the unknown key {key!r}{meant}",
            column=f"{prefix}.{key}" if prefix else key,
        )


def number(section: Mapping[str, Any], key: str, where: str, path: Path) -> float:
    """A finite number.

    Raises
    ------
    CampaignError
        The key is missing or holds something else.
    """
    value = section.get(key)
    if not is_number(value):
        found = missing(key, section) if value is None else repr(value)
        raise fault(path, expected="a finite number", found=found, column=where)
    return float(value)


def is_number(value: Any) -> TypeGuard[float]:
    """Whether a value is a finite number, and no truth value."""
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def vector(section: Mapping[str, Any], key: str, where: str, path: Path) -> FloatArray:
    """Three finite numbers, read-only.

    Raises
    ------
    CampaignError
        The key is missing or holds something else.
    """
    value = section.get(key)
    if not isinstance(value, list) or len(value) != 3 or not all(map(is_number, value)):
        found = missing(key, section) if value is None else repr(value)
        raise fault(path, expected="three finite numbers", found=found, column=where)
    return frozen(np.array(value, dtype=np.float64))


def missing(key: str, section: Mapping[str, Any]) -> str:
    """That a key is not there, and which was probably meant."""
    near = lookalike(key, list(section))
    return f"no such key, but {near!r}" if near else "no such key"


def frozen(array: FloatArray) -> FloatArray:
    """The array, read-only from now on."""
    array.setflags(write=False)
    return array
