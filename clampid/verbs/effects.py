"""``clampid effects``: every effect known."""

from __future__ import annotations

from typing import Any

from clampid.verbs.options import EffectsFrom, Json, Quiet
from clampid.verbs.output import Output

__all__ = ["effects"]


def effects(effects_from: EffectsFrom = None, json: Json = None, quiet: Quiet = False) -> None:
    """List every effect known: family, parameters with units, what it needs, its equation, its source."""
    from clampid.catalogue import with_user_effects

    out = Output(quiet, json)
    known = sorted(with_user_effects(effects_from).values(), key=lambda effect: effect.name)
    out.result([_json(effect) for effect in known])
    rows = []
    for effect in known:
        parameters = [f"{p.name} [{p.unit or '1'}]" for p in effect.parameters]
        units = ", ".join(sorted({p.unit or "1" for p in effect.parameters}))
        named = ", ".join(parameters) if len(parameters) <= 6 else f"{len(parameters)} parameters [{units}]"
        name = effect.name if effect.name == effect.family else f"{effect.name} ({effect.family})"
        rows.append((name, ", ".join(effect.stages), named, effect.equation, ", ".join(effect.source)))
    out.table("", ("effect", "acts in", "parameters", "equation", "source"), rows, left=5)
    out.say("what each one needs, and every parameter, is in the JSON: clampid effects --json -")


def _json(effect: Any) -> dict[str, Any]:
    return {
        "name": effect.name,
        "family": effect.family,
        "parameters": [
            {"name": p.name, "unit": p.unit, "per": p.per, "size": p.size, "gearing": p.gearing, "meaning": p.meaning}
            for p in effect.parameters
        ],
        "needs": list(effect.needs),
        "stages": list(effect.stages),
        "equation": effect.equation,
        "source": list(effect.source),
    }
