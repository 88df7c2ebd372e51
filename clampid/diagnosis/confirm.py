"""Confirmation of a candidate on held-out rows.

Stability: for each of five parts the candidate must be selected again from the other four. Fall of the held-out error:
the squared error with and without the candidate, unit by unit, on a verification table or by cross-validation; a
one-sided sign-flip test decides whether the fall is significant.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import block_diag

from clampid.diagnosis.probes import probes
from clampid.evidence.candidates import Candidate
from clampid.evidence.columns import Sums
from clampid.evidence.joined import Joined
from clampid.evidence.score import Scored, explained_by
from clampid.evidence.space import Space
from clampid.fitting.noise import Noise
from clampid.fitting.solve import Estimate
from clampid.slots import Term
from clampid.stages.pose_rows import join_rows
from clampid.stages.rows import Array, Integers, Rows

__all__ = [
    "Fall",
    "cross_fitted_fall",
    "event_p",
    "first_without_parts",
    "held_out_p",
    "probe_held_out_fall",
    "same_effect",
    "stability",
    "terms_p",
]

FOLDS = 5
FLIPS = 999


@dataclass(frozen=True)
class Fall:
    """Relative fall of the whitened squared errors of held-out rows, and its one-sided p.

    ``error``: standard error of that share, from the scatter between units.
    """

    p: float
    share: float
    error: float = 0.0


def first_without_parts(space: Space, scored: Sequence[Scored], fold: Integers, seed: int) -> list[Scored]:
    """The best candidate without each of five parts of the rows.

    Parameters
    ----------
    fold
        ``(M,)``: folds of the whitened entries; of fewer than five each is a part.
    """
    able = [s for s in scored if s.freedom and s.state in ("testable", "weak")]
    names = np.unique(fold)
    part_of = np.random.default_rng(seed).permutation(len(names)) % FOLDS
    part = np.r_[part_of[np.searchsorted(names, fold)], np.full(len(space.residual) - len(fold), -1)]
    by_part = Sums.of(part + 1, space.residual)
    absorbed = by_part.over(0, len(part)) @ space.basis
    joined = Joined([s.candidate.columns for s in able])
    sums = joined.own(joined.summed(by_part))
    amplitudes = [(own.T - absorbed @ s.absorbed) @ s.weights for s, own in zip(able, sums, strict=True)]
    first = []
    for k in range(min(len(names), FOLDS)):
        rest = [
            float(explained_by(s, a.sum(axis=0) - a[k + 1], space.scale)) - s.cost
            for s, a in zip(able, amplitudes, strict=True)
        ]
        if rest:
            first.append(able[int(np.argmax(rest))])
    return first


def stability(first: Sequence[Scored], chosen: Sequence[Scored]) -> float:
    """Share of the parts without which a candidate, or one of its own effect, is :func:`first_without_parts`.

    Of several candidates: the share for any of them.
    """
    return float(np.mean([any(same_effect(s, c) for c in chosen) for s in first])) if first else 0.0


def same_effect(a: Scored, b: Scored) -> bool:
    """Whether two candidates are one effect, variants of one at the same places, or probes of a common variable."""
    a_what, b_what = a.candidate, b.candidate
    if a_what.terms or b_what.terms:
        return a_what.name == b_what.name or a_what.is_variant_of(b_what)
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


def probe_held_out_fall(estimate: Estimate, verification: Rows, probe: Candidate, seed: int) -> Fall:
    """Fall of the errors of a verification table by a pose probe, fitted in one linear step."""
    rows = estimate.problem.rows
    both = join_rows([rows, verification])
    joined = estimate.problem.with_rows(both)
    sigma = estimate.noise.sigma
    noise = Noise(np.vstack([sigma, np.broadcast_to(np.median(sigma, axis=0), (len(verification), sigma.shape[1]))]))
    residual, jacobian = joined.residual(estimate.theta)
    white = noise.whiten(both, residual, jacobian)
    stand_in = replace(estimate, problem=joined, noise=noise, residual=residual, whitened=white)
    found = next((p for p in probes(stand_in) if p.label == probe.label), None)
    if found is None:
        return Fall(1.0, 0.0)
    found = replace(found, prior=probe.prior)
    D = found.columns.dense(len(white.residual))
    fit = white.entry < len(rows)
    J, r = white.jacobian, white.residual
    precision = estimate.prior_precision
    start = J[fit].T @ r[fit] + precision @ (estimate.prior_mean - estimate.theta)
    before = _solution(J[fit].T @ J[fit] + precision, start)
    wide, count = np.c_[J, D], J.shape[1]
    A = wide[fit].T @ wide[fit]
    A[:count, :count] += precision
    A[count:, count:] += _assumed(found, D[fit], rows.unit[white.entry[fit]])
    after = _solution(A, np.r_[start, D[fit].T @ r[fit]])
    test = ~fit
    squares_before, squares_after = (r - J @ before)[test] ** 2, (r - wide @ after)[test] ** 2
    return _fall(squares_before, squares_after, both.unit[white.entry[test]], seed)


def _fall(before: Array, after: Array, unit: Integers, seed: int) -> Fall:
    """Fall of the squared errors ``(N,)`` from before to after."""
    _, index = np.unique(unit, return_inverse=True)
    whole, total = np.bincount(index, before), max(float(np.sum(before)), 1e-300)
    share = float(np.sum(before - after)) / total
    off = np.bincount(index, before - after) - share * whole  # of a ratio of sums
    return Fall(held_out_p(before, after, unit, seed), share, float(np.sqrt(off @ off)) / total)


def _assumed(candidate: Candidate, columns: Array, unit: Integers) -> Array:
    """Precision ``(k, k)`` of a candidate's prior; zero for an effect that has none.

    A probe without a prior has one that knows as much as one unit of the rows on average, of no error. Its curves are
    free, and where only a few units show a part of a curve, other units do not predict that part. Source: Kass and
    Wasserman, A reference Bayesian test for nested hypotheses, J. Am. Stat. Assoc. 90, 1995 (unit information prior).

    Parameters
    ----------
    columns, unit
        Its columns ``(M, k)``, and the units ``(M,)``.
    """
    if candidate.prior is not None:
        return np.diag(1.0 / candidate.prior**2)
    gram = columns.T @ columns
    return np.zeros_like(gram) if candidate.terms else gram / max(len(np.unique(unit)), 1)


def cross_fitted_fall(estimate: Estimate, s: Scored, seed: int) -> Fall:
    """Fall of the errors by a candidate that is fitted on the other four fifths of the units.

    Linear in all parameters about the estimate; for stages that have no verification table.
    """
    white = estimate.whitened
    lever = estimate.prior_precision @ (estimate.prior_mean - estimate.theta)
    columns, unit = s.candidate.columns.dense(len(white.residual)), estimate.problem.rows.unit[white.entry]
    whole = np.c_[white.jacobian, columns]
    precision = block_diag(estimate.prior_precision, _assumed(s.candidate, columns, unit))
    moment = whole.T @ white.residual + np.r_[lever, np.zeros(columns.shape[1])]
    return _cross_fitted(whole, white.residual, precision, moment, unit, white.jacobian.shape[1], seed)


def event_p(estimate: Estimate, name: str, seed: int) -> float:
    """The same for an event in an estimate: each fifth of the blocks is predicted by the others.

    Uses the noise of the fit with the event. Without the event its step looks like strongly correlated noise.
    """
    return _own_p(estimate, [k for k, slot in enumerate(estimate.slots) if slot.effect == name], seed)


def terms_p(estimate: Estimate, terms: Sequence[Term], seed: int) -> float:
    """The same of amplitudes that an estimate has for some terms, on the rows of its fit."""
    shape = estimate.problem.shapes()
    wanted = {(t.effect, t.place) for t in terms}
    own = [k for k, slot in enumerate(estimate.slots) if (slot.effect, slot.place) in wanted and not shape[k]]
    return _own_p(estimate, own, seed) if own else 1.0


def _own_p(estimate: Estimate, numbers: Sequence[int], seed: int) -> float:
    """One-sided p of the fall by some of an estimate's parameters; units are predicted by the other four fifths."""
    white, count = estimate.whitened, len(estimate.theta)
    own = np.array(numbers, dtype=int)
    order = np.r_[np.setdiff1d(np.arange(count), own), own]
    J, precision = white.jacobian[:, order], estimate.prior_precision[np.ix_(order, order)]
    first = count - len(own)
    residual = white.residual + J[:, first:] @ estimate.theta[own]  # as if it had not happened
    at = np.where(np.arange(count) < first, estimate.theta[order], 0.0)
    moment = J.T @ residual + precision @ (estimate.prior_mean[order] - at)
    unit = estimate.problem.rows.unit[white.entry]
    return _cross_fitted(J, residual, precision, moment, unit, first, seed).p


def _cross_fitted(J: Array, r: Array, precision: Array, moment: Array, unit: Integers, first: int, seed: int) -> Fall:
    """Fall by the columns from ``first`` on; units ``(M,)`` are predicted by the other four fifths."""
    names = np.unique(unit)
    part = (np.random.default_rng(seed).permutation(len(names)) % FOLDS)[np.searchsorted(names, unit)]
    gram = J.T @ J + precision
    before, after = np.zeros(len(r)), np.zeros(len(r))
    for k in range(FOLDS):
        test = part == k
        A = gram - J[test].T @ J[test]
        b = moment - J[test].T @ r[test]
        null = _solution(A[:first, :first], b[:first])
        full = _solution(A, b)
        before[test] = (r[test] - J[test, :first] @ null) ** 2
        after[test] = (r[test] - J[test] @ full) ** 2
    return _fall(before, after, unit, seed)


def _solution(normal: Array, moment: Array) -> Array:
    """Least-norm solution ``(P,)`` of normal equations. From eigenvalues, whose search ends at any range of sizes."""
    return np.asarray(np.linalg.pinv(normal, rcond=len(normal) * np.finfo(float).eps, hermitian=True) @ moment)
