"""``clampid undo``: takes back the last round of a model."""

from __future__ import annotations

from clampid.verbs.inputs import read_checked
from clampid.verbs.options import Campaigns, EffectsFrom, Json, ModelFile, Quiet, Verbose
from clampid.verbs.options import Output as OutputFile
from clampid.verbs.output import Output, output_file

__all__ = ["undo"]


def undo(
    model: ModelFile,
    campaigns: Campaigns,
    output: OutputFile,
    effects_from: EffectsFrom = None,
    json: Json = None,
    verbose: Verbose = False,
    quiet: Quiet = False,
) -> None:
    """Take back the last round: fit again without what it added."""
    out = Output(quiet, json, verbose)
    output_file(output, "a model")

    from clampid.loop.undo import undo as step_back
    from clampid.models.model import load_model, save_model
    from clampid.verbs.screens import undo_screen
    from clampid.verbs.show import show_rounds

    loaded = load_model(model)
    with out.working("reading"):
        read = read_checked(campaigns, out)
    with out.working("fitting again"):
        before, gone = step_back(loaded, read, user_effects=effects_from)
    save_model(before, output)
    show_rounds(before.ledger, out)
    out.show(undo_screen(before, gone, output, campaigns, effects_from))
    out.result({"model": str(output), "stage": gone.stage, "removed": list(gone.added)})
