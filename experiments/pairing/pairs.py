"""Pairs the stops of an instrument's log with those of a robot's log.

A pair is one stop of the robot and all still samples of the instrument within it. Doubtful pairs are left out, with
the reason: a wrong pair harms a calibration more than a missing one.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from experiments.pairing.clocks import ClockFit, fit_clocks
from experiments.pairing.geometry import MIN_CONFIRMED, OUTLIER, rigid_residuals
from experiments.pairing.stops import FALSE_ALARMS, ROBUST, Stops, find_stops

__all__ = ["LeftOut", "Pair", "Pairing", "confirmed", "pair_logs"]

FloatArray = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]

MIN_SAMPLES = 3
SETTLING_S = 0.5  # the arm may vibrate so long after its encoders are at rest
MOVED_RAD = 1e-3  # a joint that came from farther than this came from a direction (as of an imported table)


@dataclass(frozen=True)
class Pair:
    """One stop that both logs saw.

    Attributes
    ----------
    rows
        Of the instrument's log: its still samples ``(m,)``.
    robot_row
        The first still row of the robot's log.
    time_s
        Median time of the samples, on the instrument's clock.
    point, scatter
        Median and robust standard deviation of one sample ``(k,)``.
    joints
        Median of the robot's still rows ``(n,)``.
    direction
        ``(n,)``: from where each joint came, 1 from below, -1 from above, 0 unknown.
    """

    rows: Integers
    robot_row: int
    time_s: float
    point: FloatArray
    scatter: FloatArray
    joints: FloatArray
    direction: Integers


@dataclass(frozen=True)
class LeftOut:
    """A stop that is in no pair: whose log (``instrument`` or ``robot``), when on that log's clock, and why."""

    log: str
    start_s: float
    end_s: float
    reason: str


@dataclass(frozen=True)
class Pairing:
    """Pairs in order of time, stops left out, and the clocks."""

    pairs: tuple[Pair, ...]
    left_out: tuple[LeftOut, ...]
    clock: ClockFit
    stops: tuple[int, int]
    """How many the instrument and the robot made."""
    geometry_rms_m: float | None = None
    """Of the pairs about the nominal arm; None where there were too few, or no kinematics."""


def pair_logs(
    time: FloatArray,
    points: FloatArray,
    robot_time: FloatArray,
    joints: FloatArray,
    *,
    near_s: float | None = None,
    false_alarms: float = FALSE_ALARMS,
) -> Pairing:
    """Pair two logs.

    Parameters
    ----------
    time, points
        ``(N,)`` s on the instrument's clock and ``(N, k)`` m in its frame.
    robot_time, joints
        ``(M,)`` s on the robot's clock and ``(M, n)`` rad.
    near_s
        Robot time minus instrument time, known within 2 s.
    false_alarms
        Expected false detections of motion per log.

    Raises
    ------
    ValueError
        A log is too short, or the clocks cannot be found.
    """
    ours, theirs = find_stops(time, points, false_alarms), find_stops(robot_time, joints, false_alarms)
    clock = fit_clocks(ours, theirs, near_s)
    slack = max(clock.tolerance_s, theirs.step_s)
    start, end = clock.to_robot(ours.start), clock.to_robot(ours.end)
    left_out: list[LeftOut] = []
    members: dict[int, list[int]] = {}
    for i in range(len(ours)):
        shared = np.minimum(end[i], theirs.end) - np.maximum(start[i], theirs.start)
        with_ = np.flatnonzero(shared > min(slack, (end[i] - start[i]) / 2))
        if len(with_) == 1:
            members.setdefault(int(with_[0]), []).append(i)
        else:
            reason = "the robot moved" if len(with_) else "the robot's log has no stop then"
            left_out.append(LeftOut("instrument", float(ours.start[i]), float(ours.end[i]), reason))
    directions = _directions(joints, theirs)
    at = clock.to_robot(time)
    pairs = []
    for j in range(len(theirs)):
        one = members.get(j, [])
        rows = np.concatenate([np.arange(ours.first[i], ours.last[i]) for i in one] or [np.zeros(0, dtype=np.int64)])
        rows = rows[(at[rows] >= theirs.start[j]) & (at[rows] <= theirs.end[j])]
        reason = _doubt(ours, theirs, one, j, (start, end), slack) if one else "the instrument's log has no stop then"
        if not reason and len(rows) < MIN_SAMPLES:
            reason = f"only {len(rows)} still samples of the instrument"
        if reason:
            left_out.append(LeftOut("robot", float(theirs.start[j]), float(theirs.end[j]), reason))
            continue
        point = np.median(points[rows], axis=0)
        scatter = ROBUST * np.median(np.abs(points[rows] - point), axis=0)
        inside = slice(int(theirs.first[j]), int(theirs.last[j]))
        pairs.append(
            Pair(rows, inside.start, float(np.median(time[rows])), point, scatter,
                 np.median(joints[inside], axis=0), directions[j])
        )  # fmt: skip
    if not pairs:
        raise ValueError("expected stops that both logs saw, found none")
    return Pairing(tuple(pairs), tuple(left_out), clock, (len(ours), len(theirs)))


