"""Three effects as a stranger would write them, in one file of their own; nothing else of the program is edited."""

from __future__ import annotations

from typing import Any

import casadi as ca

from clampid.effect import Effect, Parameter
from clampid.search_policy import Search


def widening(p: Any, x: Any) -> Any:
    """The clearance's width grows by the temperature of the link: dq = -b_T T s / 2."""
    return -0.5 * p.growth * x.link_temperature * x.flank


def softening(p: Any, x: Any) -> Any:
    """The drive's compliance depends on the joint's angle: dq = -T' diag(c_1 sin q + d_1 cos q) T tau."""
    c = p.sine * ca.sin(x.q) + p.cosine * ca.cos(x.q)
    return -x.transmission.T @ (c * (x.transmission @ x.torque))


def rubbing(p: Any, x: Any) -> Any:
    """Dry friction at the arm's side grows with the load: tau = mu |tau_load| sign(w_joint)."""
    return p.mu * ca.fabs(x.torque) * x.joint_motion


EFFECTS = (
    Effect(
        name="warm_clearance",
        family="warm_clearance",
        acts={"joint_angle": widening},
        parameters=(Parameter("growth", "rad/K", 2e-5, "joint", meaning="growth of the clearance"),),
        needs=("flank", "link_temperature"),
        stages=("clamped", "poses"),
        equation="dq = -b_T (T - T_0) s / 2",
        source=("own measurements",),
    ),
    Effect(
        name="angle_stiffness",
        family="angle_stiffness",
        acts={"joint_angle": softening},
        parameters=(
            Parameter("sine", "rad/Nm", 2e-5, "joint", meaning="sine part of the compliance", gearing=2),
            Parameter("cosine", "rad/Nm", 2e-5, "joint", meaning="cosine part of the compliance", gearing=2),
        ),
        needs=("q", "torque"),
        stages=("clamped", "poses"),
        equation="dq = -T' diag(c_1 sin q + d_1 cos q) T tau",
        source=("own measurements",),
        search=Search(refines="joint_compliance"),
    ),
    Effect(
        name="arm_load_friction",
        family="arm_load_friction",
        acts={"joint_torque": rubbing},
        parameters=(Parameter("mu", "", 0.05, "joint", (0.0, 1.0), "arm-side friction per load"),),
        needs=("torque", "joint_motion"),
        stages=("free_air", "poses"),
        equation="tau_joint = mu |tau_load| sign(w)",
        source=("own measurements",),
    ),
)
