"""The catalogue: every effect that stands in ``clampid/effects``, and those that a user hands in."""

from __future__ import annotations

import importlib
import importlib.util
import pkgutil
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from types import MappingProxyType, ModuleType

import clampid.effects
from clampid.effect import Effect, EffectError

__all__ = ["catalogue", "with_user_effects"]


@cache
def catalogue() -> Mapping[str, Effect]:
    """Every effect known, by name: those in the folder, and of those that happen once the same a second time."""
    found: dict[str, Effect] = {}
    for module in pkgutil.iter_modules(clampid.effects.__path__):
        effect = _effect_of(importlib.import_module(f"clampid.effects.{module.name}"))
        found |= {e.name: e for e in ((effect,) if effect.event is None else (effect, effect.again))}
    return MappingProxyType(found)


def with_user_effects(path: Path | None) -> Mapping[str, Effect]:
    """The catalogue and the effects of a user's own file (``EFFECT``, or several in ``EFFECTS``).

    Raises
    ------
    EffectError
        The file does not exist, does not run, or holds no effect.
    """
    if path is None:
        return catalogue()
    spec = importlib.util.spec_from_file_location(f"user_effects_{path.stem}", path)
    if spec is None or spec.loader is None or not path.is_file():
        raise EffectError(
            f"{path}: expected a Python file that defines EFFECT, found none; say where it is by --effects-from"
        )
    module = importlib.util.module_from_spec(spec)
    try:
        spec.loader.exec_module(module)
    except Exception as error:  # a user's file may raise anything: name the file, keep the cause
        raise EffectError(f"{path}: {type(error).__name__}: {error}") from error
    several = getattr(module, "EFFECTS", None)
    own = tuple(several) if several is not None else (_effect_of(module),)
    return MappingProxyType({**catalogue(), **{effect.name: effect for effect in own}})


def _effect_of(module: ModuleType) -> Effect:
    effect = getattr(module, "EFFECT", None)
    if not isinstance(effect, Effect):
        raise EffectError(f"{module.__file__}: expected a value EFFECT of type Effect, found {type(effect).__name__}")
    return effect
