"""The score test: how much of a residual a candidate explains that the active parameters cannot absorb.

Residual and columns are whitened. The columns D are projected off the span Q of the active parameters' Jacobian, prior
rows included, because what the model could absorb is not evidence. No candidate is refitted.

The null distribution comes from sign flips of the residual by unit: a pose, or a block of a log. The maximum of -ln p
over all candidates (Westfall-Young) controls false alarms over everything tested. p-values of different candidates must
be comparable. Each is therefore computed from the mean and variance of the candidate's own statistic under flips.
(Entries of a unit share noise. With plain chi-square tails, candidates with hundreds of columns would get far too small
p-values, and would alone set the maximum.)

The pseudo-rows of a prior have a known variance. In the null they are drawn from the normal distribution, not flipped:
a pull of eight standard deviations on a prior keeps its size under any flip.

With Z = (1 - QQ')D only products such as Z'Z = D'D - (Q'D)'(Q'D) are formed.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import linalg

from clampid.evidence.candidates import Candidate
from clampid.evidence.joined import Joined
from clampid.evidence.of_size import of_any_size, of_size
from clampid.evidence.space import ABSORBED, Space
from clampid.evidence.studentised import MOST_DIRECTIONS, MOST_UNITS, Studentised, studentised
from clampid.evidence.tails import log_tail
from clampid.stages.rows import Array, Bools

__all__ = [
    "Scored",
    "canonical",
    "explained_by",
    "explained_together",
    "flip_moments",
    "followed",
    "score",
    "tail_of",
]


ENOUGH = -50.0  # ln p that a candidate would have if all of many units agreed: it is not limited by their number
WEAK_BELOW = 0.05  # share of a candidate's columns that the fit cannot absorb: with less, its test is weak
LEAST_SHARE_OF_PRIOR = 1e-3  # information of the rows over that of the prior: directions with less are left out
SHORTEST_COLUMN = 1e-100  # length of a whitened column: the inverse square of less overflows
NEGLIGIBLE_EFFECT = 1e-6
"""Length of a column for a parameter of reasonable size, over the noise: a smaller one is rounding error.

