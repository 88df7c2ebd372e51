"""Peaks found on a detector, and what the identified arm says of where they were: points with a common covariance.

A peak at (x, y) on the detector, whose pose is (R, p), was found at p + R (x, y, 0). What the model does not know
exactly is the same for all poses: with the derivative J of the poses by its parameters and their covariance C, poses
have the covariance J C J'. An approach from an unknown side, what is beyond the ranges of the model, and the robot's
repeatability are each pose's own, shared by the peaks found there.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from offline_ik.errors import TargetError
from offline_ik.reflections.bragg import Reflection, SamplePosition, sample_position
from offline_ik.reflections.peak_wording import LAB, agreement, undetermined_directions

if TYPE_CHECKING:
    from offline_ik.inverse.detector import Detector

__all__ = ["MAX_PEAKS", "Peak", "SampleFound", "sample_from_peaks"]

Array = npt.NDArray[np.float64]

MAX_PEAKS = 500  # peaks of one answer: their common covariance is that of 1500 numbers
WIDEST_ERROR = 0.1  # rad: no peak is as wide; a larger standard error is in degrees
LIMIT_MARGIN = 0.02  # rad: limits on paper and in a controller may differ
LARGEST_OFFSET = 1.0  # m from the detector's middle, and of a standard error there


@dataclass(frozen=True, eq=False)
class Peak:
    """One reflection found.

    Attributes
    ----------
    two_theta, std_angle
        The scattering angle of its spacing, and its standard error, rad.
    q
        ``(n,)``: joint angles at which the robot stood, rad; None where ``place`` says.
    place
        ``(4,)``: gamma, delta, r, roll that were asked of this model in this cell, rad and m.
    direction
        ``(n,)``: how each joint came there, ±1; 0 not known; None: of no joint.
    offset
        ``(2,)``: where it lies on the detector along its x and y axes from its middle, m.
    std_offset
        Standard error of both, m.
    name
        What to call it.
    """

    two_theta: float
    std_angle: float
    q: Sequence[float] | Array | None = None
    place: Sequence[float] | None = None
    direction: Sequence[float] | Array | None = None
    offset: Sequence[float] = (0.0, 0.0)
    std_offset: float = 0.0
    name: str = ""


@dataclass(frozen=True, eq=False)
class SampleFound:
    """The scattering point, and from which postures it was found.

    Attributes
    ----------
    position
        In the convention's frame.
    shift, std
        ``(3,)``, m: from the cell's sample, across, up and along the beam, and its standard errors.
    q
        ``(N, n)``: the posture of each peak, rad.
    points
        ``(N, 3)``: where each was found, convention's frame, m.
    notes
        What else must be said.
    convention
        Of the cell, with its sample.
    """

    position: SamplePosition
    shift: Array
    std: Array
    q: Array
    points: Array
    names: tuple[str, ...]
    notes: tuple[str, ...]
    convention: dict[str, Any]

    @property
    def agreement(self) -> tuple[str, ...]:
        """Whether the reflections agree, in words."""
        return agreement(self.position, self.names)

    @property
    def cell_lines(self) -> tuple[str, ...]:
        """The lines of a cell file that take the position over."""
        x, y, z = (f"{v:.7f}" for v in self.position.sample.tolist())
        return ("[convention]", f"sample_m = [{x}, {y}, {z}]", f'frame = "{self.convention["frame"]}"')

    def to_json(self) -> dict[str, Any]:
        """For programs."""
        return {
            **self.position.to_json(),
            "shift_m": dict(zip(LAB, self.shift.tolist(), strict=True)),
            "shift_std_m": dict(zip(LAB, self.std.tolist(), strict=True)),
            "reflections": [
                {"name": name, "q_rad": q.tolist(), "point_m": point.tolist()}
                for name, q, point in zip(self.names, self.q, self.points, strict=True)
            ],
            "agreement": list(self.agreement),
            "notes": list(self.notes),
            "cell_lines": list(self.cell_lines),
            "convention": self.convention,
        }


def sample_from_peaks(
    detector: Detector,
    peaks: Sequence[Peak],
    *,
    near: Sequence[float] | Array | None = None,
    repeatability: float = 0.0,
) -> SampleFound:
    """The scattering point that explains peaks found by one robot.

    Parameters
    ----------
    near
        ``(n,)``, rad: the posture from which the first asked place was gone to, the others from the one before.
    repeatability
        The robot's own, a standard deviation in each direction, m: each posture's error of its own.

    Raises
    ------
    TargetError
        A peak that cannot be meant or a place out of reach, named by its number from 1; else as for
        :func:`offline_ik.reflections.bragg.sample_position`.
    """
    if len(peaks) > MAX_PEAKS:
        raise TargetError(f"expected at most {MAX_PEAKS} reflections, found {len(peaks)}")
    if not 0 <= repeatability <= LARGEST_OFFSET:
        raise TargetError(f"repeatability: expected metres from 0 to {LARGEST_OFFSET:g}, found {repeatability:g}")
    offsets = np.array([_checked(k, peak) for k, peak in enumerate(peaks, 1)]).reshape(-1, 2)
    stands = _Stands(detector, None if near is None else detector.check_posture(near), repeatability)
    which = [stands.of(k, peak) for k, peak in enumerate(peaks, 1)]
    points, covariance = stands.points(which, offsets, [peak.std_offset for peak in peaks])
    reflections = [Reflection(p, k.two_theta, k.std_angle) for p, k in zip(points, peaks, strict=True)]
    position = sample_position(detector.cell.convention, reflections, covariance)
    lab, shift = detector.cell.convention.lab, position.sample - np.asarray(detector.cell.convention.sample)
    return SampleFound(
        position,
        lab.T @ shift,
        np.sqrt(np.diag(lab.T @ position.covariance @ lab)),
        np.array([stands.q[m] for m in which]),
        points,
        tuple(peak.name or f"row {k}" for k, peak in enumerate(peaks, 1)),
        (*undetermined_directions(position.undetermined @ lab), *detector.notes, *stands.notes(which)),
        detector.cell.convention.to_json(),
    )


class _Stands:
    """The postures at which peaks were found, each once."""

    def __init__(self, detector: Detector, near: Array | None, repeatability: float) -> None:
        self.detector, self.near, self.repeatability = detector, near, repeatability
        self.q: list[Array] = []
        self.direction: list[Array] = []
        self._known: dict[tuple[float, ...], int] = {}

    def of(self, number: int, peak: Peak) -> int:
        """The number of a peak's posture, from 0."""
        n = self.detector.arm.n
        direction = np.zeros(n) if peak.direction is None else np.asarray(peak.direction, dtype=float)
        if direction.shape != (n,) or not np.isin(direction, (-1.0, 0.0, 1.0)).all():
            raise TargetError(f"reflection {number}: expected {n} directions -1, 0 or 1, found {direction.tolist()}")
        if (peak.q is None) == (peak.place is None):
            raise TargetError(f"reflection {number}: expected either joint angles or gamma, delta and r")
        given = peak.place if peak.q is None else peak.q
        key = (float(peak.q is None), *np.asarray(given, dtype=float).tolist(), *direction.tolist())
        if key not in self._known:
            try:
                q = self._posture(peak, direction)
            except TargetError as error:
                raise TargetError(f"reflection {number}: {error}") from None
            self._known[key] = len(self.q)
            self.q.append(q)
            self.direction.append(direction)
        return self._known[key]

    def _posture(self, peak: Peak, direction: Array) -> Array:
        if peak.q is not None:
            q = self.detector.check_posture(peak.q, "q")
            robot = self.detector.robot
            beyond = (q < robot.lower - LIMIT_MARGIN) | (q > robot.upper + LIMIT_MARGIN)
            if beyond.any():
                i = int(np.argmax(beyond))
                low, high = robot.lower[i], robot.upper[i]
                raise TargetError(
                    f"q: expected {robot.joints[i].name} from {low:.4g} to {high:.4g} rad, the limits of {robot.name}, "
                    f"found {q[i]:g}: the robot cannot have stood there"
                )
            return q
        gamma, delta, r, roll = map(float, peak.place or ())
        answer = self.detector.locate(gamma, delta, r, roll, near=self.near, direction=direction, nearest=False)
        if not answer.reachable:
            raise TargetError(
                f"gamma {gamma:g}, delta {delta:g}, r {r:g} cannot be reached by this model in this cell "
                f"({'; '.join(answer.reasons)}): a reflection cannot have been found there"
            )
        self.near = answer.solutions[0].q
        return self.near

    def points(self, which: Sequence[int], offsets: Array, std: Sequence[float]) -> tuple[Array, Array]:
        """Where peaks were found ``(N, 3)``, m, and their covariance ``(3 N, 3 N)``, m²."""
        if not which:
            return np.zeros((0, 3)), np.zeros((0, 0))
        placed = [self._placed(q, direction) for q, direction in zip(self.q, self.direction, strict=True)]
        J = np.array([J for _, J, _ in placed])
        poses = np.einsum("aip,pq,bjq->aibj", J, self.detector.propagation.covariance, J, optimize=True)
        for m, (_, _, own) in enumerate(placed):
            poses[m, :, m, :] += own
        points, by_pose = np.zeros((len(which), 3)), np.zeros((len(which), 3, 6))
        for k, m in enumerate(which):
            pose = placed[m][0]
            arm = pose[:3, :2] @ offsets[k]
            points[k] = pose[:3, 3] + arm
            by_pose[k] = np.hstack([np.eye(3), -_cross(arm)])
        rows = np.asarray(which)
        covariance = np.einsum("aij,ajbk,blk->aibl", by_pose, poses[rows][:, :, rows], by_pose, optimize=True)
        for k, m in enumerate(which):
            across = placed[m][0][:3, :2]
            covariance[k, :, k, :] += std[k] ** 2 * across @ across.T
        return points, covariance.reshape(3 * len(which), -1)

    def _placed(self, q: Array, direction: Array) -> tuple[Array, Array, Array]:
        """Pose ``(4, 4)``, derivative by the parameters ``(6, P)``, and the posture's own covariance ``(6, 6)``."""
        detector = self.detector
        conditions = replace(detector.still, direction=direction)
        turn = np.kron(np.eye(2), np.eye(3) if detector.cell.convention.frame == "base" else detector.arm.base[:3, :3])
        flat, spread = detector.propagation.jacobian(q, conditions)
        J, half = turn @ flat, turn @ (0.5 * (direction == 0)[:, None] * spread).T
        own = half @ half.T + self.repeatability**2 * np.diag([1.0, 1, 1, 0, 0, 0])
        outside = detector.propagation.outside
        if outside is not None:
            own = own + outside.widening(J[:, outside.empirical.parameter], q, conditions.link_temperature)
        return detector.pose(q[None], conditions)[0], J, own

    def notes(self, which: Sequence[int]) -> tuple[str, ...]:
        """What of the postures must be said beside the position."""
        said = []
        outside = self.detector.propagation.outside
        if outside is not None:
            beyond = [k + 1 for k, m in enumerate(which) if outside.posture(self.q[m])]
            if beyond:
                said.append(f"reflections {_listed(beyond)} are beyond what the model was identified on")
        unknown = [k + 1 for k, m in enumerate(which) if not self.direction[m].all()]
        if unknown:
            said.append(
                f"reflections {_listed(unknown)}: from which side joints came is not known; half of play and wind-up "
                "counts as an error"
            )
        if not self.repeatability:
            said.append("the robot's own repeatability is not in the standard errors")
        return tuple(said)


