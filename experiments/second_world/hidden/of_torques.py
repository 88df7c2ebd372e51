"""Hidden effects of torques in free air that have a family name."""

from collections.abc import Callable

import numpy as np

from experiments.second_world.arrays import Array
from experiments.second_world.hidden.kinds import Active, HiddenEffect, Parameter, Setting, everywhere, fixed, joints
from experiments.second_world.states import LogState, TorqueLaw

__all__ = ["EFFECTS", "torque_law"]

Depends = Callable[[str], tuple[str, ...]]


def torque_law(j: int, torque: TorqueLaw) -> TorqueLaw:
    """Law that adds a torque (S,) to one motor."""

    def law(state: LogState) -> Array:
        out = np.zeros(state.q.shape)
        out[:, j] = torque(state)
        return out

    return law


def _asymmetric(s: Setting) -> Active:
    j = s.index()
    more = 0.2 * s.robot.coulomb_Nm[j] * s.magnitude

    def torque(state: LogState) -> Array:
        return np.asarray(more * np.maximum(state.direction[:, j], 0.0))

    return Active((Parameter("more_forward", more, "Nm"),), torque=torque_law(j, torque))


def _stribeck(s: Setting) -> Active:
    """Breakaway friction above Coulomb that falls off as a Gaussian of speed."""
    j = s.index()
    excess = 0.8 * s.robot.coulomb_Nm[j] * s.magnitude
    slow = 0.03 * s.robot.nominal.joints[j].max_speed_rad_s

    def torque(state: LogState) -> Array:
        return np.asarray(excess * np.exp(-((state.qd[:, j] / slow) ** 2)) * state.direction[:, j])

    return Active((Parameter("excess", excess, "Nm"), Parameter("speed", slow, "rad/s")), torque=torque_law(j, torque))


def _power_viscous(s: Setting) -> Active:
    """Grease that shears thin: from w to w^0.55, with the same friction at full speed."""
    j = s.index()
    level = 2.0 * s.robot.viscous_Nm[j] * s.magnitude
    top = s.robot.nominal.joints[j].max_speed_rad_s

    def torque(state: LogState) -> Array:
        w = state.qd[:, j] / top
        return np.asarray(level * (np.sign(w) * np.abs(w) ** 0.55 - w))

    return Active((Parameter("level", level, "Nm"), Parameter("exponent", 0.55, "1")), torque=torque_law(j, torque))


def _load_friction(s: Setting) -> Active:
    """Meshing loss: a share of the transmitted torque, rounded off near no load by the preload of the gear."""
    j, share = s.index(), 0.06 * s.magnitude
    preload = 0.01 * s.robot.nominal.joints[j].max_torque_Nm

    def torque(state: LogState) -> Array:
        return np.asarray(share * (np.hypot(state.load_Nm[:, j], preload) - preload) * state.direction[:, j])

    return Active((Parameter("share", share, "1"), Parameter("preload", preload, "Nm")), torque=torque_law(j, torque))


def _vogel(temp_C: Array) -> Array:
    """Viscosity of gear oil over that at 40 °C, by Vogel's law."""
    return np.asarray(np.exp(880.0 / (temp_C + 95.0) - 880.0 / 135.0))


def _temperature_friction(s: Setting) -> Active:
    j = s.index()
    level = 0.8 * s.robot.viscous_Nm[j] * s.magnitude
    top = s.robot.nominal.joints[j].max_speed_rad_s

    def torque(state: LogState) -> Array:
        return np.asarray(level * (_vogel(state.motor_temps_C[:, j]) - 1.0) * state.qd[:, j] / top)

    return Active((Parameter("viscous_at_40C", level, "Nm"),), torque=torque_law(j, torque))


def _warm_up(s: Setting) -> Active:
    """Cold grease in every gear, where no sensor sits: Coulomb and viscous friction fall with the work done."""
    robot = s.robot
    share = 0.6 * s.magnitude
    gear_s = 1500.0 * np.exp(0.3 * s.rng.standard_normal(robot.n))
    top = robot.nominal.max_speeds()

    def torque(state: LogState) -> Array:
        cold = np.exp(-state.work_s[:, None] / gear_s)
        viscous = robot.viscous_Nm * state.qd / top
        return np.asarray(share * cold * (viscous + 0.4 * robot.coulomb_Nm * state.direction))

    times = tuple(Parameter(f"time{i + 1}", float(t), "s") for i, t in enumerate(gear_s))
    return Active((Parameter("share", share, "1"), *times), torque=torque)


