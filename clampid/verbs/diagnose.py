"""``clampid diagnose``: where a model fails, and which effect is missing."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from clampid.plain_json import finite
from clampid.verbs.errors import CallError
from clampid.verbs.inputs import read_checked
from clampid.verbs.options import Campaigns, EffectsFrom, Json, ModelFile, Quiet, Seed, Verbose
from clampid.verbs.output import Output, output_file
from clampid.verbs.plan_options import names_of
from experiments.targets import OutputError, refuse_other_kind

if TYPE_CHECKING:
    from clampid.diagnosis.diagnose import Diagnosis

__all__ = ["diagnose"]


def diagnose(
    model: ModelFile,
    campaigns: Campaigns,
    flips: Annotated[
        int, typer.Option(min=1, help="Number of sign flips of the test; p is at least 1/(flips + 1).")
    ] = 199,
    seed: Seed = 0,
    plan: Annotated[
        Path | None,
        typer.Option(
            metavar="PLAN.toml",
            help="Where to write the poses, runs or sweeps to measure next: what separates candidates that explain the "
            "same, or else what tests effects that these data test too weakly.",
            show_default=False,
        ),
    ] = None,
    plan_for: Annotated[
        str | None,
        typer.Option(
            metavar="EFFECT[@joint3],…",
            help="With --plan: which effects are to be tested better; all that are tested too weakly otherwise.",
            show_default=False,
        ),
    ] = None,
    effects_from: EffectsFrom = None,
    json: Json = None,
    verbose: Verbose = False,
    quiet: Quiet = False,
) -> None:
    """Say where a model fails, and which effect is missing."""
    out = Output(quiet, json, verbose)

    from clampid.diagnosis.candidate_scores import refuse_few_flips
    from clampid.diagnosis.diagnose import diagnose as look_for_missing
    from clampid.diagnosis.headline import listed
    from clampid.loop.kept_diagnosis import keep_diagnosis, kept_file
    from clampid.models.model import load_model
    from clampid.role_slots import any_of_role
    from clampid.verbs.findings import show_diagnosis
    from clampid.verbs.next_step import after_diagnosis
    from clampid.verbs.screens import diagnosis_screen

    refuse_few_flips(flips)
    refuse_other_kind(kept_file(model), "a diagnosis")
    target = None if plan is None else output_file(plan, "a plan")
    if plan_for is not None and target is None:
        raise CallError("--plan-for: expected --plan PLAN.toml with it, found none")
    wanted = None if target is None else names_of(plan_for) or ()
    loaded = load_model(model)
    with out.working("reading"):
        # Every fold is fitted again: with too few poses its residuals would show a structure that is overfitting.
        stage = loaded.stages.get("poses")
        fits = stage is not None and any_of_role(stage.slots, "link_frame")
        read = read_checked(campaigns, out, fits=fits)
    with out.working("diagnosing"):
        found = look_for_missing(loaded, read, seed=seed, flips=flips, user_effects=effects_from, plan_for=wanted)
    data = found.to_json()
    show_diagnosis(data, out)
    try:
        keep_diagnosis(model, read, finite(data))
    except (OSError, OutputError) as error:  # it only saves a report the time to compute it again
        out.step(f"the diagnosis is not kept for a report: {error}")
    written = [] if target is None else _write_plans(found, len(read), target)
    done = f"Diagnosed {model} on {listed([str(c) for c in campaigns], 2)}."
    steps = after_diagnosis(data, model, campaigns, target, effects_from)
    out.show(diagnosis_screen(data, done, written, steps))
    out.result(data)


def _write_plans(found: Diagnosis, campaigns: int, target: Path) -> list[str]:
    """Write the plans of what to measure next, a file for each stage; say so, or why there is none."""
    from experiments.plans.write import write_plan

    if campaigns > 1:
        return ["No plan is written: a plan is made for one campaign's cell; name one campaign."]
    plans = {name: stage.next_plan for name, stage in found.stages.items() if stage.next_plan is not None}
    ready = {name: made for name, made in plans.items() if made.plan is not None}
    said = []
    for name, made in ready.items():
        path = target if len(ready) == 1 else target.with_name(f"{target.stem}.{name}{target.suffix}")
        if made.plan is not None:
            write_plan(made.plan, path)
            minutes = f"{made.plan.duration / 60:.0f} min"
            said.append(f"Wrote {path}: {made.count}, {minutes}.")
    said += [f"{name}: no plan is written: {made.nothing}." for name, made in plans.items() if made.plan is None]
    for name in found.stages:
        if name not in plans:
            said.append(f"{name}: no plan is written: no candidates to distinguish, and none tested too weakly.")
    return said
