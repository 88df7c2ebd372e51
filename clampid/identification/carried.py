"""Results of earlier stages as a Gaussian prior of a later stage: values with their covariance.

The pose stage takes gravity and arm-side friction from the torque stage, springs and clearances from clamped sweeps.
Both are fits of rows that the poses do not contain, so that product of prior and likelihood is the posterior of all of
them together, exactly where the fits are linear. Source: Bar-Shalom, Li, Kirubarajan, Estimation with Applications to
Tracking and Navigation, 2001, section 3.4 (recursive least squares).

A covariance speaks of noise only. Where the clamp yielded, springs come out too soft by many of their standard errors,
and as a prior they would spoil the poses. So springs are taken over only where the poses alone do not contradict them
(`clampid.models.agreement`, 5 % over all joints): a contradiction at one joint says that the sweeps are not understood,
and then nothing of them is taken over.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from clampid.catalogue import catalogue
from clampid.effect import Effect, Stage
from clampid.fitting.log_springs import springs
from clampid.fitting.priors import description_priors
from clampid.fitting.solve import Estimate
from clampid.models.agreement import Agreement, agreement_of, shared_drives
from clampid.models.model import StageModel
from clampid.role_slots import has_role
from clampid.slots import Prior, Slot
from clampid.stages.rows import Rows
from clampid.stages.stage_kind import acts_with, known_of

__all__ = ["Drives", "carried_drives", "carried_over", "is_load", "is_start", "prior_from"]


def is_load(slot: Slot, effects: Mapping[str, Effect] | None = None) -> bool:
    """Whether the pose stage takes a slot over from the torque stage with its covariance: loads and flanks."""
    effect = (catalogue() if effects is None else effects).get(slot.effect)
    return effect is not None and "joint_torque" in effect.acts and acts_with(effect, "moving", "points")


def is_start(slot: Slot, effects: Mapping[str, Effect] | None = None) -> bool:
    """Whether a later stage begins with a slot's value."""
    return is_load(slot, effects) or has_role(slot, "compliance", "clearance", effects=effects)


@dataclass(frozen=True)
class Drives:
    """What the pose stage makes of the clamped one.

    Attributes
    ----------
    prior
        Springs and clearances with their covariance; None where the poses contradict them.
    contradicted
        Where they do.
    """

    prior: Prior | None
    contradicted: tuple[Agreement, ...]


def carried_over(
    rows: Rows, stages: Mapping[Stage, StageModel], effects: Mapping[str, Effect] | None = None
) -> tuple[tuple[Prior, ...], dict[Slot, float]]:
    """What a stage knows before it sees its rows: priors with covariance, and start values.

    Gravity has the description's tolerances; the pose stage takes what the torque stage found instead. Springs are a
    start here; whether they are more, `carried_drives` says when the poses have been fitted once.
    """
    start: dict[Slot, float] = {}
    if not rows.kind.points:
        return description_priors(rows), start
    for stage in stages.values():
        start |= {slot: v for slot, v in stage.values().items() if is_start(slot, effects)}
    torque = known_of(stages, "moving")
    if torque is None:
        return description_priors(rows), start
    loads = tuple(s for s in torque.slots if is_load(s, effects))
    prior = prior_from(torque, loads)
    if torque.by_springs is not None:
        slope = torque.by_springs[[torque.slots.index(s) for s in loads]]
        prior = replace(prior, follows=springs(slope.shape[1]), slope=slope)
    return (prior,), start


def carried_drives(clamped: StageModel | None, poses: Estimate) -> Drives:
    """Springs and clearances of the clamped stage as a prior of the poses, unless these contradict them.

    Parameters
    ----------
    poses
        Fitted without anything from the clamped stage but start values.
    """
    if clamped is None or not shared_drives(clamped.slots, poses.slots, poses.problem.effects):
        return Drives(None, ())
    count = len(poses.slots)
    alone = StageModel(
        stage=poses.problem.stage,
        terms=(),
        slots=poses.slots,
        theta=poses.theta[:count],
        covariance=poses.covariance[:count, :count],
        identified=tuple(bool(b) for b in poses.identified[:count]),
    )
    found, _ = agreement_of(clamped, alone, poses.problem.effects)
    contradicted = tuple(a for a in found if a.verdict == "differs")
    if contradicted:
        return Drives(None, contradicted)
    # What no pose determines stays out: a clearance that does not show would only stand, on a guessed flank, in
    # predictions.
    identified = tuple(
        s
        for s in shared_drives(clamped.slots, poses.slots, poses.problem.effects)
        if alone.identified[poses.slots.index(s)]
    )
    return Drives(prior_from(clamped, identified) if identified else None, ())


def prior_from(stage: StageModel, slots: tuple[Slot, ...]) -> Prior:
    """Some slots of a stage with their covariance, all other parameters left free."""
    index = np.array([stage.slots.index(s) for s in slots], dtype=int)
    return Prior(slots, stage.theta[index], stage.covariance[np.ix_(index, index)])
