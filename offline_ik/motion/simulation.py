"""The simulation of a move: its end with uncertainty, its path, clearances and duration.

:func:`simulate_move` is what `move` itself decides by. A simulation that is looked at and the check before a motion are
one computation.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import numpy.typing as npt

from offline_ik.cell.coordinates import detector_angles
from offline_ik.collision.safety import Clearance, clearances_along, move_time
from offline_ik.motion.ways import Way, Ways, straight_way, ways_to

if TYPE_CHECKING:
    from offline_ik.inverse.answer import Answer
    from offline_ik.inverse.detector import Detector

__all__ = ["Position", "Simulation", "simulate_move", "simulate_straight"]

Array = npt.NDArray[np.float64]

POINTS = 25  # along a way
PAIRS_REPORTED = 5  # pairs of bodies whose clearance is reported
PLACES_AT_ONCE = 64  # places on a way that may be looked at before others' requests are answered: a few ms


@dataclass(frozen=True)
class Simulation:
    """A move that was not made.

    Attributes
    ----------
    detector
        That it was simulated for.
    start
        ``(n,)``: where it begins, rad; None: nobody said, and only the place at its end is known.
    ways
        The posture, and what the check of the way there found.
    """

    detector: Detector
    start: Array | None
    ways: Ways

    @property
    def way(self) -> Way | None:
        """The move itself; None: the position cannot be reached."""
        return self.ways.chosen[0] if self.ways.chosen else None

    @property
    def safe(self) -> bool:
        """Whether it would be made."""
        return self.way is not None and self.way.path.safe

    @property
    def reasons(self) -> tuple[str, ...]:
        """Why it would be refused."""
        return self.ways.answer.reasons if self.way is None else self.way.path.reasons

    @property
    def postures(self) -> Array:
        """From where it begins to where it ends ``(m, n)``, rad; none where the position cannot be reached."""
        if self.way is None:
            return np.zeros((0, self.detector.arm.n))
        return self.way.postures if self.start is None else np.vstack([self.start, self.way.postures])

    def along(self, points: int = POINTS) -> tuple[Array, Array]:
        """Postures ``(points, n)`` along it, rad, and when they are reached ``(points,)``, s; one posture, if alone."""
        corners = self.postures
        if len(corners) < 2:
            return corners, np.zeros(len(corners))
        times = np.cumsum([0.0, *(move_time(self.detector, corners[k : k + 2]) for k in range(len(corners) - 1))])
        if not times[-1] > 0:
            return corners[:1], times[:1]
        at = np.linspace(0.0, float(times[-1]), points)
        return np.column_stack([np.interp(at, times, column) for column in corners.T]), at

    def clearances(self, points: int = POINTS) -> list[Clearance]:
        """The least distances of the nearest pairs of bodies, at points along it."""
        q, _ = self.along(points)
        return clearances_along(self.detector, q)[:PAIRS_REPORTED] if len(q) else []

    def track(self, points: int = POINTS) -> list[dict[str, Any]]:
        """Where the detector passes, for programs."""
        q, times = self.along(points)
        if not len(q):
            return []
        found = []
        for t, posture, pose in zip(times.tolist(), q, self.detector.pose(q), strict=True):
            at = detector_angles(self.detector.cell.convention, pose)
            place = {"gamma_rad": at.gamma, "delta_rad": at.delta, "r_m": at.r, "roll_rad": at.roll}
            found.append({"t_s": t, "q_rad": posture.tolist(), **place})
        return found

    def to_json(self) -> dict[str, Any]:
        """For programs, beside the answer's members."""
        return {
            **self.ways.to_json(),
            "would_move": self.safe,
            "clearances": [c.to_json() for c in self.clearances()],
            "track": self.track(),
        }


class Position(NamedTuple):
    """A detector position as :meth:`offline_ik.inverse.detector.Detector.locate` takes it: rad, m; roll None: free."""

    gamma: float
    delta: float
    r: float
    roll: float | None = 0.0


def simulate_move(
    detector: Detector,
    position: Position,
    *,
    start: Sequence[float] | Array | None = None,
    branch: str = "nearest",
    approach: bool = False,
    direction: Sequence[float] | Array | None = None,
) -> Simulation:
    """Simulate a move to a detector position.

    Parameters
    ----------
    position
        Where the detector shall be.
    start
        ``(n,)``: where the move begins, rad.
    branch, approach, direction
        As :func:`offline_ik.motion.ways.ways_to` takes them.

    Raises
    ------
    TargetError
        The position cannot be meant, ``start`` is no posture, or ``branch`` no choice.
    """
    here = None if start is None else detector.check_posture(start, "start")
    came = direction if direction is not None else None if here is None else "moved"
    answer = detector.locate(*position, near=here, branch=branch, direction=came)  # type: ignore[arg-type]
    ways = ways_to(detector, answer, start=here, branch=branch, approach=approach, direction=direction)
    return Simulation(detector, here, ways)


def simulate_straight(
    detector: Detector, answer: Answer, start: Array, direction: Array | None = None
) -> Simulation | None:
    """The straight move to the nearest posture, as :func:`simulate_move` has it; None where that takes longer.

    It does where another posture has to be searched because the way to the nearest one is refused, or where something
    is so near that many places on the way have to be looked at.

    Parameters
    ----------
    answer
        Located from ``start`` ``(n,)``, rad, for ``direction``.
    """
    ways = straight_way(detector, answer, start, direction, PLACES_AT_ONCE)
    return None if ways is None else Simulation(detector, start, ways)
