"""The postures of an arm that put the detector somewhere: every branch, in the turns that its limits allow.

Also what is said of them: why a branch leads nowhere, and which singularity a posture is near.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import numpy.typing as npt

from offline_ik.arm import Conditions
from offline_ik.branches import candidate_turns
from offline_ik.ortho import SIGNS
from offline_ik.solver import NEARLY, Solver

__all__ = ["ROLLS", "Direction", "PostureSearch", "Reasons"]

Array = npt.NDArray[np.float64]
Direction = Array | Literal["moved"] | None
"""The intended direction of approach of each joint ``(n,)``; as the joints move straight from the posture at hand; or
not known."""
Reasons = dict[str, None]
"""Why there is no solution, each reason once, in the order in which they were found."""

ROLLS = 24  # tried where the roll is free, and starts of an arm without an analytic solution
WRIST_SINGULAR = 0.02  # |sin| of the wrist's angle below which it is called singular: joints 4 and 6 trade places
ELBOW_SINGULAR = 0.02  # |sin| of the elbow's angle
SHOULDER_SINGULAR = 0.02  # m: the wrist this near to axis 1
SAME = 1e-9  # rad: not another turn
BEYOND = 0.05  # rad: by which the nominal arm may be beyond its limits and the identified one still be tried


@dataclass(frozen=True)
class PostureSearch:
    """A solver within limits.

    Attributes
    ----------
    lower, upper
        ``(n,)``: of the controller's joint values, rad.
    """

    solver: Solver
    lower: Array
    upper: Array

    def order(self, bases: Array, here: Array) -> list[int]:
        """Poses ``(N, 4, 4)`` in the base's frame, those first that move the joints least from ``here`` ``(n,)``."""
        if self.solver.analytic is None:
            return list(range(len(bases)))
        q, quality = self.solver.branches(bases, here)
        fits = (quality[..., :2] <= 0).all(axis=2) & ((q >= self.lower) & (q <= self.upper)).all(axis=2)
        cost = np.where(fits, np.abs(q - here).max(axis=2), np.inf).min(axis=1)
        return [int(k) for k in np.argsort(cost, kind="stable")]

    def find(
        self, base: Array, here: Array, direction: Direction, still: Conditions, reasons: Reasons
    ) -> list[tuple[Array, Array]]:
        """Postures within the limits on the identified arm, with the directions that they were solved for.

        Parameters
        ----------
        base
            ``(4, 4)``: the detector in the base's frame, m.
        here
            ``(n,)``: the posture at hand, rad.
        still
            Temperatures now.
        reasons
            Gets a line for every branch that leads nowhere.
        """
        out = []
        for start, signs in self._starts(base, here, reasons):
            given = _directions(direction, start, here)
            conditions = replace(still, direction=given)
            solved = self.solver.solve(base[None], start[None], signs[None], conditions)
            if not solved.reached[0]:
                reasons["beyond the reach of the identified arm" if self.solver.ortho else
                        "no posture was found: out of reach, or nearly"] = None  # fmt: skip
                continue
            q = candidate_turns(solved.q[0], start, self.lower, self.upper)
            if q is None:
                reasons[self._beyond(solved.q[0])] = None
                continue
            if np.abs(q - solved.q[0]).max() > SAME:  # another turn: solved again, since ratios may be off
                again = self.solver.solve(base[None], q[None], signs[None], conditions)
                q = again.q[0]
                if not again.reached[0] or (q < self.lower).any() or (q > self.upper).any():
                    reasons[self._beyond(q)] = None
                    continue
            out.append((q, given))
        return out

    def _starts(self, base: Array, here: Array, reasons: Reasons) -> list[tuple[Array, Array]]:
        """Postures ``(n,)`` to search from, and the signs of their branches ``(3,)``."""
        if self.solver.analytic is None:
            rng = np.random.default_rng(0)
            low, high = np.clip(self.lower, -np.pi, np.pi), np.clip(self.upper, -np.pi, np.pi)
            return [(start, np.ones(3)) for start in (here, *rng.uniform(low, high, (ROLLS, len(here))))]
        q, quality = self.solver.branches(base[None], here)
        out = []
        for branch, lacks, signs in zip(q[0], quality[0], SIGNS, strict=True):
            if lacks[0] > NEARLY:
                reasons[f"the wrist would be {1e3 * lacks[0]:.0f} mm too near to axis 1"] = None
                continue
            if lacks[1] > NEARLY:
                reasons[f"out of reach by {1e3 * lacks[1]:.0f} mm"] = None
                continue
            turned = candidate_turns(branch, here, self.lower - BEYOND, self.upper + BEYOND)
            if turned is None:
                reasons[self._beyond(branch)] = None
                continue
            out.append((turned, signs))
        return out

    def _beyond(self, q: Array) -> str:
        """The joints whose limits no turn keeps."""
        beyond = []
        for i, joint in enumerate(self.solver.arm.robot.joints):
            one = slice(i, i + 1)
            if candidate_turns(q[one], q[one], self.lower[one], self.upper[one]) is None:
                beyond.append(joint.name)
        return f"beyond the limits of {', '.join(beyond)}" if beyond else "at the limits"

    def singular(self, base: Array, chain: Array, still: Conditions) -> tuple[str, ...]:
        """Which singularities a posture ``chain`` ``(n,)`` for a pose ``base`` ``(4, 4)`` is near.

        Some of ``wrist``, ``elbow``, ``shoulder``; for an arm without an analytic solution just ``singular``.
        """
        ortho = self.solver.ortho
        if ortho is None:
            row = np.r_[self.solver.unlinked @ chain, still.vector]
            J = self.solver.forward.one(row)[2].reshape(6, -1)
            return ("singular",) if np.linalg.svd(J, compute_uv=False)[-1] < WRIST_SINGULAR else ()
        _, quality = self.solver.branches(base[None], chain)
        return self.names(abs(math.sin(chain[4] + ortho.psi)), float(chain[2]), -float(quality[0, 0, 0]))

    def names(self, wrist: float, elbow: float, shoulder: float) -> tuple[str, ...]:
        """The singular parts by |sin| of the wrist's angle, joint 3 of the chain, m from axis 1 to the wrist."""
        ortho = self.solver.ortho
        found = ["wrist"] if wrist < WRIST_SINGULAR else []
        if ortho is not None and abs(math.sin(elbow - ortho.stretched)) < ELBOW_SINGULAR:
            found.append("elbow")
        if shoulder < SHOULDER_SINGULAR:
            found.append("shoulder")
        return tuple(found)


def _directions(direction: Direction, start: Array, here: Array) -> Array:
    """The directions of approach ``(n,)``, ±1 and 0."""
    if direction is None:
        return np.zeros(len(start))
    if isinstance(direction, str):
        return np.asarray(np.sign(start - here))
    return np.asarray(np.sign(np.asarray(direction, dtype=float)))
