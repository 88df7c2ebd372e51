"""Which rows are held out together: whole runs where runs are exchangeable, else parts of runs.

A held-out run is predicted from the others. If what it shows of a candidate lies outside their range in a variable of
the candidate, this tests an extrapolation and not the candidate: a cold run does not predict a warm one, nor slow
runs the curvature of friction that only the fastest shows. The same holds for the model without any candidate: slow
runs do not determine the inertia that a fast one shows, and predict it worse than its noise. Then each run is cut
into contiguous pieces, one for every part of the rows, so that each piece lies between others of its own run. Pieces
are at least four units of noise long. The first and last unit of each piece share noise with its neighbours; they are
fitted and not judged.

Source: Roberts et al., Cross-validation strategies for data with temporal, spatial, hierarchical, or phylogenetic
structure, Ecography 40, 2017: blocks in time, and no extrapolation between them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from clampid.effect import Effect
from clampid.evidence.score import Scored
from clampid.evidence.space import Space
from clampid.fitting.accuracy import parts_of_rows
from clampid.fitting.descent import inverse_of
from clampid.fitting.solve import Estimate
from clampid.slots import number_of
from clampid.stages.rows import Array, Bools, Integers, Rows

__all__ = [
    "PARTS",
    "Folds",
    "extrapolated_in",
    "folds_of",
    "parts_of_runs",
    "runs_determine_each_other",
    "stability_folds",
]

PARTS = 5
UNITS = 4  # of noise, of which a piece consists at least: its first and last are not judged
MARGIN = 0.02  # of a range's width: runs of one program repeat their speeds no better
AS_NOISE = 1.0  # error of a prediction, over the noise, in squares: with more it tests the fit of the other runs
MOSTLY = 0.5  # of a candidate's evidence, which lies outside the other runs' ranges


@dataclass(frozen=True)
class Folds:
    """Parts of runs that are held out together.

    Attributes
    ----------
    fold
        ``(N,)``: the part of each row.
    judged
        ``(N,)``: False next to a piece that other parts have.
    because
        Signals in which runs lie outside each other; empty if runs do not determine each other.
    """

    fold: Integers
    judged: Bools
    because: tuple[str, ...]

    def of(self, rows: Rows) -> Rows:
        """The rows with these folds."""
        return replace(rows, fold=self.fold)

    def judging(self, rows: Rows) -> Rows:
        """The rows without those that are not judged."""
        return rows.without(~self.judged)

    @property
    def sentence(self) -> str:
        """For people: what was held out, and why."""
        if not self.because:
            return (
                "Parts of runs are held out, not whole runs: the other runs do not determine all parameters that one "
                "of them shows, and predict it worse than its noise."
            )
        names = " and ".join(name.replace("_", " ").replace("elapsed", "time") for name in self.because)
        return (
            "Parts of runs are held out, not whole runs: most of what shows an effect lies where a run is outside the "
            f"others in {names}."
        )

    def to_json(self) -> dict[str, Any]:
        """For programs."""
        return {"held_out": "parts of runs", "because": list(self.because)}


def runs_determine_each_other(estimate: Estimate, seed: int) -> bool:
    """Whether whole runs of a log are predicted from the others with errors, expected, below their noise.

    The variance of a prediction follows from the normal equations of the others and the prior; no residual counts.

    Parameters
    ----------
    seed
        For the division into parts.
    """
    rows, white = estimate.problem.rows, estimate.whitened
    if not rows.kind.moving:
        return True
    part = parts_of_rows(rows, seed)[white.entry]
    parts = np.unique(part)  # a run of which no row counts is none
    if len(parts) < 2:
        return True
    normals = [(J.T @ J, len(J)) for J in (white.jacobian[part == k] for k in parts)]
    whole = estimate.prior_precision + sum(A for A, _ in normals)
    return all(np.sum(A * inverse_of(whole - A)) <= AS_NOISE * count for A, count in normals)


def folds_of(
    estimate: Estimate, space: Space, candidates: Sequence[Scored], effects: Mapping[str, Effect]
) -> Folds | None:
    """Parts of runs if whole runs would test an extrapolation of one of the candidates; else None.

    Parameters
    ----------
    space
        In which the candidates were scored on the estimate's residual.
    """
    rows = estimate.problem.rows
    if not rows.kind.moving:  # sweeps have constants of their own, and poses are not ordered by anything
        return None
    because: dict[str, None] = {}
    for s in candidates:
        evidence, c = _evidence_of(s, space, estimate.whitened.entry, len(rows)), s.candidate
        because |= dict.fromkeys(extrapolated_in(rows, effects[c.name], c.places, evidence))
    if not because:
        return None
    fold, judged = parts_of_runs(rows)
    return Folds(fold, judged, tuple(because))


def _evidence_of(s: Scored, space: Space, entry: Integers, rows: int) -> Array:
    """How much of a candidate each row shows ``(N,)``: the squares of its whitened columns that the fit cannot absorb.

    Zero where it does not act, or where the rows of the motors on which it acts are not used.

    Parameters
    ----------
    entry
        ``(M,)``: the row of each whitened number.
    """
    acts = np.any(s.candidate.columns.dense(space.rows) != 0.0, axis=1)
    left = s.directions(space.basis)[: space.rows][acts]
    return np.asarray(np.bincount(entry[acts], np.sum(left**2, axis=1), rows), dtype=float)


def extrapolated_in(rows: Rows, effect: Effect, places: Sequence[str], evidence: Array) -> tuple[str, ...]:
    """Signals that an effect needs, in which most evidence lies outside the ranges of all runs but its own.

    Parameters
    ----------
    evidence
        ``(N,)``: how much of the effect each row shows.
    """
    joints = [number_of(place) for place in places if place.startswith(effect.per)]
    shows = evidence > 0.0
    if not shows.any():
        return ()
    found = []
    for name in effect.needs:
        values = rows.signals.get(name)
        if values is None or values.ndim > 2:
            continue
        columns = values[:, None] if values.ndim == 1 else values[:, joints] if joints else values
        columns = columns[:, np.ptp(columns, axis=0) > 0.0]
        if not columns.shape[1]:
            continue
        outside = _outside(columns[shows], rows.fold[shows]).mean(axis=1)
        if np.average(outside, weights=evidence[shows]) > MOSTLY:
            found.append(name)
    return tuple(found)


def _outside(columns: Array, run: Integers) -> Bools:
    """Which numbers ``(N, k)`` lie clearly outside the ranges of all runs but their own."""
    runs = np.unique(run)
    inside = np.zeros(columns.shape, dtype=bool)
    for k in runs:
        mine = run == k
        low, high = columns[mine].min(axis=0), columns[mine].max(axis=0)
        margin = MARGIN * (high - low)
        inside |= ~mine[:, None] & (columns >= low - margin) & (columns <= high + margin)
    return ~inside


def parts_of_runs(rows: Rows) -> tuple[Integers, Bools]:
    """Parts ``(N,)``, a contiguous piece of each run in every one, and which rows ``(N,)`` are judged.

    A run that is too short for pieces belongs to one part as a whole.
    """
    part, judged = np.zeros(len(rows), dtype=np.int64), np.ones(len(rows), dtype=bool)
    for number, run in enumerate(np.unique(rows.fold)):
        mine = np.flatnonzero(rows.fold == run)
        units, order = np.unique(rows.unit[mine], return_inverse=True)
        pieces = min(PARTS, len(units) // UNITS)
        if pieces < 2:
            part[mine] = number % PARTS
            continue
        of_unit = np.arange(len(units)) * pieces // len(units)
        part[mine] = (of_unit[order] + number) % PARTS
        cut = np.flatnonzero(np.diff(of_unit))
        judged[mine] = ~np.isin(order, np.r_[cut, cut + 1])
    return part, judged


def stability_folds(rows: Rows) -> Integers:
    """Folds ``(N,)`` of which a fifth may be left out: parts of runs, where there are fewer runs than that."""
    if rows.kind.moving and len(np.unique(rows.fold)) < PARTS:
        return parts_of_runs(rows)[0]
    return rows.fold
