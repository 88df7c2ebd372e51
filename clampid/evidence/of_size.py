"""Marginal likelihood of the size of a prior, for effects that have many small amplitudes.

A fit says all that its rows know of some amplitudes z: a Gaussian, the rest of the model integrated out (``L`` is the
rows' information, ``h`` information times estimate). With a normal prior of covariance S on them, about zero, the
evidence against all of them being zero is exact::

    ln evidence = 1/2 h' (S^-1 + L)^-1 h - 1/2 ln det(1 + S L)

Of an effect whose amplitudes' size is not known, the size with the largest evidence is taken: a larger one would let
noise into them, a smaller one hold them back. Source: MacKay, Bayesian interpolation, Neural Computation 4, 1992.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy import linalg, optimize, special

from clampid.fitting.descent import inverse_of
from clampid.fitting.solve import Estimate
from clampid.slots import Slot
from clampid.stages.rows import Array, Integers

__all__ = ["ANY_SIZE", "SIZES", "evidence", "of_any_size", "of_size", "rows_say", "sized"]

SIZES = (1.0, 0.5, 0.25, 0.125, 0.0625)
"""Of the size that an effect states, which is the upper end of what there is: those that a score tries."""

SPAN = (float(np.log(0.01)), float(np.log(10.0)))
"""Logarithm of the same, within which a fit looks for it."""


ANY_SIZE = np.geomspace(1e-3, 1e2, 21)
"""Of an effect's reasonable size, in quarter decades: from what no instrument would show to what cannot be."""


def evidence(information: Array, score: Array, prior: Array) -> tuple[float, Array]:
    """Logarithm of the evidence against zero, and the posterior mean ``(k,)``.

    Parameters
    ----------
    information, score, prior
        L ``(k, k)``, h ``(k,)``, and the square root of the diagonal of S ``(k,)``.
    """
    A = np.eye(len(prior)) + information * np.outer(prior, prior)
    factor = linalg.cho_factor(A)
    z = linalg.cho_solve(factor, prior * score)
    return 0.5 * float(prior * score @ z) - float(np.sum(np.log(np.diag(factor[0])))), prior * z


def of_size(size: Array | float, information: Array, component: Array) -> Array:
    """Logarithm of the evidence ``(...)`` for the prior times ``size`` ``(...)``, in its eigendirections.

    Parameters
    ----------
    information, component
        ``(k,)``: eigenvalues of S^1/2 L S^1/2, and h there divided by their square roots: of unit variance where the
        amplitudes are zero.
    """
    ratio = np.multiply.outer(np.square(size), information)
    return np.asarray(0.5 * (np.sum(ratio / (1.0 + ratio) * component**2, axis=-1) - np.sum(np.log1p(ratio), axis=-1)))


def of_any_size(information: Array, component: Array) -> float:
    """Logarithm of the evidence with a prior whose size may be anything in :data:`ANY_SIZE`, each decade as likely.

    What an amplitude's freedom costs is then what the rows narrow it, however many there are: six compliances that the
    rows say little about are charged little, where a fixed charge for each would prefer one wrong number to six right
    ones. Arguments as in :func:`of_size`.
    """
    found = of_size(ANY_SIZE, information, component)
    return float(special.logsumexp(found) - np.log(len(ANY_SIZE)))


def rows_say(estimate: Estimate, chosen: Integers) -> tuple[Array, Array]:
    """What a fit's rows, and not its prior, say of the parameters ``chosen`` ``(k,)``: L ``(k, k)`` and h ``(k,)``.

    As if all numbers were independent: the estimate's own covariance counts what the points of a visit share, and is
    not the inverse of an information. The prior of the chosen must be about zero, and of each alone.
    """
    white, r = estimate.whitened, estimate.whitened.residual
    inverse = inverse_of(white.normal + estimate.prior_precision)
    determined = len(estimate.theta) - float(np.sum(inverse * estimate.prior_precision))  # by the rows, not the prior
    scale = max(float(r @ r) / max(len(r) - determined, 1.0), 1e-12)
    posterior = inverse_of(inverse[np.ix_(chosen, chosen)] * scale)
    assumed = np.diag(np.diag(estimate.prior_precision)[chosen])
    return posterior - assumed / scale, posterior @ estimate.theta[chosen]


def sized(estimate: Estimate, name: str) -> dict[Slot, float]:
    """Values of an effect's slots with its amplitudes' prior of the size that has the largest evidence.

    Parameters
    ----------
    name
        Of an effect whose amplitudes' size is a parameter of its own (:attr:`clampid.effect.Effect.sized_by`).
    """
    own = {slot: k for k, slot in enumerate(estimate.slots) if slot.effect == name}
    size = next(slot for slot in own if slot.parameter == estimate.problem.effects[name].sized_by)
    values = estimate.values()
    amplitudes = np.array([k for slot, k in own.items() if not estimate.problem.parameters[k].shape], dtype=np.int64)
    information, score = rows_say(estimate, amplitudes)
    prior = estimate.problem.prior_std()[amplitudes]
    ratio, vectors = linalg.eigh(information * np.outer(prior, prior))
    seen = ratio > 1e-9
    component = (prior * score @ vectors[:, seen]) / np.sqrt(ratio[seen])
    found = optimize.minimize_scalar(
        lambda x: -float(of_size(np.exp(x), ratio[seen], component)), bounds=SPAN, method="bounded"
    )
    factor = float(np.exp(found.x))
    return _scaled(values, own, size, factor)


def _scaled(values: Mapping[Slot, float], own: Mapping[Slot, int], size: Slot, factor: float) -> dict[Slot, float]:
    """The same curve, written with another size: amplitudes are counted in it."""
    return {slot: values[slot] * factor if slot == size else values[slot] / factor for slot in own}
