"""``clampid history``: the ledger of a model."""

from __future__ import annotations

from clampid.verbs.options import EffectsFrom, Json, ModelFile, Quiet, Verbose
from clampid.verbs.output import Output

__all__ = ["history"]


def history(
    model: ModelFile,
    effects_from: EffectsFrom = None,
    json: Json = None,
    verbose: Verbose = False,
    quiet: Quiet = False,
) -> None:
    """Show each round's effects, evidence and error."""
    from clampid.catalogue import with_user_effects
    from clampid.models.model import load_model
    from clampid.verbs.screens import history_screen
    from clampid.verbs.show import show_rounds, stage_unit

    out = Output(quiet, json, verbose)
    ledger = load_model(model).ledger
    with_user_effects(effects_from)  # a ledger is read without; a file that is wrong is said all the same
    show_rounds(ledger, out)
    rounds = [
        {
            "stage": r.stage,
            "unit": stage_unit(r.stage),
            "effects": list(r.effects),
            "added": list(r.added),
            "rms": r.rms,
            "heldout_rms": r.heldout_rms,
            "noise_floor": r.noise_floor,
            "evidence": dict(r.evidence),
        }
        for r in ledger
    ]
    out.show(history_screen(rounds, model))
    out.result({"rounds": rounds})
