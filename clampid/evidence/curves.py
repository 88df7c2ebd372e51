"""Fitted angle-error curves of joints: their information matrix, their prior, and their shift in phase."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import linalg

from clampid.effect import Effect
from clampid.evidence.of_size import evidence, rows_information
from clampid.fitting.solve import Estimate
from clampid.slots import Slot
from clampid.stages.rows import Array, Bools

__all__ = ["CurvePart", "Curves", "coefficient_names", "curves_of", "turned", "without_curves"]


@dataclass(frozen=True)
class Curves:
    """Likelihood of the curves of J single joints, and their prior.

    A joint has ``2 K`` coefficients: sine and cosine of each harmonic, in ascending order.

    Attributes
    ----------
    joints
        Joints (from 0) that have a curve.
    information
        ``(J, 2K, J, 2K)``, 1/rad²: of the rows alone, without the prior; all other parameters integrated out.
    score
        ``(J, 2K)``, 1/rad: information times estimate.
    seat
        ``(2L,)``, rad: prior standard deviations of the first L harmonics. These come from how a gear is seated and are
        never shared between joints.
    share
        ``(2K - 2L,)``: prior standard deviations of the other harmonics, per unit of the curve's rms over a turn.
    """

    joints: tuple[int, ...]
    information: Array
    score: Array
    seat: Array
    share: Array

    @property
    def low(self) -> int:
        """2L, the number of coefficients that are never shared between joints."""
        return len(self.seat)


def coefficient_names(effect: Effect) -> tuple[list[str], list[str], list[str]]:
    """Names of the shared curve's coefficients; of a joint's own that are never shared; and of its others."""
    shared = [p.name for p in effect.parameters if p.per == "robot" and not p.shape]
    own = [p.name.removeprefix("own_") for p in effect.parameters if p.name.startswith("own_")]
    return shared, [a for a in own if a not in shared], [a for a in own if a in shared]


def curves_of(estimate: Estimate, effect: Effect, places: Sequence[str] | None = None) -> Curves:
    """Likelihood and prior of the curves of an estimate that ``effect`` may align, at some places or all.

    Parameters
    ----------
    estimate
        A fit with curves of single joints.
    effect
        The effect that aligns these curves (:attr:`clampid.effect.Effect.aligns`).
    places
        Joints to include (``joint3`` …); all by default.
    """
    own = estimate.problem.effects[str(effect.aligns)]
    shared, low, _ = coefficient_names(effect)
    names = [*low, *shared]
    index = {slot: k for k, slot in enumerate(estimate.slots)}
    n = estimate.problem.rows.robot.n
    where = {j: [index.get(Slot(own.name, a, f"joint{j + 1}"), -1) for a in names] for j in range(n)}
    allowed = {f"joint{j + 1}" for j in range(n)} if places is None else set(places)
    joints = tuple(j for j, found in where.items() if min(found) >= 0 and f"joint{j + 1}" in allowed)
    chosen = np.array([k for j in joints for k in where[j]], dtype=int)
    information, score = rows_information(estimate, chosen)
    unit = estimate.values()[Slot(own.name, str(own.sized_by), own.at)]  # rad, in which the coefficients are counted
    width = len(names)
    return Curves(
        joints,
        (information / unit**2).reshape(len(joints), width, len(joints), width),
        (score / unit).reshape(len(joints), width),
        np.array([effect.by_name[f"own_{a}"].prior_std for a in low]),
        np.array([effect.by_name[f"own_{a}"].prior_std for a in shared]),
    )


@dataclass(frozen=True)
class CurvePart:
    """Gaussian likelihood of k coefficients with their prior, and the log evidence of those integrated out before.

    Attributes
    ----------
    information, score, prior
        ``(k, k)``, ``(k,)``, and prior standard deviations ``(k,)``.
    evidence
        Natural logarithm.
    """

    information: Array
    score: Array
    prior: Array
    evidence: float = 0.0

    def total(self) -> float:
        """Logarithm of the evidence with these coefficients integrated out as well."""
        return self.evidence + evidence(self.information, self.score, self.prior)[0]

    def mean(self) -> Array:
        """The posterior mean ``(k,)``."""
        return evidence(self.information, self.score, self.prior)[1]


def without_curves(part: CurvePart, gone: Bools) -> CurvePart:
    """Integrate out the coefficients marked in ``gone`` ``(k,)`` under their prior."""
    keep = ~gone
    if not gone.any():
        return part
    D, C = part.information[np.ix_(gone, gone)], part.information[np.ix_(gone, keep)]
    S, h = part.prior[gone], part.score[gone]
    A = np.eye(len(S)) + D * np.outer(S, S)
    factor = linalg.cho_factor(A)
    into = linalg.cho_solve(factor, S[:, None] * np.c_[C, h])
    taken = S[:, None] * np.c_[C, h]
    rest = part.information[np.ix_(keep, keep)] - taken[:, :-1].T @ into[:, :-1]
    score = part.score[keep] - taken[:, :-1].T @ into[:, -1]
    return CurvePart(rest, score, part.prior[keep], part.evidence + evidence(D, h, S)[0])


def turned(sense: float, phase: float, harmonics: Array) -> Array:
    """The matrix ``(2k, 2k)`` from the coefficients of a curve g to those of ``s g(s q - phase)``.

    Parameters
    ----------
    sense, phase
        s, +1 or -1; and rad.
    harmonics
        ``(k,)``: orders of the harmonics.
    """
    C, S = np.cos(harmonics * phase), np.sin(harmonics * phase)
    out = np.zeros((2 * len(harmonics), 2 * len(harmonics)))
    sine, cosine = np.arange(0, len(out), 2), np.arange(1, len(out), 2)
    out[sine, sine], out[sine, cosine] = C, S
    out[cosine, sine], out[cosine, cosine] = -sense * S, sense * C
    return out
