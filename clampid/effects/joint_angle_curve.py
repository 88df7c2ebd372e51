"""Angle error periodic in a joint's revolution, of any shape: errors of an encoder's disc or of a wheel's teeth.

Each joint has its own curve of 48 harmonics, with a prior: its rms is estimated from all joints and angles. Away from
measured angles the estimate fades to zero within a few degrees, and its error band widens to that rms.
"""

from __future__ import annotations

from typing import Any

from clampid.algebra import harmonics
from clampid.effect import Effect, Parameter
from clampid.search_policy import JOINT_ANGLE_PERIODIC, Search

HARMONICS = 48
"""Shapes down to 4 degrees; a disc's flaw of that width is smeared by the reading head, finer ones more so."""

FADING = tuple(1.0 - (k / (HARMONICS + 1)) ** 2 for k in range(1, HARMONICS + 1))
"""The same smear as relative sizes of the harmonics. With equal sizes and a sharp end, the estimate at one angle would
ring through all angles without poses."""

ERROR = 3e-4
"""rad: transmission and encoder errors are of 10 to 60 arc seconds, 5e-5 to 3e-4; here the largest rms of a curve."""


def error(p: Any, x: Any) -> Any:
    """Dq = r times the sum over k of a_k sin kq + b_k cos kq."""
    total = 0.0
    for k, (sine, cosine) in enumerate(harmonics(x.q, HARMONICS), start=1):
        total = total + getattr(p, f"a{k}") * sine + getattr(p, f"b{k}") * cosine
    return p.rms * total


EFFECT = Effect(
    name="joint_angle_curve",
    family="gear_eccentricity",
    acts={"joint_angle": error},
    parameters=(
        Parameter(
            "rms", "rad", ERROR, bounds=(0.0, 0.05), meaning="rms of the curves over a turn",
            shape=True, grid=(ERROR,), fixed="everywhere",
        ),
        *(
            Parameter(
                f"{a}{k}",
                "",
                FADING[k - 1] / sum(share**2 for share in FADING) ** 0.5,  # a sine's mean square is a half
                "joint",
                (-50.0, 50.0),
                f"{f} part in units of rms, {k} per revolution of the joint",
                spread=1.0,
                role="angle_error",
            )
            for k in range(1, HARMONICS + 1)
            for a, f in (("a", "sine"), ("b", "cosine"))
        ),
    ),
    needs=("q",),
    stages=("poses",),
    equation="dq = r sum_k a_k sin k q + b_k cos k q, k = 1 ... 48, r of at most about 0.3 mrad",
    source=("UniversalModel", "Landgraf2021"),
    sized_by="rms",
    meaning="periodic in the joint's angle, of any shape",
    search=Search(scope="jointly", revealed_by=JOINT_ANGLE_PERIODIC),
)  # fmt: skip
