"""``clampid add``: adds effects to a model and fits again."""

from __future__ import annotations

from typing import Annotated

import typer

from clampid.verbs.inputs import read_checked, split_terms
from clampid.verbs.options import Campaigns, EffectsFrom, Json, ModelFile, Quiet, Seed, Verbose
from clampid.verbs.options import Output as OutputFile
from clampid.verbs.output import Output, output_file

__all__ = ["add"]


def add(
    effects: Annotated[
        str,
        typer.Argument(
            metavar="[STAGE=]EFFECT[@joint3][,…]", help="Effects to add, with their places.", show_default=False
        ),
    ],
    model: ModelFile,
    campaigns: Campaigns,
    output: OutputFile,
    seed: Seed = 0,
    effects_from: EffectsFrom = None,
    json: Json = None,
    verbose: Verbose = False,
    quiet: Quiet = False,
) -> None:
    """Add effects, fit again, and say what the error was and is, on held-out rows."""
    out = Output(quiet, json, verbose)
    output_file(output, "json")
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
    save_model(mended, output)
    show_addition(data, out)
    again = typed("diagnose", output, *campaigns, effects_from=effects_from)
    out.show(addition_screen(data, f"Fitted {output}.", [Next("Next, diagnose again:", again)]))
    out.result(data)
