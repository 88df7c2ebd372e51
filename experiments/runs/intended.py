"""Every posture to which a run of a plan may send the robot: tests compare the real motions with it."""

from __future__ import annotations

import numpy as np

from experiments.plans.model import Plan
from experiments.plans.motion import Array

__all__ = ["targets_of"]


def targets_of(plan: Plan) -> list[Array]:
    """Postures ``(n,)``, rad: approaches and poses, knots, clamped postures and their steps.

    A search for the posture of least torque goes to others, which nobody knows before: within its bounds of the clamped
    posture, and `experiments.runs.least_torque.PROBE` of its steps beyond.
    """
    visits = [posture for visit in plan.visits for posture in (visit.via, visit.q)]
    knots = [knot for run in plan.runs for knot in run.course.knots]
    steps = []
    for sweep in plan.sweeps:
        for offset in (0.0, *sweep.offset):
            posture = np.array(sweep.posture)
            posture[sweep.joint] += offset
            steps.append(posture)
    return [*visits, *knots, *steps]
