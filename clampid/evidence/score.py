"""The score test: what candidates explain of a residual, beyond what the active parameters could still absorb.

Residual and columns are whitened; the columns are projected off the span of the active parameters' Jacobian (prior rows
included), so that what the model could take up is not evidence. No candidate is refitted. The null is a sign flip of
the residual by pose or block: the maximum of -ln p over the whole dictionary (Westfall-Young) controls false alarms
over everything that was looked at. So that one candidate's p means what another's does, each is read off the moments
that its own flips have: entries of a unit share noise that the scale of single entries does not know, and of a
candidate with hundreds of columns plain chi-square tails are then so far off that its flips alone would set the
maximum. What a prior says has no unknown scale: its pseudo-rows are normal with the variance that it states, and in the
null they are drawn, not flipped: a pull of eight standard deviations on one of them stays as large however it is
flipped. With Z = (1 - QQ')D only products such as Z'Z = D'D - (Q'D)'(Q'D) are ever formed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import linalg
from scipy.special import gammainc, gammaincc, gammaln

from clampid.evidence.candidates import Candidate
from clampid.evidence.columns import Joined
from clampid.evidence.of_size import of_any_size, of_size
from clampid.evidence.space import ABSORBED, Space
from clampid.stages.rows import Array, Bools

__all__ = [
    "Flips",
    "Scored",
    "canonical",
    "explained_by",
    "explained_together",
    "flip_maxima",
    "flip_moments",
    "log_tail",
    "score",
    "tail_of",
]


WEAK_BELOW = 0.05
LEAST_SHARE_OF_PRIOR = 1e-3  # of a parameter's prior information: what the rows say less about is not worth a direction
SHORTEST_COLUMN = 1e-100  # of whitened columns: the inverse square of less is no number
UNSEEN = 1e-6
"""Of the noise: what moves all rows together by less, at the parameter's plausible size, is rounding and no lever.

The weight of an upright arm turns no joint with a vertical axis: its torque comes out as 1e-16 Nm.
"""
COLUMNS_AT_ONCE = 512  # columns of candidates that are scored together: more would gain no time, and take memory
SMALLEST_TAIL = 1e-290  # a smaller tail than this may have underflowed


@dataclass(frozen=True)
class Scored:
    """A candidate with its score.

    Attributes
    ----------
    absorbed
        ``(r, k)``: Q'D.
    weights
        ``(k, f)``: Z times these is orthonormal.
    parts
        ``(U, f)``: what each unit adds in the null to the residual's components in these directions: of rows what it
        would have added before the fit took its share, with a sign that flips turn; of a prior's pseudo-row what one
        standard deviation of it would.
    amplitude
        ``(f,)``: these components.
    kept
        ``(f,)``: the share of each that its prior lets it take, 1 without a prior.
    cost
        Penalty for its degrees of freedom: explained less cost is twice the logarithm of its Bayes factor: with a
        prior, the logarithm of how much the rows narrow it (where its sizes are open, of the one with the largest
        factor); else f ln(rows) (Schwarz), as if the rows determined each parameter as well as they can. A named effect
        that the rows determine less well is charged at most the mean over all sizes that its parameters may have
        (`clampid.evidence.of_size.of_any_size`).
    explained
        Sum of squares that it explains, in units of the residual's variance.
    log_p
        Natural logarithm of the p-value by the moments of its flips.
    bic
        Explained less cost; the larger the better.
    retained
        Share of the columns that the active parameters cannot absorb.
    state
        ``absent``, ``absorbed``, ``weak``, ``testable``, or ``implausible``: of a size or sign that cannot be.
    assumed
        Share of what it explains that is how far the fit was pulled off what the prior says, and not in the rows.
    unit_limit
        ``(k,)``: the residual's scale, as the candidate's flips have it, over each projected column's length,
        parameter units.
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

    @property
    def remembered(self) -> Scored:
        """The same without its parts, once the null has been drawn."""
        return replace(self, parts=self.parts[:0].copy())

    @property
    def freedom(self) -> int:
        """Independent directions of the candidate in these rows."""
        return int(self.weights.shape[1])

    def directions(self, columns: Array, basis: Array) -> Array:
        """Its orthonormal directions ``(M, f)``.

        Parameters
        ----------
        columns, basis
            Its whitened columns ``(M, k)``, and the basis ``(M, r)`` of what the fit absorbs.
        """
        return np.asarray((columns - basis @ self.absorbed) @ self.weights)

    @property
    def value(self) -> Array:
        """One step from zero ``(k,)``: what the score makes of the parameters, SI."""
        return np.asarray(self.weights @ (self.kept * self.amplitude))

    @property
    def spread(self) -> Array:
        """What a unit of the residual's scale moves :attr:`value` by ``(k,)``, SI."""
        return np.asarray(np.sqrt(np.sum((self.weights * self.kept) ** 2, axis=1)))


