"""The page: all sections in their order, put into the template."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from clampid.charts.style import STYLE
from clampid.charts.svg import svg
from clampid.display import true_minus
from clampid.identification.model_on_campaign import on_campaign
from clampid.models.model import Model
from clampid.progress import in_parts
from clampid.report.angle_curves import angle_curves_section
from clampid.report.budget_section import budget_section
from clampid.report.dh_section import dh_section
from clampid.report.drives import drives_section
from clampid.report.findings import findings
from clampid.report.first_screen import FirstScreen, first_screen
from clampid.report.ledger_figures import with_ledger_figures
from clampid.report.measured import measured_section
from clampid.report.origin import origin_section
from clampid.report.parameters import parameters_section
from clampid.report.robot3d import robot_section
from clampid.report.rounds import rounds_section
from clampid.report.spread import spread_sentences, spreads
from clampid.report.stage_data import stage_data
from clampid.report.steps import steps_section
from clampid.report.style import Figure, Section
from clampid.report.torque import torque_section
from clampid.report.truth import truth_and_found
from clampid.report.unknown_shape import unknown_shape_section
from clampid.report.verdict import headline, verdict_section
from clampid.report.where import where_section
from experiments.campaign import Campaign

__all__ = ["page"]

Json = Mapping[str, Any]


def page(
    model: Model,
    campaign: Campaign,
    comparison: Json | None,
    diagnosis: Json | None,
    first_model: Model | None,
    truth: Sequence[Json] | None,
    user_effects: str | Path | None,
) -> str:
    """The report as HTML."""
    own = None if user_effects is None else Path(user_effects)
    opened = on_campaign(model, campaign, own)
    effects, stages = opened.effects, stage_data(opened)
    poses = stages.get("poses")
    diagnosis = with_ledger_figures(diagnosis, model, first_model)
    before = stage_data(on_campaign(first_model, campaign, own)) if first_model is not None else {}
    sure = spreads(stages, before, model.seed)
    makers: dict[str, Callable[[], Section | None]] = {
        "what was measured": lambda: measured_section(model, campaign),
        "rounds": lambda: rounds_section(model, first_model, stages, sure),
        "steps": lambda: steps_section(model, first_model),
        "verdict": lambda: verdict_section(diagnosis, comparison),
        "unknown shape": lambda: unknown_shape_section(diagnosis),
        "what was hidden": lambda: truth_and_found(truth, model, effects, campaign.robot),
        "residuals": lambda: where_section(stages, model.seed),
        "the robot": lambda: robot_section(campaign.robot, poses, before.get("poses")) if poses is not None else None,
        "error budget": lambda: budget_section(stages),
        "torques": lambda: torque_section(stages),
        "drives": lambda: drives_section(stages.get("clamped")),
        "angle curves": lambda: angle_curves_section(model, effects, campaign.robot, poses, diagnosis),
        "parameters": lambda: parameters_section(model, effects, campaign.robot),
        "DH table": lambda: dh_section(model, campaign.robot),
        "origin": lambda: origin_section(model, campaign, effects),
    }
    sections = [makers[name]() for name in in_parts(makers, str)]
    sentences = [*headline(model, first_model, comparison, diagnosis), *spread_sentences(sure)]
    first = first_screen(model, first_model, stages, diagnosis)
    heads = findings(model, first_model, campaign, stages, diagnosis, truth, first.verdict)
    return render(
        campaign.robot.title,
        campaign.name,
        first,
        [_with_sentences(_headed(s, heads), sentences) for s in sections if s is not None],
    )


def _headed(section: Section, heads: Mapping[str, str]) -> Section:
    """The section with its finding as heading; a finding that it states itself is kept."""
    return section if section.finding else replace(section, finding=heads.get(section.key, ""))


def _with_sentences(section: Section, sentences: Sequence[str]) -> Section:
    """The findings in full, folded, before the rounds that they are about."""
    return section if section.key != "rounds" else replace(section, in_full=tuple(sentences))


def render(title: str, campaign: str, first: FirstScreen, sections: Sequence[Section]) -> str:
    """Fill the template."""
    environment = Environment(
        loader=PackageLoader("clampid", "report"),
        autoescape=True,
        finalize=_finalized,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return environment.get_template("template.html").render(
        title=title,
        campaign=campaign,
        first=first,
        sections=sections,
        kind=lambda block: type(block).__name__,
        typeset=_typeset,
        drawing=_drawing,
        choices_json=_choices_json,
        chart_style=Markup(STYLE),
    )


def _typeset(cell: str) -> str:
    """A cell of numbers as printed: groups of three digits from 10 000."""
    return re.sub(r"(?<![\w.])\d{5,}", lambda digits: f"{int(digits[0]):,}".replace(",", "\u202f"), cell)


def _finalized(value: Any) -> Any:
    """Whatever the template prints: text with true minus signs; drawings, styles and JSON as they are."""
    return true_minus(value) if isinstance(value, str) and not isinstance(value, Markup) else value


def _embedded(text: str) -> Markup:
    """JSON that may stand inside a script element."""
    return Markup(text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026"))


def _drawing(figure: Figure) -> Markup:
    return Markup(svg(figure.plot, figure.key, figure.caption))


def _choices_json(figure: Figure) -> Markup:
    s = figure.selector
    if s is None:
        return Markup("null")
    parts = {"choices": s.choices, "values": s.values, "ends": s.ends, "outlines": s.outlines}
    return _embedded(json.dumps(parts, ensure_ascii=False, separators=(",", ":")))
