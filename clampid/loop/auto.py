"""The whole loop: identify, then diagnose and add until nothing more is confirmed."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from clampid.diagnosis.diagnose import Diagnosis, diagnose
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
    """Identify a model, then add what diagnosis confirms.

    Returns
    -------
    model, diagnosis
        The mended model with its ledger, and what was found.
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
    """Add what diagnosis confirms to a model of these campaigns, each step as a round of its own in the ledger.

    Diagnosis itself adds, refits and looks again until nothing more is confirmed, so that one pass is the whole loop.
    What these data cannot separate is not added, but where it makes no difference which of them it is: an offset of a
    motor's torque and a friction that differs by direction are one model under two names. Where joints have one and the
    same curve, that takes the place of one for each, in a round after those of the curves.

    Returns
    -------
    model, diagnosis
        The mended model with its ledger, and what was found.
    """
    with substep("diagnosing", 0.8):
        found = diagnose(model, campaigns, seed=seed, user_effects=user_effects)
    steps: dict[Stage, list[Step]] = {}
    for stage, part in found.stages.items():
        progress(f"{stage}: {headline({stage: part.to_json()})}")
        # Places that were tried and confirmed together stay one step: each alone need not pay for its numbers. Steps
        # are not put together: what shows only through another (friction through springs) would be lost.
        steps[stage] = [*part.in_order, *(_one_curve(c) for c in found.simpler.get(stage, ()))]
        for step in part.alike:
            others = ", ".join(dict.fromkeys(c["effect"] for c in step.evidence["confusable_with"]))
            progress(f"{stage}: added {step.label}; on these rows {others} would give the same model")
    with substep("adding", 1.0):
        mended, left_out = add_steps(model, campaigns, steps, seed=seed, user_effects=user_effects)
    for stage, step in left_out:
        progress(f"{stage}: {step.label} is left out: with the effects already added it is not identifiable")
    return mended, found


def _one_curve(found: Mapping[str, Any]) -> Step:
    """The step to one curve instead of several; it is not tried on held-out rows, and its evidence are its odds."""
    return Step((Term(found["name"]),), {key: found[key] for key in ("instead_of", "log_odds", "deviation")})
