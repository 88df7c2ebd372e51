"""The ways to the postures of an answer, checked: every one where all are asked for, or the nearest that is safe."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from kinematics.collision.moves import LongCheckError
from offline_ik.cell.checks import check_directions
from offline_ik.collision.safety import PathReport, check_path
from offline_ik.inverse.branches import parse_choice
from offline_ik.inverse.postures import Direction
from offline_ik.motion.approach import Approach, approach_through

if TYPE_CHECKING:
    from offline_ik.inverse.answer import Answer, Solution
    from offline_ik.inverse.detector import Detector

__all__ = ["Way", "Ways", "straight_way", "ways_to"]

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Way:
    """A move to one posture.

    Attributes
    ----------
    solution
        Where it ends; solved for the approach, where there is one.
    path
        What its check found.
    approach
        Through which point it comes; None: straight.
    begins
        Whether it is known where it begins.
    """

    solution: Solution
    path: PathReport
    approach: Approach | None = None
    begins: bool = True

    @property
    def postures(self) -> Array:
        """What to move through ``(m, n)``, rad, without where it begins."""
        end = self.solution.q
        return np.array([end] if self.approach is None else [self.approach.through, end])

    def to_json(self) -> dict[str, Any]:
        """For programs: ``path``, and ``approach`` where there is one."""
        members: dict[str, Any] = {} if self.approach is None else {"approach": self.approach.to_json()}
        return {**members, "path": self.path.to_json() | {"checked": self.checked}}

    @property
    def checked(self) -> str:
        """What of it was checked: the whole ``way``, the ``approach`` from its point on, or just the ``place``."""
        if self.begins:
            return "way"
        return "place" if self.approach is None else "approach"


@dataclass(frozen=True)
class Ways:
    """What became of the ways to an answer's postures.

    Attributes
    ----------
    answer
        With the postures of ``chosen``.
    chosen
        One for each posture, in the same order; none where the position is not reachable.
    refused
        Postures that were checked and refused, and for which another stands or which would have been no better.
    came
        Where the directions of approach are from: ``asked``, ``moved`` (a straight move from the posture at hand),
        ``approach`` (the last part of the way through a point) or ``unknown``.
    against
        Joints that were asked to come from one side and come from the other on a straight move.
    """

    answer: Answer
    chosen: tuple[Way, ...]
    refused: tuple[Way, ...] = ()
    came: str = "unknown"
    against: tuple[str, ...] = ()

    @property
    def instead(self) -> str | None:
        """Note if the first posture is not the nearest, or if no posture is safe."""
        if not self.refused:
            return None
        if self.chosen[0].path.safe:
            why = "; ".join(self.refused[0].path.reasons)
            return f"the nearest posture is refused ({why}); this is the nearest of those that are safe"
        return f"none of the {1 + len(self.refused)} postures is safe; this is the nearest"

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes on the first posture."""
        said = [] if self.instead is None else [self.instead]
        if self.against:
            said.append(
                f"{', '.join(self.against)}: a straight move from the posture at hand comes from another side than was "
                "asked for; with an approach the last part of the way comes from there"
            )
        return tuple(said)

    def to_json(self) -> dict[str, Any]:
        """For programs: of the posture at the head, and what was refused."""
        if not self.chosen:
            return {}
        members = self.chosen[0].to_json() | {"direction_from": self.came}
        if self.refused:
            members["refused"] = [
                {"q_rad": w.solution.q.tolist(), "reasons": list(w.path.reasons)} for w in self.refused
            ]
        if self.notes:
            members["notes"] = list(self.notes)
        return members


