"""What is known of masses before they are measured: the description's, to within the tolerance of such figures."""

from __future__ import annotations

import numpy as np

from clampid.role_slots import weight_slots
from clampid.slots import Prior
from clampid.stages.rows import Rows
from kinematics.masses import usual_covariance

__all__ = ["description_priors"]

MASS_SHARE = 0.10  # of the described mass: gravity of a described arm is off by 5-20 %
MASS_FLOOR = 0.5  # kg: screws, cables and grease that no description lists
CENTRE = 0.02  # m
CENTRE_MASS = 2.0  # kg: how much of a neighbour's mass a link described without mass may have


def description_priors(rows: Rows) -> tuple[Prior, ...]:
    """The prior of the links' gravity parameters.

    If the description has no masses: no prior for torque logs, which determine the gravity parameters themselves; for
    poses, which determine only the product of mass and compliance, the spread of the links of usual arms.

    Mass and centre of mass are off independently, m = M + dm and c = C + dc, so that m c = M C + dm C + M dc is
    correlated with m. Base axes at the zero pose, SI.
    """
    robot = rows.robot
    if not robot.has_masses:
        slots = tuple(slot for i in range(robot.n) for slot in weight_slots(f"link{i + 1}"))
        return (Prior(slots, np.zeros(len(slots)), usual_covariance(robot)),) if rows.kind.points else ()
    priors = []
    for i, link in enumerate(robot.links):
        place = f"link{i + 1}"
        slots = weight_slots(place)
        centre = np.asarray(link.com) if link.mass > 0 else np.asarray(robot.joints[i].point)
        J = np.vstack([np.r_[1.0, centre], np.c_[np.zeros(3), np.eye(3)]]).T  # (m, m c) by (dm, M dc)
        spread = np.r_[MASS_SHARE * link.mass + MASS_FLOOR, np.full(3, CENTRE * max(link.mass, CENTRE_MASS))]
        priors.append(Prior(slots, np.zeros(4), J @ np.diag(spread**2) @ J.T))
    return tuple(priors)
