"""Marginal likelihood of the size of a prior, for effects with many small amplitudes.

The likelihood of some amplitudes z of a linearised fit is Gaussian, with the rest of the model integrated out. ``L`` is
the information of the rows, ``h`` information times estimate. With a normal prior of mean zero and covariance S, the
evidence against all amplitudes being zero is exact::

    ln evidence = 1/2 h' (S^-1 + L)^-1 h - 1/2 ln det(1 + S L)

If the size of the amplitudes is not known, the size with the largest evidence is taken. A larger prior would fit noise;
a smaller one would shrink the amplitudes too much. Source: MacKay, Bayesian interpolation, Neural Computation 4, 1992.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy import linalg, optimize, special

from clampid.fitting.descent import inverse_of
from clampid.fitting.solve import Estimate
from clampid.slots import Slot
from clampid.stages.rows import Array, Integers

__all__ = ["ANY_SIZE", "SIZES", "evidence", "of_any_size", "of_size", "rows_information", "sized"]

SIZES = (1.0, 0.5, 0.25, 0.125, 0.0625)
"""Sizes that a score test tries, as shares of the size that the effect declares, the largest to be expected."""

LOG_SIZE_BOUNDS = (float(np.log(0.01)), float(np.log(10.0)))
"""Bounds of a fitted size: natural logarithm of its share of the declared size."""

ANY_SIZE = np.geomspace(1e-3, 1e2, 21)
"""Shares of a reasonable size, in quarter decades: from too small for any instrument to larger than any real effect."""


def evidence(information: Array, score: Array, prior: Array) -> tuple[float, Array]:
    """Logarithm of the evidence against zero amplitudes, and their posterior mean ``(k,)``.

    Parameters
    ----------
    information, score, prior
        L ``(k, k)``, h ``(k,)``, and the prior standard deviations ``(k,)``: S is diagonal.
    """
    A = np.eye(len(prior)) + information * np.outer(prior, prior)
    factor = linalg.cho_factor(A)
    z = linalg.cho_solve(factor, prior * score)
    return 0.5 * float(prior * score @ z) - float(np.sum(np.log(np.diag(factor[0])))), prior * z


def of_size(size: Array | float, information: Array, component: Array) -> Array:
    """Logarithm of the evidence ``(...)`` with the prior standard deviations times ``size`` ``(...)``.

    Parameters
    ----------
    information
        ``(k,)``: eigenvalues of S^1/2 L S^1/2.
    component
        ``(k,)``: S^1/2 h in the eigendirections, over the square roots of the eigenvalues; of unit variance if all
        amplitudes are zero.
    """
    ratio = np.multiply.outer(np.square(size), information)
    return np.asarray(0.5 * (np.sum(ratio / (1.0 + ratio) * component**2, axis=-1) - np.sum(np.log1p(ratio), axis=-1)))


def of_any_size(information: Array, component: Array) -> float:
    """Logarithm of the evidence averaged over all sizes in :data:`ANY_SIZE`, each decade equally likely.

    An amplitude then costs as much as the rows narrow its prior. Six compliances that the rows hardly narrow cost
    little. With a fixed cost for each parameter, one wrong parameter would be preferred to six right ones. Arguments as
    in :func:`of_size`.
    """
    found = of_size(ANY_SIZE, information, component)
    return float(special.logsumexp(found) - np.log(len(ANY_SIZE)))


def rows_information(estimate: Estimate, chosen: Integers) -> tuple[Array, Array]:
    """Information L ``(k, k)`` and h ``(k,)`` of a fit's rows, without its prior, on parameters ``chosen`` ``(k,)``.

    All numbers count as independent. (The estimate's own covariance includes noise that the points of a visit share; it
    is not the inverse of an information matrix.) The prior of the chosen parameters must have mean zero and be
    independent from parameter to parameter.
    """
    white, r = estimate.whitened, estimate.whitened.residual
    inverse = inverse_of(white.normal + estimate.prior_precision)
    determined = len(estimate.theta) - float(np.sum(inverse * estimate.prior_precision))  # by the rows, not the prior
    scale = max(float(r @ r) / max(len(r) - determined, 1.0), 1e-12)
    posterior = inverse_of(inverse[np.ix_(chosen, chosen)] * scale)
    assumed = np.diag(np.diag(estimate.prior_precision)[chosen])
    return posterior - assumed / scale, posterior @ estimate.theta[chosen]


def sized(estimate: Estimate, name: str) -> dict[Slot, float]:
    """Values of an effect's slots, its size set to the one with the largest evidence; SI.

    Parameters
    ----------
    estimate
        A fit that has the effect.
    name
        An effect with a parameter for the size of its amplitudes (:attr:`clampid.effect.Effect.sized_by`).
    """
    own = {slot: k for k, slot in enumerate(estimate.slots) if slot.effect == name}
    size = next(slot for slot in own if slot.parameter == estimate.problem.effects[name].sized_by)
    values = estimate.values()
    amplitudes = np.array([k for slot, k in own.items() if not estimate.problem.parameters[k].shape], dtype=np.int64)
    information, score = rows_information(estimate, amplitudes)
    prior = estimate.problem.prior_std()[amplitudes]
    ratio, vectors = linalg.eigh(information * np.outer(prior, prior))
    seen = ratio > 1e-9
    component = (prior * score @ vectors[:, seen]) / np.sqrt(ratio[seen])
    found = optimize.minimize_scalar(
        lambda x: -float(of_size(np.exp(x), ratio[seen], component)), bounds=LOG_SIZE_BOUNDS, method="bounded"
    )
    factor = float(np.exp(found.x))
    return _scaled(values, own, size, factor)


def _scaled(values: Mapping[Slot, float], own: Mapping[Slot, int], size: Slot, factor: float) -> dict[Slot, float]:
    """The same effect with its size multiplied by ``factor``: amplitudes are in units of the size."""
    return {slot: values[slot] * factor if slot == size else values[slot] / factor for slot in own}
