"""The whole loop: identify, then diagnose and add until nothing more is confirmed."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from clampid.add import add
from clampid.diagnose import Diagnosis, diagnose
from clampid.effect import Stage
from clampid.identify import identify
from clampid.model import Model
from experiments.campaign import Campaign

__all__ = ["auto"]


def auto(
    campaigns: Sequence[Campaign] | Campaign,
    effects: Mapping[Stage, Sequence[str]] | Sequence[str] | None = None,
    *,
    seed: int = 0,
    user_effects: Path | None = None,
    progress: Callable[[str], None] = lambda _: None,
) -> tuple[Model, Diagnosis]:
    """Identify a model, then add what diagnosis confirms.

    Diagnosis itself adds, refits and looks again until nothing more is confirmed, so that one pass is the whole loop.
    What these data cannot tell apart is not added. Where joints have one and the same curve, that takes the place of
    one for each.

    Returns
    -------
    model, diagnosis
        The mended model with its ledger, and what was found.
    """
    several = [campaigns] if isinstance(campaigns, Campaign) else list(campaigns)
    progress("identifying the start model")
    model = identify(several, effects, seed=seed, user_effects=user_effects)
    progress("diagnosing")
    found = diagnose(model, several, seed=seed, user_effects=user_effects)
    for stage, part in found.stages.items():
        progress(f"{stage}: {part.summary}")
        terms = [f"{stage}={term.label}" for term in part.added]
        terms += [f"{stage}={c['name']}" for c in found.simpler.get(stage, ())]
        if terms:
            model, _ = add(model, several, terms, seed=seed, user_effects=user_effects)
    return model, found
