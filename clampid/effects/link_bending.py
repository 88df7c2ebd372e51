"""A link that bends under the weight it carries: a cantilever of one flexural rigidity."""

from __future__ import annotations

from typing import Any

from clampid.algebra import across_rows, columns, cross_rows, norms, turning
from clampid.effect import CAST_ARM, Effect, Parameter
from clampid.search_policy import Search, Separator


def bending(p: Any, x: Any) -> Any:
    """End rotation and shift of a beam under end moment M and end force F across its length L; it does not twist."""
    L = norms(x.link_vectors)
    across = cross_rows(x.link_vectors, x.link_force)  # L e x F
    M, f = across_rows(x.link_moment, x.link_vectors), p.f * L
    turned = [f * (M[:, k] + 0.5 * across[:, k]) for k in range(3)]
    lever = columns(*(f * (0.5 * M[:, k] + across[:, k] / 3.0) for k in range(3)))
    shifted = cross_rows(lever, x.link_vectors)
    return turning(turned, [shifted[:, k] for k in range(3)])


EFFECT = Effect(
    name="link_bending",
    family="link_bending",
    acts={"link_twist": bending},
    parameters=(
        Parameter("f", "1/(N m^2)", 2e-7, "link", (0.0, 5e-5), "flexibility of the link, 1/(E I)", moment=CAST_ARM),
    ),
    needs=("link_force", "link_moment"),
    stages=("poses",),
    equation="w = (M L + F L^2/2)/(E I), v = (M L^2/2 + F L^3/3)/(E I), M and F across the beam",
    source=("Young1989",),
    search=Search(
        scope="places",
        separators=(
            Separator("joint_compliance", "loaded poses with the arm folded, or the same poses with two payloads"),
        ),
    ),
)
