"""``clampid add``: adds effects to a model and fits again."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated, Any

import typer

from clampid.verbs.errors import CallError
from clampid.verbs.inputs import read_checked, split_terms
from clampid.verbs.options import Campaigns, EffectsFrom, Json, ModelFile, Quiet, Seed, Verbose
from clampid.verbs.options import Output as OutputFile
from clampid.verbs.output import Output, output_file

__all__ = ["add"]


def add(
    effects: Annotated[
        str,
        typer.Argument(
            metavar="EFFECTS",
            help="What to add, as [STAGE=]EFFECT[@joint3][,…]: poses=backlash@joint3.",
            show_default=False,
        ),
    ],
    model: ModelFile,
    campaigns: Campaigns,
    output: OutputFile,
    accept_worse: Annotated[
        bool,
        typer.Option(
            "--accept-worse", help="Write the model even if the held-out error rises by more than its standard error."
        ),
    ] = False,
    seed: Seed = 0,
    effects_from: EffectsFrom = None,
    json: Json = None,
    verbose: Verbose = False,
    quiet: Quiet = False,
) -> None:
    """Add effects, fit again, and say what the error was and is, on held-out rows."""
    out = Output(quiet, json, verbose)
    output_file(output, "a model")
    terms = split_terms(effects)

    from clampid.loop.add import add as add_effects
    from clampid.models.model import load_model, save_model
    from clampid.screen import Next
    from clampid.verbs.findings import show_addition
    from clampid.verbs.screens import addition_screen, typed

    loaded = load_model(model)
    with out.working("reading"):
        read = read_checked(campaigns, out)
    with out.working("fitting again"):
        mended, addition = add_effects(loaded, read, terms, seed=seed, user_effects=effects_from)
    data = addition.to_json()
    if addition.worse and not accept_worse:
        raise CallError(_risen(data, addition.worse))
    save_model(mended, output)
    show_addition(data, out)
    again = typed("diagnose", output, *campaigns, effects_from=effects_from)
    out.show(addition_screen(data, f"Fitted {output}.", [Next("Next, diagnose again:", again)]))
    out.result(data)


def _risen(data: Mapping[str, Any], stages: Sequence[str]) -> str:
    """Error message: the error has risen, by stage, and the option that accepts it."""
    from clampid.display import change_text, error_text

    said = []
    for stage in stages:
        part = data["stages"][stage]
        before, after = (error_text(part[f"heldout_rms_{when}"], part["unit"]) for when in ("before", "after"))
        std = part["heldout_rise_std"]
        rise = change_text(part["heldout_rise"], 0.0 if std is None else std, part["unit"])
        said.append(f"{stage}: the held-out error would rise from {before} to {after} ({rise})")
    return f"{'; '.join(said)}; nothing is written. To go on all the same: --accept-worse"
