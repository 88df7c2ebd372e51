"""The effects that a model is opened with: the catalogue, and its own where their code may run."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from clampid.catalogue import catalogue, effects_for_model
from clampid.effect import Effect, EffectError
from clampid.models.checked import check_slot
from clampid.models.model import Model, ModelError

__all__ = ["effects_of"]


def effects_of(model: Model | None, user_effects: Path | None = None) -> Mapping[str, Effect]:
    """The catalogue with the user's own, those of the model among them.

    The code of a file that only the model names does not run unless the user trusts it; see :mod:`clampid.trusted`.

    Parameters
    ----------
    user_effects
        The file that the caller names; it goes before the model's.

    Raises
    ------
    ModelError
        An effect of the model is missing, or stands in a file that is not trusted.
    EffectError
        The file that the caller names does not run or holds no effect.
    """
    remembered = model.user_effects if model else None
    stages = list(model.stages.values()) if model else []
    needed = [name for stage in stages for name in (*(s.effect for s in stage.slots), *(t.effect for t in stage.terms))]
    try:
        effects = effects_for_model(remembered, needed, user_effects)
    except EffectError as error:
        if user_effects is not None:
            raise
        raise ModelError(str(error)) from None
    for stage in stages:
        for slot in stage.slots:
            if slot.effect not in catalogue() and model is not None:  # the others were looked at when it was read
                try:
                    check_slot(slot, effects, model.layout)
                except ValueError as error:
                    raise ModelError(str(error)) from None
    return effects
