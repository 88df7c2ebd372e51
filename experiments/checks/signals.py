"""Checks whether torques, velocities and times agree with their columns' names."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import numpy.typing as npt
import pandas as pd

from experiments.campaign import Campaign
from experiments.checks.finding import Finding, joint_list
from experiments.columns import POSES, joint_columns, table_format, temperature_columns

__all__ = ["signal_findings"]

FloatArray = npt.NDArray[np.float64]

# Servo motors give two to four times their rated torque, for seconds. More, in more than a twentieth of the rows, is
# torque on the joint's side of the gears (30 to 250 times as much), per cent, or a current.
OVERLOAD = 5.0
# A joint that covers a degree does so well above the noise of its differentiated encoder.
MOVING_RAD = 0.02
# Differences over a log's step blur accelerations by some per cent; a unit is a factor.
RATIO_TOLERANCE = 0.25
DEGREES = 180.0 / np.pi
RATIOS = {
    DEGREES: "velocities look like deg/s, rad/s are expected",
    1 / DEGREES: "joint angles look like degrees (or velocities are too small by 57.3), radians are expected",
    1e3: "times look like milliseconds, seconds are expected",
}


def signal_findings(
    campaign: Campaign, angles_wrong: frozenset[str], torques_wrong: frozenset[str] = frozenset()
) -> Iterator[Finding]:
    """Look at every table's torques, velocities and times.

    Parameters
    ----------
    campaign
        The campaign.
    angles_wrong
        Tables whose angles are known to be in another unit.
    torques_wrong
        Tables whose torques are known to be in another unit: their size is not judged again.

    Yields
    ------
    Finding
        What does not look like what it should be.
    """
    for table, frame in campaign.tables.items():
        if "tau1_Nm" in frame:
            yield from _torques(campaign, table, frame, table not in torques_wrong)
        if "qd1_rad_s" in frame and table not in angles_wrong:
            yield from _velocities(campaign, table, frame)
        yield from _unread(campaign, table, frame)
    yield from _clocks(campaign)
    yield from _instrument(campaign)


def _torques(campaign: Campaign, table: str, frame: pd.DataFrame, size: bool) -> Iterator[Finding]:
    robot = campaign.robot
    names = joint_columns("tau{}_Nm", robot.n)
    tau = frame[list(names)].to_numpy(dtype=np.float64)  # (rows, n)
    constant = np.flatnonzero(np.ptp(tau, axis=0) == 0.0) if len(tau) > 1 else ()
    for i in map(int, constant):
        what = "zero" if tau[0, i] == 0.0 else f"{tau[0, i]:g} Nm"
        message = f"the torque of motor {i + 1} is {what} in every row: nothing about it can be identified here"
        yield Finding("warning", table, names[i], None, message)
    if not size or not robot.transmission_known or any(joint.rated_torque is None for joint in robot.joints):
        return
    rated = np.abs(np.diag(robot.transmission)) * [joint.rated_torque or 0.0 for joint in robot.joints]
    typical = np.quantile(np.abs(tau), 0.95, axis=0)
    over = [int(i) for i in np.flatnonzero(typical > OVERLOAD * rated)]
    if over:
        i = over[0]
        message = (
            f"torques of {joint_list([k + 1 for k in over])} are far above what the motors can give (motor {i + 1}: "
            f"{typical[i]:.3g}, rated {rated[i]:.3g} Nm at its shaft): joint-side torques, per cent or currents?"
        )
        yield Finding("warning", table, names[i], None, message)


def _velocities(campaign: Campaign, table: str, frame: pd.DataFrame) -> Iterator[Finding]:
    n = campaign.robot.n
    names = joint_columns("qd{}_rad_s", n)
    stated, differentiated, moving = [], [], np.zeros(n, dtype=bool)
    for _, run in frame.groupby("run", sort=False):
        if len(run) > 2:
            q = run[list(joint_columns("q{}_rad", n))].to_numpy(dtype=np.float64)
            moving |= np.ptp(q, axis=0) > MOVING_RAD
            differentiated.append(np.gradient(q, run["time_s"].to_numpy(dtype=np.float64), axis=0))
            stated.append(run[list(names)].to_numpy(dtype=np.float64))
    if not stated:
        return
    v, d = np.concatenate(stated), np.concatenate(differentiated)  # (rows, n) each
    verdicts: dict[str, list[int]] = {}
    for i in map(int, np.flatnonzero(moving)):
        verdict = _velocity_verdict(v[:, i], d[:, i])
        if verdict:
            verdicts.setdefault(verdict, []).append(i)
    for verdict, joints in verdicts.items():
        i = joints[0]
        ratio = np.sum(v[:, i] * d[:, i]) / np.sum(d[:, i] ** 2)
        message = (
            f"{verdict}: {joint_list([k + 1 for k in joints])}, stated velocities are {ratio:.3g} times the "
            f"differentiated positions (joint {i + 1}), 1 is expected"
        )
        yield Finding("error" if verdict in RATIOS.values() else "warning", table, names[i], None, message)


def _velocity_verdict(v: FloatArray, d: FloatArray) -> str | None:
    """Say what is wrong with stated velocities v (rows,) against differentiated positions d (rows,), if anything is."""
    if not np.any(v):
        return "velocities are all zero while positions change"
    slope = float(np.sum(v * d) / np.sum(d**2))
    correlation = float(np.sum(v * d) / np.sqrt(np.sum(d**2) * np.sum(v**2)))
    # A factor leaves the correlation of a motion with itself at ±1; a shift in time lowers it; with less than half in
    # common, the columns are of something else.
    if abs(correlation) < 0.9:
        loosely = "only in part (shifted in time against them?)" if abs(correlation) > 0.5 else "not at all"
        return f"velocities follow positions {loosely}"
    if slope < 0.0:
        return "velocities have the opposite sign of the change of positions"
    near = [words for ratio, words in RATIOS.items() if abs(np.log(slope / ratio)) < RATIO_TOLERANCE]
    # A factor of 1.5 either way: beyond any blur.
    if not near and abs(np.log(slope)) > np.log(1.5):
        return "velocities are not the rate of change of positions (is time_s in seconds, or does it count rows?)"
    return near[0] if near else None


def _unread(campaign: Campaign, table: str, frame: pd.DataFrame) -> Iterator[Finding]:
    """Extra columns are kept; a misspelt optional column would be ignored without a message."""
    known = table_format(table, campaign.robot.n).known()
    joints = {f"{signal}{campaign.robot.n + 1}" for signal in ("q", "qd", "tau", "motor", "dir")}
    for name in map(str, frame.columns):
        if name in known or name in temperature_columns([name]):
            continue
        stem = name.lower().split("_")[0]
        if stem == "temp":
            yield Finding("warning", table, name, None, f"{name} is not read: a temperature is named temp_<where>_C")
        elif stem in joints:
            message = f"{name} is not read: {campaign.robot.name} has {campaign.robot.n} joints (is it this robot?)"
            yield Finding("warning", table, name, None, message)
        elif stem in ("qd1", "fixture", "qx"):
            yield Finding("warning", table, name, None, f"{name} is not read: the contract has no such column")


def _clocks(campaign: Campaign) -> Iterator[Finding]:
    ends: dict[str, tuple[float, float]] = {}
    for table in POSES:
        if table in campaign.tables:
            time = campaign.tables[table]["time_s"].to_numpy(dtype=np.float64)
            ends[table] = float(time.min()), float(time.max())
            back = np.flatnonzero(np.diff(time) < 0.0)
            if back.size:
                row = int(back[0]) + 2
                message = f"rows are not in order of time ({back.size} steps back, first in row {row})"
                yield Finding("note", table, "time_s", row, message)
    if {"poses", "verification"} <= set(ends) and ends["verification"][0] < ends["poses"][1]:
        message = (
            "verification starts before poses ends, on what should be one clock: drift with time will not carry over"
        )
        yield Finding("note", "verification", "time_s", None, message)


def _instrument(campaign: Campaign) -> Iterator[Finding]:
    # A robot's own errors are of the order of 1 mm: an instrument of that size hardly sees them.
    sigma = campaign.instrument.position_std
    if sigma is not None and sigma > 1e-3:
        message = (
            f"an instrument with {sigma * 1e3:.3g} mm per axis can hardly see a robot's errors; is the unit right?"
        )
        yield Finding("warning", "campaign.toml", "instrument.position_std_m", None, message)
    if "poses" in campaign.tables and sigma is None:
        message = "the campaign does not state position_std_m: the noise has to come from replicates or residuals"
        yield Finding("note", "campaign.toml", "instrument.position_std_m", None, message)
