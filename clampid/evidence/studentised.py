"""What a candidate explains, over what the fit with it leaves in the same directions: the statistic of few units.

The variance of a candidate's components comes from the units. In the residual of the fit without the candidate, a true
effect is part of that variance: if it shows in six units, one of 32 patterns of signs explains as much, and no p is
small. In the residual of the fit with the candidate its own share is left out.

The components a of the residual along f orthonormal directions are sums over units of parts p_u. H_u is each unit's
share of the directions' squares (their sum is one). The fit with the candidate leaves e_u = p_u - H_u a, and with
K = diag(kept) the statistic is a'Ka / sum_u e_u'K^1/2 (1 - H_u)^-1 K^1/2 e_u: the inverse makes up for the noise of a
unit that the candidate absorbs. Its p-value is that of an F distribution, with the degrees of freedom of white noise.
Flips of signs calibrate it. It is the better one where an effect shows in few units, and the worse one where few units
hold most of the noise; so the more significant of both counts (:mod:`clampid.evidence.flips`).

Sources: Cameron, Gelbach and Miller, Bootstrap-based improvements for inference with clustered errors, Rev. Econ. Stat.
90, 2008 (studentised statistics where clusters are few); Bell and McCaffrey, Survey Methodology 28, 2002 (CR2);
Brunner, Dette and Munk, J. Am. Stat. Assoc. 92, 1997 (ratio of traces with Satterthwaite's degrees of freedom).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clampid.evidence.space import Space
from clampid.evidence.tails import log_tail_of_f
from clampid.stages.rows import Array

__all__ = ["MOST_DIRECTIONS", "MOST_UNITS", "Studentised", "studentised"]

MOST_UNITS = 199  # above it a candidate has this statistic only if few of them show it: it takes longer
MOST_DIRECTIONS = 32  # of a candidate: with more, units determine no variance
LEAST_FREEDOM = 0.5
LEAST_LEFT = 1e-3  # of a unit's noise, that the candidate leaves: less is rounding error, and is not enlarged further


@dataclass(frozen=True)
class Studentised:
    """The denominator of the statistic for any signs of the units.

    Attributes
    ----------
    kept
        ``(f,)``: K.
    own
        The sum of the units' own squares, without the candidate.
    crossed
        ``(U, f)``: its products with the components, by unit.
    square
        ``(f, f)``: its square in the components.
    freedom
        Degrees of freedom of numerator and denominator.
    log_tried
        Logarithm of how many sizes of its prior were tried: added to the logarithm of its p-value.
    """

    kept: Array
    own: float
    crossed: Array
    square: Array
    freedom: tuple[float, float]
    log_tried: float = 0.0

    def log_p(self, amplitude: Array, signs: Array) -> Array:
        """Natural logarithm of the p-value of components ``(…, f)``, where the units have factors ``(…, U)``."""
        explained = np.sum(self.kept * amplitude**2, axis=-1)
        crossed = np.sum((signs @ self.crossed) * amplitude, axis=-1)
        left = self.own - 2.0 * crossed + np.sum((amplitude @ self.square) * amplitude, axis=-1)
        first, second = self.freedom
        return log_tail_of_f(explained / np.maximum(left, 1e-12 * self.own + 1e-300), first, second)


def studentised(space: Space, directions: Array, parts: Array, kept: Array, tried: int = 1) -> Studentised:
    """The statistic of a candidate.

    Parameters
    ----------
    space
        The residual.
    directions
        Its orthonormal directions ``(M + p, f)``, pseudo-rows of the prior included.
    parts, kept
        As :class:`clampid.evidence.score.Scored` has them.
    tried
        Sizes of its prior that were tried.
    """
    share = _by_unit(directions, space)
    flipped, root = ~space.drawn, np.sqrt(kept)
    weight = np.tile(np.diag(kept), (len(share), 1, 1))  # in pseudo-rows: their variance is known
    absorbed = np.eye(len(kept)) - (1.0 - LEAST_LEFT) * share[flipped]
    weight[flipped] = np.linalg.inv(absorbed) * np.outer(root, root)
    of_parts = (weight @ parts[:, :, None])[:, :, 0]
    crossed = (share @ of_parts[:, :, None])[:, :, 0]
    crossed[space.drawn] = 0.0
    square = np.sum(share[flipped] @ weight[flipped] @ share[flipped], axis=0)
    own = float(np.sum(parts * of_parts))
    weighted = share * kept
    first = float(kept.sum()) ** 2 / max(float(np.sum(kept**2)), 1e-300)
    spread = float(np.einsum("ukl,ulk->", weighted[flipped], weighted[flipped]))  # of what is not known
    second = max(float(np.einsum("ukk->", weighted)) ** 2 / max(spread, 1e-300) - first, LEAST_FREEDOM)
    return Studentised(kept, own, crossed, square, (first, second), float(np.log(tried)))


def _by_unit(directions: Array, space: Space) -> Array:
    """Squares ``(U, f, f)`` of directions ``(M + p, f)`` in each unit."""
    f, sums = directions.shape[1], space.over_units
    out = np.empty((sums.shape[0], f, f))
    for k in range(f):
        out[:, k, k:] = out[:, k:, k] = sums @ (directions[:, k:] * directions[:, k, None])
    return out
