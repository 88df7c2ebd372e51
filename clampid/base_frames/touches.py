"""The base frame in which a tip touches what it has touched: planes, spheres and points, by generalised least squares.

With the tip's middle p in the base frame, c = R p + t in the cell, feature at a, tip radius ρ, a touch says::

    point    c - a = 0                 three numbers
    plane    n (c - a) - ρ = 0         one, along the normal to the touched side
    sphere   |c - a| - (r + ρ) = 0     one, along the line of centres

The base's small motion (w, v) in its own axes moves c by R (w x p + v). Errors that touches share (where a feature is,
where the tip is, what the model says of the arm) stand in the covariance V of the misfits, and the fit is weighed by
its inverse.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import permutations, product

import numpy as np
from scipy import linalg

from clampid.stages.rows import Array, Integers
from experiments.errors import CampaignError
from experiments.touched import Touched
from kinematics.screws import exp_se3, hat3, inverse, log_se3

__all__ = ["Touches", "descend", "starts_of", "touches_of", "undetermined"]

MAX_STEPS, SETTLED = 200, 1e-11  # rad and m: a base that moves less has been found
BLIND = 1e-4  # of the best determined motion: below that share of it a motion is not determined by the touches
EQUALLY_GOOD = 2.0  # of the best rms: a base that fits no worse than this is another that might be meant
LEAST_BASE_DISTANCE = 1e-3  # rad and m between bases that are not one
NEVER = 1e12  # a damping at which no step is a step


@dataclass(frozen=True)
class Touches:
    """Touches as misfits of a base.

    Attributes
    ----------
    points
        ``(N, 3)`` m: the tip's middle in the base frame, as far as known.
    kind
        ``(N,)``: plane, sphere or point.
    at, normal
        ``(N, 3)``: of the touched feature, m, and unit, cell frame.
    reach
        ``(N,)`` m: how far the tip's middle is from a plane, or from a sphere's centre.
    """

    points: Array
    kind: tuple[str, ...]
    at: Array
    normal: Array
    reach: Array

    @cached_property
    def touch(self) -> Integers:
        """Which touch each misfit is of ``(m,)``."""
        return np.repeat(np.arange(len(self.kind)), [3 if kind == "point" else 1 for kind in self.kind])

    @cached_property
    def _axis(self) -> Integers:
        """Which axis each misfit of a point is along ``(m,)``; 0 elsewhere."""
        return np.concatenate([np.arange(3 if kind == "point" else 1) for kind in self.kind])

    def misfit(self, base: Array) -> tuple[Array, Array]:
        """How far each touch is from its feature ``(m,)`` m, and by which direction of the tip ``(m, 3)``, cell."""
        off = self.points @ base[:3, :3].T + base[:3, 3] - self.at
        kind = np.array(self.kind)[self.touch]
        along = np.eye(3)[self._axis]
        along[kind == "plane"] = self.normal[self.touch][kind == "plane"]
        round_ = kind == "sphere"
        away = off[self.touch][round_]
        along[round_] = away / np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 1e-12)
        return np.einsum("mi,mi->m", off[self.touch], along) - self.reach[self.touch], along

    def jacobian(self, base: Array, along: Array) -> Array:
        """Derivative of the misfits by the base's small motion in its own axes ``(m, 6)``, m/rad and 1."""
        turned = along @ base[:3, :3]
        return np.hstack([np.cross(self.points[self.touch], turned), turned])

    def take(self, kept: Integers) -> Touches:
        """Some of the touches."""
        kinds = tuple(self.kind[k] for k in kept)
        return Touches(self.points[kept], kinds, self.at[kept], self.normal[kept], self.reach[kept])


def touches_of(touched: Touched, points: Array) -> Touches:
    """The touches, the tip's middle being at points ``(N, 3)`` m of the base frame."""
    found = [touched.features[k] for k in touched.feature]
    reach = [0.0 if f.kind == "point" else f.radius + touched.tip_radius for f in found]
    kinds = tuple(f.kind for f in found)
    return Touches(points, kinds, np.array([f.point for f in found]), np.array([f.normal for f in found]),
                   np.array(reach))  # fmt: skip


