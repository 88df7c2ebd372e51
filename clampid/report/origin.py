"""Sources of a report: literature of the effects used, version and seed, and the command that repeats the fit."""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from importlib.metadata import PackageNotFoundError, version

from clampid.effect import Effect
from clampid.models.model import Model
from clampid.report.style import Command, Section, as_table
from clampid.screen import command_lines
from experiments.campaign import Campaign
from kinematics.sources import load_sources

__all__ = ["command", "origin_section"]


def command(model: Model, campaign: Campaign) -> str:
    """The call that fits this model again."""
    folder = str(campaign.path) if campaign.path is not None else campaign.name
    words = ["clampid", "identify", folder, *("OTHER_CAMPAIGN" for _ in model.sessions[1:]), "-o", "model.json"]
    for stage, part in model.stages.items():
        words += ["--effects", f"{stage}={','.join(t.label for t in part.terms)}"]
    if model.holdout:
        words += ["--holdout", repr(model.holdout)]
    words += ["--seed", str(model.seed)]
    if model.user_effects:
        words += ["--effects-from", model.user_effects]
    return shlex.join(words)


def origin_section(model: Model, campaign: Campaign, effects: Mapping[str, Effect]) -> Section:
    """Section "Sources and how to do it again"."""
    titles = load_sources()
    used: dict[str, list[str]] = {}
    for part in model.stages.values():
        for term in part.terms:
            for key in effects[term.effect].source:
                if term.effect not in used.setdefault(key, []):
                    used[key].append(term.effect)
    rows = [(key, titles.get(key, "given by the effect's own file"), ", ".join(names)) for key, names in used.items()]
    facts = [
        ("Software", f"clampid {_version()}"),
        ("Seed", str(model.seed)),
        ("Campaigns", "; ".join(f"{s.name} ({s.fingerprint[:16]}…)" for s in model.sessions)),
        ("Robot description", campaign.robot.source or "–"),
    ]
    caption = "The literature that follows from the effects used."
    return Section(
        "origin",
        "Sources, and how to do it again",
        (),
        (
            Command(tuple(command_lines(command(model, campaign))), "This command fits the model again:"),
            as_table(("", ""), facts),
            as_table(("Key", "Title", "For"), rows, caption),
        ),
        finding=f"Made by clampid {_version()}; the command below fits the model again.",
    )


def _version() -> str:
    try:
        return version("clampid")
    except PackageNotFoundError:
        return "(not installed)"