def _checked(number: int, peak: Peak) -> Sequence[float]:
    """Refuse a peak whose numbers cannot be meant; its offset."""
    where = f"reflection {number}"
    if not math.isfinite(peak.two_theta) or not 0 < peak.two_theta < math.pi:
        degrees = math.pi <= peak.two_theta <= 180.0
        hint = (
            f"; did you mean {peak.two_theta:g} degrees, that is {math.radians(peak.two_theta):.6g}?" if degrees else ""
        )
        raise TargetError(f"{where}: expected two theta in radians between 0 and pi, found {peak.two_theta:g}{hint}")
    if not 0 < peak.std_angle <= WIDEST_ERROR:
        raise TargetError(
            f"{where}: expected a positive standard error of two theta of at most {WIDEST_ERROR:g} rad, found "
            f"{peak.std_angle:g}"
        )
    if not all(abs(v) <= LARGEST_OFFSET for v in (*peak.offset, peak.std_offset)) or peak.std_offset < 0:
        found = ", ".join(f"{v:g}" for v in (*peak.offset, peak.std_offset))
        raise TargetError(
            f"{where}: expected a peak within {LARGEST_OFFSET:g} m of the detector's middle and a standard error not "
            f"below 0, found {found}; are these millimetres or pixels?"
        )
    return peak.offset


def _cross(v: Array) -> Array:
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])


def _listed(numbers: Sequence[int]) -> str:
    return ", ".join(map(str, numbers)) if len(numbers) <= 8 else f"{', '.join(map(str, numbers[:8]))} and more"