def descend(touches: Touches, base: Array, covariance: Array | None = None) -> tuple[Array, float]:
    """The base ``(4, 4)`` nearest to a start that the touches agree with best, and their chi-square, by damped steps.

    ``covariance`` ``(m, m)`` m² of the misfits; without it all count alike, and chi-square is in m².
    """
    root = None if covariance is None else np.linalg.cholesky(covariance)

    def whitened(at: Array) -> tuple[Array, Array]:
        misfit, along = touches.misfit(at)
        both = np.c_[misfit, touches.jacobian(at, along)]
        both = both if root is None else linalg.solve_triangular(root, both, lower=True)
        return both[:, 0], both[:, 1:]

    damping = 1e-3
    misfit, J = whitened(base)
    for _ in range(MAX_STEPS):
        scale = np.maximum(np.linalg.norm(J, axis=0), 1e-12)
        A = J / scale
        step = np.linalg.solve(A.T @ A + damping * np.eye(6), -A.T @ misfit) / scale
        there = base @ exp_se3(step)
        next_misfit, next_J = whitened(there)
        if next_misfit @ next_misfit <= misfit @ misfit:
            base, misfit, J, damping = there, next_misfit, next_J, damping / 5
            if np.abs(step).max() < SETTLED:
                break
        elif damping > NEVER:
            break
        else:
            damping *= 10
    return base, float(misfit @ misfit)


def starts_of(touches: Touches, given: Array | None, least: float) -> Array:
    """The base that the touches agree with best, from wherever one starts.

    Parameters
    ----------
    given
        ``(4, 4)``: about where it is, or None if nobody knows.
    least
        m: no misfit matters that is smaller.

    Raises
    ------
    CampaignError
        Touches leave a motion open, or another base agrees nearly as well.
    """
    if given is not None:
        found = [descend(touches, given)]
    else:
        found = [descend(touches, _placed(touches, R)) for R in _quarter_turns()]
        found.sort(key=lambda pair: pair[1])
    base, best = found[0]
    left = undetermined(touches, base)
    if left:
        raise CampaignError(
            f"{len(touches.kind)} touches leave the base free to {' and to '.join(left)} (frame of the cell): touch "
            "further features"
        )
    count = len(touches.touch)
    limit = EQUALLY_GOOD**2 * max(best, count * least**2)
    for other, size in found[1:]:
        away = np.abs(log_se3(inverse(base) @ other)).max()
        if size <= limit and away > LEAST_BASE_DISTANCE:
            raise CampaignError(
                f"two bases agree with the {len(touches.kind)} touches, at {_place(base)} and at {_place(other)}: say "
                "with start_m and start_rad about where the base is, or touch more"
            )
    return base


def undetermined(touches: Touches, base: Array) -> list[str]:
    """Motions of the base that the touches do not determine, in words: shifts and turns in the cell frame."""
    J = touches.jacobian(base, touches.misfit(base)[1])
    middle = touches.points.mean(axis=0)
    size = max(float(np.sqrt(np.mean(np.sum((touches.points - middle) ** 2, axis=1)))), 1e-3)
    # Motion as turn (times size) and as velocity of the touched points' middle, base axes.
    to_own = np.block([[np.eye(3) / size, np.zeros((3, 3))], [hat3(middle) / size, np.eye(3)]])
    _, singular, Vt = np.linalg.svd(J @ to_own)
    gain = np.zeros(6)
    gain[: len(singular)] = singular
    N = Vt[gain < BLIND * gain.max()]  # (k, 6)
    if not len(N):
        return []
    U, turning, _ = np.linalg.svd(N[:, :3])
    turning = np.r_[turning, np.zeros(len(N))][: len(N)]
    words = []
    R, centre = base[:3, :3], base[:3, :3] @ middle + base[:3, 3]
    for coefficients, much in zip(U.T, turning, strict=True):
        motion = coefficients @ N
        w, v = R @ motion[:3] / size, R @ motion[3:]
        if much < 1e-6:
            words.append(f"shift along {_vector(_direction(v))}")
        else:
            pivot = centre + np.cross(w, v) / (w @ w)
            words.append(f"turn about {_vector(_direction(w))} through {_vector(pivot)} m")
    return words


def _direction(v: Array) -> Array:
    """The line's unit vector whose largest entry is positive."""
    return np.asarray(v / np.linalg.norm(v) * np.sign(v[np.argmax(np.abs(v))]))


def _vector(v: Array) -> str:
    return f"({', '.join(f'{x:.3f}' for x in np.round(v, 3) + 0.0)})"


def _place(base: Array) -> str:
    return f"{_vector(base[:3, 3])} m"


def _placed(touches: Touches, R: Array) -> Array:
    """A base turned so, where the middle of the touched points is that of the features."""
    base = np.eye(4)
    base[:3, :3], base[:3, 3] = R, touches.at.mean(axis=0) - R @ touches.points.mean(axis=0)
    return base


def _quarter_turns() -> Sequence[Array]:
    """The 24 rotations of a cube: none is farther than 63 degrees from one of them."""
    found = []
    for order in permutations(range(3)):
        for signs in product((1.0, -1.0), repeat=3):
            R = np.eye(3)[list(order)] * np.array(signs)[:, None]
            if np.linalg.det(R) > 0:
                found.append(R)
    return found
