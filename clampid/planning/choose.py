"""D-optimal choice among candidate measurements: those with the largest determinant of the information.

A candidate has the information F Fᵀ, with a factor F ``(P, r)`` of few columns, in parameters scaled by their
reasonable size. With A the information so far, adding a candidate multiplies the determinant by det(I + Fᵀ A⁻¹ F), and
A⁻¹ is updated with the same small matrix. Removing a candidate multiplies the determinant by det(I - Fᵀ A⁻¹ F). No
determinant of size P is computed when candidates are added or exchanged.

Sources: Fedorov, Theory of Optimal Experiments, 1972 (exchange); Mitchell, An algorithm for the construction of
D-optimal experimental designs, Technometrics 16, 1974; the matrix determinant lemma and Woodbury's identity for the
updates.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

__all__ = ["choose", "exchange", "factor", "factors_of", "greedy", "log_det"]

Array = npt.NDArray[np.float64]
UPDATES_PER_INVERSION = 50  # after so many updates the inverse is computed again, which limits rounding errors
LEAST_GAIN = 1e-6  # of the log-determinant: candidates that add less are not taken


def factor(information: Array) -> Array:
    """A factor ``(P, r)`` of a positive semidefinite matrix ``(P, P)``, as narrow as its rank."""
    values, vectors = np.linalg.eigh(information)
    keep = values > 1e-12 * max(float(values[-1]), 1e-300)
    return np.asarray(vectors[:, keep] * np.sqrt(values[keep]))


def factors_of(informations: Sequence[Array]) -> Array:
    """Factors ``(c, P, r)`` of c matrices ``(P, P)``; narrower ones are filled with columns of zeros."""
    found = [factor(information) for information in informations]
    out = np.zeros((len(found), len(found[0]), max(F.shape[1] for F in found)))
    for k, F in enumerate(found):
        out[k, :, : F.shape[1]] = F
    return out


def log_det(information: Array) -> float:
    """Logarithm of the determinant of a matrix ``(P, P)``; minus infinity if the determinant is not positive."""
    sign, value = np.linalg.slogdet(information)
    return float(value) if sign > 0 else -np.inf


class _Design:
    """The information of the candidates chosen so far, with its inverse, which is updated with each change."""

    def __init__(self, information: Array) -> None:
        self.information = information.copy()
        self.inverse = np.linalg.inv(information)
        self._updates = 0

    def gains(self, factors: Array) -> Array:
        """Gain of the log-determinant ``(c,)`` by each candidate ``(c, P, r)``."""
        inner = np.swapaxes(factors, 1, 2) @ (self.inverse @ factors)
        return np.asarray(np.linalg.slogdet(np.eye(factors.shape[2]) + inner)[1])

    def change(self, F: Array, sign: float) -> None:
        """Add (``sign`` 1) or remove (``sign`` -1) a candidate ``(P, r)``."""
        self.information += sign * F @ F.T
        AF = self.inverse @ F
        inner = sign * np.eye(F.shape[1]) + F.T @ AF
        self.inverse -= AF @ np.linalg.solve(inner, AF.T)
        self._updates += 1
        if self._updates % UPDATES_PER_INVERSION == 0:
            self.inverse = np.linalg.inv(self.information)


def greedy(
    factors: Array,
    prior: Array,
    *,
    count: int | None = None,
    cost: Array | None = None,
    budget: float = np.inf,
    start: Sequence[int] = (),
    repeat: bool = False,
) -> list[int]:
    """Choose candidates one by one, each with the largest gain of log-determinant per cost.

    Parameters
    ----------
    factors
        Factors of the candidates ``(c, P, r)``, see :func:`factors_of`.
    prior
        Information before any measurement ``(P, P)``, positive definite.
    count
        The largest number of candidates; None: no limit.
    cost, budget
        Cost of each candidate ``(c,)``, such as seconds, and the largest total. Without costs each candidate costs 1.
    start
        Candidates that are taken in any case; they count towards ``count`` and ``budget``.
    repeat
        Whether a candidate may be taken more than once.

    Returns
    -------
    list of int
        Indices of the candidates, those of ``start`` first.
    """
    price = np.ones(len(factors)) if cost is None else np.asarray(cost, dtype=float)
    state, chosen, spent = _Design(prior), list(start), float(price[list(start)].sum())
    for k in chosen:
        state.change(factors[k], 1.0)
    free = np.ones(len(factors), dtype=bool)
    if not repeat:
        free[chosen] = False
    while (count is None or len(chosen) < count) and free.any():
        open_ = np.flatnonzero(free & (price <= budget - spent + 1e-9))
        if not len(open_):
            break
        gain = state.gains(factors[open_])
        best = int(np.argmax(gain / price[open_]))
        if gain[best] < LEAST_GAIN:
            break
        k = int(open_[best])
        state.change(factors[k], 1.0)
        chosen.append(k)
        spent += float(price[k])
        free[k] = repeat
    return chosen


def exchange(
    factors: Array,
    prior: Array,
    chosen: Sequence[int],
    *,
    cost: Array | None = None,
    budget: float = np.inf,
    fixed: Sequence[int] = (),
    passes: int = 5,
) -> list[int]:
    """Exchange chosen candidates for others, one at a time, while the determinant grows; it never falls.

    Parameters
    ----------
    factors, prior, cost, budget
        As in :func:`greedy`.
    chosen
        Indices of the candidates to begin with.
    fixed
        Indices that are not exchanged.
    passes
        The largest number of passes over all chosen candidates.

    Returns
    -------
    list of int
        Indices, each in the place of the one that it replaces.
    """
    price = np.ones(len(factors)) if cost is None else np.asarray(cost, dtype=float)
    out = list(chosen)
    state = _Design(prior + np.einsum("cpr,cqr->pq", factors[out], factors[out]))
    spent = float(price[out].sum())
    for _ in range(passes):
        moved = False
        for place, k in enumerate(out):
            if k in fixed:
                continue
            state.change(factors[k], -1.0)
            left = budget - spent + price[k]
            taken = np.zeros(len(factors), dtype=bool)
            taken[out] = True
            taken[k] = False
            open_ = np.flatnonzero(~taken & (price <= left + 1e-9))
            gain = state.gains(factors[open_])
            own = float(gain[open_ == k][0])
            best = int(np.argmax(gain))
            new = int(open_[best]) if gain[best] > own + LEAST_GAIN else k
            state.change(factors[new], 1.0)
            if new != k:
                spent += float(price[new] - price[k])
                out[place], moved = new, True
        if not moved:
            break
    return out


def choose(factors: Array, prior: Array, count: int, *, start: Sequence[int] = (), passes: int = 5) -> list[int]:
    """Indices of ``count`` candidates: chosen by :func:`greedy`, improved by :func:`exchange`.

    Parameters are those of these two functions; the candidates of ``start`` are kept.
    """
    picked = greedy(factors, prior, count=count, start=start)
    return exchange(factors, prior, picked, fixed=start, passes=passes)
