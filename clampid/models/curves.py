"""Errors of joint angles as curves over the angle: values, standard errors, and where no pose was near.

On a curve that joints share, a pose of any of them counts for all: what one has not visited another may have.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from clampid.chain.chain import build_chain
from clampid.effect import Effect, Parameter
from clampid.models.model import StageModel
from clampid.slots import Layout, Slot, find_parameter, number_of
from clampid.stages import poses
from clampid.stages.rows import Array, Bools
from clampid.stages.stage_kind import kind_of
from kinematics.description import RobotDescription

__all__ = ["AngleErrors", "SharedCurve", "angle_errors", "shared_curve"]

KNOWN = 0.5  # of the variance that poses take away where they tell most: where they take less, none came near
TURN = np.linspace(-np.pi, np.pi, 720, endpoint=False)


@dataclass(frozen=True)
class AngleErrors:
    """Errors of joint angles that are periodic in the joint's own angle.

    Attributes
    ----------
    error
        ``(N, n)``, rad: arm less controller.
    std
        ``(N, n)``, rad: its standard error; zero where a joint has no such effect.
    assumed
        ``(N, n)``, rad: what was assumed of its size before any row was seen.
    least
        ``(n,)``, rad: its standard error at the best determined angle.
    active
        ``(n,)``: which joints have such an effect.
    """

    error: Array
    std: Array
    assumed: Array
    least: Array
    active: Bools

    @property
    def extrapolated(self) -> Bools:
        """Where ``(N, n)`` no pose of the fit came near: the error fades to zero there, and its band opens."""
        return self.active & _unvisited(self.std, self.assumed, self.least)


def angle_errors(
    stage: StageModel, effects: Mapping[str, Effect], layout: Layout, robot: RobotDescription, q: Array
) -> AngleErrors:
    """Errors of the joints at angles ``q`` ``(N, n)``, rad, by a pose model's effects with the role angle_error.

    Parameters
    ----------
    stage
        The model's stage ``poses``.

    Raises
    ------
    clampid.effect.EffectError
        The model has an effect that is not known here.
    """
    wanted = {name for name, e in effects.items() if "angle_error" in e.roles and set(e.needs) == {"q"}}
    chosen = [k for k, slot in enumerate(stage.slots) if slot.effect in wanted]
    slots = tuple(stage.slots[k] for k in chosen)
    count, q = len(q), np.vstack([q, np.tile(TURN[:, None], (1, q.shape[1]))])
    error, std, assumed = np.zeros((3, *q.shape))
    active = np.zeros(q.shape[1], dtype=bool)
    if not slots:
        return AngleErrors(error[:count], std[:count], assumed[:count], std[0], active)
    chain = build_chain(kind_of("poses"), slots, effects, layout, poses.constants_of(robot))
    found = chain.evaluate(stage.theta[chosen], {"q": q})
    covariance = stage.covariance[np.ix_(chosen, chosen)]
    prior = np.array([_assumed(find_parameter(slot, effects)) for slot in slots])
    first = chain.offsets["joint_angle"].start
    error[:] = found.values[:, chain.offsets["joint_angle"]]
    for j in range(q.shape[1]):
        own = np.flatnonzero(found.station == first + j)
        index, slope = found.parameter[own], found.partials[:, own]
        std[:, j] = np.sqrt(np.maximum(np.sum((slope @ covariance[np.ix_(index, index)]) * slope, axis=1), 0.0))
        assumed[:, j] = np.sqrt(np.sum((slope * prior[index]) ** 2, axis=1))
        active[j] = len(own) > 0
    return AngleErrors(error[:count], std[:count], assumed[:count], std[count:].min(axis=0), active)


def _unvisited(std: Array, assumed: Array, least: Array | float) -> Bools:
    """Where the rows took less away of what was assumed than :data:`KNOWN` of what they did where they tell most."""
    return np.asarray(assumed**2 - std**2 < KNOWN * (assumed**2 - np.square(least)))


def _assumed(parameter: Parameter) -> float:
    """What is assumed of an amplitude; phases and the like are no part of an error's size."""
    return 0.0 if parameter.shape else parameter.prior_std


@dataclass(frozen=True)
class SharedCurve:
    """The one curve that several joints' angle errors follow.

    Attributes
    ----------
    joints
        From 0; phases count from the first.
    sense, phase, phase_std
        ``(j,)``: a joint's error is ``sense g(sense q - phase)`` and what it has of its own; rad.
    angle, error, std, assumed
        ``(M,)``, rad: where on the curve, g there, its standard error, and what was assumed of its size.
    least
        rad: the standard error at the best determined angle.
    deviation
        rad, rms over a turn: by how much the joints differ from the curve, beside once and twice per turn.
    """

    joints: tuple[int, ...]
    sense: Array
    phase: Array
    phase_std: Array
    angle: Array
    error: Array
    std: Array
    assumed: Array
    least: float
    deviation: float

    @property
    def extrapolated(self) -> Bools:
        """Where ``(M,)`` no pose of any of the joints came near."""
        return _unvisited(self.std, self.assumed, self.least)

    def on_curve(self, q: Array) -> Array:
        """Where joint angles ``(N, n)`` stand on the curve ``(N, j)``, rad, from 0 to 2 pi."""
        return np.mod(self.sense * q[:, list(self.joints)] - self.phase, 2 * np.pi)


def shared_curve(stage: StageModel, effects: Mapping[str, Effect], angle: Array) -> SharedCurve | None:
    """The curve that a pose model's joints share, at angles ``(M,)``, rad; None where none do."""
    name = next((s.effect for s in stage.slots if effects[s.effect].aligns is not None), None)
    if name is None:
        return None
    effect, values = effects[name], stage.values()
    std = dict(zip(stage.slots, stage.std.tolist(), strict=True))
    places = [s.place for s in stage.slots if s.effect == name and s.parameter == "sense"]
    phases = [Slot(name, "phase", p) for p in places]
    index = [k for k, s in enumerate(stage.slots) if s.effect == name and _coefficient(effect, s)]
    order = np.array([int(stage.slots[k].parameter[1:]) for k in index])
    sine = np.array([stage.slots[k].parameter.startswith("a") for k in index])
    count, turn = len(angle), np.r_[angle, TURN][:, None]
    slope = np.where(sine, np.sin(turn * order), np.cos(turn * order))
    prior = np.array([find_parameter(stage.slots[k], effects).prior_std for k in index])
    covariance = stage.covariance[np.ix_(index, index)]
    spread = np.sqrt(np.maximum(np.sum((slope @ covariance) * slope, axis=1), 0.0))
    return SharedCurve(
        joints=tuple(number_of(p) for p in places),
        sense=np.array([values[Slot(name, "sense", p)] for p in places]),
        phase=np.array([values[s] for s in phases]),
        phase_std=np.array([std[s] for s in phases]),
        angle=angle,
        error=slope[:count] @ stage.theta[index],
        std=spread[:count],
        assumed=np.sqrt(np.sum((slope[:count] * prior) ** 2, axis=1)),
        least=float(spread[count:].min()),
        deviation=values[Slot(name, "deviation", effect.at)],
    )


def _coefficient(effect: Effect, slot: Slot) -> bool:
    """Whether a slot is an amplitude of the shared curve."""
    parameter = effect.by_name[slot.parameter]
    return parameter.per == "robot" and not parameter.shape
