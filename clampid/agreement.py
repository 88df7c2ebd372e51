"""Holds springs and clearances of clamped sweeps against those that the poses want, joint by joint.

The poses are fitted once more without anything from the clamped stage, so that the two are independent; then for each
joint z = (c_poses − c_clamped)/√(σ²_poses + σ²_clamped), two-sided, and for all of them together the quadratic form of
the differences, χ² with as many degrees of freedom. Source: Rice, Mathematical Statistics and Data Analysis, 3rd ed.,
section 11.2; Holm, A simple sequentially rejective multiple test procedure, Scand. J. Statist. 6, 1979.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import linalg, stats

from clampid.identify import fit_stage
from clampid.model import StageModel
from clampid.reopen import Reopened
from clampid.slots import Slot

__all__ = ["Agreement", "agreement_of", "pose_drives"]

SHARED = (("joint_compliance", "c"), ("backlash", "gap"))
LEVEL = 0.05  # chance that any joint of drives that do agree is called different


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
        ``agrees``, ``differs`` (5 % over all joints, Holm), or ``not testable`` where the poses do not tell it to
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


def pose_drives(opened: Reopened) -> StageModel | None:
    """The pose stage fitted anew without the clamped one; None where one of the two or the poses are missing."""
    here = "poses" in opened.campaign.tables
    if not here or opened.session is None or not {"clamped", "poses"} <= set(opened.stages):
        return None
    before = {name: stage for name, stage in opened.stages.items() if name not in ("clamped", "poses")}
    model = opened.stages["poses"]
    if not _shared(opened.stages["clamped"], model):
        return None
    held = opened.held("poses")
    return fit_stage(opened.rows("poses"), opened.effects, model.terms, before, model.values(), held).model


def agreement_of(clamped: StageModel, poses: StageModel) -> tuple[tuple[Agreement, ...], float | None]:
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
    slots = _shared(clamped, poses)
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
    for rank, k in enumerate(tested[np.argsort(p[tested])]):
        if p[k] > LEVEL / (len(tested) - rank):
            break
        differs[k] = True
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


def _shared(clamped: StageModel, poses: StageModel) -> tuple[Slot, ...]:
    return tuple(s for s in clamped.slots if (s.effect, s.parameter) in SHARED and s in poses.slots)
