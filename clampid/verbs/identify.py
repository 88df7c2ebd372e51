"""``clampid identify``: from campaigns to a model."""

from __future__ import annotations

from typing import Annotated, Literal

import typer

from clampid.verbs.errors import CallError
from clampid.verbs.inputs import fits_geometry, read_checked, split_effects
from clampid.verbs.options import Campaigns, Effects, EffectsFrom, Json, Quiet, Seed, Verbose
from clampid.verbs.options import Output as OutputFile
from clampid.verbs.output import Output, output_file

__all__ = ["identify"]


def identify(
    campaigns: Campaigns,
    output: OutputFile,
    effects: Effects = None,
    holdout: Annotated[
        float, typer.Option(metavar="SHARE", help="Share of whole poses, runs and sweeps that no fit sees.")
    ] = 0.0,
    bootstrap: Annotated[
        int, typer.Option(metavar="N", help="Bootstrap: draw whole poses N times, for standard errors of poses.")
    ] = 0,
    seed: Seed = 0,
    cost: Annotated[
        Literal["least-squares", "mean-norm"],
        typer.Option(help="What the fit of poses minimises; mean-norm is the universal model's cost."),
    ] = "least-squares",
    joint: Annotated[
        bool, typer.Option("--joint", help="All tables in one fit, with the parameters that they share.")
    ] = False,
    effects_from: EffectsFrom = None,
    json: Json = None,
    verbose: Verbose = False,
    quiet: Quiet = False,
) -> None:
    """Fit a model, stage by stage: free air, clamped, poses; or all tables at once."""
    out = Output(quiet, json, verbose)
    output_file(output, "a model")
    if not 0.0 <= holdout < 1.0:
        raise CallError(f"--holdout: expected a share from 0 to below 1, found {holdout:g}")
    if bootstrap < 0 or bootstrap == 1:
        raise CallError(f"--bootstrap: expected 0 or 2 and more draws, found {bootstrap}")
    chosen = split_effects(effects)

    import pandas as pd

    from clampid.catalogue import with_user_effects
    from clampid.comparison.nominal import nominal_errors
    from clampid.identification.identify import identify as fit_model
    from clampid.models.drives import clamped_drives
    from clampid.models.model import save_model
    from clampid.stages.resolution import resolution_of
    from clampid.stages.stage_kind import known_of
    from clampid.verbs.rejected import rejected_words
    from clampid.verbs.screens import fit_screen
    from clampid.verbs.show import model_json, show_drives, show_model
    from experiments.checks.points import enough_poses
    from experiments.long_log import LONG_ROWS

    with out.working("reading"):
        read = read_checked(campaigns, out, rows_in_memory=LONG_ROWS, fits=fits_geometry(chosen))
    with out.working("identifying"):
        model = fit_model(
            read,
            chosen,
            holdout=holdout,
            seed=seed,
            joint=joint,
            user_effects=effects_from,
            bootstrap=bootstrap,
            cost=cost,
        )
    with out.working("comparing with the nominal robot"):
        nominal = nominal_errors(model, read, effects_from)
    save_model(model, output)
    rejected = rejected_words(model, read, effects_from)
    show_model(model, with_user_effects(effects_from), read[0].robot, rejected, out)
    data = {"model": str(output), **model_json(model)}
    drives = clamped_drives(model, read[0].robot)
    if drives is not None:
        show_drives(drives, out)
        data["stages"]["clamped"]["drives"] = drives.to_json()
    moving, points = known_of(data["stages"], "moving"), known_of(data["stages"], "points")
    if moving is not None and (resolution := resolution_of(read)) is not None:
        moving["resolution"] = resolution.to_json()
    if points is not None and "poses" in read[0].tables:
        frame = pd.concat([c.tables["poses"] for c in read if "poses" in c.tables])
        points["enough_poses"] = enough_poses(frame, points["parameters"])
    out.show(fit_screen(data, nominal, rejected, read, campaigns, effects_from))
    out.result(data)
