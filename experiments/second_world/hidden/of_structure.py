"""Hidden effects of links, base, tool and instrument."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from experiments.second_world.arms import Body
from experiments.second_world.arrays import Array, unit
from experiments.second_world.chain import Bend
from experiments.second_world.climate import lagged
from experiments.second_world.hidden.kinds import Active, HiddenEffect, Parameter, Setting, fixed
from experiments.second_world.individual import Robot
from experiments.second_world.states import PoseState

__all__ = ["EFFECTS", "along_link"]

_EXPANSION = 1.2e-5  # 1/K, of cast iron and steel
_REFERENCE_C = 20.0


def along_link(robot: Robot, i: int) -> tuple[Array, float]:
    """Unit vector (3,) from joint i (from 0) to the next joint or flange, in its frame, and the length, m."""
    arm = robot.arm
    way = arm.joints[i + 1].xyz_m if i + 1 < arm.n else arm.flange_xyz_m
    length = float(np.linalg.norm(way))
    return unit(way), length


def _bending(s: Setting) -> Active:
    """Euler–Bernoulli cantilever with its own weight spread along it, and what follows at its tip."""
    i = s.index()
    e, L = along_link(s.robot, i)
    # At magnitude 1 the far end of a level link turns by about 0.3 mrad under half of the joint's torque.
    EI = 0.5 * s.robot.nominal.joints[i].max_torque_Nm * L / 3.0e-4 / s.magnitude

    def across(v: Array) -> Array:
        return np.asarray(v - (v @ e)[:, None] * e)

    def law(state: PoseState) -> Bend:
        bend = Bend.none(*state.visits.q.shape)
        R = state.frames.turned[:, i]
        own = state.robot.arm.bodies[i].mass_kg * state.robot.gravity_m_s2
        tip_force = across(np.einsum("nji,nj->ni", R, state.loads.force_N[:, i + 1]))
        tip_moment = across(np.einsum("nji,nj->ni", R, state.loads.moment_Nm[:, i + 1]))
        spread = across(np.einsum("nji,j->ni", R, own / L))  # N/m
        bend.shift_m[:, i] = (tip_force * L**3 / 3 + np.cross(tip_moment, e) * L**2 / 2 + spread * L**4 / 8) / EI
        bend.turn_rad[:, i] = (np.cross(e, tip_force) * L**2 / 2 + tip_moment * L + np.cross(e, spread) * L**3 / 6) / EI
        return bend

    return Active((Parameter("EI", EI, "N m2"),), bend=law)


def _base_tilt(s: Setting) -> Active:
    """A pedestal that yields to the moment on it, unequally about its two horizontal axes."""
    c = 2.0e-4 / s.robot.nominal.joints[1].max_torque_Nm * s.magnitude
    cx, cy = c * np.exp(0.3 * s.rng.standard_normal(2))

    def law(state: PoseState) -> Bend:
        bend = Bend.none(*state.visits.q.shape)
        foot = state.loads.moment_Nm[:, 0] + np.cross(state.frames.origin_m[:, 0], state.loads.force_N[:, 0])
        bend.base_turn_rad[:, 0], bend.base_turn_rad[:, 1] = cx * foot[:, 0], cy * foot[:, 1]
        return bend

    return Active((Parameter("cx", float(cx), "rad/Nm"), Parameter("cy", float(cy), "rad/Nm")), bend=law)


def _base_settling(s: Setting) -> Active:
    """A base that settles with time: it leans over, fast at first."""
    lean = 1.5e-4 * s.magnitude
    about = s.rng.uniform(0, 2 * np.pi)
    settle_s = 2400.0

    def law(state: PoseState) -> Bend:
        bend = Bend.none(*state.visits.q.shape)
        grown = -lean * np.expm1(-state.visits.time_s / settle_s)
        bend.base_turn_rad[:, 0], bend.base_turn_rad[:, 1] = grown * np.cos(about), grown * np.sin(about)
        return bend

    parameters = (Parameter("lean", lean, "rad"), Parameter("about", about, "rad"), Parameter("time", settle_s, "s"))
    return Active(parameters, bend=law)


def _expansion(s: Setting) -> Active:
    """A link grows with the temperature of its core, which follows its surface, where the sensor sits, with a lag."""
    i = s.index()
    e, L = along_link(s.robot, i)
    a, lag_s = _EXPANSION * s.magnitude, 240.0

    def law(state: PoseState) -> Bend:
        bend = Bend.none(*state.visits.q.shape)
        core = lagged(state.visits.link_temps_C[:, i], state.visits.time_s, lag_s)
        bend.shift_m[:, i] = (a * L * (core - _REFERENCE_C))[:, None] * e
        return bend

    return Active((Parameter("expansion", a, "1/K"), Parameter("lag", lag_s, "s")), bend=law)


def _payload(s: Setting) -> Active:
    """The tool is heavier than declared, and its centre of mass lies elsewhere."""
    more = 0.35 * s.robot.tool.mass_kg * s.magnitude
    aside = 0.02 * s.magnitude * s.rng.standard_normal(3)

    def alter(robot: Robot) -> Robot:
        tool = robot.tool
        heavier = Body(tool.mass_kg + more, tool.com_m + aside, tool.inertia_kg_m2 * (1 + more / tool.mass_kg))
        return replace(robot, tool=heavier)

    shift = tuple(Parameter(f"com_{c}", float(v), "m") for c, v in zip("xyz", aside, strict=True))
    return Active((Parameter("mass", more, "kg"), *shift), alter=alter)


def _depth_scale(s: Setting) -> Active:
    """An instrument whose scale along its line of sight is wrong, right at its working distance."""
    error = 2.5e-4 * s.magnitude
    sight, middle = s.instrument.sight, s.instrument.middle_m

    def reading(points: Array, time_s: Array) -> Array:
        return np.asarray(error * ((points - middle) @ sight)[:, None] * sight)

    return Active((Parameter("scale", error, "1"),), reading=reading)


def _links(*numbers: int) -> Callable[[int], tuple[str, ...]]:
    return lambda n: tuple(f"link{i}" for i in numbers if i <= n)


def _bent_links(n: int) -> tuple[str, ...]:
    """Links with a length: not the ones inside a seven-axis arm's double joints."""
    return ("link3", "link5") if n == 7 else ("link2", "link3")


def _warm_links(n: int) -> tuple[str, ...]:
    return _links(3, 2, 5)(n) if n == 7 else _links(2, 3, 4)(n)


EFFECTS = (
    HiddenEffect("link_bending", "link_bending", ("poses",), _bent_links, _bending, lambda w: ("q2", "q3", "q4", "q5")),
    HiddenEffect("base_tilt", "base_tilt", ("poses",), fixed("base"), _base_tilt, lambda w: ("q1", "q2", "q3")),
    HiddenEffect("base_settling", "base_tilt", ("poses",), fixed("base"), _base_settling, lambda w: ("time",)),
    HiddenEffect(
        "thermal_expansion", "thermal_expansion", ("poses",), _warm_links, _expansion, lambda w: (f"temp_{w}",)
    ),
    HiddenEffect(
        "payload", "payload", ("poses", "free_air"), fixed("tool"), _payload, lambda w: ("q2", "q3", "q4", "q5")
    ),
    HiddenEffect(
        "depth_scale", "instrument_scale", ("poses",), fixed("instrument"), _depth_scale, lambda w: ("x", "y", "z")
    ),
)
