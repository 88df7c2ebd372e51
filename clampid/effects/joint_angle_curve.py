"""Angle error periodic in a joint's revolution, of any shape: what an encoder's disc or a wheel's teeth leave.

A joint's own curve, in as many harmonics as such a shape needs. Between poses and beyond the angles that any pose
visited nothing is known but its size, which is that of the other joints and angles: there it fades to zero within a few
degrees, and its band opens to that size.
"""

from __future__ import annotations

from typing import Any

from clampid.algebra import harmonics
from clampid.effect import Effect, Parameter
from clampid.search_policy import JOINT_ANGLE_PERIODIC, Search

HARMONICS = 48
"""Shapes down to 4 degrees; a disc's flaw of that width is smeared by the reading head, finer ones more so."""

FADING = tuple(1.0 - (k / (HARMONICS + 1)) ** 2 for k in range(1, HARMONICS + 1))
"""The same smear as shares of the harmonics. Had all the same size and the next one none, what is known of one angle
would ring on through all those where no pose was."""

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
            "rms", "rad", ERROR, bounds=(0.0, 0.05), meaning="what the curves amount to, rms over a turn",
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
