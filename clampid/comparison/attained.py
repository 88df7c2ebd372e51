"""Errors of attained against commanded poses, and their metrics by ISO 9283.

The commanded pose is that of the nominal chain at the mean of the joint angles reported at all returns to a pose, so
all returns share one command. The base in the instrument frame and the targets on the flange are not known. Both are
fitted to the same rows, so the errors found are a lower limit of those of the uncompensated robot.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from clampid.effect import Effect
from clampid.fitting.fit import fit
from clampid.role_slots import slot_of
from clampid.stages.fit_problem import fit_problem
from clampid.stages.rows import Array, Bools, Integers, Rows
from experiments.measures.iso9283 import WANTED, expected_repeatability, pose_metrics
from kinematics.screws import log_so3, nearest_rotation

__all__ = ["Attained", "as_sent", "iso9283"]

LARGEST_REST_RANGE = 1e-4  # rad (m): a joint with a smaller range in a table is at rest and has no approach direction
LEAST_TARGET_SPREAD = 1e-3  # m: targets closer to a line do not determine the rotation about it


@dataclass(frozen=True)
class Attained:
    """Errors of the uncompensated robot.

    Attributes
    ----------
    residual
        Measured less commanded ``(N, m)``, instrument frame, m and, with orientations, rad.
    reported
        Largest displacement of the point between the reported angles of a return and their mean over the returns, m.
    fitted
        Number of parameters of base, targets and flange that were fitted to the same rows.
    """

    residual: Array
    reported: float
    fitted: int


def as_sent(rows: Rows, effects: Mapping[str, Effect]) -> Attained:
    """Errors of poses of one session against the nominal chain, with base and targets fitted to the same rows.

    ``effects``: name → effect.
    """
    _, place = np.unique(np.c_[rows.session, rows.fold], axis=0, return_inverse=True)
    sums = np.zeros((int(place.max()) + 1, rows.robot.n))
    np.add.at(sums, place, rows.signals["q"])
    shared = (sums / np.bincount(place)[:, None])[place]
    sent = replace(rows, signals={**rows.signals, "q": shared})
    session = rows.layout.sessions[0]
    axes = ("x", "y", "z", "rx", "ry", "rz")
    slots = [slot_of("base_frame", session, a) for a in axes]
    if rows.measured.shape[1] == 6:
        slots += [slot_of("flange_frame", session, a) for a in axes]
    seen = np.flatnonzero(rows.signals["target_is"].any(axis=0))
    slots += [slot_of("target_point", rows.layout.targets[t], a) for t in seen for a in "xyz"]
    trial = fit_problem(sent, effects, slots)
    theta = fit(trial).theta
    residual = trial.residual(theta)[0]
    own = trial.with_rows(rows).residual(theta)[0]
    return Attained(residual, float(np.linalg.norm((own - residual)[:, :3], axis=1).max()), len(slots))


def iso9283(rows: Rows, residual: Array) -> dict[str, Any]:
    """Metrics of ISO 9283 of rows of poses, for JSON.

    Parameters
    ----------
    rows
        Rows of poses.
    residual
        Measured less commanded ``(N, m)``, instrument frame, m and, with orientations, rad.

    Returns
    -------
    dict
        ``returns_wanted``, ``position`` and ``orientation``; the last two as in
        :class:`experiments.measures.iso9283.PoseMetrics`. ``orientation`` is present if orientations were measured or
        follow from three or more targets of one visit. ``RP_by_instrument`` of positions is the RP of thirty returns of
        a perfect robot with the instrument's stated noise.
    """
    used = np.flatnonzero(rows.used[:, 0])
    frame = rows.pose.base_reference[:, :3, :3]
    out: dict[str, Any] = {"returns_wanted": WANTED}
    labels = _labels(rows, used, rows.signals["target_is"])
    error = np.einsum("nji,nj->ni", frame, residual[:, :3])[used]
    out["position"] = pose_metrics(error, *labels).to_json()
    stated = np.diag(np.mean(rows.sigma[used, :3] ** 2, axis=0))
    out["position"]["RP_by_instrument"] = expected_repeatability(stated)
    turned = _turns(rows, residual)
    if turned is not None:
        chosen, turns = turned
        turns = np.einsum("nji,nj->ni", frame[chosen], turns)
        labels = _labels(rows, chosen, np.zeros((len(rows), 0)))
        out["orientation"] = pose_metrics(turns, *labels, "orientation").to_json()
    return out


def _labels(rows: Rows, chosen: Integers, target: Array) -> tuple[Integers, Integers, Integers, Array]:
    """Labels of the rows ``chosen`` ``(k,)``, for :func:`~experiments.measures.iso9283.pose_metrics`.

    Returns
    -------
    place, number, side, time
        Number of pose and target, of pose, and of approach direction (-1 if unknown); time, s; ``(k,)`` each.
    """
    pose = np.c_[rows.session, rows.fold]
    direction = rows.signals["direction"][chosen]
    moved = np.ptp(rows.signals["q"], axis=0) > LARGEST_REST_RANGE
    _, place = np.unique(np.c_[pose, target][chosen], axis=0, return_inverse=True)
    _, number = np.unique(pose[chosen], axis=0, return_inverse=True)
    _, side = np.unique(direction[:, moved], axis=0, return_inverse=True)
    side = np.where(np.all(direction[:, moved] != 0, axis=1), side, -1)
    place, number, side = (a.astype(np.int64) for a in (place, number, side))
    return place, number, side, np.asarray(rows.constants.time[chosen], dtype=float)


def _turns(rows: Rows, residual: Array) -> tuple[Integers, Array] | None:
    """One row of each visit ``(k,)``, and its orientation error ``(k, 3)``, rad, instrument frame; None if unknown."""
    if residual.shape[1] == 6:
        chosen = np.flatnonzero(rows.used[:, 0] & rows.used[:, 3])
        _, first = np.unique(rows.unit[chosen], return_index=True)
        return (chosen[first], residual[chosen[first], 3:]) if len(first) else None
    used: Bools = rows.used[:, 0]
    order = np.flatnonzero(used)[np.argsort(rows.unit[used], kind="stable")]
    found, turns = [], []
    for here in np.split(order, np.flatnonzero(np.diff(rows.unit[order])) + 1):
        if len(here) < 3:
            continue
        there = rows.measured[here, :3]
        sent = there - residual[here, :3]
        a, b = sent - sent.mean(axis=0), there - there.mean(axis=0)
        if np.linalg.svd(a, compute_uv=False)[1] < LEAST_TARGET_SPREAD:
            continue
        found.append(here[0])
        turns.append(log_so3(nearest_rotation(a, b)))
    return (np.array(found), np.array(turns)) if found else None
