"""Where a joint fit and the same stages fitted one by one disagree by more than chance.

Both are estimates of the same numbers, and the joint one uses every row, so that where all is as modelled the
difference has the variance σ²_apart − σ²_joint (the efficient estimate is uncorrelated with what the other has beyond
it). A larger difference says that some stage's rows contradict another's. Source: Hausman, Specification tests in
econometrics, Econometrica 46, 1978, theorem 2.1; over all parameters of a stage by Holm, as in
`clampid.models.agreement`.

If the other stages add almost no information to a stage, the variance of the difference is itself a small difference of
large numbers. It is taken as at least a tenth of σ²_apart, which only makes the test less sensitive.
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

MIN_VARIANCE_SHARE = 0.1  # of the variance apart that counts as the difference's


@dataclass(frozen=True)
class StageDisagreement:
    """A parameter that the joint fit sees elsewhere than its stage alone; SI.

    Attributes
    ----------
    apart, joint
        Value and standard error.
    z
        The difference in standard errors of it.
    """

    slot: Slot
    apart: tuple[float, float]
    joint: tuple[float, float]
    z: float

    def to_json(self) -> dict[str, Any]:
        """For programs."""
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
    """The parameters on which a stage alone and the joint fit disagree: 5 % chance that any does where all is well.

    Parameters
    ----------
    apart, joint
        The same stage, with the same slots.
    shared
        The parameters that several stages share; only these are tested, for the others follow them.
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
