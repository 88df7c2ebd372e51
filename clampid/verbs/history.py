"""``clampid history``: the ledger of a model."""

from __future__ import annotations

from clampid.verbs.options import Json, ModelFile, Quiet
from clampid.verbs.output import Output

__all__ = ["history"]


def history(model: ModelFile, json: Json = None, quiet: Quiet = False) -> None:
    """Show each round's effects, evidence and error."""
    from clampid.model import load_model
    from clampid.verbs.show import show_rounds, stage_unit

    out = Output(quiet, json)
    ledger = load_model(model).ledger
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
    out.result({"rounds": rounds})
