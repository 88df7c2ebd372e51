"""Reads TOML files that state their own format."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

from experiments.errors import CampaignError, fault
from kinematics.reading import read_text, toml_of
from kinematics.section import migrated

__all__ = ["read_toml"]


def read_toml(path: Path, what: str, stated: str) -> dict[str, Any]:
    """Read a TOML file.

    Parameters
    ----------
    what
        What kind of file it is, for errors.
    stated
        Its kind and newest version, as its key ``format`` says; without the key it is version 1.

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
    try:
        return migrated(raw, stated, {})
    except ValueError as error:
        raise CampaignError(f"{path}, {error}") from None
