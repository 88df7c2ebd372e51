"""Hidden effects of joints at rest: clearances, springs, eccentric discs, ratios, bearings, lost motion."""

import numpy as np

from experiments.second_world.arrays import Array
from experiments.second_world.chain import Bend
from experiments.second_world.equilibrium import clearance_side
from experiments.second_world.hidden.kinds import (
    Active,
    HiddenEffect,
    Parameter,
    Setting,
    angle_law,
    everywhere,
    joints,
)
from experiments.second_world.states import PoseState

__all__ = ["EFFECTS"]


def _digits(where: str) -> str:
    return "".join(c for c in where if c.isdigit())


def _backlash(s: Setting) -> Active:
    j, gap = s.index(), 2.0e-4 * s.magnitude

    def error(state: PoseState) -> Array:
        side = clearance_side(state.robot, state.loads.torque_Nm, state.visits.dirs)
        return np.asarray(-gap / 2 * side[:, j])

    return Active((Parameter("gap", gap, "rad"),), bend=angle_law(j, error))


def _compliance(s: Setting) -> Active:
    j = s.index()
    c = 1.5e-3 / s.robot.nominal.joints[j].max_torque_Nm * s.magnitude
    return Active((Parameter("compliance", c, "rad/Nm"),), bend=angle_law(j, lambda st: -c * st.loads.torque_Nm[:, j]))


def _hardening(s: Setting) -> Active:
    """Teeth that come into contact: a spring that gives most at small torque, its wind-up saturating."""
    j = s.index()
    T = 0.12 * s.robot.nominal.joints[j].max_torque_Nm
    size = 2.0e-4 * s.magnitude

    def error(state: PoseState) -> Array:
        return np.asarray(-size * np.arctan(state.loads.torque_Nm[:, j] / T))

    return Active((Parameter("windup", size, "rad"), Parameter("torque", T, "Nm")), bend=angle_law(j, error))


def _eccentricity(s: Setting) -> Active:
    """Angle read on a disc whose centre is off its axis: the line to the mark turns by atan2(e sin, 1 + e cos)."""
    j, e, phase = s.index(), 2.0e-4 * s.magnitude, s.rng.uniform(0, 2 * np.pi)

    def error(state: PoseState) -> Array:
        x = state.visits.q[:, j] - phase
        return np.arctan2(e * np.sin(x), 1.0 + e * np.cos(x))

    return Active((Parameter("offset", e, "1"), Parameter("phase", phase, "rad")), bend=angle_law(j, error))


def _coupling(s: Setting) -> Active:
    """A wrist joint turns with the joint before it; joints 1 to 4 turn by a share of themselves."""
    j = s.index()
    source = j - 1 if j >= 4 else j
    k = 2.5e-4 * s.magnitude * float(s.rng.choice([-1.0, 1.0]))
    name = f"ratio_{source + 1}_to_{j + 1}"
    return Active((Parameter(name, k, "1"),), bend=angle_law(j, lambda st: k * st.visits.q[:, source]))


def _coupling_depends(where: str) -> tuple[str, ...]:
    j = int(_digits(where))
    return (f"q{j - 1 if j >= 5 else j}",)


def _tilt(s: Setting) -> Active:
    j = s.index()
    c = 2.5e-3 / s.robot.nominal.joints[j].max_torque_Nm * s.magnitude

    def law(state: PoseState) -> Bend:
        bend = Bend.none(*state.visits.q.shape)
        local = np.einsum("nji,nj->ni", state.frames.before[:, j], state.loads.moment_Nm[:, j])
        axis = state.robot.arm.joints[j].axis
        bend.tilt_rad[:, j] = c * (local - axis * (local @ axis)[:, None])
        return bend

    return Active((Parameter("tilt", c, "rad/Nm"),), bend=law)


def _lost_motion(s: Setting) -> Active:
    """
    Lost motion that builds up over some way after a reversal (Dahl), so that short approaches leave it part-way.

    z of the visit before is carried over; the way to the approach point is taken in one step against the last motion.
    """
    j, size, way = s.index(), 1.2e-4 * s.magnitude, 0.12

    def error(state: PoseState) -> Array:
        q, travel = state.visits.q[:, j], state.visits.travel_rad[:, j]
        z = np.zeros(len(q))
        last, before = 0.0, float(q[0] - travel[0])
        for k in range(len(q)):
            for step in (q[k] - travel[k] - before, travel[k]):
                side = np.sign(step)
                last = side + (last - side) * np.exp(-abs(step) / way) if side else last
            z[k], before = last, float(q[k])
        return -size * z

    return Active((Parameter("size", size, "rad"), Parameter("way", way, "rad")), bend=angle_law(j, error))


EFFECTS = (
    HiddenEffect(
        "backlash", "backlash", ("poses",), everywhere(1), _backlash, lambda w: (f"dir{_digits(w)}", f"tau{_digits(w)}")
    ),
    HiddenEffect(
        "joint_compliance", "joint_compliance", ("poses",), everywhere(2), _compliance, lambda w: (f"tau{_digits(w)}",)
    ),
    HiddenEffect(
        "hardening_spring",
        "nonlinear_stiffness",
        ("poses",),
        everywhere(2),
        _hardening,
        lambda w: (f"tau{_digits(w)}",),
    ),
    HiddenEffect(
        "gear_eccentricity",
        "gear_eccentricity",
        ("poses",),
        everywhere(3),
        _eccentricity,
        lambda w: (f"q{_digits(w)}",),
    ),
    HiddenEffect(
        "coupling_ratio_error", "coupling_ratio_error", ("poses",), everywhere(5), _coupling, _coupling_depends
    ),
    HiddenEffect(
        "bearing_tilt", "bearing_tilt", ("poses",), joints(2, 3, 1, 4, 5, 6), _tilt, lambda w: ("q2", "q3", "q4", "q5")
    ),
    HiddenEffect("hysteresis", "hysteresis", ("poses",), everywhere(3), _lost_motion, lambda w: (f"dir{_digits(w)}",)),
)
