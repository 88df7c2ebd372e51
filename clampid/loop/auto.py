"""The whole loop: identify a model, then diagnose and add until no further effect is confirmed."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from clampid.diagnosis.diagnose import Diagnosis, with_fits
from clampid.diagnosis.headline import headline
from clampid.diagnosis.result import Step
from clampid.effect import Stage
from clampid.identification.identify import identify
from clampid.loop.add import add_steps
from clampid.models.model import Model
from clampid.progress import substep
from clampid.slots import Term
from experiments.campaign import Campaign

__all__ = ["auto", "mend"]

Progress = Callable[[str], None]


def auto(
    campaigns: Sequence[Campaign] | Campaign,
    effects: Mapping[Stage, Sequence[str]] | Sequence[str] | None = None,
    *,
    seed: int = 0,
    user_effects: Path | None = None,
    progress: Progress = lambda _: None,
) -> tuple[Model, Diagnosis]:
    """Identify a model, then add the effects that a diagnosis confirms.

    Parameters
    ----------
    campaigns
        One campaign, or several that are fitted together.
    effects
        Effects of the start model, by stage or for all stages; the standard sets by default.
    seed, user_effects
        Of the diagnosis and of held-out folds; file or folder with effects of your own.
    progress
        Called with each line for the user.

    Returns
    -------
    model, diagnosis
        The model with the added effects and its ledger, and what the diagnosis found.
    """
    several = [campaigns] if isinstance(campaigns, Campaign) else list(campaigns)
    progress("identifying the start model")
    model = identify(several, effects, seed=seed, user_effects=user_effects)
    progress("diagnosing")
    return mend(model, several, seed=seed, user_effects=user_effects, progress=progress)


def mend(
    model: Model,
    campaigns: Sequence[Campaign] | Campaign,
    *,
    seed: int = 0,
    user_effects: Path | None = None,
    progress: Progress = lambda _: None,
) -> tuple[Model, Diagnosis]:
    """Add the effects that a diagnosis confirms to a model, each step as a round of its own in the ledger.

    The diagnosis itself adds, refits and searches again until nothing more is confirmed, so one pass is the whole loop.
    Effects that these data cannot separate are not added, unless all of them give the same predictions. For example, a
    torque offset and friction that differs by direction are one model under two names. If joints share one curve, it
    replaces the curves of the single joints, in a round after theirs. Parameters are those of :func:`auto`.

    Returns
    -------
    model, diagnosis
        The model with the added effects and its ledger, and what the diagnosis found.
    """
    with substep("diagnosing", 0.8):
        found = with_fits(model, campaigns, seed=seed, user_effects=user_effects)
    steps: dict[Stage, list[Step]] = {}
    for stage, part in found.stages.items():
        progress(f"{stage}: {headline({stage: part.to_json()})}")
        # Places that were confirmed together stay one step, because a single one may not justify its parameters. Steps
        # are not merged: an effect that is identifiable only through another (friction through springs) would be lost.
        steps[stage] = [*part.in_order, *(_one_curve(c) for c in found.simpler.get(stage, ()))]
        for step in part.alike:
            others = ", ".join(dict.fromkeys(c["effect"] for c in step.evidence["confusable_with"]))
            progress(f"{stage}: added {step.label}; on these rows {others} would give the same model")
    with substep("adding", 1.0):
        mended, left_out = add_steps(model, campaigns, steps, seed=seed, user_effects=user_effects)
    for part in found.stages.values():
        part.forget_fits()
    for stage, step in left_out:
        progress(f"{stage}: {step.label} is left out: with the effects already added it is not identifiable")
    return mended, found


def _one_curve(found: Mapping[str, Any]) -> Step:
    """The step from several curves to a shared one. Its evidence is its odds; it is not tested on held-out rows."""
    return Step((Term(found["name"]),), {key: found[key] for key in ("instead_of", "log_odds", "deviation")})
