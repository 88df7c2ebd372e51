"""The nearest detector position that can be reached, where the asked one cannot."""

from __future__ import annotations

from collections.abc import Generator
from typing import TYPE_CHECKING, cast

import numpy as np
import numpy.typing as npt

from offline_ik.branches import candidate_turns
from offline_ik.coordinates import detector_angles, detector_pose

if TYPE_CHECKING:
    from offline_ik.detector import Detector

__all__ = ["Nearest", "nearest_reachable", "nearest_steps", "reachable"]

Array = npt.NDArray[np.float64]
Nearest = dict[str, float] | None
"""``gamma_rad``, ``delta_rad``, ``r_m``, ``distance_m``; None if there is none at all."""

INSIDE = 4e-3  # m by which the nominal arm must reach further: calibrated arms differ by millimetres
SHELLS = np.geomspace(2e-3, 4.0, 40)  # m
DIRECTIONS = 240
ROUNDS, POINTS = 24, 240


def reachable(detector: Detector, poses: Array) -> npt.NDArray[np.bool_]:
    """Which poses ``(N, 4, 4)``, convention's frame, the arm reaches within its limits, by its analytic postures."""
    base = np.array([detector.to_base(p) for p in poses]) if detector.cell.convention.frame != "base" else poses
    q, quality = detector.solver.branches(base)
    closes = (quality[..., :2] <= -INSIDE).all(axis=2)
    within = np.zeros(q.shape, dtype=bool)
    for turn in (-1, 0, 1):
        moved = q + 2 * np.pi * turn
        within |= (moved >= detector.lower) & (moved <= detector.upper)
    return np.asarray(np.any(closes & np.all(within, axis=2), axis=1))


def nearest_reachable(detector: Detector, target: Array, roll: float) -> Nearest:
    """The nearest position to a pose that is out of reach: :func:`nearest_steps` to the end."""
    steps = nearest_steps(detector, target, roll)
    while True:
        try:
            next(steps)
        except StopIteration as end:
            return cast(Nearest, end.value)


def nearest_steps(detector: Detector, target: Array, roll: float) -> Generator[None, None, Nearest]:
    """The nearest position, looking at the sample, to a pose ``(4, 4)`` that is out of reach; in steps of milliseconds.

    Shells of growing radius around the asked position find a first one; points drawn in shrinking balls improve it.

    Returns
    -------
    Nearest
        As the generator's value.
    """
    if detector.solver.analytic is None:
        return _by_least_squares(detector, target)
    yield
    goal = target[:3, 3]
    around = _sphere(DIRECTIONS)
    best: Array | None = None
    for radius in SHELLS:
        points = goal + radius * around
        ok = reachable(detector, _looking(detector, points, roll))
        if ok.any():
            best = points[np.argmax(ok)]
            break
        yield
    if best is None:
        return None
    rng = np.random.default_rng(0)
    size = float(np.linalg.norm(best - goal))
    width = 0.5 * size
    for _ in range(ROUNDS):
        points = best + width * rng.normal(size=(POINTS, 3)) / np.sqrt(3.0)
        points[0] = goal + 0.98 * (best - goal)
        ok = reachable(detector, _looking(detector, points, roll))
        far = np.where(ok, np.linalg.norm(points - goal, axis=1), np.inf)
        if far.min() < np.linalg.norm(best - goal):
            best = points[int(np.argmin(far))]
        else:
            width *= 0.6
        yield
    return _told(detector, _looking(detector, best[None], roll)[0], goal)


def _told(detector: Detector, pose: Array, goal: Array) -> dict[str, float]:
    at = detector_angles(detector.cell.convention, pose)
    distance = float(np.linalg.norm(pose[:3, 3] - goal))
    return {"gamma_rad": at.gamma, "delta_rad": at.delta, "r_m": at.r, "distance_m": distance}


def _looking(detector: Detector, points: Array, roll: float) -> Array:
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


def _by_least_squares(detector: Detector, target: Array) -> dict[str, float] | None:
    """For arms without analytic postures: the pose of the least error, turned to look at the sample."""
    solver, base = detector.solver, detector.to_base(target)
    rng = np.random.default_rng(0)
    low, high = np.clip(detector.lower, -np.pi, np.pi), np.clip(detector.upper, -np.pi, np.pi)
    starts = rng.uniform(low, high, (16, detector.arm.n))
    ends = solver.search.refine(np.tile(base, (len(starts), 1, 1)), starts, detector.still)
    order = np.argsort(np.linalg.norm(ends.error, axis=1))
    for k in order:
        q = candidate_turns(ends.q[k], np.zeros(detector.arm.n), detector.lower, detector.upper)
        if q is not None:
            return _told(detector, detector.pose(q[None])[0], target[:3, 3])
    return None
