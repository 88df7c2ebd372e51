"""``clampid compare``: model against measurement."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from clampid.verbs.errors import CallError
from clampid.verbs.inputs import numbers_of, read_checked
from clampid.verbs.options import EffectsFrom, Json, ModelFile, OneCampaign, Quiet, Seed, Verbose
from clampid.verbs.output import Output, output_file
from clampid.verbs.units import Units

__all__ = ["compare"]


def compare(
    model: ModelFile,
    campaign: OneCampaign,
    refit: Annotated[
        str, typer.Option(metavar="base,tool", help="Fit only these again, such as base,tool.", show_default=False)
    ] = "",
    refit_fraction: Annotated[
        float, typer.Option(metavar="SHARE", help="Share of whole poses that they are fitted on.")
    ] = 0.2,
    report: Annotated[
        Path | None, typer.Option(metavar="FILE.html", help="Write the report, with a diagnosis.", show_default=False)
    ] = None,
    sample: Annotated[
        str | None,
        typer.Option(metavar="X,Y,Z", help="Split errors about this point, m, base frame.", show_default=False),
    ] = None,
    mm: Annotated[bool, typer.Option("--mm", help="--sample is given in millimetres, not metres.")] = False,
    seed: Seed = 0,
    effects_from: EffectsFrom = None,
    json: Json = None,
    verbose: Verbose = False,
    quiet: Quiet = False,
) -> None:
    """Compare a model with a campaign, table by table: errors of fitted and of held-out rows, and the noise floor."""
    out = Output(quiet, json, verbose)
    parts = tuple(part.strip() for part in refit.split(",") if part.strip())
    for part in parts:
        if part not in ("base", "tool"):
            raise CallError(f"--refit: expected base, tool or both, found {part!r}")
    if not 0.0 < refit_fraction < 1.0:
        raise CallError(f"--refit-fraction: expected a share between 0 and 1, found {refit_fraction:g}")
    centre = numbers_of("--sample", sample)
    units = Units(millimetres=mm)
    if centre is not None and len(centre) != 3:
        raise CallError(f"--sample: expected x, y, z in {units.distance_unit}, found {sample!r}")
    if mm and centre is None:
        raise CallError("--mm is the unit of --sample: expected --sample X,Y,Z with it")
    centre = units.lengths(centre)
    if report is not None:
        output_file(report, "HTML")

    from clampid.comparison.compare import compare as hold_against
    from clampid.comparison.nominal import nominal_errors
    from clampid.models.model import load_model
    from clampid.verbs.findings import show_comparison
    from clampid.verbs.screens import comparison_screen

    loaded = load_model(model)
    with out.working("reading"):
        (read,) = read_checked([campaign], out)
    with out.working("comparing"):
        comparison = hold_against(
            loaded,
            read,
            refit=parts,
            refit_fraction=refit_fraction,
            seed=seed,
            user_effects=effects_from,
            sample=centre,
        )
        nominal = nominal_errors(loaded, read, effects_from)
    data = {**comparison.to_json(), "model": str(model), "campaign": str(campaign)}
    show_comparison(data, out)
    if report is not None:
        from clampid.diagnosis.diagnose import diagnose
        from clampid.report import write_report

        with out.working("diagnosing and writing the report"):
            diagnosis = diagnose(loaded, read, seed=seed, user_effects=effects_from).to_json()
            write_report(report, loaded, read, comparison=data, diagnosis=diagnosis, user_effects=effects_from)
    out.show(comparison_screen(data, nominal, model, campaign, report, effects_from))
    out.result(data)
