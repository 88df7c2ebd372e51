"""Dry friction that builds up over a short travel after each reversal, and relaxes at rest.

Coulomb's friction jumps at a reversal and is anything between its limits at rest. In a gear it is the bending of many
small contacts: a state z between -1 and +1 that follows the motion over the length s (Dahl), and creeps back to zero in
the time t where nothing moves. It scales whatever friction goes with the sign of a motor's motion: Coulomb's,
Stribeck's, asymmetric. A model that has it knows the friction of a motor at rest, so that rows at rest count.
Without it they do not. Rows that move hardly show it, and its shapes take long to search, so that diagnosis does not
look for it: it is to be asked for.
"""

from __future__ import annotations

from itertools import product
from typing import Any

from clampid.algebra import fmax, log
from clampid.effect import PRESLIDING_LENGTHS, RELAXATION_TIMES, Effect, Parameter
from clampid.search_policy import Search


def hats(value: Any, nodes: tuple[float, ...]) -> list[Any]:
    """Weight of each node where what lies between them is interpolated in the logarithm; they add up to one."""
    at, last = [log(node) for node in nodes], len(nodes) - 1
    out = []
    for k, here in enumerate(at):
        x = log(value)
        left = (x - at[k - 1]) / (here - at[k - 1]) if k > 0 else 1.0
        right = (at[k + 1] - x) / (at[k + 1] - here) if k < last else 1.0
        out.append(fmax(0.0, left + right - fmax(left, right)))
    return out


def state(p: Any, x: Any) -> Any:
    """C (z(s, t) - sign(w_motor)): the share c of the dry friction has z in the place of the sign."""
    weights = product(hats(p.s, PRESLIDING_LENGTHS), hats(p.t, RELAXATION_TIMES))
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
        Parameter(
            "t",
            "s",
            1.0,
            "joint",
            (RELAXATION_TIMES[0], RELAXATION_TIMES[-1]),
            "time in which the state relaxes at rest",
            True,
            (1.5, 1.5, 1.5),
        ),
    ),
    needs=("dry_state", "motor_motion"),
    stages=("free_air",),
    equation="tau_motor = F_c z, dz/dt = |w|/s (sign(w) - z) - z/t",
    source=("Olsson1998",),
    search=Search(opt_in=True),
)
