"""Error budget: how far each active effect moves the point, or loads the motors, over the campaign."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass

import numpy as np

from clampid.charts import thin
from clampid.fitting.accuracy import predicted
from clampid.report.stage_data import StageData
from clampid.role_slots import has_role
from clampid.roles import FRAMES
from clampid.slots import Slot, find_parameter
from clampid.stages.rows import Array

__all__ = ["SETUP", "Share", "pose_budget", "torque_budget"]

MOST_ROWS = 2000
SETUP = "geometry: base, targets, flange"


@dataclass(frozen=True)
class Share:
    """What one effect does: root mean square in all, and joint by joint (metres, or Nm per motor)."""

    name: str
    total: Array
    places: Mapping[str, float]


def _without(data: StageData, slots: Collection[Slot]) -> Array:
    """Values with the amplitudes of some slots at zero; the shape parameters then have no effect."""
    theta = data.model.theta.copy()
    for k, slot in enumerate(data.model.slots):
        if slot in slots and not find_parameter(slot, data.first.problem.effects).shape:
            theta[k] = 0.0
    return theta


def _part_of(slot: Slot) -> str:
    """The line of the budget that a slot belongs to; the geometry has one for the setup and one for the robot."""
    if not has_role(slot, *FRAMES):
        return slot.effect
    if has_role(slot, "base_frame", "target_point", "flange_frame"):
        return SETUP
    return "geometry: links and joints"


def pose_budget(data: StageData) -> list[Share]:
    """For each effect the RMS shift of the measured points when it is switched off, m, largest first."""
    piece = data.first
    good = piece.good[:, 0]

    def shift(slots: Collection[Slot]) -> float:
        moved = piece.problem.residual(_without(data, slots))[0][good, :3] - piece.residual[good, :3]
        return float(np.sqrt(np.mean(np.sum(moved**2, axis=1)))) if good.any() else 0.0

    out = []
    for part in dict.fromkeys(_part_of(s) for s in data.model.slots):
        own = [s for s in data.model.slots if _part_of(s) == part]
        places = list(dict.fromkeys(s.place for s in own))
        single = {}
        if len(places) > 1 and part != SETUP:
            single = {place: shift([s for s in own if s.place == place]) for place in places}
        out.append(Share(part, np.array([shift(own)]), single))
    return sorted(out, key=lambda share: -float(share.total[0]))


def torque_budget(data: StageData) -> list[Share]:
    """For each effect its RMS torque at each motor, Nm, largest first."""
    piece = data.first
    rows = piece.rows
    keep = thin(len(rows), MOST_ROWS) if data.kind.moving else np.arange(len(rows))
    trial = piece.problem.with_rows(rows.take(keep))
    good = piece.good[keep]

    def rms(values: Array) -> Array:
        squares = (np.where(good, values, 0.0) ** 2).sum(axis=0)
        return np.asarray(np.sqrt(squares / np.maximum(good.sum(axis=0), 1)))

    out = []
    for effect in dict.fromkeys(s.effect for s in data.model.slots):
        if data.kind.solved and "compliance" in data.first.problem.effects[effect].roles:
            continue
        off = _without(data, [s for s in data.model.slots if s.effect == effect])
        if data.kind.solved:  # the posture of clamping goes with it
            change = predicted(trial, off) - piece.residual[keep]
        else:
            runs = np.zeros(trial.offsets)
            change = trial.residual(np.r_[off, runs])[0] - trial.residual(np.r_[data.model.theta, runs])[0]
        out.append(Share(effect, rms(change), {}))
    out.sort(key=lambda share: -float(np.linalg.norm(share.total)))
    described = rows.signals.get("gravity_torque")
    if described is not None and described.any():
        out.insert(0, Share("gravity as described", rms(described[keep] @ np.asarray(rows.robot.transmission).T), {}))
    out.insert(0, Share("torque measured", rms(rows.measured[keep]), {}))
    return out
