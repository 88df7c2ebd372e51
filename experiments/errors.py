"""The one error of campaign folders: it names file, row and column, what was expected and what was found."""

from __future__ import annotations

from pathlib import Path

__all__ = ["CampaignError", "fault"]


LONGEST_FOUND = 1000  # characters that are shown of what was found


class CampaignError(ValueError):
    """A campaign folder, or a call that reads or writes one, does not follow the contract."""


def fault(
    file: str | Path,
    *,
    expected: str,
    found: str,
    row: int | None = None,
    line: int | None = None,
    column: str | None = None,
) -> CampaignError:
    """Word an error the way every error about a campaign is worded.

    Parameters
    ----------
    file
        The file at fault, as the user can find it.
    expected, found
        What the contract wants and what is there.
    row
        1-based data row, where one row is at fault.
    line
        1-based line of a text file; the header is line 1.
    column
        The column, or for ``campaign.toml`` the key.

    Returns
    -------
    CampaignError
        To be raised by the caller.
    """
    where = str(file)
    if row is not None:
        where += f", row {row}"
    if line is not None:
        where += f" (line {line})" if row is not None else f", line {line}"
    if column is not None:
        where += f", column {column}" if not str(file).endswith(".toml") else f", key {column}"
    if len(found) > LONGEST_FOUND:
        found = f"{found[:LONGEST_FOUND]}… ({len(found)} characters)"
    return CampaignError(f"{where}: expected {expected}, found {found}")
