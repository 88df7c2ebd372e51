"""Errors of joint angles as curves over the angle: what a model says, how sure it is, and where no pose ever was."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from clampid.chain import build_chain
from clampid.effect import Effect
from clampid.model import StageModel
from clampid.slots import Layout, find_parameter
from clampid.stages import poses
from clampid.stages.rows import Array, Bools
from kinematics.description import RobotDescription

__all__ = ["FAMILY", "AngleErrors", "angle_errors"]

FAMILY = "gear_eccentricity"
KNOWN = 0.5  # of what was assumed before any row: an error known less well is extrapolated


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
    active
        ``(n,)``: which joints have such an effect.
    """

    error: Array
    std: Array
    assumed: Array
    active: Bools

    @property
    def extrapolated(self) -> Bools:
        """Where ``(N, n)`` no pose of the fit came near: the error fades to zero there, and its band opens."""
        return self.active & (self.std > KNOWN * self.assumed)


def angle_errors(
    stage: StageModel, effects: Mapping[str, Effect], layout: Layout, robot: RobotDescription, q: Array
) -> AngleErrors:
    """Errors of the joints at angles ``q`` ``(N, n)``, rad, by a pose model's effects of the family of :data:`FAMILY`.

    Parameters
    ----------
    stage
        The model's stage ``poses``.

    Raises
    ------
    clampid.effect.EffectError
        The model has an effect that is not known here.
    """
    wanted = {name for name, e in effects.items() if e.family == FAMILY and set(e.needs) == {"q"}}
    chosen = [k for k, slot in enumerate(stage.slots) if slot.effect in wanted]
    slots = tuple(stage.slots[k] for k in chosen)
    error, std, assumed = np.zeros((3, *q.shape))
    active = np.zeros(q.shape[1], dtype=bool)
    if not slots:
        return AngleErrors(error, std, assumed, active)
    transmission = np.asarray(robot.transmission)
    chain = build_chain("poses", slots, effects, layout, transmission, poses.link_vectors(robot))
    found = chain.evaluate(stage.theta[chosen], {"q": q})
    covariance = stage.covariance[np.ix_(chosen, chosen)]
    prior = np.array([find_parameter(slot, effects).prior_std for slot in slots])
    first = chain.offsets["joint_angle"].start
    error[:] = found.values[:, chain.offsets["joint_angle"]]
    for j in range(q.shape[1]):
        own = np.flatnonzero(found.station == first + j)
        index, slope = found.parameter[own], found.partials[:, own]
        std[:, j] = np.sqrt(np.maximum(np.sum((slope @ covariance[np.ix_(index, index)]) * slope, axis=1), 0.0))
        assumed[:, j] = np.sqrt(np.sum((slope * prior[index]) ** 2, axis=1))
        active[j] = len(own) > 0
    return AngleErrors(error, std, assumed, active)
