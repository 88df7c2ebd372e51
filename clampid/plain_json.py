"""Data as JSON has it: lists, numbers, and None for what is not finite."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    pass

__all__ = ["finite"]


def finite(data: Any) -> Any:
    """The same data for JSON: tuples as lists, numpy scalars as numbers, what is not finite as None."""
    match data:
        case Mapping():
            return {str(key): finite(value) for key, value in data.items()}
        case str() | bool() | int() | None:
            return data
        case float():
            return data if math.isfinite(data) else None
        case Iterable():
            return [finite(value) for value in data]
        case _ if hasattr(data, "item"):
            return finite(data.item())
        case _:
            raise TypeError(f"cannot write {type(data).__name__} as JSON")
