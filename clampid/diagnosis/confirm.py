"""Confirmation on rows that a candidate was not chosen on.

Stability: in each of five parts the candidate is selected again from the other four. Held-out falls: unit by unit, by how
much the squared error falls once the candidate is fitted, on a verification table or by cross-validation; a one-sided sign
flip says whether that is more than chance.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy import sparse

from clampid.diagnosis.score import Scored, Space
from clampid.stages.rows import Array, Integers

__all__ = ["held_out_p", "stability"]

FOLDS = 5
FLIPS = 999


def stability(space: Space, scored: Sequence[Scored], chosen: Scored, fold: Integers, seed: int) -> float:
    """Share of five parts in which the candidate, or one of its own effect, is first again without that part.

    Parameters
    ----------
    fold
        ``(M,)``: folds of the whitened entries.
    """
    able = [s for s in scored if s.freedom]
    names = np.unique(fold)
    part_of = np.random.default_rng(seed).permutation(len(names)) % FOLDS
    part = np.r_[part_of[np.searchsorted(names, fold)], np.full(len(space.residual) - len(fold), -1)]
    shape = (FOLDS + 1, len(part))
    by_part = sparse.csc_matrix((space.residual, (part + 1, np.arange(len(part)))), shape=shape)
    absorbed = by_part @ space.basis
    rows = max(space.rows, 2)
    amplitudes = [(s.candidate.columns.summed(by_part) - absorbed @ s.absorbed) @ s.weights for s in able]
    again = 0
    for k in range(FOLDS):
        best, best_value = None, -np.inf
        for s, amplitude in zip(able, amplitudes, strict=True):
            rest = amplitude.sum(axis=0) - amplitude[k + 1]
            value = float(rest @ rest) / space.scale**2 - s.freedom * np.log(rows)
            if value > best_value:
                best, best_value = s, value
        again += best is not None and _same(best, chosen)
    return again / FOLDS


def _same(a: Scored, b: Scored) -> bool:
    if a.candidate.terms or b.candidate.terms:
        return a.candidate.name == b.candidate.name
    return bool(set(a.candidate.depends_on) & set(b.candidate.depends_on))


def held_out_p(before: Array, after: Array, unit: Integers, seed: int) -> float:
    """One-sided p of the fall of squared errors ``(N,)`` from before to after, flipped by unit ``(N,)``."""
    _, index = np.unique(unit, return_inverse=True)
    fall = np.bincount(index, weights=before - after)
    total = float(fall.sum())
    if total <= 0:
        return 1.0
    signs = np.random.default_rng(seed).choice([-1.0, 1.0], size=(FLIPS, len(fall)))
    return float((1 + np.sum(signs @ fall >= total)) / (FLIPS + 1))