def ways_to(
    detector: Detector,
    answer: Answer,
    *,
    start: Sequence[float] | Array | None = None,
    branch: str = "nearest",
    approach: bool = False,
    direction: Sequence[float] | Array | None = None,
    others: bool = True,
) -> Ways:
    """Check the ways to the postures of an answer.

    Parameters
    ----------
    answer
        As :meth:`offline_ik.inverse.detector.Detector.locate` gave it for ``branch``, from ``start``.
    start
        ``(n,)``: where the move begins, rad; without it only the places are checked.
    branch
        ``all``: every posture is checked. Otherwise the first; where it is refused the other postures that the branch
        allows are tried, the nearest first.
    approach
        Come through an intermediate point, see :mod:`offline_ik.motion.approach`.
    direction
        ``(n,)``: from which side the joints come, as ``answer`` was located for; None: nothing was asked.
    others
        Whether to try other postures at all.

    Raises
    ------
    TargetError
        ``start`` is no posture, or ``branch`` no choice.
    """
    if not answer.solutions:
        return Ways(answer, ())
    start = None if start is None else detector.check_posture(start, "start")
    asked = None if direction is None else check_directions(detector.arm.n, direction)
    chosen = tuple(_way(detector, answer, s, start, approach, asked) for s in answer.solutions)
    refused: list[Way] = []
    if others and branch != "all" and not chosen[0].path.safe:
        refused = list(chosen[:1])
        for solution in _others(detector, answer, start, branch, asked):
            way = _way(detector, answer, solution, start, approach, asked)
            if way.path.safe:
                chosen = (way,)
                break
            refused.append(way)
        else:
            refused = refused[1:]
    came = "approach" if approach else "asked" if asked is not None else "unknown" if start is None else "moved"
    against = (
        () if approach or asked is None or start is None else _against(detector, chosen[0].solution.q - start, asked)
    )
    return Ways(_with(answer, chosen), chosen, tuple(refused), came, against)


def straight_way(detector: Detector, answer: Answer, start: Array, direction: Array | None, most: int) -> Ways | None:
    """The straight way to the first posture, as :func:`ways_to` has it; None where it is refused.

    Parameters
    ----------
    answer
        Located for the nearest posture from ``start`` ``(n,)``, rad, and for ``direction`` ``(n,)``.
    most
        Places that may be looked at on the way; None is returned where that does not decide.
    """
    first = answer.solutions[0]
    try:
        path = check_path(detector, [start, first.q], most)
    except LongCheckError:
        return None
    if not path.safe:
        return None
    against = () if direction is None else _against(detector, first.q - start, direction)
    return Ways(answer, (Way(first, path),), came="moved" if direction is None else "asked", against=against)


def _against(detector: Detector, moved: Array, asked: Array) -> tuple[str, ...]:
    """The joints that come from another side than asked for."""
    wrong = (asked != 0) & (np.sign(moved) != asked)
    return tuple(detector.robot.joints[i].name for i in np.flatnonzero(wrong).tolist())


def _with(answer: Answer, ways: tuple[Way, ...]) -> Answer:
    return answer._replace(solutions=tuple(way.solution for way in ways))


def _way(
    detector: Detector, answer: Answer, solution: Solution, start: Array | None, approach: bool, asked: Array | None
) -> Way:
    begin, begins = [] if start is None else [start], start is not None
    if not approach:
        return Way(solution, check_path(detector, [*begin, solution.q]), begins=begins)
    through = approach_through(detector, answer._replace(solutions=(solution,)), near=start, direction=asked)
    end = through.answer.solutions[0]
    return Way(end, check_path(detector, [*begin, through.through, end.q]), through, begins)


def _others(
    detector: Detector, answer: Answer, start: Array | None, branch: str, asked: Array | None
) -> list[Solution]:
    """The postures beside the first one that the branch allows, the nearest first."""
    gamma, delta, r = (answer.asked[name] for name in ("gamma_rad", "delta_rad", "r_m"))
    if gamma is None or delta is None or r is None:  # of an answer, none is
        return []
    first, choice = answer.solutions[0], parse_choice(branch)
    direction: Direction = asked if asked is not None else None if start is None else "moved"
    every = detector.locate(gamma, delta, r, first.roll, near=start, branch="all", direction=direction, nearest=False)
    ortho, linkage = detector.solver.ortho, detector.solver.linkage
    return [
        s
        for s in every.solutions
        if choice.allows(ortho, linkage @ s.q) and np.abs(s.q - first.q).max() > SAME_POSTURE_WITHIN
    ]


SAME_POSTURE_WITHIN = 1e-4  # rad: another flank of the same posture
