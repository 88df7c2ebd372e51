"""An error of a torque reading in proportion to the torque, as of a motor's torque constant or a strain gauge's gain.

It scales what the arm's weight and inertia ask of the motor. The motor's friction is scaled too, but no friction is
known beforehand, so that its parameters hold that part.

One motor's gain differs from the others' where links load several motors: the weight of link 3 is in the torques of
motors 2 and 3. A gain that all motors have in common is a gain of all masses, known only as well as these.

Source: VIM 4.12, sensitivity of a measuring system, and 4.20, instrumental bias.
"""

from __future__ import annotations

from typing import Any

from clampid.effect import Effect, Parameter
from clampid.search_policy import Search


def torque(p: Any, x: Any) -> Any:
    """tau_motor = g T tau_joint: the reading is (1 + g) times the torque."""
    return p.g * (x.transmission @ x.torque)


EFFECT = Effect(
    name="torque_gain",
    family="torque_gain",
    acts={"motor_torque": torque},
    parameters=(
        Parameter("g", "", 0.05, "joint", (-0.5, 1.0), "error of the torque reading, per torque", role="reading_gain"),
    ),
    needs=("torque",),
    stages=("free_air",),
    equation="tau_motor = (1 + g) T tau_joint",
    source=("VIM",),
    search=Search(scope="places"),  # a gain of all motors is one of all masses
)
