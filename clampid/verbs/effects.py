"""``clampid effects``: every effect known."""

from __future__ import annotations

import inspect
import sys
from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated, Any

import typer

from clampid.verbs.errors import CallError
from clampid.verbs.options import EffectsFrom, Json, Quiet, Verbose
from clampid.verbs.output import Output

if TYPE_CHECKING:
    from clampid.effect import Effect
    from clampid.screen import Screen

__all__ = ["effects", "in_words"]


def effects(
    name: Annotated[
        str | None, typer.Argument(metavar="[EFFECT]", help="One effect, in full.", show_default="all of them")
    ] = None,
    effects_from: EffectsFrom = None,
    json: Json = None,
    verbose: Verbose = False,
    quiet: Quiet = False,
) -> None:
    """Say in words what each effect is; of one, its parameters, its equation and its source, too."""
    from clampid.catalogue import with_user_effects
    from clampid.slots import no_such_effect

    out = Output(quiet, json, verbose)
    found = with_user_effects(effects_from)
    if name is not None and name not in found:
        raise CallError(no_such_effect(name, found))
    known = sorted(found.values(), key=lambda effect: effect.name)
    if name is not None:
        known = [found[name]]
    out.result([_json(effect) for effect in known])
    if name is not None:
        out.show(_one(found[name]))
        return
    for effect in known:
        parameters = [f"{p.name} [{p.unit or '1'}]" for p in effect.parameters]
        units = ", ".join(sorted({p.unit or "1" for p in effect.parameters}))
        named = ", ".join(parameters) if len(parameters) <= 6 else f"{len(parameters)} parameters [{units}]"
        label = effect.name if effect.name == effect.family else f"{effect.name} ({effect.family})"
        out.say(f"{label}, in {', '.join(effect.stages)}: {in_words(effect)}")
        out.say(f"    {effect.equation}; {named}")
    out.show(_all(found))


def in_words(effect: Effect) -> str:
    """What an effect is, in a sentence: the first one of the module that defines it; else its equation."""
    home = next(iter(effect.acts.values()), None)
    module = sys.modules.get(f"clampid.effects.{effect.name}") or (inspect.getmodule(home) if home else None)
    text = inspect.getdoc(module) if module is not None else None
    return " ".join(text.split("\n\n")[0].split()) if text else effect.equation


def _all(found: Mapping[str, Effect]) -> Screen:
    """The effects by where they act, and how to learn more."""
    from clampid.screen import Next, Screen
    from clampid.stages.stage_kind import kinds

    facts, said = [], set[str]()
    for kind in sorted(kinds(), key=lambda kind: not kind.points):
        acting = {e.family for e in found.values() if kind.has(e)}
        names = ", ".join(name.replace("_", " ") for name in sorted(acting - said))
        if not names:
            names = f"{len(acting)} of the families above"
        elif said:
            names = f"also {names}"
        facts.append((kind.name, f"{kind.words.rows}: {names}"))
        said |= acting
    return Screen(
        f"{len(found)} effects of {len({e.family for e in found.values()})} families, by the stage in which they act:",
        facts=tuple(facts),
        more="Each effect in a sentence, with its equation: --verbose, --json FILE.",
        next=(Next("Next, read what one of them is:", "clampid effects gear_eccentricity"),),
    )


def _one(effect: Effect) -> Screen:
    from clampid.screen import Next, Screen
    from clampid.stages.stage_kind import kind_of, stages_with
    from kinematics.sources import load_sources

    titles = load_sources()
    facts = [
        ("family", effect.family),
        ("acts in", ", ".join(f"{stage} ({kind_of(stage).words.rows})" for stage in stages_with(effect))),
        ("equation", effect.equation),
    ]
    many = len(effect.parameters) > 8
    for p in effect.parameters[:2] if many else effect.parameters:
        facts.append((p.name, " ".join(filter(None, (f"[{p.unit or '1'}] for each {p.per}:", p.meaning)))))
    if many:
        facts.append(("…", f"{len(effect.parameters)} parameters in all"))
    facts += [("needs", ", ".join(effect.needs)), ("source", "; ".join(titles.get(key, key) for key in effect.source))]
    return Screen(
        f"{effect.name}: {in_words(effect)}",
        facts=tuple(facts),
        next=(Next("Next, list all effects:", "clampid effects"),),
    )


def _json(effect: Effect) -> dict[str, Any]:
    return {
        "name": effect.name,
        "family": effect.family,
        "words": in_words(effect),
        "parameters": [
            {"name": p.name, "unit": p.unit, "per": p.per, "size": p.size, "gearing": p.gearing, "meaning": p.meaning}
            for p in effect.parameters
        ],
        "needs": list(effect.needs),
        "stages": list(effect.stages),
        "equation": effect.equation,
        "source": list(effect.source),
    }
