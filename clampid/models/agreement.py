"""Compares springs and clearances of clamped sweeps with those that the poses give, joint by joint.

The two have to be independent: poses fitted without anything from the clamped stage. Then for each joint
z = (c_poses − c_clamped)/√(σ²_poses + σ²_clamped), two-sided, and for all of them together the quadratic form of the
differences, χ² with as many degrees of freedom. Source: Rice, Mathematical Statistics and Data Analysis, 3rd ed.,
section 11.2; Holm, A simple sequentially rejective multiple test procedure, Scand. J. Statist. 6, 1979.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy import linalg, stats

from clampid.catalogue import catalogue
from clampid.effect import Effect
from clampid.models.model import StageModel
from clampid.slots import Slot
from clampid.stages.stage_kind import acts_with

__all__ = ["Agreement", "agreement_of", "is_of_drives", "shared_drives", "stands_out"]

AGREEMENT_FALSE_ALARMS = 0.05  # chance that any joint of drives that do agree is called different


@dataclass(frozen=True)
class Agreement:
    """One parameter seen by both stages; SI.

    Attributes
    ----------
    clamped, poses
        Value and standard error.
    z
        The difference in standard errors of it.
    p_value
        Two-sided, of this one alone.
    verdict
        ``agrees``, ``differs`` (5 % over all joints, Holm), or ``not testable`` where the poses do not determine it to
        within its reasonable size.
    """

    slot: Slot
    clamped: tuple[float, float]
    poses: tuple[float, float]
    z: float
    p_value: float
    verdict: str

    def to_json(self) -> dict[str, Any]:
        """For programs."""
        return {
            "parameter": f"{self.slot.effect}.{self.slot.parameter}",
            "where": self.slot.place,
            "clamped": self.clamped[0],
            "clamped_std": self.clamped[1],
            "poses": self.poses[0],
            "poses_std": self.poses[1],
            "z": self.z,
            "p_value": self.p_value,
            "verdict": self.verdict,
        }


def agreement_of(
    clamped: StageModel, poses: StageModel, effects: Mapping[str, Effect] | None = None
) -> tuple[tuple[Agreement, ...], float | None]:
    """Hold two independent stages against each other.

    Parameters
    ----------
    clamped, poses
        Stages that know nothing of each other.

    Returns
    -------
    tuple
        One entry for each shared parameter, in the order of the clamped stage, and the p-value of them all together
        (those not testable left out; None where none is left).
    """
    slots = shared_drives(clamped.slots, poses.slots, effects)
    a = np.array([clamped.slots.index(s) for s in slots], dtype=int)
    b = np.array([poses.slots.index(s) for s in slots], dtype=int)
    difference = poses.theta[b] - clamped.theta[a]
    covariance = clamped.covariance[np.ix_(a, a)] + poses.covariance[np.ix_(b, b)]
    known = np.array([clamped.identified[i] and poses.identified[k] for i, k in zip(a, b, strict=True)], dtype=bool)
    std = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    z = difference / std
    p = 2.0 * stats.norm.sf(np.abs(z))
    differs = np.zeros(len(slots), dtype=bool)
    tested = np.flatnonzero(known)
    differs[tested] = stands_out(p[tested], AGREEMENT_FALSE_ALARMS)
    words = np.where(~known, "not testable", np.where(differs, "differs", "agrees"))
    found = tuple(
        Agreement(
            slot,
            (float(clamped.theta[i]), float(clamped.std[i])),
            (float(poses.theta[k]), float(poses.std[k])),
            float(z[n]),
            float(p[n]),
            str(words[n]),
        )
        for n, (slot, i, k) in enumerate(zip(slots, a, b, strict=True))
    )
    if not len(tested):
        return found, None
    scale = std[tested]
    white = linalg.solve(
        covariance[np.ix_(tested, tested)] / np.outer(scale, scale), difference[tested] / scale, assume_a="pos"
    )
    return found, float(stats.chi2.sf(float(white @ (difference[tested] / scale)), len(tested)))


def stands_out(p: npt.NDArray[np.float64], level: float) -> npt.NDArray[np.bool_]:
    """Which of some p-values ``(k,)`` stand out, with the chance ``level`` that any does by chance (Holm, 1979)."""
    out = np.zeros(len(p), dtype=bool)
    for rank, k in enumerate(np.argsort(p)):
        if p[k] > level / (len(p) - rank):
            break
        out[k] = True
    return out


def is_of_drives(effect: Effect | None) -> bool:
    """Whether an effect is of the drives: it acts with the same parameters in clamped sweeps and in poses."""
    return effect is not None and acts_with(effect, "solved", "points")


def shared_drives(
    clamped: Sequence[Slot], poses: Sequence[Slot], effects: Mapping[str, Effect] | None = None
) -> tuple[Slot, ...]:
    """The drives' parameters that both stages have, in the order of the clamped stage."""
    known = catalogue() if effects is None else effects
    return tuple(s for s in clamped if is_of_drives(known.get(s.effect)) and s in poses)
