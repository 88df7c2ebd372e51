"""
Effects that no library has, each with the variables that it depends on.

A good diagnosis reports these as unknown, with their place and their variables.
"""

import numpy as np

from experiments.second_world.arrays import Array, unit
from experiments.second_world.chain import Bend
from experiments.second_world.hidden.kinds import (
    Active,
    HiddenEffect,
    Parameter,
    Places,
    Setting,
    angle_law,
    everywhere,
    fixed,
    joints,
    pairs,
)
from experiments.second_world.hidden.of_structure import along_link
from experiments.second_world.hidden.of_torques import torque_law
from experiments.second_world.states import LogState, PoseState

__all__ = ["EFFECTS"]

_PAIRS: Places = pairs((2, 3), (3, 4), (4, 5), (1, 2), (5, 6))


def _numbers(where: str) -> list[str]:
    return [part.removeprefix("joint") for part in where.split("+")]


def _surface(rng: np.random.Generator, x: Array, y: Array) -> Array:
    """Random smooth function (S,) of two angles, of unit size: seven waves of random direction and phase."""
    waves = 1.5 * rng.standard_normal((7, 2))
    phases, heights = rng.uniform(0, 2 * np.pi, 7), rng.standard_normal(7)
    waves_at = np.sin(np.outer(x, waves[:, 0]) + np.outer(y, waves[:, 1]) + phases)
    return np.asarray(waves_at @ heights / np.sqrt((heights**2).sum() / 2))


def _pose_surface(s: Setting) -> Active:
    """The first joint's angle is off by a random smooth function of both angles."""
    i, k, size, seed = s.index(0), s.index(1), 1.0e-4 * s.magnitude, int(s.rng.integers(2**31))

    def error(state: PoseState) -> Array:
        q = state.visits.q
        return np.asarray(size * _surface(np.random.default_rng(seed), q[:, i], q[:, k]))

    return Active((Parameter("size", size, "rad"),), bend=angle_law(i, error))


def _torque_surface(s: Setting) -> Active:
    i, k, seed = s.index(0), s.index(1), int(s.rng.integers(2**31))
    size = 0.004 * s.robot.nominal.joints[i].max_torque_Nm * s.magnitude

    def torque(state: LogState) -> Array:
        return np.asarray(size * _surface(np.random.default_rng(seed), state.q[:, i], state.q[:, k]))

    return Active((Parameter("size", size, "Nm"),), torque=torque_law(i, torque))


def _damaged_tooth(s: Setting) -> Active:
    """A raised cosine of 15° in one joint's angle error."""
    j, size, width = s.index(), 8.0e-4 * s.magnitude, np.deg2rad(15.0)
    centre = s.typical_rad(j, s.rng.uniform(0.35, 0.65))

    def error(state: PoseState) -> Array:
        x = (state.visits.q[:, j] - centre) / (width / 2)
        return np.asarray(np.where(np.abs(x) < 1, size * (1 + np.cos(np.pi * x)) / 2, 0.0))

    parameters = (Parameter("height", size, "rad"), Parameter("centre", centre, "rad"))
    return Active((*parameters, Parameter("width", float(width), "rad")), bend=angle_law(j, error))


def _directed_sag(s: Setting) -> Active:
    """A body sags along its own axis of weight by an amount that follows one angle and the other joint's direction."""
    i, k, size = s.index(0), s.index(1), 1.0e-4 * s.magnitude
    mean = s.typical_rad(i)

    def law(state: PoseState) -> Bend:
        bend = Bend.none(*state.visits.q.shape)
        sag = size * (state.visits.q[:, i] - mean) * state.visits.dirs[:, k]
        down = np.einsum("nji,j->ni", state.frames.turned[:, i], unit(state.robot.gravity_m_s2))
        bend.shift_m[:, i] = sag[:, None] * down
        return bend

    return Active((Parameter("sag", size, "m/rad"),), bend=law)


def _base_swing(s: Setting) -> Active:
    """Anchors that creep: the base stays turned by the stop of joint 1, as the speed that it came with."""
    size = 1.5e-4 * s.magnitude

    def law(state: PoseState) -> Bend:
        bend = Bend.none(*state.visits.q.shape)
        bend.base_turn_rad[:, 2] = size * state.visits.speed * state.visits.dirs[:, 0]
        return bend

    return Active((Parameter("turn_at_full_speed", size, "rad"),), bend=law)


def _time_of_day(s: Setting) -> Active:
    """Readings that swing with the air conditioning, along one direction of the room."""
    size, period = 6.0e-5 * s.magnitude, 1500.0 * float(np.exp(0.2 * s.rng.standard_normal()))
    along, phase = unit(s.rng.standard_normal(3)), s.rng.uniform(0, 2 * np.pi)

    def reading(points: Array, time_s: Array) -> Array:
        return np.asarray(size * np.sin(2 * np.pi * time_s / period + phase)[:, None] * along)

    return Active((Parameter("size", size, "m"), Parameter("period", period, "s")), reading=reading)


def _layered_air(s: Setting) -> Active:
    """Warm air under the ceiling bends the line of sight: readings fall with the square of the height."""
    height = 0.6
    size, middle = 8.0e-5 * s.magnitude, float(s.instrument.middle_m @ s.instrument.rotation[:, 2])
    up = s.instrument.rotation[:, 2]

    def reading(points: Array, time_s: Array) -> Array:
        return np.asarray(-size * ((points @ up - middle) / height)[:, None] ** 2 * up)

    return Active((Parameter("drop", size, "m"), Parameter("height", height, "m")), reading=reading)


