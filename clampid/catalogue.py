"""The catalogue: every effect that stands in ``clampid/effects``, and those that a user hands in.

A user's file is code. It runs where the caller names it; a file that a model names runs only if the user trusts it
(:mod:`clampid.trusted`), or if this process has run the same code before because the caller named it.
"""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Iterable, Mapping
from functools import cache
from pathlib import Path
from types import MappingProxyType, ModuleType

import clampid.effects
from clampid.effect import Effect, EffectError
from clampid.own_effect import check_own_effect
from clampid.trusted import hash_of, is_trusted, source_of

__all__ = ["catalogue", "effects_for_model", "with_user_effects"]

_named: set[str] = set()  # hashes of the sources that callers of this process have named


@cache
def catalogue() -> Mapping[str, Effect]:
    """Every effect known, by name: those in the folder, and of those that happen once the same a second time."""
    found: dict[str, Effect] = {}
    for module in pkgutil.iter_modules(clampid.effects.__path__):
        effect = _effect_of(importlib.import_module(f"clampid.effects.{module.name}"))
        found |= {e.name: e for e in ((effect,) if effect.event is None else (effect, effect.again))}
    for effect in found.values():
        _check_family(effect, found)
    return MappingProxyType(found)


def with_user_effects(path: Path | None) -> Mapping[str, Effect]:
    """The catalogue and the effects of a user's own file (``EFFECT``, or several in ``EFFECTS``).

    Raises
    ------
    EffectError
        The file does not exist, does not run, holds no effect, one with a name of the catalogue, or one that a fit
        could not use (:mod:`clampid.own_effect`).
    """
    if path is None:
        return catalogue()
    source = source_of(path)
    _named.add(hash_of(source))
    return _run(source, path)


def effects_for_model(remembered: str | None, needed: Iterable[str], given: Path | None = None) -> Mapping[str, Effect]:
    """The effects that a model is opened with; the code of the file that it remembers runs only if it is trusted.

    Parameters
    ----------
    remembered
        The file that the model names.
    needed
        Names of the effects that the model has.
    given
        The file that the caller names.

    Raises
    ------
    EffectError
        The file that the model names is not trusted or does not exist, or an effect of the model is not known; the
        message names the effects and says what to do.
    """
    own = [name for name in dict.fromkeys(needed) if name not in catalogue()]
    if given is not None or remembered is None:
        effects = with_user_effects(given)
    else:
        path, whose = Path(remembered), f"the model has {_listed(own)} of its own" if own else "the model has a file"
        try:
            source = source_of(path)
        except EffectError as error:
            raise EffectError(f"{whose}: {error}") from None
        if hash_of(source) not in _named and not is_trusted(source):
            raise EffectError(
                f"{whose}, which is code: {path}. It runs only if you say so: read it, then give it with "
                f"--effects-from {path}, or once and for all: clampid effect trust {path}"
            )
        effects = _run(source, path)
    missing = [name for name in own if name not in effects]
    if missing:
        raise EffectError(
            f"the model has {_listed(missing)} that is not known here; if it is your own, give its file with "
            "--effects-from FILE.py"
        )
    return effects


def _listed(names: list[str]) -> str:
    return f"{'an effect' if len(names) == 1 else 'effects'} {', '.join(map(repr, names))}"


def _run(source: bytes, path: Path) -> Mapping[str, Effect]:
    """Run what was read, and not what lies there by now or in a cache beside it."""
    module = ModuleType(f"user_effects_{path.stem}")
    module.__file__ = str(path)
    try:
        exec(compile(source, str(path), "exec"), module.__dict__)
    except (Exception, SystemExit) as error:  # a user's file may raise anything: name the file, keep the cause
        raise EffectError(f"{path}: {type(error).__name__}: {error}") from error
    several = getattr(module, "EFFECTS", None)
    try:
        own = tuple(several) if several is not None else (_effect_of(module),)
        for effect in own:
            if not isinstance(effect, Effect):
                raise EffectError(f"expected values of type Effect in EFFECTS, found {type(effect).__name__}")
            if effect.name in catalogue():
                raise EffectError(f"the catalogue has an effect {effect.name!r}; expected another name")
            _check_family(effect, {**catalogue(), effect.name: effect})
            check_own_effect(effect)
    except EffectError as error:
        raise EffectError(f"{path}: {error}".replace(f"{path}: {path}: ", f"{path}: ")) from None
    except Exception as error:  # its functions may raise anything
        raise EffectError(f"{path}: its effects cannot be used: {type(error).__name__}: {error}") from error
    return MappingProxyType({**catalogue(), **{effect.name: effect for effect in own}})


def _check_family(effect: Effect, known: Mapping[str, Effect]) -> None:
    """Refuse a family that no effect leads."""
    if effect.family not in known or known[effect.family].family != effect.family:
        families = sorted({e.family for e in known.values() if e.family == e.name})
        raise EffectError(
            f"effect {effect.name}: family {effect.family!r} does not exist; known: {', '.join(families)}"
        )


def _effect_of(module: ModuleType) -> Effect:
    effect = getattr(module, "EFFECT", None)
    if not isinstance(effect, Effect):
        raise EffectError(f"{module.__file__}: expected a value EFFECT of type Effect, found {type(effect).__name__}")
    return effect
