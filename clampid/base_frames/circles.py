"""Circles that a tracked point traces while one joint turns, and the base frame in which they lie about axes 1 and 2.

Of a circle only what does not depend on how far the joint has turned is used: that its points keep their distance from
the axis, and their place along it. Errors of the joint's own angle move a point along its circle and spoil nothing. The
base frame has axis 1 where the description has it, is turned about it so that the common normal of axes 1 and 2 points
as described, and is as high as that normal. Angle and distance between the two axes are this robot's own; they are
found beside it. Source: circle point analysis, as in Mooring, Roth, Driels, Fundamentals of Manipulator Calibration,
1991.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.optimize import least_squares

from clampid.fitting.fit import OUTLIER_SHARE
from clampid.fitting.noise import MAD_TO_STD
from clampid.stages.rows import Array, Bools, Integers, Rows
from experiments.campaign import CampaignError
from kinematics.poe import joint_transforms
from kinematics.robot import RobotDescription
from kinematics.screws import exp_se3, exp_so3, inverse

__all__ = ["Circle", "CircleFit", "circles_of", "fit_circles"]

MIN_ANGLES = 5  # angles on a circle: three define it, and two more say how well
SAME_ANGLE_WITHIN = 1e-4  # rad: other joints that are closer than this stand still
SMALLEST = 0.01  # m: a point nearer to the axis says nothing about where it is
PARALLEL = 1e-6  # sine of the angle between axes that have no common normal
OUTLIER_DEVIATIONS = 6.0  # robust standard deviations beyond which a point is wrong
CIRCLE_ROUNDS, BASE_SETTLED = 10, 1e-7  # rad and m: a base that moves less has been found
MAX_STEPS = 60  # of one fit; ten are usual
FARTHEST_OFF = 0.05  # m, rms: the deflection of the softest arm is a tenth of it
DIFFERENCE_STEP = 1e-6  # of a parameter's unit: a step of differences


@dataclass(frozen=True)
class Circle:
    """The rows of one target while one joint turned and no other.

    Attributes
    ----------
    joint
        0 or 1.
    target
        Its name.
    rows
        ``(k,)``: which rows.
    span
        rad, from the lowest to the highest angle.
    """

    joint: int
    target: str
    rows: Integers
    span: float


@dataclass(frozen=True)
class CircleFit:
    """What circles say.

    Attributes
    ----------
    base
        ``(4, 4)``: the base in the instrument's frame.
    between
        ``(2,)``: how far the angle (rad) and the distance (m) of axes 1 and 2 are from the described ones.
    jacobian, misfit
        ``(m, 8)`` and ``(m,)``, m: each point's distance from its circle, radially and along the axis, and the
        derivative by the base's small motion in its own axes, (w, v), rad and m, and by ``between``. Each circle's own
        radius and height are taken out of both.
    point
        ``(m,)``: which row each misfit is of.
    used
        ``(N,)``: rows on circles that are not outliers.
    problem, solution, points
        What was solved, where its solution is ``(8,)``, and for which points ``(N, 3)``, m.
    """

    base: Array
    between: Array
    jacobian: Array
    misfit: Array
    point: Integers
    used: Bools
    problem: _About
    solution: Array
    points: Array

    def follows(self, by: Array) -> Array:
        """How base and ``between`` follow parameters ``(8, P)`` that move the points by ``by`` ``(N, 3, P)``, m."""
        columns = [self.problem.misfit(self.solution, self.points + DIFFERENCE_STEP * d) for d in np.moveaxis(by, 2, 0)]
        moved = (np.array(columns).reshape(-1, len(self.misfit)) - self.misfit) / DIFFERENCE_STEP
        return np.asarray(-np.linalg.lstsq(self.jacobian, moved.T, rcond=None)[0])


def circles_of(rows: Rows) -> tuple[Circle, ...]:
    """The circles of joints 1 and 2 among measured poses.

    Raises
    ------
    CampaignError
        There is none of one of the two joints, or the robot has no such axes.
    """
    _common_normal(rows.robot)
    q, target = rows.signals["q"], rows.pose.target
    chain_q = q @ np.asarray(rows.robot.linkage).T
    found: list[Circle] = []
    for joint in (0, 1):
        others = np.round(np.delete(q, joint, axis=1) / SAME_ANGLE_WITHIN).astype(np.int64)
        _, group = np.unique(np.c_[others, np.round(target / 1e-9).astype(np.int64)], axis=0, return_inverse=True)
        radius = _radii(rows.robot, joint, chain_q, target)
        for k in range(int(group.max()) + 1):
            here = np.flatnonzero((group == k) & rows.used[:, 0])
            angles = np.unique(np.round(q[here, joint] / SAME_ANGLE_WITHIN))
            if len(angles) >= MIN_ANGLES and radius[here[0]] > SMALLEST:
                found.append(Circle(joint, _target(rows, here[0]), here, float(np.ptp(q[here, joint]))))
    missing = [f"joint {j + 1}" for j in (0, 1) if not any(c.joint == j for c in found)]
    if missing:
        raise CampaignError(
            f"expected circles of joints 1 and 2, each of {MIN_ANGLES} poses or more between which only that joint "
            f"moves; found none of {' and '.join(missing)}"
        )
    return tuple(sorted(found, key=lambda c: (c.joint, int(c.rows[0]))))


def fit_circles(rows: Rows, circles: Sequence[Circle], points: Array, start: Array) -> CircleFit:
    """The base frame in which points lie on circles about axes 1 and 2, by least squares.

    Points far off their circles are left out, unless they are more than a share of all: then they are no errors of
    single points, and none is.

    Parameters
    ----------
    points
        ``(N, 3)`` m, instrument frame: where the rows' points would be if nothing gave way.
    start
        ``(4, 4)``: about where the base is.

    Raises
    ------
    CampaignError
        The points lie on no circles.
    """
    found = _without_outliers(rows, circles, points, start)
    off = float(np.sqrt(2.0 * np.mean(found.misfit**2)))
    if not off <= FARTHEST_OFF:
        raise CampaignError(
            f"expected circles of joints 1 and 2, found points {1e3 * off:.0f} mm (rms) off any: are angles and points "
            "of the same rows, in radians and metres?"
        )
    return found


def _without_outliers(rows: Rows, circles: Sequence[Circle], points: Array, start: Array) -> CircleFit:
    on = np.zeros(len(rows), dtype=bool)
    on[np.concatenate([c.rows for c in circles])] = True
    found = _settled(rows, circles, points, start, on)
    while True:
        size = np.zeros(len(rows))
        np.maximum.at(size, found.point, np.abs(found.misfit))
        # The worst first: it has drawn the circles of others away from them.
        limit = max(
            OUTLIER_DEVIATIONS * MAD_TO_STD * float(np.median(np.abs(found.misfit))) + 1e-12, 0.5 * float(size.max())
        )
        left = found.used & (size <= limit)
        if np.array_equal(left, found.used):
            return found
        if np.sum(on & ~left) > OUTLIER_SHARE * on.sum():
            return _settled(rows, circles, points, start, on)
        found = _settled(rows, circles, points, found.base, left)


def _settled(rows: Rows, circles: Sequence[Circle], points: Array, start: Array, used: Bools) -> CircleFit:
    """The fit to some of the points, begun again from where it ends until the base stays."""
    for _ in range(CIRCLE_ROUNDS):
        problem = _About(rows, tuple(c.joint for c in circles), tuple(c.rows[used[c.rows]] for c in circles), start)
        found = least_squares(
            problem.misfit, np.zeros(8), args=(points,), jac="3-point", x_scale="jac", max_nfev=MAX_STEPS
        )
        if found.status == 0:
            raise CampaignError(
                "expected circles of joints 1 and 2 that show the base, found points on which no base settles: "
                "are angles and points of the same rows, in radians and metres?"
            )
        start = start @ exp_se3(found.x[:6])
        if np.abs(found.x[:6]).max() < BASE_SETTLED:
            break
    x = found.x
    return CircleFit(start, x[6:8], found.jac, found.fun, problem.point, used, problem, x, points)


@dataclass(frozen=True)
class _About:
    """Circles as rows of a least-squares problem: base (6), angle and distance of the axes.

    A circle's radius and height enter linearly: the best are the means, whatever the axis (variable projection).

    Attributes
    ----------
    joints
        Of each circle, 0 or 1.
    kept
        Rows of each circle.
    start
        ``(4, 4)``: the base that its small motion starts from.
    """

    rows: Rows
    joints: tuple[int, ...]
    kept: tuple[Integers, ...]
    start: Array

    @cached_property
    def back(self) -> tuple[Array | None, ...]:
        """Of each circle ``(k, 4, 4)``: axis 2 turns with joint 1; back to where it is described. None about axis 1."""
        robot = self.rows.robot
        chain_q = self.rows.signals["q"] @ np.asarray(robot.linkage).T
        pairs = zip(self.joints, self.kept, strict=True)
        return tuple(inverse(joint_transforms(robot.screws, chain_q[k])[:, 1]) if j else None for j, k in pairs)

    @property
    def point(self) -> Integers:
        """Which row each misfit is of: circle by circle, all radial ones and then all axial ones."""
        return np.concatenate([np.r_[k, k] for k in self.kept])

    def misfit(self, x: Array, points: Array) -> Array:
        """Distances from the axes less their mean on each circle, and heights along them less theirs ``(m,)``, m."""
        return np.concatenate([np.r_[r - r.mean(), h - h.mean()] for r, h in self._places(x, points)])

    def _places(self, x: Array, points: Array) -> list[tuple[Array, Array]]:
        """Distance from its axis and height along it, m, of the points of each circle."""
        inside = inverse(self.start @ exp_se3(x[:6]))
        robot = self.rows.robot
        normal, foot = _common_normal(robot)
        first = robot.joints[0]
        lines = (
            (first.axis, first.point),
            (exp_so3(x[6] * normal) @ robot.joints[1].axis, foot + x[7] * normal),
        )
        out = []
        for joint, here, back in zip(self.joints, self.kept, self.back, strict=True):
            y = points[here] @ inside[:3, :3].T + inside[:3, 3]
            if back is not None:
                y = np.einsum("kij,kj->ki", back[:, :3, :3], y) + back[:, :3, 3]
            axis, through = lines[joint]
            away = y - through
            height = away @ axis
            out.append((np.linalg.norm(away - height[:, None] * axis, axis=1), height))
        return out


def _common_normal(robot: RobotDescription) -> tuple[Array, Array]:
    """Unit vector across axes 1 and 2, and where it meets axis 2 ``(3,)`` m, base frame at the zero pose."""
    if robot.n < 2 or any(joint.kind != "revolute" for joint in robot.joints[:2]):
        raise CampaignError(f"robot {robot.name}: expected joints 1 and 2 to turn, so that points trace circles")
    first, second = robot.joints[:2]
    across = np.cross(first.axis, second.axis)
    sine = float(np.linalg.norm(across))
    if sine < PARALLEL:
        raise CampaignError(f"robot {robot.name}: axes 1 and 2 are parallel, and their circles leave the base's height")
    normal = across / sine
    between = first.point - second.point
    along = float(np.cross(between, first.axis) @ across) / sine**2
    return normal, np.asarray(second.point + along * second.axis)


def _radii(robot: RobotDescription, joint: int, chain_q: Array, target: Array) -> Array:
    """About how far each row's point is from the axis that turns it ``(N,)`` m; targets ``(N, 3)`` in the flange."""
    G = joint_transforms(robot.screws, chain_q)
    pose = G[:, -1] @ robot.flange
    point = np.einsum("nij,nj->ni", pose[:, :3, :3], target) + pose[:, :3, 3]
    back = inverse(G[:, joint])
    y = np.einsum("nij,nj->ni", back[:, :3, :3], point) + back[:, :3, 3] - robot.joints[joint].point
    axis = robot.joints[joint].axis
    return np.asarray(np.linalg.norm(y - (y @ axis)[:, None] * axis, axis=1))


def _target(rows: Rows, row: int) -> str:
    """The name of a row's target."""
    mine = np.flatnonzero(rows.signals["target_is"][row])
    return rows.layout.targets[int(mine[0])] if len(mine) else "flange"