def explained_by(s: Scored, amplitude: Array, scale: float) -> Array:
    """The sum of squares that amplitudes ``(..., f)`` in a candidate's directions explain, in units of variance."""
    return np.asarray(np.sum(s.kept * amplitude**2, axis=-1) / scale**2)


def flip_moments(parts: Array, kept: Array, scale: float, drawn: Bools) -> tuple[float, float]:
    """Mean and variance of what a candidate explains over all sign flips of the units, and draws of those ``drawn``.

    With p_u a unit's part, the sum over directions of k (sum_u s_u p_u)^2 has the mean sum_u p_u' K p_u and the
    variance 2 (|B|^2 - sum_u (p_u' K p_u)^2), B the sum of K^1/2 p_u p_u' K^1/2, the last sum over units whose s_u is a
    sign (its square never varies) and not a normal number. No flip changes either.
    """
    weighted = parts * (np.sqrt(kept) / scale)
    gram = weighted.T @ weighted
    own = np.sum(weighted**2, axis=1)
    return float(own.sum()), 2.0 * float(np.sum(gram**2) - own[~drawn] @ own[~drawn])


def tail_of(moments: tuple[float, float], explained: Array | float) -> Array:
    """Natural logarithm of the chance to explain so much where nothing is missing, given its mean and variance.

    By the multiple of a chi-square with these moments. Source: Satterthwaite, An approximate distribution of estimates
    of variance components, Biometrics Bulletin 2, 1946.
    """
    mean, variance = moments
    if variance <= 1e-9 * mean**2:  # one unit holds it all: no flip changes anything
        return np.zeros_like(np.asarray(explained, dtype=float))
    return log_tail(np.asarray(explained) * (2.0 * mean / variance), 2.0 * mean**2 / variance)


def log_tail(x: Array | float, freedom: float) -> Array:
    """Natural logarithm of the chi-square tail, also where the tail itself is too small for a number."""
    value = np.asarray(x, dtype=float)
    a, half = freedom / 2.0, np.maximum(value, 1e-300) / 2.0  # of zero there is no logarithm
    tail = gammaincc(a, half)
    tiny = tail < SMALLEST_TAIL
    tail_or_one = np.where(tiny, 1.0, tail)
    near = np.where(half < a, np.log1p(-gammainc(a, np.minimum(half, a))), np.log(tail_or_one))
    # Leading term of its expansion, summed as a geometric series; where the tail is tiny, half is well above a.
    far = a * np.log(half) - half - float(gammaln(a)) - np.log(np.where(tiny, half - a + 1.0, 1.0))
    return np.asarray(np.where(tiny, far, near))


def score(space: Space, candidates: Sequence[Candidate]) -> list[Scored]:
    """Score every candidate; those without any effect on these rows come back as ``absent``."""
    if not candidates:
        return []
    joined = Joined([c.columns for c in candidates])
    out = list[Scored]()
    for some, lines in joined.batches(joined.times(space.basis), COLUMNS_AT_ONCE):
        by_unit = some.summed(space.by_unit) - lines @ space.basis_by_unit.T
        own = zip(candidates[len(out) :], some.own(lines), some.own(by_unit), strict=False)
        out += [_score_one(space, *one) for one in own]
    return out


def _score_one(space: Space, c: Candidate, lines: Array, by_unit: Array) -> Scored:
    """Score one, of which the products with the basis ``(k, r)`` and each unit's shares ``(k, U)`` are known."""
    k = c.columns.width
    gram = c.columns.gram()
    length = np.sqrt(np.diag(gram))
    absorbed = lines.T.copy()  # a view would keep those of all candidates
    Z2 = gram - absorbed.T @ absorbed
    left = np.sqrt(np.maximum(np.diag(Z2), 0.0))
    unit_limit = np.where(left > 0, space.scale / np.where(left > 0, left, 1.0), np.inf)
    seen = length > SHORTEST_COLUMN
    if c.reasonable is not None:
        seen &= length * c.reasonable > UNSEEN * space.scale
    none = np.zeros((k, 0))

    def nothing(retained: float, state: str) -> Scored:
        zero = np.zeros(0)
        return Scored(c, absorbed, none, none, zero, zero, 0.0, 0.0, 0.0, -np.inf, retained, state, 0.0, unit_limit)

    if not seen.any():
        return nothing(0.0, "absent")
    # Columns of unit length before the projection: a direction that keeps less than a millionth of itself is absorbed.
    # With a prior, columns in units of it over the residual's scale: values are the rows' information over the prior's.
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
    amplitude = c.columns.times(space.residual) @ weights  # the residual is off the basis
    parts = by_unit.T @ weights
    # Of a candidate's own columns pseudo-rows have none.
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
    return Scored(
        candidate=c.of_size(size),
        absorbed=absorbed,
        weights=weights,
        parts=parts,
        amplitude=amplitude,
        kept=kept,
        cost=cost,
        explained=explained,
        log_p=min(float(tail_of(moments, explained)) + float(np.log(len(c.sizes))), 0.0),  # Bonferroni's
        bic=explained - cost,
        retained=retained,
        state="weak" if retained < WEAK_BELOW else "testable",
        assumed=float(
            np.sum((parts[space.drawn] @ (kept * amplitude)) ** 2) / max(np.sum((kept * amplitude) ** 2), 1e-300)
        ),
        unit_limit=unit_limit * np.sqrt(max(moments[0] / float(kept.sum()), 1.0)),
    )


