"""Links that grow while the robot warms up, without a sensor of their temperature."""

from __future__ import annotations

from typing import Any

from clampid.algebra import along, exp
from clampid.effect import Effect, Parameter
from clampid.search_policy import Search

HOUR = 3600.0


def growth(p: Any, x: Any) -> Any:
    """d_i -> d_i (1 + a_i (1 - exp(-t/tau_i))), t since the session's first row."""
    return along(p.a * (1 - exp(-x.elapsed / p.tau)), x.link_vectors)


EFFECT = Effect(
    name="warm_up_expansion",
    family="thermal_expansion",
    acts={"link_twist": growth},
    parameters=(
        Parameter("a", "", 2e-4, "link", (-5e-3, 5e-3), "growth of the link along its length in the end"),
        Parameter("tau", "s", 3 * HOUR, "link", (60.0, 3e5), "time constant", True, (HOUR, 0.25 * HOUR, 8 * HOUR)),
    ),
    needs=("elapsed",),
    stages=("poses",),
    equation="d_i(t) = d_i (1 + a_i (1 - exp(-t/tau_i)))",
    source=("UniversalModel", "XCTDrift"),
    search=Search(superseded_by="link_temperature"),
)
