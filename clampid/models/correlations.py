"""Which identified parameters the data determine only together: the correlations of their errors, strongest first.

r_kl = C_kl / sqrt(C_kk C_ll), C the model's covariance, priors included. At r = ±0.9 each of the two is known 2.3 times
better once the other is known.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from clampid.models.model import StageModel
from clampid.slots import Slot

__all__ = ["PAIRS_SHOWN", "STRONG", "Correlation", "correlations"]

STRONG = 0.9  # from which size on a correlation is reported
PAIRS_SHOWN = 20  # of a stage, to people


@dataclass(frozen=True)
class Correlation:
    """Of the errors of two parameters: ``r`` between -1 and 1."""

    first: Slot
    second: Slot
    r: float

    def to_json(self) -> dict[str, Any]:
        """For programs."""
        return {"parameters": [self.first.label, self.second.label], "r": self.r}


def correlations(stage: StageModel, least: float = STRONG) -> tuple[Correlation, ...]:
    """All correlations of a stage's identified parameters beyond ``least`` in size, the strongest first.

    Parameters that are not identified, or whose error is zero, have none. For the former see the stage's
    ``null_directions``.
    """
    std = stage.std
    own = np.array([k for k, ok in enumerate(stage.identified) if ok and np.isfinite(std[k]) and std[k] > 0], dtype=int)
    R = np.clip(stage.covariance[np.ix_(own, own)] / np.outer(std[own], std[own]), -1.0, 1.0)
    pairs = [(int(i), int(j)) for i, j in np.argwhere(np.triu(np.abs(R) > least, 1))]
    pairs.sort(key=lambda pair: -abs(R[pair]))
    return tuple(Correlation(stage.slots[own[i]], stage.slots[own[j]], float(R[i, j])) for i, j in pairs)
