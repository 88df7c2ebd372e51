"""Gauge freedom: which geometric parameters of a robot are independent, whatever postures are measured.

A rotation of a link's far end about the joint before it is the same as an offset of that joint, and so on. A chain of n
revolute joints has 4 n + 6 independent parameters, far fewer than 6 for each link. They are chosen by rank: parameters
are taken in a fixed order (anchors, base, flange or targets, then link by link). One whose column depends linearly on
those before it, over random postures, is fixed at zero. If only distances are measured, these are all parameters of the
base: moving the base is the same as moving the anchors. Stated positions of base and targets count like measured rows:
if the base is known, a motion of link 1 is the robot's own, and is kept.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from clampid.effect import Effect
from clampid.role_slots import effect_with, has_role
from clampid.roles import Role
from clampid.slots import Slot, slots_of
from clampid.stages.fit_problem import fit_problem
from clampid.stages.rows import Array, Rows
from clampid.stages.statements import stated_equations

__all__ = ["independent_geometry"]

INDEPENDENT = 1e-5  # relative length of a column's part that is new: below this it is a combination of those before it
POSTURES = 60
ANCHOR_RANGE = 2.0  # m: random anchors lie within this distance of the base along each axis


def independent_geometry(rows: Rows, effects: Mapping[str, Effect]) -> tuple[Slot, ...]:
    """The independent slots of the geometry for the targets, anchors and sessions of the rows.

    Random postures and anchors replace those of the rows. So a slot is left out only for a gauge freedom of the robot,
    not because the campaign has too few postures.

    Parameters
    ----------
    rows
        Rows of poses.
    effects
        All known effects, by name.
    """
    slots = _ordered(slots_of(effect_with("link_frame", effects), rows.layout))
    if not rows.oriented:  # points and distances alone: targets carry the tool
        slots = tuple(s for s in slots if not has_role(s, "flange_frame", effects=effects))
    seen = np.c_[rows.session, rows.signals["target_is"], rows.signals["anchor_is"]]
    _, first = np.unique(seen, axis=0, return_index=True)
    rng = np.random.default_rng(0)
    robot = rows.robot
    chosen = np.repeat(first, POSTURES)
    lower = np.where(np.isfinite(robot.lower), robot.lower, -np.pi)
    upper = np.where(np.isfinite(robot.upper), robot.upper, np.pi)
    q = rng.uniform(np.maximum(lower, -np.pi), np.minimum(upper, np.pi), (len(chosen), robot.n))
    sample = rows.take(chosen)
    anchor = sample.signals["anchor_is"] @ rng.uniform(-ANCHOR_RANGE, ANCHOR_RANGE, (len(rows.layout.anchors), 3))
    constants = replace(sample.pose, anchor=anchor)
    sample = replace(sample, signals={**sample.signals, "q": q}, constants=constants)
    trial = fit_problem(sample, effects, slots)
    _, jacobian = trial.residual(np.zeros(len(slots)))
    size = trial.sizes()
    columns = np.vstack([(jacobian * size).reshape(-1, len(slots)), _stated(rows, slots, size, jacobian)])
    basis = np.zeros((len(columns), 0))
    kept = []
    for k, slot in enumerate(slots):
        column = columns[:, k]
        length = float(np.linalg.norm(column))
        if length == 0.0:
            continue
        rest = column - basis @ (basis.T @ column)
        rest -= basis @ (basis.T @ rest)
        if np.linalg.norm(rest) > INDEPENDENT * length:
            basis = np.c_[basis, rest / np.linalg.norm(rest)]
            kept.append(slot)
    return tuple(kept)


def _stated(rows: Rows, slots: tuple[Slot, ...], size: Array, jacobian: Array) -> Array:
    """Stated positions as rows ``(m, P)``, scaled to the size of measured rows: only their directions matter."""
    at, matrix, _ = stated_equations(rows.constants.stated, {slot: k for k, slot in enumerate(slots)})
    out = np.zeros((len(matrix), len(slots)))
    out[:, at] = matrix * size[at]
    length = np.linalg.norm(out, axis=1, keepdims=True)
    return np.asarray(out / np.where(length > 0, length, 1.0) * np.linalg.norm(jacobian * size) / np.sqrt(len(slots)))


def _ordered(slots: tuple[Slot, ...]) -> tuple[Slot, ...]:
    """Slots in the order of choice: anchors, base, flange, targets; then links, translations before rotations."""
    before: tuple[Role, ...] = ("anchor_point", "base_frame", "flange_frame", "target_point")

    def key(slot: Slot) -> tuple[int, str, int]:
        kind = next((i for i, role in enumerate(before) if has_role(slot, role)), len(before))
        return kind, slot.place if kind == len(before) else "", len(slot.parameter)

    return tuple(sorted(slots, key=key))
