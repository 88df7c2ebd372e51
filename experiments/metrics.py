"""How good a robot is at reaching places, as ISO 9283 counts it, and errors split about a sample.

Attained positions x_j of one command, from one side, with barycentre x̄ and l_j = |x_j − x̄|::

    AP  = |x̄ − x_c|                                pose accuracy, unidirectional
    RP  = l̄ + 3 S_l                                pose repeatability, S_l² = Σ (l_j − l̄)² / (n − 1)
    vAP = max over sides h, k of |x̄_h − x̄_k|       multi-directional variation of pose accuracy
    dAP = max over t of |AP_1 − AP_t|               drift, over cycles in the order of time; dRP likewise

Source: ISO 9283:1998, 7.2.1 (AP), 7.2.2 (RP), 7.2.3 (vAP), 7.6 (drift). The universal model's P̄, σ_P and P_max are
mean, standard deviation and maximum of the errors' norms.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

__all__ = [
    "MEANING",
    "PoseMetrics",
    "Spread",
    "accuracy",
    "drift",
    "norm_metrics",
    "pose_metrics",
    "repeatability",
    "split_about",
    "variation",
]

Array = npt.NDArray[np.float64]
Labels = npt.NDArray[np.int64]
FEWEST_FOR_DRP = 4  # returns: two early and two late
MEANING = {
    "AP": "pose accuracy that the model leaves",
    "RP": "pose repeatability",
    "vAP": "variation with the side of approach",
    "dAP": "drift of the pose accuracy",
    "dRP": "drift of the pose repeatability, later returns against earlier ones",
}


def accuracy(attained: Array, command: Array) -> float:
    """AP, m: how far the barycentre of attained positions ``(n, 3)`` is from the command ``(3,)``."""
    return float(np.linalg.norm(np.mean(attained, axis=0) - command))


def repeatability(attained: Array) -> float:
    """RP, m, of attained positions ``(n, 3)``, n >= 2.

    Raises
    ------
    ValueError
        There are fewer than two.
    """
    if len(attained) < 2:
        raise ValueError(f"repeatability: expected two or more attained positions, found {len(attained)}")
    off = np.linalg.norm(attained - attained.mean(axis=0), axis=1)
    return float(off.mean() + 3 * off.std(ddof=1))


def variation(sides: Sequence[Array]) -> float:
    """VAP, m: the largest distance between barycentres of positions ``(n_h, 3)`` attained from two sides or more.

    Raises
    ------
    ValueError
        There are fewer than two sides.
    """
    if len(sides) < 2:
        raise ValueError(f"variation: expected two or more sides, found {len(sides)}")
    centres = np.array([side.mean(axis=0) for side in sides])
    return float(np.linalg.norm(centres[:, None] - centres[None], axis=-1).max())


def drift(cycles: Sequence[Array], command: Array) -> tuple[float, float]:
    """Find dAP and dRP, m, of cycles ``(n_t, 3)`` in the order of time; dRP is nan where a cycle has one position.

    Raises
    ------
    ValueError
        There are fewer than two cycles.
    """
    if len(cycles) < 2:
        raise ValueError(f"drift: expected two or more cycles, found {len(cycles)}")
    ap = np.array([accuracy(cycle, command) for cycle in cycles])
    d_ap = float(np.max(np.abs(ap - ap[0])))
    if min(len(cycle) for cycle in cycles) < 2:
        return d_ap, float("nan")
    rp = np.array([repeatability(cycle) for cycle in cycles])
    return d_ap, float(np.max(np.abs(rp - rp[0])))


def split_about(error: Array, points: Array, centre: Array) -> tuple[Array, Array]:
    """Radial and tangential parts of errors about a point, such as a sample that detectors look at.

    Parameters
    ----------
    error, points
        ``(n, 3)`` m, in one frame.
    centre
        ``(3,)`` m, in that frame; no point may lie there.

    Returns
    -------
    radial
        ``(n,)`` m, outward positive: what changes the distance from the sample.
    along
        ``(n,)`` m: length of what is left, along the sphere; over the distance it is an angle.
    """
    arm = points - centre
    outward = arm / np.linalg.norm(arm, axis=1, keepdims=True)
    radial = np.einsum("ni,ni->n", error, outward)
    return radial, np.linalg.norm(error - radial[:, None] * outward, axis=1)


@dataclass(frozen=True)
class Spread:
    """A number over several poses: how many poses, their mean and largest, m."""

    poses: int
    mean: float
    maximum: float

    def to_json(self) -> dict[str, float]:
        """For programs."""
        return {"poses": self.poses, "mean": self.mean, "max": self.maximum}


@dataclass(frozen=True)
class PoseMetrics:
    """Metrics of a table of poses; None where nothing was repeated in the way that a metric needs.

    Attributes
    ----------
    ap
        Over pose, target and side with two returns or more.
    rp
        Over the same.
    vap
        Over pose and target with two sides or more.
    drift_ap
        Over pose, target and side: first return against later ones.
    drift_rp
        Over pose, target and side with four returns or more: their earlier half against the later one.
    """

    ap: Spread | None
    rp: Spread | None
    vap: Spread | None
    drift_ap: Spread | None
    drift_rp: Spread | None

    def to_json(self) -> dict[str, dict[str, float]]:
        """For programs: ``AP``, ``RP``, ``vAP``, ``dAP``, ``dRP``, those that there are."""
        found = {"AP": self.ap, "RP": self.rp, "vAP": self.vap, "dAP": self.drift_ap, "dRP": self.drift_rp}
        return {name: spread.to_json() for name, spread in found.items() if spread is not None}


def pose_metrics(attained: Array, command: Array, place: Labels, side: Labels, time: Array) -> PoseMetrics:
    """Metrics over a table.

    Parameters
    ----------
    attained, command
        ``(n, 3)`` m: where each measured point was, and where it should be.
    place
        ``(n,)``: which pose and target.
    side
        ``(n,)``: from which side it was approached; negative where that is not known.
    time
        ``(n,)`` s.
    """
    error = attained - command
    ap, rp, vap, moved, spread = [], [], [], [], []
    for p in np.unique(place):
        here = np.flatnonzero(place == p)
        sides = [here[side[here] == s] for s in np.unique(side[here]) if s >= 0]
        if len(sides) > 1:
            vap.append(variation([error[group] for group in sides]))
        for group in sides:
            if len(group) < 2:
                continue
            ap.append(accuracy(error[group], np.zeros(3)))
            rp.append(repeatability(error[group]))
            in_time = error[group[np.argsort(time[group], kind="stable")]]
            moved.append(drift([one[None] for one in in_time], np.zeros(3))[0])
            if len(in_time) >= FEWEST_FOR_DRP:
                half = len(in_time) // 2
                spread.append(drift([in_time[:half], in_time[half:]], np.zeros(3))[1])
    return PoseMetrics(*(_spread(values) for values in (ap, rp, vap, moved, spread)))


def _spread(values: list[float]) -> Spread | None:
    return Spread(len(values), float(np.mean(values)), float(np.max(values))) if values else None


def norm_metrics(norms: Array) -> dict[str, float | None]:
    """Give the universal model's figures of errors.

    Parameters
    ----------
    norms
        Norms of position errors (N,) [m].

    Returns
    -------
    dict
        ``P_mean``, ``P_std`` (None of a single error) and ``P_max`` [m]. Source: the universal model, its tables.
    """
    spread = float(norms.std(ddof=1)) if len(norms) > 1 else None
    return {"P_mean": float(norms.mean()), "P_std": spread, "P_max": float(norms.max())}