def _charge(reach: Array, amplitude: Array, space: Space) -> float:
    """What a candidate's freedom costs: what it explains, less twice the logarithm of its evidence at any size.

    Parameters
    ----------
    reach
        ``(k, f)``: what a reasonable size of each parameter moves the residual along the directions of ``amplitude``.
    """
    _, gain, turn = np.linalg.svd(reach / space.scale, full_matrices=False)
    component = turn @ amplitude / space.scale
    return float(component @ component) - 2.0 * of_any_size(gain**2, component)


def _overlap(a: Scored, b: Scored) -> Array:
    """Inner products ``(f_a, f_b)`` of the orthonormal directions of two candidates."""
    cross = a.candidate.columns.cross(b.candidate.columns) - a.absorbed.T @ b.absorbed
    return np.asarray(a.weights.T @ cross @ b.weights)


def canonical(a: Scored, b: Scored) -> float:
    """Largest squared canonical correlation of two candidates, 0 to 1.

    Of a candidate with a prior, which can follow nearly everything, the share of what it found here that the other
    could have found.
    """
    if not a.freedom or not b.freedom:
        return 0.0
    for s, other in ((a, b), (b, a)):
        if s.candidate.prior is not None:
            found = s.kept * s.amplitude
            shared = found @ _overlap(s, other)
            return min(float(shared @ shared) / max(float(found @ found), 1e-300), 1.0)
    return min(float(np.linalg.norm(_overlap(a, b), 2)) ** 2, 1.0)


def explained_together(space: Space, a: Scored, b: Scored) -> float:
    """What two candidates explain together, in units of the residual's variance."""
    cross = _overlap(a, b)
    amplitude = np.r_[a.amplitude, b.amplitude]
    gram = np.block([[np.diag(1.0 / a.kept), cross], [cross.T, np.diag(1.0 / b.kept)]])
    return float(amplitude @ np.linalg.pinv(gram, rcond=1e-6, hermitian=True) @ amplitude) / space.scale**2


@dataclass(frozen=True)
class Flips:
    """Maxima of -ln p over a dictionary for sign-flipped residuals ``(flips,)``."""

    maxima: Array

    def p_familywise(self, log_p: float) -> float:
        """Chance of as small a p-value anywhere in the dictionary if nothing is missing; at least 1/(flips + 1)."""
        return float((1 + np.sum(self.maxima >= -log_p)) / (len(self.maxima) + 1))

    def critical_log_p(self, rate: float) -> float:
        """The ln p that a candidate must undercut to be confirmed at this false-alarm rate."""
        return -float(np.quantile(self.maxima, 1 - rate))

    def joined(self, tests: int, seed: int) -> Flips:
        """The same with further tests in the dictionary that have p-values of their own: -ln p is exponential."""
        drawn = np.random.default_rng([seed, tests]).exponential(size=(len(self.maxima), tests))
        return Flips(np.maximum(self.maxima, drawn.max(axis=1, initial=0.0)))


def flip_maxima(space: Space, scored: Sequence[Scored], flips: int, seed: int) -> Flips:
    """Sign-flip null over a dictionary, with draws of what a prior says: one matrix product."""
    chosen = [s for s in scored if s.freedom]
    if not chosen:
        return Flips(np.zeros(flips))
    rng = np.random.default_rng(seed)
    signs = rng.choice([-1.0, 1.0], size=(flips, len(chosen[0].parts)))
    signs[:, space.drawn] = rng.normal(size=(flips, int(space.drawn.sum())))
    amplitude = signs @ np.hstack([s.parts for s in chosen])
    kept, starts = np.concatenate([s.kept for s in chosen]), np.cumsum([0, *(s.freedom for s in chosen[:-1])])
    explained = np.add.reduceat(amplitude**2 * kept, starts, axis=1) / space.scale**2
    moments = [flip_moments(s.parts, s.kept, space.scale, space.drawn) for s in chosen]
    tails = [tail_of(m, x) for m, x in zip(moments, explained.T, strict=True)]
    return Flips(-np.min(tails, axis=0))
