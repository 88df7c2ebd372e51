"""``clampid diagnose``: where a model fails, and which effect is missing."""

from __future__ import annotations

from typing import Annotated

import typer

from clampid.verbs.inputs import read_checked
from clampid.verbs.options import EffectsFrom, Json, ModelFile, OneCampaign, Quiet, Seed
from clampid.verbs.output import Output

__all__ = ["diagnose"]


def diagnose(
    model: ModelFile,
    campaign: OneCampaign,
    flips: Annotated[int, typer.Option(min=19, help="Sign flips that decide; p is at least 1/(flips + 1).")] = 199,
    seed: Seed = 0,
    effects_from: EffectsFrom = None,
    json: Json = None,
    quiet: Quiet = False,
) -> None:
    """Say where a model fails, and which effect is missing."""
    out = Output(quiet, json)

    from clampid.diagnose import diagnose as look_for_missing
    from clampid.model import load_model
    from clampid.verbs.findings import show_diagnosis

    loaded = load_model(model)
    with out.working("reading"):
        (read,) = read_checked([campaign], out)
    with out.working("diagnosing"):
        data = look_for_missing(loaded, read, seed=seed, flips=flips, user_effects=effects_from).to_json()
    show_diagnosis(data, out)
    out.result(data)
