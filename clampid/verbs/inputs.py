"""Inputs of verbs: campaigns that were checked, lists of effects, terms to add."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from difflib import get_close_matches
from math import inf
from pathlib import Path
from typing import TYPE_CHECKING

from clampid.display import MINUS
from clampid.verbs.errors import CallError
from clampid.verbs.output import Output

if TYPE_CHECKING:
    from clampid.effect import Stage
    from experiments.campaign import Campaign
    from experiments.checks.finding import Finding

__all__ = ["finding_text", "fits_geometry", "numbers_of", "read_checked", "split_effects", "split_terms"]


def read_checked(
    folders: Sequence[Path], out: Output, rows_in_memory: float = inf, *, fits: bool = False
) -> list[Campaign]:
    """Read campaigns and look at them: warnings are printed, errors refuse the campaign.

    ``rows_in_memory``: how many rows of a torque log may be held; `experiments.campaign.read_campaign`.
    ``fits``: whether a geometry is fitted to them; one campaign alone needs enough poses for that.

    Raises
    ------
    CampaignError
        A folder does not follow the contract, or its numbers cannot mean what the contract says.
    """
    from experiments.campaign import CampaignError, read_campaign
    from experiments.checks.check import check_campaign

    campaigns = []
    for folder in folders:
        campaign = read_campaign(folder, rows_in_memory=rows_in_memory)
        findings = check_campaign(campaign, fits=fits and len(folders) == 1)
        for finding in findings:
            if finding.severity == "warning":
                out.warn(f"warning: {folder}: {finding_text(finding)}")
        wrong = [finding_text(f) for f in findings if f.severity == "error"]
        if wrong:
            raise CampaignError(f"{folder}: {'; '.join(wrong)}")
        campaigns.append(campaign)
    return campaigns


def finding_text(finding: Finding) -> str:
    """``poses, row 3, column q1_rad: …``."""
    where = finding.table
    if finding.row is not None:
        where += f", row {finding.row}"
    if finding.column is not None:
        where += f", column {finding.column}"
    return f"{where}: {finding.message}"


def numbers_of(option: str, text: str | None) -> tuple[float, ...] | None:
    """Numbers separated by commas, as screens print them, too; None where the option was not given.

    Raises
    ------
    CallError
        One of them is no number.
    """
    if text is None:
        return None
    try:
        return tuple(float(part) for part in text.replace(MINUS, "-").split(","))
    except ValueError:
        raise CallError(f"{option}: expected numbers separated by commas, found {text!r}") from None


def fits_geometry(chosen: Mapping[Stage, Sequence[str]] | Sequence[str] | None) -> bool:
    """Whether what :func:`split_effects` gave fits a geometry: the standard set does."""
    if chosen is None:
        return True
    from clampid.catalogue import catalogue
    from clampid.standard_sets import STANDARD

    names = chosen.get("poses", STANDARD["poses"]) if isinstance(chosen, Mapping) else chosen
    return any("link_frame" in effect.roles for name, effect in catalogue().items() if name in names)


def split_effects(lists: Sequence[str] | None) -> dict[Stage, list[str]] | list[str] | None:
    """Turn ``--effects`` options into stage → names, or a plain list where none names a stage.

    Raises
    ------
    CallError
        Lists with and without a stage are mixed, a stage is unknown or named twice.
    """
    if not lists:
        return None
    from clampid.effect import STAGES

    plain: list[str] = []
    staged: dict[Stage, list[str]] = {}
    for text in lists:
        head, equals, names = text.partition("=")
        if not equals:
            plain += _names(text, text)
            continue
        stage: Stage | None = next((s for s in STAGES if s == head.strip()), None)
        if stage is None:
            near = get_close_matches(head.strip(), STAGES, 1)
            hint = f"did you mean {near[0]}? " if near else ""
            raise CallError(f"--effects {text}: no stage is called {head!r}; {hint}known: {', '.join(STAGES)}")
        if stage in staged:
            raise CallError(f"--effects: the stage {stage} is given twice; expected one list for it")
        staged[stage] = _names(names, text)
    if plain and staged:
        raise CallError("--effects: expected lists with a stage or one without, found both")
    return plain or staged


def split_terms(text: str) -> list[str]:
    """Turn ``poses=a,b@joint3`` into ``poses=a`` and ``poses=b@joint3``: a stage holds until the next is named."""
    stage, terms = "", []
    for part in _names(text, text):
        head, equals, name = part.partition("=")
        if equals:
            stage, part = f"{head.strip()}=", name.strip()  # noqa: PLW2901
        if not part:
            raise CallError(f"{text!r}: expected an effect after {stage!r}, found none")
        terms.append(f"{stage}{part}")
    return terms


def _names(text: str, whole: str) -> list[str]:
    names = [name.strip() for name in text.split(",")]
    if not all(names):
        raise CallError(f"{whole!r}: expected names of effects separated by commas, found an empty one")
    return names
