"""Geometry that the data do not determine, fixed at its nominal value before anything is exported.

In units of what each parameter may reasonably amount to, the covariance C of the geometry has directions W with a
variance above 1: there the fit knows less than was known before. The exported model is the fit given that these
combinations are zero, as in the nominal robot: theta - C W (W' C W)^-1 W' theta, with the covariance that goes with it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy import linalg

from clampid.catalogue import catalogue
from clampid.models.model import Model
from clampid.role_slots import has_role, numbers_of_role
from clampid.roles import FRAMES
from clampid.slots import Slot, find_parameter
from clampid.stages.rows import Array
from clampid.stages.stage_kind import known_of

__all__ = ["Determined", "determined_shifts", "fix_undetermined", "in_words", "reasonable", "undetermined_directions"]

SHARE_OF_A_COMBINATION = 0.3  # of the largest entry of a direction: parameters that count as part of the combination


@dataclass(frozen=True, eq=False)
class Determined:
    """A model whose undetermined geometry is at its nominal value.

    Attributes
    ----------
    model
        The model with values and covariance given that.
    spread
        ``(G, k)``: of each such combination one standard deviation of the fit, in the parameters of geometry, SI.
    combinations
        The parameters of each, in words.
    """

    model: Model
    spread: Array
    combinations: tuple[str, ...]


def fix_undetermined(model: Model) -> Determined:
    """The model as it may be exported; the same one where its geometry is determined."""
    stage = known_of(model.stages, "points")
    geometry = [] if stage is None else numbers_of_role(stage.slots, *FRAMES)
    if stage is None or not geometry:
        return Determined(model, np.zeros((0, 0)), ())
    slots = [stage.slots[k] for k in geometry]
    C, size = stage.covariance, reasonable(slots)
    variance, W = undetermined_directions(C[np.ix_(geometry, geometry)], size)
    spread = size[:, None] * W * np.sqrt(variance)
    words = tuple(in_words(slots, column) for column in W.T)
    if not words:
        return Determined(model, spread, words)
    across = C[:, geometry] @ (W / size[:, None])  # (P, k)
    gain = across / variance
    theta = stage.theta - gain @ (W.T @ (stage.theta[geometry] / size))
    covariance = C - gain @ across.T
    # What stays of the directions themselves is rounding; a covariance has no negative variances.
    np.fill_diagonal(covariance, np.maximum(np.diag(covariance), 0.0))
    return Determined(model.with_stage(replace(stage, theta=theta, covariance=covariance)), spread, words)


def undetermined_directions(covariance: Array, size: Array) -> tuple[Array, Array]:
    """Variances ``(k,)`` above 1 and their directions ``(P, k)``, both in units of ``size`` ``(P,)``."""
    values, vectors = linalg.eigh(covariance / np.outer(size, size))
    weak = values > 1.0
    return values[weak], vectors[:, weak]


def reasonable(slots: list[Slot]) -> Array:
    """The standard error below which rows determine each parameter of geometry ``(P,)``, SI."""
    return np.array([find_parameter(slot, catalogue()).clear for slot in slots])


def determined_shifts(omission: Sequence[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    """Of the shifts of a model's parameters, as a diagnosis lists them, those of parameters that the data determine.

    A shift is that of one choice among many where its standard error is not below what the parameter may reasonably
    amount to: y of base and of flange of a UR10 moved by 53 mm each, in opposite directions. That is asked of geometry
    only; the sizes of other effects depend on gears and weights.
    """
    effects, out = catalogue(), []
    for shift in omission:
        effect, _, rest = str(shift.get("name", "")).partition(".")
        name, _, place = rest.partition("@")
        slot = Slot(effect, name, place)
        if not has_role(slot, *FRAMES) or float(shift["std"]) < find_parameter(slot, effects).clear:
            out.append(shift)
    return out


def in_words(slots: list[Slot], direction: Array) -> str:
    """``base_y@session1, flange_y@session1``: the parameters that make up most of a direction ``(P,)``."""
    size = np.abs(direction)
    parts = [slots[k] for k in np.flatnonzero(size > SHARE_OF_A_COMBINATION * size.max())]
    return ", ".join(f"{slot.parameter}@{slot.place}" for slot in parts)
