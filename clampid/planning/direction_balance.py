"""Balance of the approach directions of planned visits: in number, and against posture and order."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clampid.planning.directions import confounded, covariates_of
from clampid.stages.rows import Array
from experiments.plans.model import Plan

__all__ = ["Balance", "balance_of"]


@dataclass(frozen=True)
class Balance:
    """Approach directions of the poses of a plan.

    Attributes
    ----------
    plus, minus
        Number of visits that each joint approaches towards larger and smaller angles ``(n,)``.
    confounded
        Share of the variance of each joint's directions that posture and order explain ``(n,)``, 0 … 1.
    """

    plus: Array
    minus: Array
    confounded: Array

    @property
    def words(self) -> str:
        """Two sentences for people."""
        each = list(dict.fromkeys(f"{a}/{b}" for a, b in zip(self.plus, self.minus, strict=True)))
        visits = (
            f"{each[0]} for every joint"
            if len(each) == 1
            else f"for joints 1 to {len(self.plus)}: "
            + ", ".join(f"{a}/{b}" for a, b in zip(self.plus, self.minus, strict=True))
        )
        explained = f"{self.confounded.max():.0%}"
        return (
            f"Visits approached towards larger/smaller angles: {visits}. Posture and order explain "
            f"{'none' if explained == '0%' else f'at most {explained}'} of a joint's approach directions."
        )

    def to_json(self) -> dict[str, list[float]]:
        """The numbers for JSON."""
        return {"up": self.plus.tolist(), "down": self.minus.tolist(), "confounded": self.confounded.tolist()}


def balance_of(plan: Plan) -> Balance:
    """The balance of a plan's visits that belong to the table ``poses``."""
    visits = [v for v in plan.visits if v.table == "poses"]
    signs, q = np.array([v.direction for v in visits]), np.array([v.q for v in visits])
    return Balance((signs > 0).sum(axis=0), (signs < 0).sum(axis=0), confounded(signs, covariates_of(q)))
