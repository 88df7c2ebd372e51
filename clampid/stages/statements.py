"""What campaigns state beforehand, as whitened equations in the parameters of the pose stage.

A statement is one or more measurements without a row: b = A theta with errors of variance 1. They are pseudo-rows of
the prior (:meth:`clampid.stages.fit_problem.FitProblem.prior`) and make parameters identifiable that the rows alone do
not separate (:mod:`clampid.fitting.gauge`): with a known base, an offset of joint 1 is an error of the robot.

The base X = X_0 exp([w, v]) in the instrument's frame has, to first order, the position p_0 + R_0 v and the angles
rpy_0 + G w, with G the inverse of the Jacobian of R = Rz·Ry·Rx. Source: Lynch and Park, Modern Robotics, 2017, app. B.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from clampid.role_slots import slot_of
from clampid.slots import Layout, Slot
from clampid.stages.rows import Array, Integers
from experiments.campaign import Campaign
from experiments.stated import StatedBase
from kinematics.fixed_angles import roll_pitch_yaw, rotation_of

__all__ = ["ScaleBar", "Statement", "about", "stated_base_pose", "stated_equations", "statements_of"]

NOMINAL = 3e-3  # m: how far a described robot's points are from where they are
STARTS = 4  # of each angle that is not known


@dataclass(frozen=True)
class ScaleBar:
    """A certified distance |way + a - b| between targets that are off by a and b, m.

    Attributes
    ----------
    way
        ``(3,)``: between the nominal targets.
    """

    way: Array
    value: float
    std: float

    def linear(self, off: Array) -> tuple[Array, Array]:
        """The whitened equation ``(1, 6)``, ``(1,)`` in (a, b) about the values ``off`` ``(6,)``."""
        way = self.way + off[:3] - off[3:]
        length = float(np.linalg.norm(way))
        slope = np.concatenate([way, -way])[None] / length / self.std
        return slope, np.array([(self.value - length) / self.std]) + slope @ off


@dataclass(frozen=True)
class Statement:
    """Whitened equations in some slots: ``matrix`` ``(m, k)`` times their values is ``value`` ``(m,)``.

    Attributes
    ----------
    bar
        Of a certified distance, what the equation is the linear part of.
    """

    slots: tuple[Slot, ...]
    matrix: Array
    value: Array
    bar: ScaleBar | None = None

    def about(self, off: Array) -> Statement:
        """The same, linear about other values ``(k,)``."""
        if self.bar is None:
            return self
        return Statement(self.slots, *self.bar.linear(off), self.bar)


def statements_of(
    campaigns: Sequence[Campaign], layout: Layout, references: Sequence[Array | None]
) -> tuple[Statement, ...]:
    """All statements of the sessions on base and targets.

    Parameters
    ----------
    references
        ``(4, 4)`` for each session: X_0; None where no points were measured, so that nothing sees the base.
    """
    found: list[Statement] = []
    for s, (campaign, reference) in enumerate(zip(campaigns, references, strict=True)):
        stated, session = campaign.stated, layout.sessions[s]
        if stated.base is not None and reference is not None:
            found.append(_of_base(stated.base, reference, session))
        known = {name: name if len(campaigns) == 1 else f"{session}:{name}" for name in campaign.targets}
        known = {name: label for name, label in known.items() if label in layout.targets}
        for name, std in stated.targets_std.items():
            if name in known:
                found.append(Statement(_target_slots(known[name]), np.diag(1.0 / std), np.zeros(3)))
        for d in stated.distances:
            if all(name in known for name in d.between):
                a, b = d.between
                bar = ScaleBar(campaign.targets[a] - campaign.targets[b], d.value, d.std)
                slots = (*_target_slots(known[a]), *_target_slots(known[b]))
                found.append(Statement(slots, *bar.linear(np.zeros(6)), bar))
    return tuple(found)


def stated_equations(stated: Sequence[Statement], index: Mapping[Slot, int]) -> tuple[Integers, Array, Array]:
    """Statements of the slots that ``index`` numbers: which numbers ``(k,)``, and equations ``(m, k)``, ``(m,)``.

    A slot that is not among them is zero, as the model without it has it.
    """
    used = [s for s in stated if any(slot in index for slot in s.slots)]
    at = sorted({index[slot] for s in used for slot in s.slots if slot in index})
    place = {number: k for k, number in enumerate(at)}
    matrix = np.zeros((sum(len(s.value) for s in used), len(at)))
    row = 0
    for s in used:
        for slot, column in zip(s.slots, s.matrix.T, strict=True):
            if slot in index:
                matrix[row : row + len(s.value), place[index[slot]]] += column
        row += len(s.value)
    return np.array(at, dtype=np.int64), matrix, np.concatenate([s.value for s in used]) if used else np.zeros(0)


def about(stated: Sequence[Statement], values: Mapping[Slot, float]) -> tuple[Statement, ...]:
    """The statements, linear about some values of their slots; those of slots that are not given are zero."""
    return tuple(s.about(np.array([values.get(slot, 0.0) for slot in s.slots])) for s in stated)


def _target_slots(label: str) -> tuple[Slot, ...]:
    return tuple(slot_of("target_point", label, a) for a in "xyz")


def _of_base(stated: StatedBase, reference: Array, session: str) -> Statement:
    slots = tuple(slot_of("base_frame", session, a) for a in ("rx", "ry", "rz", "x", "y", "z"))
    std = np.r_[stated.rpy_std, stated.position_std]
    rpy = roll_pitch_yaw(reference[:3, :3])
    off = np.r_[_wrapped(stated.rpy - rpy), stated.position - reference[:3, 3]]
    by_twist = np.zeros((6, 6))
    by_twist[:3, :3] = np.linalg.pinv(_turning(rpy), rcond=1e-3)
    by_twist[3:, 3:] = reference[:3, :3]
    known = np.isfinite(std)
    return Statement(slots, (by_twist / std[:, None])[known], (off / std)[known])


def _turning(rpy: Array) -> Array:
    """D w / d rpy ``(3, 3)``, w the turn in the turned frame's own axes."""
    (sr, sp), (cr, cp) = np.sin(rpy[:2]), np.cos(rpy[:2])
    return np.array([[1.0, 0.0, -sp], [0.0, cr, cp * sr], [0.0, -sr, cp * cr]])


