"""Results of earlier stages as a Gaussian prior of a later stage: values with their covariance.

The pose stage takes gravity and arm-side friction from the torque stage, and springs and clearances from clamped
sweeps. These are fits of other rows than the poses. The product of prior and likelihood is therefore the posterior of
all rows together, exactly if the fits are linear. Source: Bar-Shalom, Li, Kirubarajan, Estimation with Applications to
Tracking and Navigation, 2001, section 3.4 (recursive least squares).

A covariance accounts for noise only. If the clamp yielded, springs are too soft by many standard errors, and as a prior
they would bias the pose fit. So springs are taken over only if the poses alone do not contradict them
(`clampid.models.agreement`, 5 % over all joints). A contradiction at one joint means that the model of the sweeps is
wrong; then nothing is taken over from them.
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
from clampid.stages.rows import Array, Rows
from clampid.stages.stage_kind import acts_with, known_of
from kinematics.description import RobotDescription

__all__ = [
    "Drives",
    "carried_drives",
    "carried_over",
    "is_load",
    "is_start",
    "log_friction",
    "prior_from",
    "with_log_friction",
]


def is_load(slot: Slot, effects: Mapping[str, Effect] | None = None) -> bool:
    """Whether the pose stage takes a slot over from the torque stage, with its covariance: it acts on joint torques.

    ``effects``: name → effect; None: the catalogue.
    """
    effect = (catalogue() if effects is None else effects).get(slot.effect)
    return effect is not None and "joint_torque" in effect.acts and acts_with(effect, "moving", "points")


def is_start(slot: Slot, effects: Mapping[str, Effect] | None = None) -> bool:
    """Whether a later stage takes a slot's value as an initial value; ``effects`` as in :func:`is_load`."""
    return is_load(slot, effects) or has_role(slot, "compliance", "clearance", effects=effects)


@dataclass(frozen=True)
class Drives:
    """What the pose stage takes over from the clamped stage.

    Attributes
    ----------
    prior
        Springs and clearances with their covariance; None if the poses contradict them or identify none of them.
    contradicted
        The parameters that the poses contradict.
    """

    prior: Prior | None
    contradicted: tuple[Agreement, ...]


def carried_over(
    rows: Rows, stages: Mapping[Stage, StageModel], effects: Mapping[str, Effect] | None = None
) -> tuple[tuple[Prior, ...], dict[Slot, float]]:
    """Priors and initial values of a stage from the stages fitted before it.

    Masses have a prior from the description; the pose stage has one from the torque stage instead. Springs are only
    initial values here. :func:`carried_drives` decides whether they become a prior, after a first fit of the poses.

    Parameters
    ----------
    rows
        The rows of the stage.
    stages
        The stages fitted before.
    effects
        Name → effect; None: the catalogue.

    Returns
    -------
    priors, start
        The priors, and slot → initial value, SI.
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


def log_friction(stages: Mapping[Stage, StageModel], robot: RobotDescription, effects: Mapping[str, Effect]) -> Array:
    """Dry friction of each joint that moves alone, of motors and arm side together ``(n,)``, Nm, by the torque stage.

    It bounds the arm side's part, which poses show, and which a log distinguishes only in a coupled wrist. Its square
    includes that of its standard error. Infinite where a motor that turns with the joint has no identified friction,
    and where the log has a friction of the arm side itself.

    Power of the motors: ``F_joint |w_joint| = sum of F_motor |w_motor|``, with ``w_motor = T^-T w_joint``.
    """
    n, torque = robot.n, known_of(stages, "moving")
    value, std, itself = np.full(n, np.nan), np.zeros(n), np.zeros(n, dtype=bool)
    for slot, v, s, known in (
        () if torque is None else zip(torque.slots, torque.theta, torque.std, torque.identified, strict=True)
    ):
        if has_role(slot, "arm_friction", effects=effects):
            itself[slot.number] = True
        elif known and v > 0.0 and has_role(slot, "dry_friction", effects=effects):
            motor = slot.number
            value[motor], std[motor] = v, s
    turns = np.abs(np.linalg.inv(np.asarray(robot.transmission, dtype=float)))  # (joint, motor)
    unknown = np.any((turns > 0.0) & np.isnan(value), axis=1) | itself
    total = np.hypot(turns @ np.nan_to_num(value), np.sqrt(turns**2 @ std**2))
    return np.where(unknown, np.inf, total)


def with_log_friction(rows: Rows, stages: Mapping[Stage, StageModel], effects: Mapping[str, Effect]) -> Rows:
    """Rows of poses with the friction that the log knows at joints with a larger load; other rows as they are.

    At a joint with less load (median over the rows) a clearance and the spring that friction winds up are one number.
    The clearance would look known if the friction were, through a spring that nothing identifies there. But a clearance
    that is not in the model may be tried with the flanks that this friction selects.
    """
    if not rows.kind.points or known_of(stages, "moving") is None:
        return rows
    most = log_friction(stages, rows.robot, effects)
    load = np.median(np.abs(rows.signals["gravity_torque"]), axis=0)
    bound = np.where(load > most, most, np.inf)
    return replace(rows, constants=replace(rows.pose, log_friction=bound, flank_friction=most))


def carried_drives(clamped: StageModel | None, poses: Estimate) -> Drives:
    """Springs and clearances of the clamped stage as a prior of the poses, unless the poses contradict them.

    Parameters
    ----------
    clamped
        The clamped stage; None if there is none.
    poses
        A fit that has only initial values from the clamped stage.
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
    # Parameters that the poses do not identify are left out: such a clearance would only add a guessed flank to the
    # predictions.
    identified = tuple(
        s
        for s in shared_drives(clamped.slots, poses.slots, poses.problem.effects)
        if alone.identified[poses.slots.index(s)]
    )
    return Drives(prior_from(clamped, identified) if identified else None, ())


def prior_from(stage: StageModel, slots: tuple[Slot, ...]) -> Prior:
    """The marginal distribution of some slots of a stage, as a prior; ``slots`` are among those of the stage."""
    index = np.array([stage.slots.index(s) for s in slots], dtype=int)
    return Prior(slots, stage.theta[index], stage.covariance[np.ix_(index, index)])