The weight of an upright arm turns no joint with a vertical axis: its torque comes out as 1e-16 Nm.
"""
COLUMNS_AT_ONCE = 512  # columns of candidates that are scored together: more saves no time and needs more memory


@dataclass(frozen=True)
class Scored:
    """A candidate with its score.

    Attributes
    ----------
    absorbed
        ``(r, k)``: Q'D.
    weights
        ``(k, f)``: the columns of Z times these weights are orthonormal: f directions.
    parts
        ``(U, f)``: share of each unit in the residual's components along these directions, under the null. For units of
        rows: corrected for the share of noise that the fit absorbed; flips change its sign. For a prior's pseudo-row:
        one standard deviation of it.
    amplitude
        ``(f,)``: components of the residual along these directions.
    kept
        ``(f,)``: share of each component that remains after shrinkage by the candidate's prior; 1 without a prior.
    cost
        Penalty for the degrees of freedom; ``explained - cost`` is twice the logarithm of the Bayes factor. With a
        prior: the logarithm of how much the rows narrow it, for the size with the largest Bayes factor. Without one:
        f ln(rows) (Schwarz), which assumes that the rows determine each parameter well. A named effect is charged at
        most the average over all sizes that its parameters may have (`clampid.evidence.of_size.of_any_size`), which is
        less if the rows determine it badly.
    explained
        Sum of squares that it explains, in units of the residual's variance.
    log_p
        Natural logarithm of the p-value, from the moments of its statistic under flips; or that of the other statistic
        on the same scale, if it is smaller (:func:`clampid.evidence.flips.with_null`).
    bic
        ``explained - cost``; the larger the better.
    retained
        Share of the columns that the active parameters cannot absorb.
    state
        ``absent`` (no effect on these rows), ``absorbed``, ``weak``, ``testable``, or ``implausible`` (a size or sign
        that is not possible).
    assumed
        Share of ``explained`` that comes from the pull of the fit on its prior, not from the rows.
    unit_limit
        ``(k,)``: standard error of each parameter if fitted alone, noise shared within units included; parameter units.
    studentised
        The other statistic, if units are few (:mod:`clampid.evidence.studentised`); else None.
    """

    candidate: Candidate
    absorbed: Array
    weights: Array
    parts: Array
    amplitude: Array
    kept: Array
    cost: float
    explained: float
    log_p: float
    bic: float
    retained: float
    state: str
    assumed: float
    unit_limit: Array
    studentised: Studentised | None = None

    def by_either(self, scale: Callable[[Array], Array]) -> Scored:
        """The same with the p-value of the other statistic, if that is the smaller one on the scale of the first."""
        if self.studentised is None or not self.freedom:
            return self
        other = -float(scale(-self.studentised.log_p(self.amplitude, np.ones(len(self.parts)))))
        return replace(self, log_p=min(self.log_p, other + self.studentised.log_tried))

    @property
    def remembered(self) -> Scored:
        """The same without ``parts`` and ``studentised``, which are not needed after the null has been drawn."""
        return replace(self, parts=self.parts[:0].copy(), studentised=None)

    def of_many(self, log_p: float, cost: float) -> Scored:
        """The best of many tried: with the p-value that allows for all of them, and the cost of having chosen."""
        return replace(self, log_p=min(log_p, 0.0), cost=self.cost + cost, bic=self.bic - cost)

    @property
    def freedom(self) -> int:
        """Independent directions of the candidate in these rows."""
        return int(self.weights.shape[1])

    def directions(self, basis: Array) -> Array:
        """The candidate's orthonormal directions ``(M + p, f)``, outside the basis ``(M + p, r)`` of the fit's span."""
        out = self.candidate.columns.combined(self.weights, len(basis))
        out -= basis @ (self.absorbed @ self.weights)
        return out

    @property
    def value(self) -> Array:
        """Estimate of the parameters ``(k,)`` by one linear step from zero, SI."""
        return np.asarray(self.weights @ (self.kept * self.amplitude))

    @property
    def spread(self) -> Array:
        """Standard error of :attr:`value` ``(k,)`` for a residual of unit scale, SI."""
        return np.asarray(np.sqrt(np.sum((self.weights * self.kept) ** 2, axis=1)))


def explained_by(s: Scored, amplitude: Array, scale: float) -> Array:
    """Sum of squares ``(...)`` explained by components ``(..., f)`` along a candidate's directions, over the variance.

    Parameters
    ----------
    s
        The candidate.
    amplitude
        Components of a residual along its directions.
    scale
        Standard deviation of the residual.
    """
    return np.asarray(np.sum(s.kept * amplitude**2, axis=-1) / scale**2)


def flip_moments(parts: Array, kept: Array, scale: float, drawn: Bools) -> tuple[float, float]:
    """Mean and variance under the null of what a candidate explains.

    Let p_u be the part of unit u, s_u its random factor, and K = diag(kept). The statistic (sum_u s_u p_u)' K (sum_u
    s_u p_u) has the mean sum_u p_u' K p_u and the variance 2 (|B|^2 - sum_u (p_u' K p_u)^2) with B = sum_u K^1/2 p_u
    p_u' K^1/2. The last sum is over units with a random sign only, whose square is constant.

    Parameters
    ----------
    parts, kept, scale
        As :class:`Scored` has them, and the standard deviation of the residual.
    drawn
        ``(U,)``: units whose factor is a standard normal number instead of a sign.
    """
    weighted = parts * (np.sqrt(kept) / scale)
    gram = weighted.T @ weighted
    own = np.sum(weighted**2, axis=1)
    return float(own.sum()), 2.0 * float(np.sum(gram**2) - own[~drawn] @ own[~drawn])


def tail_of(moments: tuple[float, float], explained: Array | float) -> Array:
    """Natural logarithm of the p-value of ``explained``, given its mean and variance under the null.

    A scaled chi-square distribution with these moments is used. Source: Satterthwaite, An approximate distribution of
    estimates of variance components, Biometrics Bulletin 2, 1946.
    """
    mean, variance = moments
    if variance <= 1e-9 * mean**2:  # all of it lies in one unit: flips change nothing, so the p-value is 1
        return np.zeros_like(np.asarray(explained, dtype=float))
    return log_tail(np.asarray(explained) * (2.0 * mean / variance), 2.0 * mean**2 / variance)


def score(space: Space, candidates: Sequence[Candidate]) -> list[Scored]:
    """Score every candidate, in the given order; those without any effect on these rows have the state ``absent``."""
    out = list[Scored]()
    for some, lines in Joined([c.columns for c in candidates]).batches(space.basis, COLUMNS_AT_ONCE):
        by_unit = some.summed(space.by_unit) - lines @ space.basis_by_unit.T
        own = zip(candidates[len(out) :], some.own(lines), some.own(by_unit), strict=False)
        out += [_score_one(space, *one) for one in own]
    return out


def _score_one(space: Space, c: Candidate, lines: Array, by_unit: Array) -> Scored:
    """Score one candidate.

    Parameters
    ----------
    lines, by_unit
        Products of its columns with the basis ``(k, r)``, and each unit's share in their products with the residual
        ``(k, U)``.
    """
    columns, k = c.columns, c.columns.width
    gram = columns.gram()
    length = np.sqrt(np.diag(gram))
    absorbed = lines.T.copy()  # a view would keep those of all candidates
    Z2 = gram - absorbed.T @ absorbed
    left = np.sqrt(np.maximum(np.diag(Z2), 0.0))
    unit_limit = np.where(left > 0, space.scale / np.where(left > 0, left, 1.0), np.inf)
    seen = length > SHORTEST_COLUMN
    if c.reasonable is not None:
        seen &= length * c.reasonable > NEGLIGIBLE_EFFECT * space.scale
    none = np.zeros((k, 0))

    def nothing(retained: float, state: str) -> Scored:
        zero = np.zeros(0)
        return Scored(c, absorbed, none, none, zero, zero, 0.0, 0.0, 0.0, -np.inf, retained, state, 0.0, unit_limit)

    if not seen.any():
        return nothing(0.0, "absent")
    # Columns are scaled to unit length before the projection: a direction that keeps less than a millionth is absorbed.
    # With a prior they are scaled by it: the eigenvalues are then the rows' information over the prior's.
    inverse = np.where(seen, 1.0 / np.where(seen, length, 1.0), 0.0)
    retained = float(np.clip(np.sum(left[seen] ** 2 * inverse[seen] ** 2) / np.count_nonzero(seen), 0.0, 1.0))
    least = ABSORBED
    if c.prior is not None:
        inverse, least = c.prior / space.scale, LEAST_SHARE_OF_PRIOR
    values, vectors = linalg.eigh(Z2 * np.outer(inverse, inverse))
    keep = values > least
    if not keep.any():
        return nothing(retained, "absorbed")
    values = values[keep]
    weights = inverse[:, None] * vectors[:, keep] / np.sqrt(values)
    amplitude = columns.times(space.residual) @ weights  # the residual is orthogonal to the basis
    parts = by_unit.T @ weights
    # A candidate's columns are zero in the pseudo-rows: only their projection counts there.
    parts[space.drawn] = -(space.pseudo_std[:, None] * space.basis[space.rows :]) @ absorbed @ weights
    kept, cost, size = np.ones(len(values)), len(values) * float(np.log(max(space.rows, 2))), 1.0
    if c.prior is not None:
        size = c.sizes[int(np.argmax(of_size(np.array(c.sizes), values, amplitude / space.scale)))]
        values = size**2 * values
        kept, cost = values / (1.0 + values), float(np.sum(np.log1p(values)))
    elif c.reasonable is not None:
        lengths = np.where(seen, length, 0.0)
        reach = c.reasonable[:, None] * lengths[:, None] * vectors[:, keep] * np.sqrt(values)
        cost = min(cost, _charge(reach, amplitude, space))
    explained = float(kept @ amplitude**2) / space.scale**2
    moments = flip_moments(parts, kept, space.scale, space.drawn)
    found = Scored(
        candidate=c.of_size(size),
        absorbed=absorbed,
        weights=weights,
        parts=parts,
        amplitude=amplitude,
        kept=kept,
        cost=cost,
        explained=explained,
        log_p=min(float(tail_of(moments, explained)) + float(np.log(len(c.sizes))), 0.0),  # Bonferroni over the sizes
        bic=explained - cost,
        retained=retained,
        state="weak" if retained < WEAK_BELOW else "testable",
        assumed=float(
            np.sum((parts[space.drawn] @ (kept * amplitude)) ** 2) / max(np.sum((kept * amplitude) ** 2), 1e-300)
        ),
        unit_limit=unit_limit * np.sqrt(max(moments[0] / float(kept.sum()), 1.0)),
    )
    shown = np.linalg.norm(parts[~space.drawn] * np.sqrt(kept), axis=1)
    of_many = len(shown) > MOST_UNITS and tail_of(moments, shown.sum() ** 2 / space.scale**2) < ENOUGH
    if of_many or len(kept) > MOST_DIRECTIONS:
        return found
    return replace(found, studentised=studentised(space, found.directions(space.basis), parts, kept, len(c.sizes)))


def _charge(reach: Array, amplitude: Array, space: Space) -> float:
    """Cost of a candidate's degrees of freedom: what it explains, less twice its log evidence averaged over sizes.

    Parameters
    ----------
    reach
        ``(k, f)``: effect of each parameter, at its reasonable size, on the components ``amplitude`` of the residual.
    """
    # gesvd: the quicker routine fails now and then where the sizes span twenty decades.
    _, gain, turn = linalg.svd(reach / space.scale, full_matrices=False, lapack_driver="gesvd")
    component = turn @ amplitude / space.scale
    return float(component @ component) - 2.0 * of_any_size(gain**2, component)


def _overlap(a: Scored, b: Scored) -> Array:
    """Inner products ``(f_a, f_b)`` of the orthonormal directions of two candidates."""
    cross = a.candidate.columns.cross(b.candidate.columns) - a.absorbed.T @ b.absorbed
    return np.asarray(a.weights.T @ cross @ b.weights)


def canonical(a: Scored, b: Scored) -> float:
    """Largest squared canonical correlation of two candidates, 0 to 1.

    A candidate with a prior can follow nearly everything. For it, the result is the share of its estimate on these rows
    that the other candidate can follow.
    """
    if not a.freedom or not b.freedom:
        return 0.0
    for s, other in ((a, b), (b, a)):
        if s.candidate.prior is not None:
            return followed(s, other)
    return min(float(np.linalg.norm(_overlap(a, b), 2)) ** 2, 1.0)


def followed(s: Scored, other: Scored) -> float:
    """Share of the squares of a candidate's estimate on these rows that another candidate can follow, 0 to 1."""
    if not s.freedom or not other.freedom:
        return 0.0
    found = s.kept * s.amplitude
    shared = found @ _overlap(s, other)
    return min(float(shared @ shared) / max(float(found @ found), 1e-300), 1.0)


def explained_together(space: Space, a: Scored, b: Scored) -> float:
    """Sum of squares that two candidates explain together, in units of the residual's variance."""
    cross = _overlap(a, b)
    amplitude = np.r_[a.amplitude, b.amplitude]
    gram = np.block([[np.diag(1.0 / a.kept), cross], [cross.T, np.diag(1.0 / b.kept)]])
    return float(amplitude @ np.linalg.pinv(gram, rcond=1e-6, hermitian=True) @ amplitude) / space.scale**2
