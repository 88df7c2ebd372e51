"""``clampid auto``: identify, then diagnose and add until nothing more is confirmed."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from clampid.plain_json import finite
from clampid.verbs.inputs import fits_geometry, read_checked, split_effects
from clampid.verbs.options import Campaigns, Effects, EffectsFrom, Json, Quiet, Seed, Verbose
from clampid.verbs.options import Output as OutputFile
from clampid.verbs.output import Output, output_file
from experiments.targets import OutputError, refuse_other_kind

if TYPE_CHECKING:
    from clampid.models.model import Model
    from experiments.campaign import Campaign

__all__ = ["auto"]

COMPARING_SHARE = 0.3  # of the time that a report takes


def auto(
    campaigns: Campaigns,
    output: OutputFile,
    effects: Effects = None,
    report: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE.html",
            help="Write the report, with every step and what was rejected; of several campaigns about the first.",
            show_default=False,
        ),
    ] = None,
    seed: Seed = 0,
    effects_from: EffectsFrom = None,
    json: Json = None,
    verbose: Verbose = False,
    quiet: Quiet = False,
) -> None:
    """Identify, then diagnose and add until nothing more is confirmed."""
    out = Output(quiet, json, verbose)
    output_file(output, "a model")
    if report is not None:
        output_file(report, "HTML")
    chosen = split_effects(effects)

    from clampid.catalogue import with_user_effects
    from clampid.comparison.nominal import nominal_errors
    from clampid.identification.identify import identify
    from clampid.loop.auto import mend
    from clampid.loop.kept_diagnosis import keep_diagnosis, kept_file
    from clampid.models.model import save_model
    from clampid.verbs.findings import show_diagnosis
    from clampid.verbs.next_step import after_mending
    from clampid.verbs.rejected import rejected_words
    from clampid.verbs.screens import mended_screen
    from clampid.verbs.show import model_json, show_model

    refuse_other_kind(kept_file(output), "a diagnosis")
    with out.working("reading"):
        read = read_checked(campaigns, out, fits=fits_geometry(chosen))
    with out.working("identifying the start model"):
        first = identify(read, chosen, seed=seed, user_effects=effects_from)
    with out.working("mending"):
        model, diagnosis = mend(first, read, seed=seed, user_effects=effects_from, progress=out.step)
    save_model(model, output)
    with out.working("comparing with the nominal robot"):
        nominal = nominal_errors(model, read, effects_from)
    found = diagnosis.to_json()
    rejected = rejected_words(model, read, effects_from)
    show_model(model, with_user_effects(effects_from), read[0].robot, rejected, out)
    show_diagnosis(found, out)
    if report is not None:
        _write_report(report, model, read[0], found, first, seed, effects_from, out)
    try:
        keep_diagnosis(output, read, finite(found))
    except (OSError, OutputError) as error:  # it only saves a report the time to compute it again
        out.step(f"the diagnosis is not kept for a report: {error}")
    data = {"model": str(output), **model_json(model), "diagnosis": found}
    written = "" if report is None else f" Report: {report}, about {read[0].name}."
    steps = after_mending(found, output, campaigns, report, effects_from)
    out.show(mended_screen(data, model, nominal, f"Fitted and mended {output}.{written}", steps))
    out.result(data)


def _write_report(
    target: Path,
    model: Model,
    campaign: Campaign,
    diagnosis: Mapping[str, Any],
    first: Model,
    seed: int,
    effects_from: Path | None,
    out: Output,
) -> None:
    """The mended model against one of its campaigns, and the way there from the start model."""
    from clampid.comparison.compare import compare
    from clampid.progress import substep
    from clampid.report import write_report

    with out.working("writing the report"):
        with substep("comparing", COMPARING_SHARE):
            compared = compare(model, campaign, seed=seed, user_effects=effects_from).to_json()
        write_report(
            target,
            model,
            campaign,
            comparison=compared,
            diagnosis=diagnosis,
            first_model=first,
            user_effects=effects_from,
        )
