"""Hausman test of a joint fit against the stages fitted one by one: significant differences of shared parameters.

Both fits estimate the same parameters, and the joint fit uses all rows. If the model is right, the difference has the
variance σ²_apart − σ²_joint, since an efficient estimate is uncorrelated with the difference to another estimate. A
larger difference means that the rows of different stages contradict each other. Source: Hausman, Specification tests in
econometrics, Econometrica 46, 1978, theorem 2.1. Several parameters are tested by Holm's method, as in
`clampid.models.agreement`.

If the other stages add almost no information to a stage, the variance of the difference is a small difference of large
numbers. It is taken as at least a tenth of σ²_apart, which only makes the test less sensitive.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import stats

from clampid.models.agreement import AGREEMENT_FALSE_ALARMS, stands_out
from clampid.models.model import StageModel
from clampid.slots import Slot

__all__ = ["StageDisagreement", "joint_fit_disagreements"]

MIN_VARIANCE_SHARE = 0.1  # least variance of the difference, as a share of the variance of the separate fit


@dataclass(frozen=True)
class StageDisagreement:
    """A parameter whose values in the joint fit and in the separate fit of its stage differ significantly.

    Attributes
    ----------
    slot
        The parameter.
    apart, joint
        Value and standard error, SI, of the separate fit and of the joint fit.
    z
        The difference, in units of its standard error.
    """

    slot: Slot
    apart: tuple[float, float]
    joint: tuple[float, float]
    z: float

    def to_json(self) -> dict[str, Any]:
        """The numbers for JSON."""
        return {
            "parameter": f"{self.slot.effect}.{self.slot.parameter}",
            "where": self.slot.place,
            "apart": self.apart[0],
            "apart_std": self.apart[1],
            "joint": self.joint[0],
            "joint_std": self.joint[1],
            "z": self.z,
        }


def joint_fit_disagreements(
    apart: StageModel, joint: StageModel, shared: Collection[Slot]
) -> tuple[StageDisagreement, ...]:
    """The parameters of a stage whose separate fit and joint fit differ; 5 % chance of any if the model is right.

    Parameters
    ----------
    apart, joint
        The stage of the separate fit and of the joint fit, with the same slots.
    shared
        The parameters that several stages share. Only these are tested, since all others follow them.
    """
    tested = [k for k, slot in enumerate(apart.slots) if slot in shared and apart.identified[k] and apart.std[k] > 0]
    if not tested:
        return ()
    alone, together = apart.std[tested], joint.std[tested]
    spread = np.sqrt(np.maximum(alone**2 - together**2, MIN_VARIANCE_SHARE * alone**2))
    z = (joint.theta[tested] - apart.theta[tested]) / spread
    found = stands_out(2.0 * stats.norm.sf(np.abs(z)), AGREEMENT_FALSE_ALARMS)
    return tuple(
        StageDisagreement(
            apart.slots[k],
            (float(apart.theta[k]), float(apart.std[k])),
            (float(joint.theta[k]), float(joint.std[k])),
            float(z[n]),
        )
        for n, k in enumerate(tested)
        if found[n]
    )
