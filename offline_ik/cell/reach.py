"""The nearest detector position that can be reached, where the requested one cannot."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt
from scipy.optimize import minimize

from offline_ik.cell.coordinates import detector_angles, detector_pose

if TYPE_CHECKING:
    from offline_ik.inverse.detector import Detector

__all__ = ["Nearest", "nearest_reachable"]

Array = npt.NDArray[np.float64]
Nearest = dict[str, float] | None
"""``gamma_rad``, ``delta_rad``, ``r_m``, ``roll_rad``, ``distance_m``; None if there is none at all."""

POINTS, BLOCK = 6000, 250  # of the arm's whole reach, tried on the nominal arm; at a time
SHELLS = np.geomspace(2e-3, 1.0, 12)  # m around the asked position
DIRECTIONS = 120
EACH = 2  # starts on each branch, this far apart
LEAST_CANDIDATE_DISTANCE = 0.1  # m
DRAWN = 32  # postures to start from where no branch leads anywhere
INSIDE = 1e-7  # rad that is kept from the limits: what is found must be found again
FOUND = 1e-6  # rad that the normal may miss the sample by
BACK = (0.0, 1e-5, 5e-5, 2e-4, 1e-3)  # m away from the asked position until the inverse kinematics confirms


def nearest_reachable(detector: Detector, target: Array, roll: float | None) -> Nearest:
    """The nearest position, looking at the sample, to a pose ``(4, 4)`` that is out of reach.

    Among all postures of the identified arm within its limits whose normal is at the sample the distance to the asked
    position is made least, by sequential quadratic programming from several starts: the nearest places that the nominal
    arm reaches on each of its branches. What that finds is confirmed by the inverse kinematics.

    Parameters
    ----------
    roll
        About the detector's normal, rad; None: any.
    """
    least = _Least(detector, target[:3, 3], roll)
    starts = _starts(detector, target, roll)
    ends: list[tuple[float, Array]] = []
    for start in starts:
        end = least.search(start)
        if end is not None:
            ends.append((least.distance(end), end))
    for _, q in sorted(ends, key=lambda one: one[0]):
        for back in BACK:
            confirmed = _confirmed(detector, q, target[:3, 3], roll, back)
            if confirmed is not None:
                return confirmed
    return None


def _confirmed(detector: Detector, q: Array, goal: Array, roll: float | None, back: float) -> Nearest:
    """The place of a posture, or one a little further from the goal, if the inverse kinematics finds its way there."""
    pose = detector.pose(q[None])[0]
    away = pose[:3, 3] - goal
    pose = pose.copy()
    pose[:3, 3] += back * away / max(float(np.linalg.norm(away)), 1e-12)
    at = detector_angles(detector.cell.convention, pose)
    turned = at.roll if roll is None else roll
    answer = detector.locate(at.gamma, at.delta, at.r, turned, near=q, nearest=False)
    if not answer.reachable:
        return None
    distance = float(np.linalg.norm(answer.target[:3, 3] - goal))
    return {"gamma_rad": at.gamma, "delta_rad": at.delta, "r_m": at.r, "roll_rad": turned, "distance_m": distance}


class _Least:
    """The distance to a place and the conditions on a posture that looks at the sample, with their derivatives."""

    def __init__(self, detector: Detector, goal: Array, roll: float | None) -> None:
        self.detector, self.goal, self.roll = detector, goal, roll
        self.sample = np.asarray(detector.cell.convention.sample)
        self.kernel = detector.looking
        self.given = np.concatenate([[0.0 if roll is None else roll], detector.still.vector])
        self.bound = 2 if roll is None else 3  # conditions: of the sample's direction, and of the roll
        self.lower, self.upper = detector.lower + INSIDE, detector.upper - INSIDE
        self._q = np.full(detector.arm.n, np.nan)
        self._values: tuple[Array, Array, Array, Array] = (np.zeros(0),) * 4

    def at(self, q: Array) -> tuple[Array, Array, Array, Array]:
        """Away from the goal ``(3,)`` m and its derivative ``(3, n)``; what is to be zero ``(k,)`` and its own."""
        if not (q == self._q).all():
            n = len(q)
            place, moves, misses, slopes = (o.copy() for o in self.kernel.one(np.concatenate([q, self.given])))
            misses, slopes = misses[: self.bound], slopes.reshape(3, n)[: self.bound]
            self._q, self._values = q.copy(), (place - self.goal, moves.reshape(3, n), misses, slopes)
        return self._values

    def distance(self, q: Array) -> float:
        """From the goal, m."""
        return float(np.linalg.norm(self.at(q)[0]))

    def search(self, start: Array) -> Array | None:
        """A posture ``(n,)`` of locally least distance; None: none was found that looks at the sample."""
        looks = {"type": "eq", "fun": lambda q: self.at(q)[2], "jac": lambda q: self.at(q)[3]}
        found = minimize(
            lambda q: 0.5 * float(self.at(q)[0] @ self.at(q)[0]),
            np.clip(start, self.lower, self.upper),
            jac=lambda q: self.at(q)[0] @ self.at(q)[1],
            method="SLSQP",
            bounds=list(zip(self.lower, self.upper, strict=True)),
            constraints=[looks],
            options={"maxiter": 100, "ftol": 1e-10},
        )
        q = np.clip(found.x, self.lower, self.upper)
        return q if np.isfinite(q).all() and self._right_way(q) else None

    def _right_way(self, q: Array) -> bool:
        """Whether the detector's face, not its back, is at the sample, and its roll not half a turn off."""
        if np.abs(self.at(q)[2]).max() > FOUND:
            return False
        pose = self.detector.pose(q[None])[0]
        if pose[:3, 2] @ (self.sample - pose[:3, 3]) <= 0:
            return False
        if self.roll is None:
            return True
        return bool(_looking(self.detector, pose[None, :3, 3], self.roll)[0, :3, 0] @ pose[:3, 0] > 0)


