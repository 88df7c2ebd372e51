"""Judges whether measured points and orientations are those of this robot, in metres, with these targets.

No base frame is known beforehand: spread, distances and the best rigid fit of nominal to measured points need none.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations
from typing import Literal

import numpy as np
import numpy.typing as npt
import pandas as pd
from scipy import stats

from experiments.campaign import Campaign, target_points
from experiments.checks.angles import joint_angles
from experiments.checks.finding import Finding
from experiments.checks.mistakes import joint_mistakes, renaming_words, target_mistakes
from experiments.checks.rigid_fit import (
    FEW_ROWS,
    FLAT,
    FloatArray,
    RigidFit,
    fit_rigid,
    near_points,
    orientation_findings,
    spread_of,
)
from experiments.columns import POSITION, QUATERNION
from kinematics.poe import forward

__all__ = ["enough_poses", "point_findings"]


# A real arm's points spread as the nominal ones do, within per cent. Between that and the nearest wrong unit (inches,
# 39) lies a wide gap; 5 is beyond any robot mistaken for another.
WRONG_UNIT = 5.0
UNITS = {1e6: "micrometres", 1e3: "millimetres", 100.0: "centimetres", 1 / 0.0254: "inches"}
UNIT_TOLERANCE = 0.25
# Below this the nominal points hardly move, and their spread does not show the unit.
SMALLEST_SPREAD_M = 1e-3
# No instrument for robots measures from farther away; 1 m in millimetres is ten times that.
FARTHEST_M = 100.0
FEWEST_STOPS = 4
"""Poses from which on joints are judged: base frame and tool offset fit three positions of a target exactly."""
# An arm out of calibration errs by a few millimetres; a wrong robot, joint order, sign or target by centimetres.
CLEARLY_WRONG_M = 0.02
TARGETS_WRONG_M = 0.01
# Where each stop has several rows, a shift by one row spoils one row of each stop: a tenth and more of all rows.
SHIFTED_SHARE = 0.1
# No working arm errs by so much. Whatever the mistake is, a model of these points would be useless.
NOT_THIS_ROBOT_M = 0.1
# A wrong sign of a joint that hardly moves the targets causes less; with the right sign a few millimetres remain.
SIGN_WRONG_M = 0.005
# A target nearer to the last joint's axis than the wrist's own errors is not moved by that joint.
ON_AXIS_M = 0.005
# A mistake is named if it fits better than the description; false alarms: one in a thousand campaigns, over all
# mistakes tried. A median has the efficiency of 0.37 of the rows.
BY_CHANCE, OF_A_MEDIAN = 1e-3, 0.37
# Measured numbers for each fitted parameter, with which other poses are predicted nearly as well as noise allows.
NUMBERS_PER_PARAMETER = 5
DESCRIPTIONS_TRIED = 50  # signs and pairs of up to eight joints, targets' names, and a mirror


def point_findings(campaign: Campaign, angles_wrong: frozenset[str], fits: bool = False) -> Iterator[Finding]:
    """Look at measured points.

    Parameters
    ----------
    campaign
        The campaign.
    angles_wrong
        Tables whose angles are known to be wrong, so that nominal positions there mean nothing.

    Yields
    ------
    Finding
        Errors for other units and mirrored frames, warnings for points that do not fit.
    """
    for table in ("poses", "verification"):
        if table not in campaign.tables:
            continue
        if table == "poses":
            yield from _enough(campaign, fits)
        measured = campaign.tables[table][list(POSITION)].to_numpy(dtype=np.float64)  # (rows, 3)
        poses = _nominal_poses(campaign, table)
        points = target_points(campaign, table)
        nominal = poses[:, :3, 3] + np.einsum("rij,rj->ri", poses[:, :3, :3], points)
        unit = _wrong_unit(table, nominal, measured)
        if unit:
            yield unit
            continue
        if table == "poses":
            yield from _flat(measured)
        yield from _target_distances(campaign, table, measured)
        if table not in angles_wrong and campaign.tables[table]["pose"].nunique() >= FEWEST_STOPS:
            yield from _rigid_fit(campaign, table, poses, measured)


def enough_poses(frame: pd.DataFrame, parameters: int) -> int:
    """How many poses determine so many parameters that other poses are predicted nearly as well as they are measured.

    A fit of P parameters to N numbers of random poses predicts other poses with sqrt(1 + P / (N - P - 1)) of the noise.
    With `NUMBERS_PER_PARAMETER` that is 1.12.

    Parameters
    ----------
    frame
        The rows of ``poses``, one for each point.
    parameters
        How many are fitted.
    """
    each, once = _shown(frame)
    return -(-(NUMBERS_PER_PARAMETER * parameters - once) // each)


def _shown(frame: pd.DataFrame) -> tuple[int, int]:
    """Measured numbers of each pose, and those that all poses share.

    A stop with one target has three numbers, with two five, with more six; distances between targets count once. With
    an orientation a stop has six, and the tool's frame has six of its own.
    """
    count = frame["target"].nunique()
    if QUATERNION[0] in frame or "flange" in set(frame["target"].astype(str)):
        return 6, 0
    return {1: (3, 0), 2: (5, 1)}.get(count, (6, 3 * count - 6))


def _enough(campaign: Campaign, fits: bool) -> Iterator[Finding]:
    """Whether there are enough poses for the geometry, and whether the last joint moves any target."""
    frame, robot = campaign.tables["poses"], campaign.robot
    names = sorted(set(frame["target"].astype(str)))
    oriented = QUATERNION[0] in frame or "flange" in names
    count, poses = len(names), frame["pose"].nunique()
    shown = _shown(frame)
    unknown = sum(4 if joint.kind == "revolute" else 2 for joint in robot.joints) + (6 if oriented else 3 * count)
    least = -(-(unknown - shown[1]) // shown[0])
    enough = enough_poses(frame, unknown)
    if poses < enough:  # seven poses of a UR10 with orientations: 0.1 mm fitted, 1 to 50 mm on others
        what = "the flange" if oriented else f"{count} target{'s' if count > 1 else ''}"
        few = f"fewer than the {least}" if poses < least else f"hardly more than the {least}"
        geometry = f"the geometry of {robot.n} joints and {what}"
        says = f"{few} that {geometry} needs ({unknown} parameters): a model fitted to them does not predict others"
        if poses >= 2 * least:
            says = f"few for {geometry} ({unknown} parameters): a model fitted to them may predict others badly"
        known = bool(campaign.stated.targets_std) or campaign.stated.base is not None  # then fewer poses may do
        yield Finding(
            "error" if fits and not known and poses < 2 * least else "warning", "poses", "pose", None,
            f"{poses} pose{'s are' if poses > 1 else ' is'} {says}; measure {enough} or more",
        )  # fmt: skip
    if oriented:
        return
    axis, point = np.asarray(robot.joints[-1].axis), np.asarray(robot.joints[-1].point)
    places = np.array([robot.flange[:3, :3] @ campaign.targets[name] + robot.flange[:3, 3] for name in names])
    off = np.linalg.norm(np.cross(places - point, axis), axis=1)
    if robot.joints[-1].kind == "revolute" and off.max() < ON_AXIS_M:
        yield Finding(
            "warning", "poses", "target", None,
            f"{', '.join(names)}: within {1e3 * ON_AXIS_M:g} mm of joint {robot.n}'s axis, which hardly moves "
            f"{'them' if count > 1 else 'it'}: zero offset, clearance and compliance of joint {robot.n} cannot be seen",
        )  # fmt: skip


def _flat(measured: FloatArray) -> Iterator[Finding]:
    """Whether the points (rows, 3) lie in a plane or on a line: errors across it can hardly be identified."""
    off = measured - np.median(measured, axis=0)
    near = np.linalg.norm(off, axis=1)
    kept = off[near <= 5.0 * np.median(near)]  # a lost point does not make a plane a volume
    extent = np.linalg.svd(kept - kept.mean(axis=0), compute_uv=False) / np.sqrt(len(kept))  # rms along main axes, m
    if len(kept) < 4 or not extent[0] > SMALLEST_SPREAD_M or extent[2] >= FLAT * extent[0]:
        return
    line = extent[1] < FLAT * extent[0]
    wide, thick = extent[0], extent[1 if line else 2]
    missing = "the turn of the base about it is hardly identifiable, and " if line else ""
    yield Finding(
        "warning", "poses", "x_m", None,
        f"the points lie {'on a line' if line else 'in a plane'}: within {1e3 * thick:.3g} mm (rms) of it, where they "
        f"reach {1e3 * wide:.3g} mm along it: {missing}errors that grow with the distance from it are hardly "
        "identifiable; measure points off it",
    )  # fmt: skip


def _nominal_poses(campaign: Campaign, table: str) -> FloatArray:
    """Nominal flange poses (rows, 4, 4) in the robot base frame."""
    q = joint_angles(campaign, table)
    poses: FloatArray = forward(campaign.robot.screws, campaign.robot.flange, q @ campaign.robot.linkage.T)
    return poses


def _wrong_unit(table: str, nominal: FloatArray, measured: FloatArray) -> Finding | None:
    near = near_points(measured)
    expected, found = spread_of(nominal[near]), spread_of(measured[near])
    distance = float(np.median(np.linalg.norm(measured, axis=1)))
    if expected > SMALLEST_SPREAD_M:
        ratio = found / expected
        if 1 / WRONG_UNIT < ratio < WRONG_UNIT:
            return None
        reason = f"they spread {found:.4g} about their centre, where the nominal robot spreads {expected:.4g} m"
        for factor, unit in UNITS.items():
            if abs(np.log(ratio / factor)) < UNIT_TOLERANCE:
                return Finding(
                    "error", table, "x_m", None, f"positions look like {unit}, metres are expected: {reason}"
                )
        farthest = int(np.argmax(np.linalg.norm(measured - np.median(measured, axis=0), axis=1))) + 1
        message = f"positions cannot be of this robot in metres: {reason}; farthest off is row {farthest}"
        return Finding("error", table, "x_m", farthest, message)
    if distance > FARTHEST_M:
        reason = f"half of them are more than {distance:.4g} from the instrument's origin"
        return Finding("error", table, "x_m", None, f"positions look like millimetres, metres are expected: {reason}")
    return None


def _target_distances(campaign: Campaign, table: str, measured: FloatArray) -> Iterator[Finding]:
    """Distances between targets at one stop do not depend on the arm or on any frame."""
    frame = campaign.tables[table]
    stops = frame[["pose", "visit", "target"]].assign(row=np.arange(len(frame)))
    rows = stops.drop_duplicates(["pose", "visit", "target"]).pivot(
        index=["pose", "visit"], columns="target", values="row"
    )
    known = {"flange": np.zeros(3), **campaign.targets}
    for first, second in combinations(rows.columns, 2):
        both = rows[[first, second]].dropna().to_numpy(dtype=np.intp)
        if not len(both):
            continue
        nominal = float(np.linalg.norm(known[first] - known[second]))
        error = np.linalg.norm(measured[both[:, 0]] - measured[both[:, 1]], axis=1) - nominal
        bad = np.flatnonzero(np.abs(error) > TARGETS_WRONG_M)
        if bad.size:
            worst = bad[np.argmax(np.abs(error[bad]))]
            row = int(both[worst, 1]) + 1
            message = (
                f"{first} and {second} are {nominal:.4f} m apart in [targets_m]; at {bad.size} of {len(both)} stops "
                f"their measured distance differs by more than {TARGETS_WRONG_M * 1e3:.0f} mm (worst "
                f"{nominal + error[worst]:.4f} m, row {row}): swapped, misdeclared or mismeasured targets"
            )
            yield Finding("warning", table, "target", row, message)


def _rigid_fit(campaign: Campaign, table: str, poses: FloatArray, measured: FloatArray) -> Iterator[Finding]:
    """Check the residual of nominal against measured points after the best base frame and tool offset."""
    points = target_points(campaign, table)
    fit = fit_rigid(poses, points, measured)
    residual = fit.distance
    size = float(np.median(residual))
    good = min(0.2, _clearly_better(len(measured))) * size
    mistaken = _mistaken_joints(campaign, table, points, measured, good) if size > SIGN_WRONG_M else None
    if mistaken:
        first, joints = mistaken
        message = (
            f"positions stay {size * 1e3:.0f} mm (median) from the nominal ones in the best base and tool frame; they "
            f"fit with {joints}"
        )
        yield Finding("error", table, f"q{first}_rad", None, message)
        return
    if size > CLEARLY_WRONG_M:
        far = f"positions stay {size * 1e3:.0f} mm (median) from the nominal ones in the best base and tool frame"
        if np.median(fit_rigid(poses, points, measured * [1.0, 1.0, -1.0]).distance) < good:
            message = f"{far}; they fit when mirrored: an axis has a wrong sign, or two are swapped"
            yield Finding("error", table, "x_m", None, message)
            return
        shifted = _shifted_rows(campaign, table, poses, points, measured, good)
        if shifted:
            yield Finding("error", table, "q1_rad", None, f"{far}; {shifted}")
            return
        swap = _swapped_targets(campaign, table, poses, measured, good)
        reason = f"they fit with {swap}" if swap else "wrong robot, joint order or sign?"
        severity: Literal["error", "warning"] = "error" if swap or size > NOT_THIS_ROBOT_M else "warning"
        yield Finding(severity, table, "target" if swap else "x_m", None, f"{far}; {reason}")
        return
    if QUATERNION[0] in campaign.tables[table]:
        yield from orientation_findings(table, campaign.tables[table], poses, fit.base)
    bad = np.flatnonzero(residual > CLEARLY_WRONG_M + 10.0 * size)
    if bad.size:
        shifted = None
        if bad.size > SHIFTED_SHARE * len(residual):  # of several targets at a stop only the first or the last is wrong
            shifted = _shifted_rows(campaign, table, poses, points, measured, CLEARLY_WRONG_M, 1.0 - FEW_ROWS)
        if shifted:
            message = f"{bad.size} of {len(residual)} positions are far from where the others say they should be"
            yield Finding("error", table, "q1_rad", None, f"{message}; {shifted}")
            return
        worst = int(bad[np.argmax(residual[bad])])
        renamed = _mistaken_targets(campaign, table, poses, measured, bad, fit)
        if renamed:
            yield Finding("error", table, "target", int(bad[0]) + 1, renamed)
            return
        message = (
            f"{bad.size} of {len(residual)} positions are far from where the others say they should be (worst "
            f"{residual[worst] * 1e3:.0f} mm, row {worst + 1}): probably mismeasured or mislabelled"
        )
        yield Finding("warning", table, "x_m", worst + 1, message)


def _clearly_better(rows: int) -> float:
    """Critical ratio of two fits' median distances: below it the better fit is significant.

    An F test of what both leave beyond the nine numbers that are fitted, shared out over about as many mistakes as are
    tried; zero where the points are too few to tell.
    """
    freedom = OF_A_MEDIAN * (3 * rows - 9)
    return float(stats.f.isf(BY_CHANCE / DESCRIPTIONS_TRIED, freedom, freedom) ** -0.5) if freedom > 0 else 0.0


def _mistaken_joints(
    campaign: Campaign, table: str, points: FloatArray, measured: FloatArray, good: float
) -> tuple[int, str] | None:
    """Which joint's sign must be turned, or which two joints exchanged, to make the points fit: the first, and words.

    With one target several signs may fit equally well (a mirrored arm). A mistake is named only if it alone fits.
    """
    robot, found = campaign.robot, []
    for first, words, angles in joint_mistakes(joint_angles(campaign, table)):
        poses = forward(robot.screws, robot.flange, angles @ robot.linkage.T)
        if np.median(fit_rigid(poses, points, measured).distance) < good:
            found.append((first, words))
    return found[0] if len(found) == 1 else None


def _shifted_rows(
    campaign: Campaign,
    table: str,
    poses: FloatArray,
    points: FloatArray,
    measured: FloatArray,
    good: float,
    share: float = 0.5,
) -> str | None:
    """Message: joint angles of a row or visit stand in the row of the next or previous one's points.

    ``share`` of the rows must then fit to within ``good``, m.
    """
    frame = campaign.tables[table]
    stops = frame.groupby(["pose", "visit"], sort=False).ngroup().to_numpy()
    steps: list[tuple[str, npt.NDArray[np.intp]]] = [("row", np.arange(len(frame), dtype=np.intp))]
    if stops[-1] + 1 < len(frame):  # several targets at a stop: all are in the rows of the next stop's angles
        steps.append(("visit", stops.astype(np.intp)))
    for what, number in steps:
        firsts = {int(n): int(i) for i, n in reversed(list(enumerate(number)))}
        for step in (1, -1):
            of = np.array([firsts.get(int(n) + step, -1) for n in number])
            there = of >= 0
            if there.sum() < len(frame) // 2:
                continue
            moved = fit_rigid(poses[of[there]], points[there], measured[there])
            if np.quantile(moved.distance, share) < good:
                other = "next" if step > 0 else "previous"
                return (
                    f"they fit when the points of each {what} are taken with the joint angles of the {other} one: the "
                    f"columns are shifted against each other by one {what}"
                )
    return None


def _swapped_targets(
    campaign: Campaign, table: str, poses: FloatArray, measured: FloatArray, good: float
) -> str | None:
    """How targets' names must be exchanged to make the points fit; distances do not show it if all are equal."""
    known = {"flange": np.zeros(3), **campaign.targets}
    labels = [str(name) for name in campaign.tables[table]["target"]]
    for swap in target_mistakes(sorted(set(labels))):
        points = np.stack([known[swap.get(name, name)] for name in labels])
        if np.median(fit_rigid(poses, points, measured).distance) < good:
            return renaming_words(swap)
    return None


def _mistaken_targets(
    campaign: Campaign, table: str, poses: FloatArray, measured: FloatArray, bad: npt.NDArray[np.intp], fit: RigidFit
) -> str | None:
    """In words, at which poses points lie where other targets should be; None if a point remains unexplained."""
    frame = campaign.tables[table]
    names = sorted(set(frame["target"].astype(str)))
    known = {"flange": np.zeros(3), **campaign.targets}
    found: dict[str, None] = {}
    for row in bad:
        there = np.array([fit.place(poses[row], known[name]) for name in names])
        off = np.linalg.norm(there - measured[row], axis=1)
        best, own = names[int(np.argmin(off))], str(frame["target"].iloc[row])
        if off.min() > CLEARLY_WRONG_M / 2 or best == own:
            return None
        found[f"{own} lies where {best} should"] = None
    stops = list(dict.fromkeys(int(p) for p in frame["pose"].iloc[bad]))
    listed = ", ".join(map(str, stops[:10])) + (f" and {len(stops) - 10} more" if len(stops) > 10 else "")
    return f"targets are swapped at pose{'s' if len(stops) > 1 else ''} {listed}: {', '.join(list(found)[:6])}"
