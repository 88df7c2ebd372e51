"""The postures that reach a detector position: every branch, in the turns that the limits allow.

Also what is said of them: why a branch leads nowhere, and which singularity a posture is near.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import numpy.typing as npt

from offline_ik.arm.identified import Conditions
from offline_ik.inverse.branches import candidate_turns
from offline_ik.inverse.ortho import SIGNS
from offline_ik.inverse.singular import ALONG_A_VALLEY, STRAIGHT, along_valleys
from offline_ik.inverse.solver import CONVERGED, NEARLY, Solver

__all__ = ["ROLLS", "Direction", "PostureSearch", "Reasons", "directions_of"]

Array = npt.NDArray[np.float64]
Direction = Array | Literal["moved"] | None
"""The intended direction of approach of each joint ``(n,)``; as the joints move straight from the posture at hand; or
not known."""
Reasons = dict[str, None]
"""Why there is no solution, each reason once, in the order in which they were found."""

ROLLS = 24  # tried at least where the roll is free, and starts of an arm without an analytic solution
WRIST_SINGULAR = STRAIGHT
ELBOW_SINGULAR = 0.02  # |sin| of the elbow's angle
SHOULDER_SINGULAR = 0.02  # m: the wrist this near to axis 1
SAME_TURN_WITHIN = 1e-9  # rad: not another turn
STAYED = 0.1  # rad: if joints 1 and 4 move less than this, no nearer posture is searched
LIMIT_MARGIN = 0.05  # rad: so far beyond a limit of the nominal arm the identified one is still tried


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
        out: list[tuple[Array, Array]] = []
        ends: list[Array] = []
        for start, signs in self._starts(base, here, reasons):
            given = directions_of(direction, start, here)
            conditions = replace(still, direction=given)
            solved = self.solver.solve(base[None], start[None], signs[None], conditions)
            if not solved.reached[0]:
                reasons["beyond the reach of the identified arm" if self.solver.ortho else
                        "no posture was found: out of reach, or nearly"] = None  # fmt: skip
                continue
            end = solved.q[0]
            if any(np.abs(end - other).max() < SAME_TURN_WITHIN for other in ends):  # at a singular pose branches meet
                continue
            ends.append(end)
            q = self._within(base, end, start, signs, conditions)
            found = self.nearer(base, q, end, here, direction, conditions, keep_side=True)
            if found is None:
                reasons[self._beyond(end)] = None
                continue
            out.append(found)
        return out

    def _within(self, base: Array, end: Array, start: Array, signs: Array, conditions: Conditions) -> Array | None:
        """A solution in the turns within the limits that are nearest to where it was sought; None: there are none."""
        q = candidate_turns(end, start, self.lower, self.upper)
        if q is None or np.abs(q - end).max() <= SAME_TURN_WITHIN:
            return q
        again = self.solver.solve(base[None], q[None], signs[None], conditions)  # since ratios may be off
        q = again.q[0]
        return q if again.reached[0] and (q >= self.lower).all() and (q <= self.upper).all() else None

    def nearer(
        self,
        base: Array,
        q: Array | None,
        end: Array,
        here: Array,
        direction: Direction,
        conditions: Conditions,
        *,
        keep_side: bool = False,
    ) -> tuple[Array, Array] | None:
        """The posture of a singular pose that is nearest to the one at hand; ``q`` where it is not singular.

        With the directions ``(n,)`` that it was solved for; None: there is none within the limits.

        Parameters
        ----------
        base
            ``(4, 4)``: the detector in the base's frame, m.
        q
            ``(n,)``: a posture within the limits; None: none is known.
        end
            ``(n,)``: the same in any turns, or one that is beyond the limits, rad.
        here
            ``(n,)``: the posture at hand, rad.
        conditions
            Those that ``q`` was solved for, in the intended ``direction``.
        keep_side
            Whether joint 5 has to stay on its side.
        """
        parts = self.singular(base, self.solver.linkage @ end, conditions)
        side, best = self.solver.signs(end)[0, 2], q
        for turns in (ALONG_A_VALLEY[:1], ALONG_A_VALLEY[1:]):
            starts = along_valleys(self.solver, base, end, here, parts, turns)
            if not len(starts):
                break
            ends = self.solver.search.refine(np.tile(base, (len(starts), 1, 1)), starts, conditions)
            for other in ends.q[ends.reached]:
                turned = candidate_turns(other, here, self.lower, self.upper)
                if turned is None or (best is not None and not _nearer(turned, best, here)):
                    continue
                if keep_side and self.solver.signs(turned)[0, 2] != side:
                    continue
                if np.abs(self.solver.residual(base, turned, conditions)).max() <= CONVERGED:  # ratios may be off
                    best = turned
            if best is not None and np.abs(best - here)[[0, 3]].max() < STAYED:
                break
        return None if best is None else self._approached(base, best, here, direction, conditions)

    def _approached(
        self, base: Array, q: Array, here: Array, direction: Direction, conditions: Conditions
    ) -> tuple[Array, Array] | None:
        """A solution for its own directions of approach, which may differ from those it was solved for."""
        given = conditions.direction if direction is None else directions_of(direction, q, here)
        if (given == conditions.direction).all():
            return q, given
        again = self.solver.search.refine(base[None], q[None], replace(conditions, direction=given))
        q = again.q[0]
        return (q, given) if again.reached[0] and (q >= self.lower).all() and (q <= self.upper).all() else None

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
            turned = candidate_turns(branch, here, self.lower - LIMIT_MARGIN, self.upper + LIMIT_MARGIN)
            if turned is None and (lacks[2] < WRIST_SINGULAR or -lacks[0] < SHOULDER_SINGULAR):
                turned = branch  # another posture of the same pose may be within them
            if turned is None:
                reasons[self._beyond(branch)] = None
                continue
            out.append((turned, signs))
        return out

    def _beyond(self, q: Array) -> str:
        """The joints that are beyond their limits in every turn."""
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


def _nearer(q: Array, than: Array, here: Array) -> bool:
    return bool(np.abs(q - here).max() < np.abs(than - here).max() - SAME_TURN_WITHIN)


def directions_of(direction: Direction, start: Array, here: Array) -> Array:
    """The directions of approach ``(n,)``, ±1 and 0, of a move from ``here`` to ``start``."""
    if direction is None:
        return np.zeros(len(start))
    if isinstance(direction, str):
        return np.asarray(np.sign(start - here))
    return np.asarray(np.sign(np.asarray(direction, dtype=float)))
