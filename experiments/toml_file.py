"""Reads TOML files that state their own format."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from experiments.errors import CampaignError, fault
from kinematics.reading import read_text, toml_of
from kinematics.section import Section, migrated

__all__ = ["read_toml", "root_of"]


def read_toml(path: Path, what: str, stated: str, *, needed: bool = False) -> Section:
    """Read a TOML file.

    Parameters
    ----------
    what
        What kind of file it is, for errors.
    stated
        Its kind and newest version, as its key ``format`` says; without the key it is version 1.
    needed
        The key has to be there.

    Raises
    ------
    CampaignError
        The file is missing, no TOML, or of another format.
    """
    try:
        raw = toml_of(read_text(path))
    except FileNotFoundError:
        raise fault(path, expected=what, found="no such file") from None
    except UnicodeDecodeError as error:
        raise fault(path, expected="UTF-8 text", found=f"a byte that is not, at offset {error.start}") from error
    except (OSError, tomllib.TOMLDecodeError) as error:
        raise fault(path, expected="TOML", found=getattr(error, "strerror", None) or str(error)) from error
    return root_of(raw, path, stated, needed=needed)


def root_of(raw: Mapping[str, Any], path: Path, stated: str, *, needed: bool = False) -> Section:
    """The content of a file, of its newest version; ``format`` is read.

    Raises
    ------
    CampaignError
        It is of another format.
    """
    try:
        root = Section(migrated(raw, stated, {}, needed=needed), str(path), error=CampaignError)
    except ValueError as error:
        raise CampaignError(f"{path}, {error}") from None
    root.has("format")
    return root
