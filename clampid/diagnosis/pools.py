"""Pools of planned measurements: the information of each on a fit's parameters and on candidates.

Constants of a single run or sweep, such as the posture at which the flange was clamped, are projected out of its
columns; the rest is reduced by an orthogonal transformation to as many rows as columns, which keeps all products.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from clampid.evidence.candidates import Candidate
from clampid.fitting.noise import Noise
from clampid.fitting.solve import Estimate
from clampid.slots import Slot
from clampid.stages.rows import Array, Integers, Rows
from experiments.campaign import Campaign
from experiments.plans.cell import cell_like
from experiments.plans.limits import Limits, limits_of
from experiments.plans.model import Cell, Plan

__all__ = ["Pool", "Seen", "cell_of", "columns_seen_by", "joined", "seen_of", "without_own"]

UNSTATED = 1e-4  # m: a position's, where the instrument states angles and ranges
FREE = 1e-6  # of a column's length: how tightly a measurement's own constants are known before it


@dataclass(frozen=True)
class Pool:
    """Measurements to choose from, K of them.

    Attributes
    ----------
    nuisance
        ``(K, r, P)``: whitened columns of the fitted parameters.
    columns
        ``(K, r, k)`` of each candidate.
    cost
        ``(K,)`` s.
    what
        The words for one and for several: ``pose``, ``poses``.
    batch, most
        How many are added at once, and at most.
    words
        What some of them are, for people.
    plan
        Some of them as a plan that the runner can execute.
    """

    nuisance: Array
    columns: tuple[Array, ...]
    cost: Array
    what: tuple[str, str]
    batch: int
    most: int
    words: Callable[[Sequence[int]], str]
    plan: Callable[[Sequence[int], dict[str, float | int | str]], Plan]

    def __len__(self) -> int:
        return len(self.nuisance)


@dataclass(frozen=True)
class Seen:
    """The same columns in the rows so far, ``(r, P)`` and ``(r, k)`` each; the prior is among the rows."""

    nuisance: Array
    columns: tuple[Array, ...]


def seen_of(estimate: Estimate, candidates: Sequence[Candidate]) -> Seen:
    """The columns in the rows of a fit."""
    white, count, size = estimate.whitened, len(estimate.slots), estimate.problem.sizes()
    values, vectors = np.linalg.eigh(estimate.prior_precision * np.outer(size, size))
    root = (vectors * np.sqrt(np.maximum(values, 0.0))).T / size
    columns = [c.columns.dense(len(white.residual)) for c in candidates]
    width = count + sum(c.shape[1] for c in columns)
    own = (white.jacobian[:, count:], root[:, count:])
    slots = (
        [white.jacobian[:, :count], *columns],
        [root[:, :count], np.zeros((len(root), width - count))],
    )
    left = _without_own(slots, own, width)
    return Seen(left[:, :count], tuple(_split(left[:, count:], candidates)))


def without_own(columns: Array, own: Array) -> Array:
    """Columns ``(M, w)`` as ``(w, w)`` with the same products, after projecting out ``own`` ``(M, k)``."""
    return _without_own(([columns],), (own,), columns.shape[1])


def _without_own(parts: Sequence[Sequence[Array]], own: Sequence[Array], width: int) -> Array:
    """The same of rows in parts, each of them several arrays side by side.

    A block of rows at a time, so that the columns are never all copied.
    """
    length = np.sqrt(sum((np.einsum("mk,mk->k", A, A) for A in own), start=np.zeros(own[0].shape[1])))
    free = length > 0.0
    count = int(free.sum())
    R = np.zeros((count + width, count + width))
    R[:count, :count] = FREE * np.eye(count)
    for beside, A in zip(parts, own, strict=True):
        for first in range(0, len(A), 2 * len(R)):
            block = slice(first, first + 2 * len(R))
            more = np.hstack([A[block][:, free] / length[free], *(B[block] for B in beside)])
            R = np.asarray(np.linalg.qr(np.vstack([R, more]), mode="r"), dtype=float)
    return R[count:, count:]


def _split(columns: Array, candidates: Sequence[Candidate]) -> list[Array]:
    widths = np.cumsum([len(c.slots) for c in candidates])[:-1]
    return [np.asarray(part) for part in np.split(columns, widths, axis=-1)]


def joined(parts: Sequence[Array], candidates: Sequence[Candidate], count: int) -> tuple[Array, tuple[Array, ...]]:
    """Nuisance and candidates' columns of a pool, from the whitened columns of each measurement."""
    stacked = np.stack(list(parts))
    return stacked[:, :, :count], tuple(_split(stacked[:, :, count:], candidates))


def columns_seen_by(
    estimate: Estimate,
    candidates: Sequence[Candidate],
    rows: Rows,
    group: Integers,
    offsets: Callable[[Array], Array] | None = None,
) -> list[Array]:
    """Whitened columns of fit and candidates in planned rows, ``(w, w)`` of each group.

    Parameters
    ----------
    rows, group
        Rows of torques, and the number of the measurement, from 0, that each belongs to ``(N,)``.
    offsets
        Finds the constants that single runs or sweeps have, given the slots' values; zero by default.
    """
    own = len(estimate.slots)
    slots: dict[Slot, float] = {}
    for c in candidates:
        slots |= dict.fromkeys(c.slots, 0.0) | dict(c.shapes)
    trial = estimate.problem.with_rows(rows).with_slots((*estimate.slots, *slots))
    theta = np.r_[estimate.theta[:own], list(slots.values())]
    constants = np.zeros(rows.offsets) if offsets is None else offsets(theta)
    _, jacobian = trial.residual(np.r_[theta, constants])
    index = {slot: own + k for k, slot in enumerate(slots)}
    wanted = [*range(own), *(index[slot] for c in candidates for slot in c.slots)]
    past, known = estimate.noise, estimate.problem.rows.used
    channels = range(known.shape[1])
    sigma = np.array([np.median(past.sigma[known[:, c], c]) if known[:, c].any() else np.inf for c in channels])
    noise = replace(past, sigma=np.tile(sigma, (len(rows), 1)))
    return [
        _whitened_columns(noise, rows, np.flatnonzero(group == number), jacobian, wanted, len(theta))
        for number in range(int(group.max()) + 1)
    ]


def _whitened_columns(
    noise: Noise, rows: Rows, mine: Integers, jacobian: Array, wanted: Sequence[int], count: int
) -> Array:
    own = jacobian[mine]
    white = noise.at(mine).whiten(rows.take(mine), np.zeros(own.shape[:2]), own)
    return without_own(white.jacobian[:, list(wanted)], white.jacobian[:, count:])


def cell_of(campaign: Campaign) -> tuple[Cell, Limits, tuple[str, ...]]:
    """The cell that a campaign was measured in, the limits of its robot, and what had to be assumed."""
    cell = cell_like(campaign, UNSTATED)
    limits, assumed = limits_of(campaign.robot)
    return replace(cell, reference=campaign.robot_file or cell.reference), limits, assumed
