"""One finding of a check as a frozen value, for people and for programs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

__all__ = ["Finding", "joint_list"]


@dataclass(frozen=True)
class Finding:
    """One finding that a campaign's user should know.

    Attributes
    ----------
    severity
        ``error``: the numbers cannot mean what the contract says. ``warning``: something is improbable, or cannot be
        identified. ``note``: good to know.
    table
        The table, or ``campaign.toml``.
    column
        The column, or the first of several.
    row
        1-based data row, where one row stands out.
    message
        In words.
    """

    severity: Literal["error", "warning", "note"]
    table: str
    column: str | None
    row: int | None
    message: str


def joint_list(joints: list[int]) -> str:
    """Name joints, counted from 1.

    Parameters
    ----------
    joints
        Numbers from 1.

    Returns
    -------
    str
        ``joint 2`` or ``joints 2, 3``.
    """
    return f"joint{'s' if len(joints) > 1 else ''} {', '.join(map(str, joints))}"
