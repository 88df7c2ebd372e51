"""One periodic angle error of any shape that several joints share, because they have encoders of one make.

Encoders with the same disc have the same error curve, shifted by a phase of each joint and read in one sense or the
other. The mounting of each disc adds an error once and twice per revolution; a small deviation per joint is allowed.
"""

from __future__ import annotations

from typing import Any, Literal

from clampid.algebra import harmonics
from clampid.effect import Effect, Parameter

LOW = (1, 2)
"""Harmonics of each joint: eccentric and oval seats. The disc's harmonics of these orders cannot be separated."""

SHARED = range(3, 49)
"""Shapes down to 4 degrees, as at single joints."""

_SMEAR = tuple(1.0 - (k / SHARED.stop) ** 2 for k in SHARED)
SHARE = tuple(share / sum(s**2 for s in _SMEAR) ** 0.5 for share in _SMEAR)
"""Sizes of the harmonics over the rms of the curve: the reading head smears the finer ones. Without this decrease the
estimate at one angle would ring through the others."""

ERROR = 3e-4
"""rad: transmission and encoder errors are of 10 to 60 arc seconds, 5e-5 to 3e-4; here the rms of the whole curve."""

SEAT = 1.2e-4
"""rad: the middle of the same range; 4 micrometres of eccentricity on a disc of 30 mm radius."""


ANYWHERE = 1.8
"""rad: the standard deviation of an angle of which nothing is known."""


def error(p: Any, x: Any) -> Any:
    """Dq = s g(s q - phase) + own(q); g and own are sums over k of a_k sin ku + b_k cos ku."""
    u = p.sense * x.q - p.phase
    curve, seat, rest = 0.0, 0.0, 0.0
    on_disc, on_joint = (dict(enumerate(harmonics(v, SHARED.stop - 1), start=1)) for v in (u, x.q))
    for k in LOW:
        seat = seat + _part(p, f"own_a{k}", f"own_b{k}", on_joint[k])
    for k in SHARED:
        curve = curve + _part(p, f"a{k}", f"b{k}", on_disc[k])
        rest = rest + _part(p, f"own_a{k}", f"own_b{k}", on_joint[k])
    return p.sense * curve + seat + p.deviation * rest


def _part(p: Any, a: str, b: str, of: tuple[Any, Any]) -> Any:
    return getattr(p, a) * of[0] + getattr(p, b) * of[1]


def _sines(prefix: str, k: int, unit: str, size: float, per: Literal["robot", "joint"]) -> tuple[Parameter, ...]:
    whose = "of the joint alone, " if per == "joint" else ""
    bounds = (-50.0 * size, 50.0 * size)
    return tuple(
        Parameter(
            f"{prefix}{a}{k}", unit, size, per, bounds, f"{f} part, {whose}{k} per turn", spread=1.0, role="angle_error"
        )
        for a, f in (("a", "sine"), ("b", "cosine"))
    )


EFFECT = Effect(
    name="shared_angle_curve",
    family="gear_eccentricity",
    acts={"joint_angle": error},
    parameters=(
        Parameter(
            "sense", "", 1.0, "joint", (-1.0, 1.0), "how the part is mounted: +1 or -1; 0: another part",
            shape=True, grid=(0.0, 1.0, -1.0), fixed="everywhere",
        ),
        Parameter(
            "phase", "rad", ANYWHERE, "joint", meaning="where the curve begins, counted from the first joint's",
            shape=True, grid=(0.0,), fixed="first",
        ),
        *(p for k in LOW for p in _sines("own_", k, "rad", SEAT / len(LOW) ** 0.5, "joint")),
        *(p for k, share in zip(SHARED, SHARE, strict=True) for p in _sines("own_", k, "", share, "joint")),
        Parameter(
            "deviation", "rad", ERROR, bounds=(0.0, 0.05), meaning="difference between such parts, rms over a turn",
            shape=True, grid=(0.3 * ERROR,), fixed="everywhere",
        ),
        *(p for k, share in zip(SHARED, SHARE, strict=True) for p in _sines("", k, "rad", ERROR * share, "robot")),
    ),
    needs=("q",),
    stages=("poses",),
    equation=(
        "dq = s g(s q - phase) + own(q), g(u) = sum_k a_k sin k u + b_k cos k u, k = 3 ... 48, in all about 0.3 mrad; "
        "own(q) the same with k = 1, 2 of about 0.1 mrad, and from 3 on in units of the deviation"
    ),
    source=("UniversalModel", "Landgraf2021"),
    aligns="joint_angle_curve",
    meaning="one periodic curve for several joints, each with its phase and sense",
)  # fmt: skip
