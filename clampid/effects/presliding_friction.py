"""Dry friction that builds up over a short travel after each reversal, and relaxes at rest.

Coulomb's friction jumps at a reversal and is anything between its limits at rest. In a gear it is the bending of many
small contacts: a state z between -1 and +1 that follows the motion over the length s (Dahl), and creeps back to zero in
a time 1/r where nothing moves. It scales whatever friction goes with the sign of a motor's motion: Coulomb's,
Stribeck's, asymmetric. A model that has it knows the friction of a motor at rest, so that rows at rest count.
Without it they do not, and only the rows after a reversal show it.
"""

from __future__ import annotations

from itertools import product
from typing import Any

from clampid.algebra import log, spline
from clampid.effect import PRESLIDING_LENGTHS, RELAXATION_TIMES, Effect, Parameter


def state(p: Any, x: Any) -> Any:
    """C (z(s, r) - sign(w_motor)): the share c of the dry friction has z in the place of the sign."""
    weights = product(spline(log(p.s), map(log, PRESLIDING_LENGTHS)), spline(-log(p.r), map(log, RELAXATION_TIMES)))
    z = sum(a * b * x.dry_state[:, k] for k, (a, b) in enumerate(weights))
    return p.c * (z - x.motor_motion)


EFFECT = Effect(
    name="presliding_friction",
    family="hysteresis",
    acts={"friction_state": state},
    parameters=(
        Parameter(
            "c",
            "",
            0.3,  # the standard deviation of a share of which nothing is known
            "joint",
            (0.0, 1.0),
            "share of the dry friction that builds up over a travel",
            spread=1.0,
            share=True,
        ),
        Parameter(
            "s",
            "rad",
            2e-3,
            "joint",
            (PRESLIDING_LENGTHS[0], PRESLIDING_LENGTHS[-1]),
            "presliding length, at the motor",
            True,
            (2e-3, 6e-3, 6e-4),
        ),
        Parameter(  # a rate, since many do not relax at all
            "r",
            "1/s",
            1.0,
            "joint",
            (1.0 / RELAXATION_TIMES[-1], 1.0 / RELAXATION_TIMES[0]),
            "rate at which the state relaxes at rest",
            True,
            (0.7, 0.7, 0.7),
        ),
    ),
    needs=("dry_state", "motor_motion"),
    stages=("free_air",),
    equation="tau_motor = F_c z, dz/dt = |w|/s (sign(w) - z) - r z",
    source=("Olsson1998",),
)
