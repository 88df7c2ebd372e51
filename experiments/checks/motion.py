"""Judges whether the joints moved enough, and in enough ways, for what the tables are meant to identify."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import numpy.typing as npt
import pandas as pd
from scipy import stats

from experiments.campaign import Campaign
from experiments.checks.angles import joint_angles
from experiments.checks.finding import Finding, joint_list
from experiments.columns import POSES, POSITION, joint_columns
from experiments.measures.returns import ENOUGH_RETURNS, SAME_TEMPERATURE_K, comparable_returns, freedom_of

__all__ = ["motion_findings", "moved_joints", "replicates", "wrist_joints"]

# A joint that moves less shifts a point 1 m away by less than 1 mm: its parameters cannot be identified.
STILL_RAD = 1e-3
# Returns to a pose agree within the robot's repeatability, 1e-4 rad or less; 1e-2 rad is 10 mm at 1 m, another pose.
SAME_POSE_RAD = 1e-2
# Springs of drives deflect by milliradians under rated torque; an arm that moves more than this is not clamped. Soft
# wrists deflect more: there the limit is this multiple of the described spring's deflection at rated torque.
CLAMPED_RAD, CLAMPED_SPRINGS = 0.05, 3.0

# Returns that agree to the last digit are reported as copies if rounding does that less than once in 1000 campaigns.
BY_CHANCE = 1e-3
LEAST_NOISE_M = 1e-5  # of instruments for robots, where none is stated
ON_STEP = 0.01  # of a step, by which numbers may be off it

_FROM_NEIGHBOURS = (
    "its zero offset, compliance and clearance are not separable from its neighbours' and the frames' parameters"
)
_LOST = {
    "poses": _FROM_NEIGHBOURS,
    "distances": _FROM_NEIGHBOURS,
    "free_air": "its friction cannot be identified, and gravity about it only as a constant",
    "wrist": "friction that reaches several motors through it is not separable",
}


def wrist_joints(campaign: Campaign) -> list[int]:
    """Joints that share motors through the transmission; the last three where none is known to.

    Parameters
    ----------
    campaign
        The campaign.

    Returns
    -------
    list of int
        0-based.
    """
    n, T = campaign.robot.n, campaign.robot.transmission
    coupled = (T - np.diag(np.diag(T))) != 0.0
    joints = [int(i) for i in np.flatnonzero(coupled.any(axis=0) | coupled.any(axis=1))]
    return joints or list(range(max(0, n - 3), n))


def moved_joints(campaign: Campaign, table: str) -> list[int]:
    """Joints that move in a table; for ``clamped``, joints that are driven.

    Parameters
    ----------
    campaign
        The campaign.
    table
        A table that it has.

    Returns
    -------
    list of int
        0-based.
    """
    if table == "clamped":
        return sorted({int(j) - 1 for j in campaign.tables[table]["joint"]})
    travel = campaign.long[table].travel if table in campaign.long else np.ptp(joint_angles(campaign, table), axis=0)
    return [int(i) for i in np.flatnonzero(travel > STILL_RAD)]


def replicates(campaign: Campaign) -> int:
    """Count returns to a pose, of one target, with the same directions and, within 0.5 K, the same temperatures.

    Parameters
    ----------
    campaign
        The campaign; only its ``poses`` count.

    Returns
    -------
    int
        Rows beyond the first of each group of returns.
    """
    frame, n = campaign.tables["poses"], campaign.robot.n
    _, target = np.unique(frame["target"].astype(str).to_numpy(), return_inverse=True)
    names = [*joint_columns("temp_link{}_C", n), *joint_columns("temp_motor{}_C", n)]
    warmth = frame[[name for name in names if name in frame]].to_numpy(dtype=np.float64)
    place = np.c_[frame["pose"].to_numpy(), target].astype(np.float64)
    direction = frame[list(joint_columns("dir{}", n))].to_numpy(dtype=np.float64)
    return freedom_of(comparable_returns(place, frame["visit"].to_numpy(dtype=np.int64), direction, warmth))


def motion_findings(campaign: Campaign, angles_wrong: frozenset[str]) -> Iterator[Finding]:
    """Look at what moved.

    Parameters
    ----------
    campaign
        The campaign.
    angles_wrong
        Tables whose angles are known to be in another unit.

    Yields
    ------
    Finding
        Warnings for what cannot be identified, notes on directions and replicates.
    """
    n = campaign.robot.n
    for table, lost in _LOST.items():
        if table in campaign.tables:
            wanted = wrist_joints(campaign) if table == "wrist" else range(n)
            moved = moved_joints(campaign, table)
            if not moved and table in ("free_air", "wrist") and len(campaign.tables[table]) > 1:
                message = f"nothing moves in {table} (standstill only): friction cannot be identified"
                yield Finding("warning", table, "q1_rad", None, message)
                continue
            for i in sorted(set(wanted) - set(moved)):
                message = f"joint {i + 1} never moves in {table}: {lost}"
                yield Finding("warning", table, f"q{i + 1}_rad", None, message)
    for table in POSES:
        if table in campaign.tables:
            yield from _directions(table, campaign.tables[table], n)
            stated = campaign.instrument.distance_std if table == "distances" else campaign.instrument.position_std
            yield from _stops(table, campaign.tables[table], n, stated)
    if "poses" in campaign.tables:
        yield from _replicates(campaign)
    if "clamped" in campaign.tables:
        yield from _clamped(campaign)
        if campaign.robot.transmission_known and "clamped" not in angles_wrong:
            yield from _unclamped(campaign)


def _directions(table: str, frame: pd.DataFrame, n: int) -> Iterator[Finding]:
    names = joint_columns("dir{}", n)
    directions = frame[list(names)].to_numpy(dtype=np.int64)
    unknown = [i for i in range(n) if not directions[:, i].any()]
    if unknown:
        which = "all joints" if len(unknown) == n else joint_list([i + 1 for i in unknown])
        message = f"approach directions of {which} are unknown (0): backlash cannot be identified there"
        yield Finding("note", table, names[unknown[0]], None, message)
    for i in range(n):
        signs = set(directions[:, i].tolist()) - {0}
        if len(signs) == 1 and table != "verification":
            message = (
                f"joint {i + 1} was only approached from one side ({signs.pop():+d}): its backlash looks like an offset"
            )
            yield Finding("warning", table, names[i], None, message)


def _stops(table: str, frame: pd.DataFrame, n: int, noise: float | None) -> Iterator[Finding]:
    what = ["target", "anchor"] if "anchor" in frame else ["target"]
    again = np.flatnonzero(frame.duplicated(["pose", "visit", *what]).to_numpy())
    if again.size:
        row = int(again[0])
        where = ", ".join(f"{name} {frame[name].iloc[row]}" for name in ("pose", "visit", *what))
        message = (
            f"{again.size} rows measure a target again within one visit, first in row {row + 1} ({where}): returns are "
            "numbered in the column visit"
        )
        yield Finding("warning", table, "visit", row + 1, message)
    q = list(joint_columns("q{}_rad", n))
    angles = frame.groupby("pose")[q]
    spread = (angles.max() - angles.min()).to_numpy(dtype=np.float64).max(axis=1)
    apart = np.flatnonzero(spread > SAME_POSE_RAD)
    if apart.size:
        pose = sorted(set(frame["pose"]))[apart[0]]
        message = (
            f"{apart.size} pose numbers stand for several postures, first pose {pose}, whose joint angles differ by "
            f"{spread[apart[0]]:.3g} rad: rows of one pose number count as replicates, fitted or held out together"
        )
        yield Finding("warning", table, "pose", None, message)
    read, word = (["distance_m"], "distance") if "anchor" in frame else ([*POSITION], "position")
    copied = frame.duplicated(["pose", *what, *read]).to_numpy() & ~frame.duplicated(["pose", "visit", *what])
    rows = np.flatnonzero(copied)
    returns = np.count_nonzero(frame.duplicated(["pose", *what]) & ~frame.duplicated(["pose", "visit", *what]))
    if rows.size and stats.binom.sf(rows.size - 1, returns, _same_by_rounding(frame[read], noise)) < BY_CHANCE:
        message = (
            f"{rows.size} returns have exactly the {word} of an earlier one, first in row {rows[0] + 1}: copied, not "
            "measured again"
        )
        yield Finding("warning", table, read[0], int(rows[0]) + 1, message)


def _same_by_rounding(read: pd.DataFrame, noise: float | None) -> float:
    """How probable it is that two readings of one point agree in all of their numbers because these are rounded.

    Two readings, each with the noise [m] that the instrument is stated to have, fall on the same step with the density
    of their difference at zero times the step. Numbers that are not on steps never agree by chance.
    """
    probability = 1.0
    for values in read.to_numpy(dtype=np.float64).T:
        apart = np.diff(np.unique(values))
        step = float(apart.min(initial=np.inf))
        on_steps = bool(np.all(np.abs(apart / step - np.round(apart / step)) < ON_STEP)) if apart.size else True
        if not on_steps:
            return 0.0
        probability *= min(step / (2.0 * np.sqrt(np.pi) * (noise or LEAST_NOISE_M)), 1.0)
    return probability


def _replicates(campaign: Campaign) -> Iterator[Finding]:
    count = replicates(campaign)
    same = f"same directions, temperatures within {SAME_TEMPERATURE_K:g} K"
    if count >= ENOUGH_RETURNS:
        message = f"{count} repeated points ({same}) give the noise floor"
    else:
        message = (
            f"{count} repeated points ({same}), fewer than {ENOUGH_RETURNS}: the noise floor is the instrument's "
            "stated noise"
        )
    yield Finding("note", "poses", "visit", None, message)


def _clamped(campaign: Campaign) -> Iterator[Finding]:
    frame, n = campaign.tables["clamped"], campaign.robot.n
    for i in sorted(set(range(n)) - set(moved_joints(campaign, "clamped"))):
        message = f"joint {i + 1} is never driven: its drive's stiffness is only seen through the others"
        yield Finding("warning", "clamped", "joint", None, message)
    motors = list(joint_columns("motor{}_rad", n))
    sweeps = frame["sweep"].to_numpy()
    for sweep in np.unique(sweeps):
        rows = np.flatnonzero(sweeps == sweep)
        driven = set(frame["joint"].to_numpy()[rows].tolist())
        first = int(rows[0]) + 1
        if len(driven) > 1:
            message = f"sweep {sweep} drives {joint_list(sorted(driven))}: one joint at a time is expected"
            yield Finding("warning", "clamped", "joint", first, message)
        joint = min(driven) - 1
        if np.ptp(frame[motors[joint]].to_numpy(dtype=np.float64)[rows]) == 0.0:
            message = f"in sweep {sweep}, joint {joint + 1} is driven but its motor never moves"
            yield Finding("warning", "clamped", motors[joint], first, message)


def _unclamped(campaign: Campaign) -> Iterator[Finding]:
    sweeps = campaign.tables["clamped"]["sweep"].to_numpy()
    q = joint_angles(campaign, "clamped")
    moved = {int(sweep): np.ptp(q[sweeps == sweep], axis=0) for sweep in np.unique(sweeps)}  # (n,) each
    most = _spring_travel(campaign)
    free = [sweep for sweep, span in moved.items() if np.any(span > most)]
    if free:
        joint = int(np.argmax(moved[free[0]] / most)) + 1
        message = (
            f"in {len(free)} of {len(moved)} sweeps a joint moves by more than {most[joint - 1]:.2g} rad, first in "
            f"sweep {free[0]}, joint {joint}, by {moved[free[0]][joint - 1]:.3g} rad: was the flange clamped?"
        )
        yield Finding("warning", "clamped", f"motor{joint}_rad", int(np.flatnonzero(sweeps == free[0])[0]) + 1, message)


def _spring_travel(campaign: Campaign) -> npt.NDArray[np.float64]:
    """How far (n,) [rad] a clamped joint may turn, from end to end of a sweep, by its spring alone."""
    robot = campaign.robot
    most = np.full(robot.n, CLAMPED_RAD)
    if robot.motor_spring is None:
        return most
    for i, joint in enumerate(robot.joints):
        if joint.rated_torque is not None:
            soft = float(robot.transmission[i, i]) ** 2 / float(robot.motor_spring[i])
            most[i] = max(CLAMPED_RAD, CLAMPED_SPRINGS * joint.rated_torque * soft)
    return most
