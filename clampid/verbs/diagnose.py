"""``clampid diagnose``: where a model fails, and which effect is missing."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from clampid.verbs.inputs import read_checked
from clampid.verbs.options import Campaigns, EffectsFrom, Json, ModelFile, Quiet, Seed
from clampid.verbs.output import Output, output_file

if TYPE_CHECKING:
    from clampid.diagnose import Diagnosis
    from experiments.campaign import Campaign

__all__ = ["diagnose"]


def diagnose(
    model: ModelFile,
    campaigns: Campaigns,
    flips: Annotated[int, typer.Option(min=19, help="Sign flips that decide; p is at least 1/(flips + 1).")] = 199,
    seed: Seed = 0,
    plan: Annotated[
        Path | None,
        typer.Option(
            metavar="PLAN.toml",
            help="Where to write the poses to measure next, if there are any that part what these cannot.",
            show_default=False,
        ),
    ] = None,
    effects_from: EffectsFrom = None,
    json: Json = None,
    quiet: Quiet = False,
) -> None:
    """Say where a model fails, and which effect is missing."""
    out = Output(quiet, json)

    from clampid.diagnose import diagnose as look_for_missing
    from clampid.model import load_model
    from clampid.verbs.findings import show_diagnosis

    target = None if plan is None else output_file(plan)
    loaded = load_model(model)
    with out.working("reading"):
        read = read_checked(campaigns, out)
    with out.working("diagnosing"):
        found = look_for_missing(loaded, read, seed=seed, flips=flips, user_effects=effects_from)
    data = found.to_json()
    show_diagnosis(data, out)
    if target is not None:
        _write_plan(found, read[0], target, out)
    out.result(data)


def _write_plan(found: Diagnosis, campaign: Campaign, target: Path, out: Output) -> None:
    """Write the poses to measure next, or say why there are none."""
    from clampid.diagnosis.next_poses import plan_of
    from experiments.plans.write import write_plan

    poses = found.stages.get("poses")
    if poses is None or poses.next_poses is None:
        out.say("no plan is written: the poses leave no candidates that cannot be told apart")
    elif not poses.next_poses.helps:
        out.say("no plan is written: no poses are expected to part the candidates")
    else:
        write_plan(plan_of(campaign, poses.next_poses), target)
        out.say(f"wrote {target}: {len(poses.next_poses.q)} poses to measure next")