def _ripple(s: Setting) -> Active:
    """Cogging of six slots per turn of the shaft, peaked: its first overtone is a third of it."""
    j = s.index()
    size, phase = 0.006 * s.robot.nominal.joints[j].max_torque_Nm * s.magnitude, s.rng.uniform(0, 2 * np.pi)

    def torque(state: LogState) -> Array:
        x = 6.0 * state.q[:, j] + phase
        return np.asarray(size * (np.sin(x) + np.sin(2.0 * x) / 3.0))

    return Active((Parameter("size", size, "Nm"), Parameter("phase", phase, "rad")), torque=torque_law(j, torque))


def _dress_pack(s: Setting) -> Active:
    """A hose with slack: it pulls little until the slack is taken up, then as a spring."""
    j = s.index()
    rest, slack = s.typical_rad(j) + 0.3 * s.rng.standard_normal(), 0.5
    stiffness = 0.02 * s.robot.nominal.joints[j].max_torque_Nm * s.magnitude

    def torque(state: LogState) -> Array:
        x = state.q[:, j] - rest
        return np.asarray(stiffness * (x - slack * np.tanh(x / slack)))

    parameters = (Parameter("stiffness", stiffness, "Nm/rad"), Parameter("rest", rest, "rad"))
    return Active((*parameters, Parameter("slack", slack, "rad")), torque=torque_law(j, torque))


def _compensator(s: Setting) -> Active:
    """A coil spring between a pin on the column and a pin on the arm: k (l − l0) dl/dq."""
    j = s.index()
    near, far = 0.18, 0.55  # m from the joint's axis
    neutral, free_m = s.typical_rad(j) + 0.2 * s.rng.standard_normal(), 0.9 * (far - near)
    k = 0.12 * s.robot.nominal.joints[j].max_torque_Nm / (near * far) * s.magnitude

    def torque(state: LogState) -> Array:
        x = state.q[:, j] - neutral
        length = np.sqrt(near**2 + far**2 - 2 * near * far * np.cos(x))
        return np.asarray(k * (length - free_m) * near * far * np.sin(x) / length)

    parameters = (Parameter("stiffness", k, "N/m"), Parameter("free_length", free_m, "m"))
    return Active((*parameters, Parameter("neutral", neutral, "rad")), torque=torque_law(j, torque))


def _offset(s: Setting) -> Active:
    j = s.index()
    size = 0.01 * s.robot.nominal.joints[j].max_torque_Nm * s.magnitude
    return Active((Parameter("offset", size, "Nm"),), torque=torque_law(j, lambda state: np.full(len(state.q), size)))


def _gain(s: Setting) -> Active:
    """A drive whose torque constant is not that of its data sheet: all that it reports is too large."""
    error = 0.04 * s.magnitude
    return Active((Parameter("gain_error", error, ""),), gain=(s.index(), 1.0 + error))


def _lag(s: Setting) -> Active:
    lag_s = 0.008 * s.magnitude
    return Active((Parameter("lag", lag_s, "s"),), lag_s=lag_s)


def _at(symbol: str) -> Depends:
    return lambda where: tuple(f"{c}{where.removeprefix('joint')}" for c in symbol.split())


_AIR = ("free_air",)
EFFECTS = (
    HiddenEffect("asymmetric_friction", "asymmetric_friction", _AIR, everywhere(2), _asymmetric, _at("qd")),
    HiddenEffect("stribeck_friction", "stribeck_friction", _AIR, everywhere(1), _stribeck, _at("qd")),
    HiddenEffect("power_viscous_friction", "viscous_friction", _AIR, everywhere(1), _power_viscous, _at("qd")),
    HiddenEffect(
        "load_dependent_friction", "load_dependent_friction", _AIR, everywhere(2), _load_friction, _at("qd tau")
    ),
    HiddenEffect(
        "temperature_dependent_friction",
        "temperature_dependent_friction",
        _AIR,
        everywhere(3),
        _temperature_friction,
        lambda w: (f"qd{w.removeprefix('joint')}", f"temp_motor{w.removeprefix('joint')}"),
    ),
    HiddenEffect(
        "warm_up_friction", "temperature_dependent_friction", _AIR, fixed("all"), _warm_up, lambda w: ("time", "qd")
    ),
    HiddenEffect("torque_ripple", "torque_ripple", _AIR, everywhere(4), _ripple, _at("q")),
    HiddenEffect("dress_pack", "dress_pack", _AIR, joints(5, 4, 6), _dress_pack, _at("q")),
    HiddenEffect("gravity_compensator", "gravity_compensator", _AIR, joints(2), _compensator, _at("q")),
    HiddenEffect("torque_offset", "torque_offset", _AIR, everywhere(3), _offset, lambda w: ()),
    HiddenEffect("torque_gain", "torque_gain", _AIR, joints(3, 2, 5), _gain, _at("q tau")),
    HiddenEffect("time_lag", "time_lag", _AIR, fixed("all"), _lag, lambda w: ("qd", "qdd")),
)
