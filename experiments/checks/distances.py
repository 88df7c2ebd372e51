"""Checks measured distances: in metres, from this robot to fixed anchors, and enough to locate the anchors."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import numpy.typing as npt

from experiments.campaign import Campaign, target_points
from experiments.checks.angles import joint_angles
from experiments.checks.finding import Finding
from experiments.checks.mistakes import joint_mistakes, renaming_words, target_mistakes
from experiments.checks.points import CLEARLY_WRONG_M, SIGN_WRONG_M, UNITS
from experiments.checks.rigid_fit import FLAT
from experiments.measures.lateration import Located, locate
from kinematics.poe import forward
from kinematics.robot import RobotDescription

__all__ = ["distance_findings"]

FloatArray = npt.NDArray[np.float64]

# Three distances determine a place; only the fourth depends on the robot's errors.
FEWEST_POSES = 4
TABLE = "distances"
CLEARLY = 0.2  # share of the error; a correct explanation leaves less


def distance_findings(campaign: Campaign, angles_wrong: frozenset[str], fits: bool = False) -> Iterator[Finding]:
    """Look at measured distances.

    Parameters
    ----------
    campaign
        The campaign.
    angles_wrong
        Tables whose angles are known to be wrong, so that nominal positions there mean nothing.

    Yields
    ------
    Finding
        Errors for other units, warnings for anchors that cannot be located and distances that do not fit, a note on
        what distances alone do not determine.
    """
    if TABLE not in campaign.tables:
        return
    frame, robot = campaign.tables[TABLE], campaign.robot
    distances = frame["distance_m"].to_numpy(dtype=np.float64)
    if not distances.all():
        row = int(np.flatnonzero(distances == 0.0)[0]) + 1
        message = f"{np.sum(distances == 0.0)} distances are zero, first in row {row}: was the target at the anchor?"
        yield Finding("error", TABLE, "distance_m", row, message)
        return
    names = frame["anchor"].astype(str).to_numpy()
    if TABLE not in angles_wrong:
        q, targets = joint_angles(campaign, TABLE), target_points(campaign, TABLE)
        points = _places(robot, q, targets)
        wrong = _wrong_unit(names, points, distances) or _mistaken(campaign, names, q, targets, distances)
        if wrong:
            yield wrong
            return
        for name in dict.fromkeys(names):
            mine = np.flatnonzero(names == name)
            yield from _anchor(name, frame["pose"].to_numpy()[mine], points[mine], distances[mine], mine)
    yield from _enough(campaign, fits)
    if "poses" not in campaign.tables:
        yield Finding(
            "note", TABLE, "anchor", None,
            "distances alone do not determine where the robot's base stands: anchors are located in the described "
            "robot's own base frame, and its base is taken to stand there",
        )  # fmt: skip


def _wrong_unit(names: npt.NDArray[np.object_], points: FloatArray, distances: FloatArray) -> Finding | None:
    """Distances that fit in another unit, and do not fit in metres."""
    here = _misfit(names, points, distances)
    if here <= CLEARLY_WRONG_M:
        return None
    fits = {words: _misfit(names, points, distances / factor) for factor, words in UNITS.items()}
    best = min(fits, key=lambda words: fits[words])
    if fits[best] > CLEARLY * min(here, 5.0 * CLEARLY_WRONG_M):
        return None
    message = (
        f"distances look like {best}, metres are expected: in metres they stay {here:.3g} m (median) from the nominal "
        "robot's wherever the anchors are"
    )
    return Finding("error", TABLE, "distance_m", None, message)


def _mistaken(
    campaign: Campaign, names: npt.NDArray[np.object_], q: FloatArray, targets: FloatArray, distances: FloatArray
) -> Finding | None:
    """The sign, exchange of joints or exchange of target names with which the distances fit.

    Anchors may be anywhere, so that more than one mistake may nearly fit: one is named only if it fits far better.
    """
    robot, here = campaign.robot, _misfit(names, _places(campaign.robot, q, targets), distances)
    if here <= SIGN_WRONG_M:
        return None
    found: list[tuple[float, str, str]] = []
    for first, words, angles in joint_mistakes(q):
        found.append((_misfit(names, _places(robot, angles, targets), distances), f"q{first}_rad", words))
    labels = [str(name) for name in campaign.tables[TABLE]["target"]]
    known = {"flange": np.zeros(3), **campaign.targets}
    for swap in target_mistakes(sorted(set(labels))):
        renamed = np.stack([known[swap.get(name, name)] for name in labels])
        found.append((_misfit(names, _places(robot, q, renamed), distances), "target", renaming_words(swap)))
    best, column, words = min(found)
    if best > CLEARLY * min([here, *(miss for miss, _, other in found if other != words)]):
        return None
    message = (
        f"distances stay {here * 1e3:.0f} mm (median) from the nominal robot's wherever the anchors are; they fit with "
        f"{words}"
    )
    return Finding("error", TABLE, column, None, message)


def _places(robot: RobotDescription, q: FloatArray, targets: FloatArray) -> FloatArray:
    """Nominal points ``(N, 3)``, m, base frame, of angles ``(N, n)``, rad, and targets ``(N, 3)``, m, on the flange."""
    pose = forward(robot.screws, robot.flange, q @ robot.linkage.T)
    return np.asarray(pose[:, :3, 3] + np.einsum("rij,rj->ri", pose[:, :3, :3], targets))


def _misfit(names: npt.NDArray[np.object_], points: FloatArray, distances: FloatArray) -> float:
    """Median error of the distances, m, with each anchor at its best-fitting place."""
    parts = [locate(points[names == name], distances[names == name]).error for name in set(names)]
    return float(np.median(np.abs(np.concatenate(parts))))


def _anchor(
    name: str, poses: npt.NDArray[np.int64], points: FloatArray, distances: FloatArray, rows: npt.NDArray[np.intp]
) -> Iterator[Finding]:
    """One anchor: whether it can be located, and whether its distances fit."""
    count = len(set(poses.tolist()))
    if count < FEWEST_POSES:
        message = (
            f"anchor {name} is seen from {count} pose{'s' if count > 1 else ''}: three are needed to locate the anchor "
            f"itself, so that these distances identify {'hardly anything' if count == FEWEST_POSES - 1 else 'nothing'} "
            "of the robot"
        )
        yield Finding("warning", TABLE, "anchor", int(rows[0]) + 1, message)
        return
    found = locate(points, distances)
    yield from _unlocated(name, points, found)
    if found.size > CLEARLY_WRONG_M:
        message = (
            f"distances to anchor {name} stay {found.size * 1e3:.0f} mm (median) from the nominal robot's wherever it "
            "is: wrong robot, joint order, sign or target, or an anchor that was moved?"
        )
        yield Finding("warning", TABLE, "distance_m", int(rows[0]) + 1, message)
        return
    bad = np.flatnonzero(np.abs(found.error) > CLEARLY_WRONG_M + 10.0 * found.size)
    if bad.size:
        worst = int(bad[np.argmax(np.abs(found.error[bad]))])
        message = (
            f"{bad.size} of {len(rows)} distances to anchor {name} are far from where the others say they should be "
            f"(worst {abs(found.error[worst]) * 1e3:.0f} mm, row {rows[worst] + 1}): probably mismeasured or misnamed"
        )
        yield Finding("warning", TABLE, "distance_m", int(rows[worst]) + 1, message)
    elif found.constant:
        message = (
            f"distances to anchor {name} are all too {'long' if found.constant > 0 else 'short'} by about "
            f"{abs(found.constant) * 1e3:.0f} mm: does the instrument have a zero offset, as a draw-wire has? "
            "The effect additive_constant fits it"
        )
        yield Finding("warning", TABLE, "distance_m", int(rows[0]) + 1, message)


def _unlocated(name: str, points: FloatArray, found: Located) -> Iterator[Finding]:
    """Whether the directions to the points do not determine the anchor's place."""
    off = points - points.mean(axis=0)
    extent = np.linalg.svd(off, compute_uv=False) / np.sqrt(len(off))
    if found.spread[0] < FLAT:
        across = "line" if found.spread[1] < FLAT else "plane"
        message = (
            f"anchor {name} and all points measured to it lie on one {across}: its place across that is "
            "hardly identifiable; measure points off it"
        )
        yield Finding("warning", TABLE, "anchor", None, message)
    elif extent[2] < FLAT * extent[0] or found.mirrored is not None:
        message = (
            f"the points measured to anchor {name} lie in a plane: it may be on either side of "
            "it; measure points off it"
        )
        yield Finding("warning", TABLE, "anchor", None, message)


def _enough(campaign: Campaign, fits: bool) -> Iterator[Finding]:
    """Whether there are enough distances for the geometry, where nothing else is measured."""
    if "poses" in campaign.tables:
        return
    frame, robot = campaign.tables[TABLE], campaign.robot
    targets, anchors = frame["target"].nunique(), frame["anchor"].nunique()
    # Six parameters belong to the base frame, on which distances do not depend.
    unknown = sum(4 if joint.kind == "revolute" else 2 for joint in robot.joints) + 3 * targets + 3 * anchors - 6
    numbers = len(frame.drop_duplicates(["pose", "target", "anchor"]))
    if numbers < 2 * unknown:
        few = "fewer than" if numbers < unknown else "hardly more than"
        known = bool(campaign.stated.targets_std)  # then fewer may do
        yield Finding(
            "error" if fits and not known and numbers < unknown else "warning", TABLE, "pose", None,
            f"{numbers} distances are {few} the {unknown} numbers that the geometry of {robot.n} joints, "
            f"{targets} target{'s' if targets > 1 else ''} and {anchors} anchor{'s' if anchors > 1 else ''} have: a "
            f"model fitted to them does not predict other poses; measure {2 * unknown} or more",
        )  # fmt: skip
