"""Reads TOML files that state their own format."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

from experiments.errors import fault
from kinematics.reading import read_text, toml_of

__all__ = ["read_toml"]


def read_toml(path: Path, what: str, stated: str) -> dict[str, Any]:
    """Read a TOML file.

    Parameters
    ----------
    what
        What kind of file it is, for errors.
    stated
        What its key ``format`` must say.

    Raises
    ------
    CampaignError
        The file is missing, no TOML, or of another format.
    """
    try:
        raw = toml_of(read_text(path))
    except FileNotFoundError:
        raise fault(path, expected=what, found="no such file") from None
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise fault(path, expected="TOML", found=str(error)) from error
    if raw.get("format") != stated:
        raise fault(path, expected=repr(stated), found=repr(raw.get("format")), column="format")
    return raw