def _wrapped(angle: Array) -> Array:
    return np.asarray((angle + np.pi) % (2.0 * np.pi) - np.pi)


def stated_base_pose(stated: StatedBase, points: Array, measured: Array) -> Array:
    """Where the base stands ``(4, 4)``: as stated, and what is not stated as it fits the points best.

    Parameters
    ----------
    points, measured
        ``(N, 3)``, m: of the described robot in its base frame, and in the instrument's frame.
    """
    out = stated.pose
    unknown = ~np.isfinite(np.r_[stated.rpy_std, stated.position_std])
    if not unknown.any():
        return out
    first = np.r_[stated.rpy, stated.position]

    def at(free: Array) -> Array:
        pose: Array = np.array(first, dtype=np.float64)
        pose[unknown] = free
        return pose

    def off(free: Array) -> Array:
        pose = at(free)
        return np.asarray(np.ravel(points @ rotation_of(pose[:3]).T + pose[3:] - measured) / NOMINAL)

    best, cost = first[unknown], np.inf
    angles = [np.arange(STARTS) * (2.0 * np.pi / STARTS) if u else np.zeros(1) for u in unknown[:3]]
    for turn in np.stack(np.meshgrid(*angles, indexing="ij"), axis=-1).reshape(-1, 3):
        start = first.copy()
        start[:3] += turn
        middle = measured.mean(axis=0) - rotation_of(start[:3]) @ points.mean(axis=0)
        start[3:] = np.where(unknown[3:], middle, start[3:])
        found = least_squares(off, start[unknown], loss="soft_l1")
        if found.cost < cost:
            best, cost = found.x, float(found.cost)
    pose = at(best)
    out[:3, :3], out[:3, 3] = rotation_of(pose[:3]), pose[3:]
    return out
