"""D-optimal choice among candidates: those that make the determinant of the information largest.

A candidate is represented by its information F Fᵀ, with a factor F ``(P, r)`` of few columns, in parameters scaled by
their reasonable size. With A the information so far, taking a candidate multiplies the determinant by
det(I + Fᵀ A⁻¹ F), and A⁻¹ follows by the same small matrix; giving one up divides it by det(I - Fᵀ A⁻¹ F). So adding,
and exchanging until nothing gains, never form a determinant anew.

Sources: Fedorov, Theory of Optimal Experiments, 1972 (exchange); Mitchell, An algorithm for the construction of
D-optimal experimental designs, Technometrics 16, 1974; the matrix determinant lemma and Woodbury's identity for the
updates.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

__all__ = ["choose", "exchange", "factor", "greedy", "log_det"]

Array = npt.NDArray[np.float64]
RENEW = 50  # updates after which the inverse is formed anew, so that rounding does not add up
GAIN = 1e-6  # of a unit of log-determinant: less is no gain


def factor(information: Array) -> Array:
    """A factor ``(P, r)`` of a positive semidefinite matrix ``(P, P)``, as narrow as its rank."""
    values, vectors = np.linalg.eigh(information)
    keep = values > 1e-12 * max(float(values[-1]), 1e-300)
    return np.asarray(vectors[:, keep] * np.sqrt(values[keep]))


def log_det(information: Array) -> float:
    """Logarithm of the determinant ``(P, P)``; minus infinity where it is not positive."""
    sign, value = np.linalg.slogdet(information)
    return float(value) if sign > 0 else -np.inf


class _State:
    """Inverse of the information so far, kept up by small updates."""

    def __init__(self, information: Array) -> None:
        self.information = information.copy()
        self.inverse = np.linalg.inv(information)
        self._updates = 0

    def gains(self, factors: Array) -> Array:
        """Log-determinant that each candidate ``(c, P, r)`` would add ``(c,)``."""
        inner = np.swapaxes(factors, 1, 2) @ (self.inverse @ factors)
        return np.asarray(np.linalg.slogdet(np.eye(factors.shape[2]) + inner)[1])

    def change(self, F: Array, sign: float) -> None:
        """Add (``sign`` 1) or give up (-1) a candidate ``(P, r)``."""
        self.information += sign * F @ F.T
        AF = self.inverse @ F
        inner = sign * np.eye(F.shape[1]) + F.T @ AF
        self.inverse -= AF @ np.linalg.solve(inner, AF.T)
        self._updates += 1
        if self._updates % RENEW == 0:
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
    """Candidates in the order in which they gain most, for what they cost.

    Parameters
    ----------
    factors
        ``(c, P, r)``, see the module; narrower ones are filled up with zeros.
    prior
        ``(P, P)``: what is known before, positive definite.
    count
        How many at most.
    cost, budget
        ``(c,)`` and how much of it may be spent, such as seconds; without costs every candidate costs the same.
    start
        Candidates that are taken in any case; they count and cost.
    repeat
        Whether a candidate may be taken more than once.

    Returns
    -------
    list of int
        Indices, those of ``start`` first.
    """
    price = np.ones(len(factors)) if cost is None else np.asarray(cost, dtype=float)
    state, chosen, spent = _State(prior), list(start), float(price[list(start)].sum())
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
        if gain[best] < GAIN:
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
    """Exchange chosen candidates for others, one at a time, as long as the determinant grows.

    Parameters are those of `greedy`; ``fixed`` ones stay. The determinant never falls.
    """
    price = np.ones(len(factors)) if cost is None else np.asarray(cost, dtype=float)
    out = list(chosen)
    state = _State(prior + np.einsum("cpr,cqr->pq", factors[out], factors[out]))
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
            new = int(open_[best]) if gain[best] > own + GAIN else k
            state.change(factors[new], 1.0)
            if new != k:
                spent += float(price[new] - price[k])
                out[place], moved = new, True
        if not moved:
            break
    return out


def choose(factors: Array, prior: Array, count: int, *, start: Sequence[int] = (), passes: int = 5) -> list[int]:
    """``count`` candidates whose information has the largest determinant: greedy, then exchanged."""
    picked = greedy(factors, prior, count=count, start=start)
    return exchange(factors, prior, picked, fixed=start, passes=passes)