def _starts(detector: Detector, target: Array, roll: float | None) -> list[Array]:
    """Postures ``(n,)`` to begin at: the nearest that the nominal arm reaches, some on each branch."""
    rng = np.random.default_rng(0)
    low, high = np.clip(detector.lower, -np.pi, np.pi), np.clip(detector.upper, -np.pi, np.pi)
    drawn = rng.uniform(low, high, (DRAWN, detector.arm.n))
    if detector.solver.ortho is None:
        return list(drawn)
    goal = target[:3, 3]
    shells = (goal + SHELLS[:, None, None] * _sphere(DIRECTIONS)).reshape(-1, 3)
    points = np.vstack([shells, _within_reach(detector, rng)])
    rolls = rng.uniform(-np.pi, np.pi, len(points)) if roll is None else np.full(len(points), roll)
    branch, place, posture = [], [], []
    for k in range(0, len(points), BLOCK):
        some = slice(k, k + BLOCK)
        row, on, q = _reached(detector, _looking(detector, points[some], rolls[some]))
        branch.append(on)
        place.append(points[some][row])
        posture.append(q)
    on, at, q = np.concatenate(branch), np.vstack(place), np.vstack(posture)
    found: list[Array] = []
    for b in np.unique(on):
        rows = np.flatnonzero(on == b)
        for _ in range(EACH):
            if not len(rows):
                break
            first = rows[int(np.argmin(np.linalg.norm(at[rows] - goal, axis=1)))]
            found.append(q[first])
            rows = rows[np.linalg.norm(at[rows] - at[first], axis=1) > LEAST_CANDIDATE_DISTANCE]
    return found or list(drawn)


def _reached(detector: Detector, poses: Array) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp], Array]:
    """Of poses ``(N, 4, 4)``, convention's frame, those ``(K,)`` that the nominal arm reaches within the limits.

    With the branch ``(K,)`` and the posture ``(K, n)``.
    """
    in_base = detector.cell.convention.frame == "base"
    q, quality = detector.solver.branches(poses if in_base else np.linalg.inv(detector.arm.base) @ poses)
    within = np.full(q.shape[:2], True)
    turned = q.copy()
    for i in range(q.shape[2]):
        value, low, high = q[..., i], detector.lower[i], detector.upper[i]
        if np.isfinite(low) and np.isfinite(high):
            turned[..., i] = value + 2 * np.pi * np.ceil((low - value) / (2 * np.pi))
            within &= turned[..., i] <= high
    row, branch = np.nonzero(within & (quality[..., :2] <= 0).all(axis=2))
    return row, branch, turned[row, branch]


def _within_reach(detector: Detector, rng: np.random.Generator) -> Array:
    """Places ``(POINTS, 3)`` in the ball that the arm can reach at all, convention's frame, m."""
    ortho, mount = detector.solver.ortho, detector.solver.mount
    assert ortho is not None
    tool = (ortho.home @ mount)[:3, 3] - ortho.wrist
    reach = sum(ortho.lengths) + float(np.linalg.norm(ortho.shoulder - ortho.foot)) + float(np.linalg.norm(tool))
    direction = rng.normal(size=(POINTS, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    places = ortho.foot + reach * np.cbrt(rng.uniform(size=(POINTS, 1))) * direction
    if detector.cell.convention.frame == "base":
        return np.asarray(places)
    return np.asarray(places @ detector.arm.base[:3, :3].T + detector.arm.base[:3, 3])


def _looking(detector: Detector, points: Array, roll: float | Array) -> Array:
    """Poses at points ``(N, 3)`` whose normal is at the sample."""
    convention = detector.cell.convention
    v = (points - np.asarray(convention.sample)) @ convention.lab
    r = np.maximum(np.linalg.norm(v, axis=1), 1e-9)
    x, y, z = (v / r[:, None]).T
    if convention.order == "gamma_outer":
        delta, gamma = np.arctan2(y, np.hypot(x, z)), np.arctan2(-x, z)
    else:
        gamma, delta = np.arctan2(-x, np.hypot(y, z)), np.arctan2(y, z)
    return detector_pose(convention, convention.gamma_sign * gamma, convention.delta_sign * delta, r, roll)


def _sphere(count: int) -> Array:
    """Directions ``(count, 3)`` spread evenly: a Fibonacci lattice."""
    k = np.arange(count) + 0.5
    z, azimuth = 1 - 2 * k / count, np.pi * (1 + np.sqrt(5)) * k
    rho = np.sqrt(1 - z * z)
    return np.column_stack([rho * np.cos(azimuth), rho * np.sin(azimuth), z])