def _leaning_link(s: Setting) -> Active:
    """A link that the room's air warms on one side: it leans over as the ambient temperature leaves its mean."""
    i = s.index()
    e, _ = along_link(s.robot, i)
    size, mean = 1.2e-4 * s.magnitude, s.robot.climate.ambient_C
    about = unit(np.cross(e, s.rng.standard_normal(3)))

    def law(state: PoseState) -> Bend:
        bend = Bend.none(*state.visits.q.shape)
        bend.turn_rad[:, i] = (size * (state.visits.ambient_C - mean))[:, None] * about
        return bend

    return Active((Parameter("lean", size, "rad/K"),), bend=law)


def _friction_of_both(s: Setting) -> Active:
    """Friction of one drive that grows with its speed times the other's load: they share a bearing."""
    i, k = s.index(0), s.index(1)
    top, load = s.robot.nominal.joints[i].max_speed_rad_s, 0.2 * s.robot.nominal.joints[k].max_torque_Nm
    size = 3.0 * s.robot.coulomb_Nm[i] * s.magnitude

    def torque(state: LogState) -> Array:
        return np.asarray(size * state.qd[:, i] / top * np.abs(state.load_Nm[:, k]) / load)

    return Active((Parameter("size", float(size), "Nm"),), torque=torque_law(i, torque))


def _ambient_torque(s: Setting) -> Active:
    """A current sensor that follows the room's temperature."""
    j, mean = s.index(), s.robot.climate.ambient_C
    size = 0.008 * s.robot.nominal.joints[j].max_torque_Nm * s.magnitude

    def torque(state: LogState) -> Array:
        return np.asarray(size * (state.ambient_C - mean))

    return Active((Parameter("drift", size, "Nm/K"),), torque=torque_law(j, torque))


def _resonance(s: Setting) -> Active:
    """A drag that peaks at one speed, where a housing resonates."""
    j = s.index()
    top = s.robot.nominal.joints[j].max_speed_rad_s
    speed, width, size = 0.35 * top, 0.07 * top, 1.5 * s.robot.coulomb_Nm[j] * s.magnitude

    def torque(state: LogState) -> Array:
        w = state.qd[:, j]
        return np.asarray(size * np.sign(w) / (1 + ((np.abs(w) - speed) / width) ** 2))

    return Active((Parameter("drag", size, "Nm"), Parameter("speed", speed, "rad/s")), torque=torque_law(j, torque))


def _dragged_cable(s: Setting) -> Active:
    """A cable from the second joint drags on the first: by a product of the second's direction and angle."""
    i, k = s.index(0), s.index(1)
    top, rest = s.robot.nominal.joints[k].max_speed_rad_s, s.typical_rad(k)
    size = 2.0 * s.robot.coulomb_Nm[i] * s.magnitude

    def torque(state: LogState) -> Array:
        return np.asarray(size * np.tanh(4 * state.qd[:, k] / top) * np.sin(state.q[:, k] - rest))

    return Active((Parameter("size", float(size), "Nm"),), torque=torque_law(i, torque))


def _two(first: str, second: str, pair: str) -> tuple[str, ...]:
    i, k = _numbers(pair)
    return (f"{first}{i}", f"{second}{k}")


_POSES, _AIR = ("poses",), ("free_air",)
EFFECTS = (
    HiddenEffect("pose_surface", None, _POSES, _PAIRS, _pose_surface, lambda w: _two("q", "q", w)),
    HiddenEffect("damaged_tooth", None, _POSES, everywhere(3), _damaged_tooth, lambda w: (f"q{_numbers(w)[0]}",)),
    HiddenEffect("directed_sag", None, _POSES, _PAIRS, _directed_sag, lambda w: _two("q", "dir", w)),
    HiddenEffect("base_swing", None, _POSES, fixed("base"), _base_swing, lambda w: ("dir1", "approach_qd1_rad_s")),
    HiddenEffect("time_of_day", None, _POSES, fixed("instrument"), _time_of_day, lambda w: ("time",)),
    HiddenEffect("layered_air", None, _POSES, fixed("instrument"), _layered_air, lambda w: ("x", "y", "z")),
    HiddenEffect(
        "leaning_link",
        None,
        _POSES,
        lambda n: ("link3", "link5") if n == 7 else ("link2", "link3"),
        _leaning_link,
        lambda w: ("temp_ambient",),
    ),
    HiddenEffect("torque_surface", None, _AIR, _PAIRS, _torque_surface, lambda w: _two("q", "q", w)),
    HiddenEffect("friction_of_both", None, _AIR, _PAIRS, _friction_of_both, lambda w: _two("qd", "tau", w)),
    HiddenEffect("ambient_torque", None, _AIR, everywhere(2), _ambient_torque, lambda w: ("temp_ambient",)),
    HiddenEffect("resonance", None, _AIR, joints(1, 2, 3, 4, 5, 6), _resonance, lambda w: (f"qd{_numbers(w)[0]}",)),
    HiddenEffect(
        "dragged_cable",
        None,
        _AIR,
        pairs((4, 6), (4, 5), (5, 6)),
        _dragged_cable,
        lambda w: (f"q{_numbers(w)[1]}", f"qd{_numbers(w)[1]}"),
    ),
)
