"""Priors of masses and centres of mass: the robot description's values, with the usual tolerance of such values."""

from __future__ import annotations

import numpy as np

from clampid.role_slots import weight_slots
from clampid.slots import Prior
from clampid.stages.rows import Rows
from kinematics.masses import usual_covariance

__all__ = ["description_priors"]

MASS_STD_SHARE = 0.10  # of the described mass: gravity computed from a description has errors of 5-20 %
MASS_STD_FLOOR = 0.5  # kg: screws, cables and grease that no description lists
CENTRE_STD = 0.02  # m: error of a described centre of mass
LEAST_CENTRE_MASS = 2.0  # kg: a link described with no or little mass may have this much of its neighbour's mass


def description_priors(rows: Rows) -> tuple[Prior, ...]:
    """Priors of the links' masses and first moments, as deviations from the description, SI, base axes at zero pose.

    Mass and centre of mass have independent errors, m = M + dm and c = C + dc. To first order the first moment is then
    m c = M C + dm C + M dc, which is correlated with m.

    If the description has no masses, torque logs get no prior: they identify the gravity parameters themselves. Poses
    identify only the product of mass and compliance, so they get the covariance of the links of usual arms.
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
        spread = np.r_[
            MASS_STD_SHARE * link.mass + MASS_STD_FLOOR, np.full(3, CENTRE_STD * max(link.mass, LEAST_CENTRE_MASS))
        ]
        priors.append(Prior(slots, np.zeros(4), J @ np.diag(spread**2) @ J.T))
    return tuple(priors)
