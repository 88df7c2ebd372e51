"""``clampid auto``: identify, then diagnose and add until nothing more is confirmed."""

from __future__ import annotations

from clampid.verbs.inputs import read_checked, split_effects
from clampid.verbs.options import Campaigns, Effects, EffectsFrom, Json, Quiet, Seed
from clampid.verbs.options import Output as OutputFile
from clampid.verbs.output import Output, output_file

__all__ = ["auto"]


def auto(
    campaigns: Campaigns,
    output: OutputFile,
    effects: Effects = None,
    seed: Seed = 0,
    effects_from: EffectsFrom = None,
    json: Json = None,
    quiet: Quiet = False,
) -> None:
    """Identify, then diagnose and add until nothing more is confirmed."""
    out = Output(quiet, json)
    output_file(output)
    chosen = split_effects(effects)

    from clampid.auto import auto as find_all
    from clampid.catalogue import with_user_effects
    from clampid.model import save_model
    from clampid.verbs.findings import show_diagnosis
    from clampid.verbs.show import model_json, show_model

    with out.working("reading"):
        read = read_checked(campaigns, out)
    with out.working("identifying, diagnosing, adding"):
        model, diagnosis = find_all(read, chosen, seed=seed, user_effects=effects_from, progress=out.step)
    save_model(model, output)
    found = diagnosis.to_json()
    show_model(model, with_user_effects(effects_from), out)
    show_diagnosis(found, out)
    out.say(f"model: {output}")
    out.result({"model": str(output), **model_json(model), "diagnosis": found})
