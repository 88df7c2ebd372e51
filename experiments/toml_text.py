"""Writes TOML, which the standard library only reads."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from datetime import date, time
from pathlib import Path
from typing import Any

import numpy as np

from experiments.errors import CampaignError

__all__ = ["toml_text"]


def toml_text(raw: Mapping[str, Any]) -> str:
    """Write a header as TOML: plain keys first, then one section per mapping.

    Parameters
    ----------
    raw
        Text, numbers, truth values, dates, lists of them, and mappings of those.

    Returns
    -------
    str
        TOML that `tomllib` reads back to equal values; numbers keep every digit.

    Raises
    ------
    CampaignError
        If a value is of a kind that TOML text is not written for here.
    """
    lines = [f"{_key(k)} = {_value(k, v)}" for k, v in raw.items() if not isinstance(v, Mapping)]
    for name, section in raw.items():
        if isinstance(section, Mapping):
            lines += ["", f"[{_key(name)}]", *(f"{_key(k)} = {_value(k, v)}" for k, v in section.items())]
    return "\n".join(lines) + "\n"


def _key(key: str) -> str:
    bare = key.isascii() and key.replace("_", "").replace("-", "").isalnum()
    return key if bare else _quoted(key)


def _quoted(text: str) -> str:
    # JSON escapes what TOML wants escaped, but for the one control character that JSON leaves as it is.
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


def _value(key: str, value: Any) -> str:
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, Path):
        value = str(value)
    if isinstance(value, str):
        return _quoted(value)
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int | float):
        return repr(value)
    if isinstance(value, Sequence):
        return "[" + ", ".join(_value(key, v) for v in value) + "]"
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{_key(k)} = {_value(k, v)}" for k, v in value.items()) + "}"
    if isinstance(value, date | time):  # a datetime is a date
        return value.isoformat()
    raise CampaignError(f"campaign.toml, key {key}: expected text, a number or a list, found {type(value).__name__}")
