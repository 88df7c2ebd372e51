"""The report: one HTML file that opens offline and that an engineer can put into their own."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from clampid.models.model import Model
from clampid.report.page import page
from experiments.campaign import Campaign
from experiments.outputs import write_text

__all__ = ["write_report"]


def write_report(
    path: str | Path,
    model: Model,
    campaign: Campaign,
    *,
    comparison: Mapping[str, Any] | None = None,
    diagnosis: Mapping[str, Any] | None = None,
    first_model: Model | None = None,
    truth: Sequence[Mapping[str, Any]] | None = None,
    user_effects: str | Path | None = None,
) -> None:
    """Write the report of a model and one of its campaigns.

    Parameters
    ----------
    path
        The HTML file; it is replaced whole or not at all.
    comparison, diagnosis
        What ``compare`` and ``diagnose`` say, as their JSON has it.
    first_model
        The model before anything was added, for before and after.
    truth
        What a demonstration had hidden (``CAMPAIGN.hidden.json``), shown after the verdict.
    user_effects
        The user's own effects; by default the file that the model names.
    """
    write_text(path, page(model, campaign, comparison, diagnosis, first_model, truth, user_effects))