def _doubt(ours: Stops, theirs: Stops, one: list[int], j: int, at: tuple[FloatArray, FloatArray], slack: float) -> str:
    """Why the instrument's intervals ``one`` may not belong to the robot's stop j; empty where they do."""
    centers = ours.center[one]
    # Any two of the intervals may differ by what two windows' means do.
    if np.any(np.ptp(centers, axis=0) > ours.limit * ours.mean_noise):
        return "the instrument saw two points while the robot stood still"
    first, last = one[0], one[-1]
    slack += SETTLING_S
    early = theirs.starts_seen[j] and theirs.start[j] - at[0][first] > slack
    late = theirs.ends_seen[j] and at[1][last] - theirs.end[j] > slack
    if early or late:
        return "the instrument stood still while the robot moved"
    if ours.ends_seen[last] and theirs.end[j] - at[1][last] > slack:
        return "the instrument saw motion while the robot stood still"
    return ""


def _directions(joints: FloatArray, stops: Stops) -> Integers:
    """From where each joint came to each stop ``(S, n)``; a joint that did not move keeps its direction."""
    out = np.zeros((len(stops), joints.shape[1]), dtype=np.int64)
    middle = np.array([np.median(joints[a:b], axis=0) for a, b in zip(stops.first, stops.last, strict=True)])
    for j in range(len(stops)):
        before = int(stops.last[j - 1]) - 1 if j else 0
        away = middle[j] - joints[before : stops.first[j]]
        for i in range(joints.shape[1]):
            far = np.flatnonzero(np.abs(away[:, i]) > MOVED_RAD)
            out[j, i] = int(np.sign(away[far[-1], i])) if far.size else out[j - 1, i] if j else 0
    return out


def confirmed(pairing: Pairing, flanges: FloatArray) -> Pairing:
    """Leave out pairs whose points do not fit the arm.

    Parameters
    ----------
    flanges
        ``(P, 4, 4)``: nominal poses of the flange at the pairs' joints, in the base frame.

    Raises
    ------
    ValueError
        Most points do not fit: the logs, units or joints do not belong together.
    """
    if len(pairing.pairs) < MIN_CONFIRMED:
        return pairing
    points = np.array([pair.point for pair in pairing.pairs])
    off = rigid_residuals(points, flanges)
    middle = float(np.median(off))
    size = float(np.median(np.linalg.norm(points - np.median(points, axis=0), axis=1)))
    if middle > size / 4:
        raise ValueError(
            "expected points that a rigid body on this robot's flange can take, found them "
            f"{1e3 * middle:.3g} mm off in the median; the joints' order, signs, units or the robot may be wrong"
        )
    noise = max(float(np.median([pair.scatter for pair in pairing.pairs])), 1e-9)
    bad = off > OUTLIER * max(middle, noise)
    out = [
        LeftOut("instrument", pair.time_s, pair.time_s, f"its point is {1e3 * r:.3g} mm off the arm's")
        for pair, r, wrong in zip(pairing.pairs, off, bad, strict=True)
        if wrong
    ]
    pairs = tuple(pair for pair, wrong in zip(pairing.pairs, bad, strict=True) if not wrong)
    rms = float(np.sqrt(np.mean(off[~bad] ** 2)))
    return replace(pairing, pairs=pairs, left_out=(*pairing.left_out, *out), geometry_rms_m=rms)
