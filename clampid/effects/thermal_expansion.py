"""Links that grow with their temperature, each along the line to its next joint."""

from __future__ import annotations

from typing import Any

from clampid.algebra import along
from clampid.effect import Effect, Parameter
from clampid.search_policy import Search, Separator


def growth(p: Any, x: Any) -> Any:
    """d_i -> d_i (1 + alpha_i dT_i)."""
    return along(p.alpha * x.link_temperature, x.link_vectors)


EFFECT = Effect(
    name="thermal_expansion",
    family="thermal_expansion",
    acts={"link_twist": growth},
    parameters=(
        Parameter("alpha", "1/K", 1.2e-5, "link", meaning="expansion of the link along its length", role="expansion"),
    ),
    needs=("link_temperature",),
    stages=("poses",),
    equation="d_i(T) = d_i (1 + alpha_i (T_i - T_0))",
    source=("UniversalModel", "VisualInspection"),
    known_within="link_temperature",
    search=Search(
        separators=(
            Separator("base_tilt", "restart cold and measure the same poses in another order", same_stage=True),
        )
    ),
)
