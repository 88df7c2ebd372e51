"""Deflection of the arm at each measured point, so that the base is found as if the arm were stiff.

Springs, clearances and loads are those of a model, whose errors are counted, or those of the robot's description, taken
as exact.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass

import numpy as np

from clampid.effect import Effect
from clampid.identification.carried import is_load, is_start
from clampid.models.model import Model, ModelError
from clampid.role_slots import any_of_role, has_role, slot_of
from clampid.roles import FRAMES
from clampid.slots import Slot
from clampid.stages.fit_problem import fit_problem
from clampid.stages.rows import Array, Rows
from clampid.stages.stage_kind import known_of
from kinematics.description import RobotDescription

__all__ = ["Yielding", "gives_way", "what_yields"]


@dataclass(frozen=True)
class Yielding:
    """What is put back: slots of the pose stage with values ``(P,)`` and covariance ``(P, P)``, and where from."""

    slots: tuple[Slot, ...]
    theta: Array
    covariance: Array
    said: str


def what_yields(
    robot: RobotDescription, model: Model | None, *, rigid: bool = False, tips: Collection[str] | None = None
) -> Yielding:
    """Slots that the arm differs by from a stiff one.

    Parameters
    ----------
    tips
        If given, from the nominal one: what the model's stage ``poses`` says of links, joints and expansion counts,
        too, and where it has targets of these names; not where its base and flange are, nor what belongs to its
        instrument or sessions.

    Raises
    ------
    ModelError
        Nothing is known of springs or weights.
    """
    return _rigid() if rigid else _of_description(robot) if model is None else _of_model(model, tips)


def _rigid() -> Yielding:
    return Yielding(
        (), np.zeros(0), np.zeros((0, 0)), "none; nothing was put back, and the frame is biased by deflection"
    )


def _of_description(robot: RobotDescription) -> Yielding:
    if robot.motor_spring is None or not robot.has_masses:
        raise ModelError(
            f"the description of {robot.name} has no springs or no masses, so that points cannot be corrected for "
            "deflection: give a model with joint_compliance, or have nothing put back (--rigid)"
        )
    slots = tuple(slot_of("compliance", f"joint{i + 1}") for i in range(robot.n))
    theta = 1.0 / np.asarray(robot.motor_spring)
    return Yielding(slots, theta, np.zeros((robot.n, robot.n)), "those of the description, taken as exact")


def _of_model(model: Model, tips: Collection[str] | None) -> Yielding:
    """All but geometry of the pose stage, if that has springs; else what the pose stage would start from."""
    poses = known_of(model.stages, "points")
    if poses is not None and any_of_role(poses.slots, "compliance"):
        kept = [not has_role(s, *FRAMES) if tips is None else _of_arm(s, tips) for s in poses.slots]
        parts = [(poses, [k for k, keep in enumerate(kept) if keep])]
        said = "those of the model's stage poses"
    else:
        clamped, free = known_of(model.stages, "solved"), known_of(model.stages, "moving")
        if clamped is None or not any_of_role(clamped.slots, "compliance"):
            raise ModelError("expected a model with joint_compliance in its stage poses or clamped, found none")
        own = [k for k, s in enumerate(clamped.slots) if is_start(s) and (free is None or not is_load(s))]
        parts = [(clamped, own)]
        if free is not None:
            parts.append((free, [k for k, s in enumerate(free.slots) if is_load(s)]))
        said = "those of the model's stage clamped"
    slots = tuple(stage.slots[k] for stage, chosen in parts for k in chosen)
    theta = np.concatenate([stage.theta[chosen] for stage, chosen in parts])
    covariance, at = np.zeros((len(theta), len(theta))), 0
    for stage, chosen in parts:
        end = at + len(chosen)
        covariance[at:end, at:end] = stage.covariance[np.ix_(chosen, chosen)]
        at = end
    return Yielding(slots, theta, covariance, said)


def _of_arm(slot: Slot, tips: Collection[str]) -> bool:
    """Whether a parameter belongs to the arm or to one of its tips, wherever it stands and whatever measures it."""
    frame = has_role(slot, "base_frame", "flange_frame", "target_point") and slot.place not in tips
    return not frame and not slot.place.startswith("session") and slot.place != "instrument"


def gives_way(rows: Rows, effects: Mapping[str, Effect], yielding: Yielding) -> tuple[Array, Array]:
    """How far the points give way ``(N, 3)`` m, instrument frame, and its derivative ``(N, 3, P)``."""
    trial = fit_problem(rows, effects, yielding.slots).with_flanks(yielding.theta)
    bent, by = trial.residual(yielding.theta)
    straight, _ = fit_problem(rows, effects, ()).residual(np.zeros(0))
    return straight[:, :3] - bent[:, :3], by[:, :3]
