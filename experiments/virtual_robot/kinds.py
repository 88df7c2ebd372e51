"""What can be hidden: each kind sets a few true numbers of the plant that are zero in a baseline robot.

Default sizes make an effect clearly visible: in poses about `sizes.VISIBLE` times the instrument's noise is left after
a standard model (geometry, compliance, backlash, gravity) has taken what it can; in torques a few times the noise.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from experiments.virtual_robot.description import Array
from experiments.virtual_robot.drive import compliance_matrix
from experiments.virtual_robot.outside import OUTSIDE_KINDS
from experiments.virtual_robot.plant import Plant
from experiments.virtual_robot.sizes import Sizes

Numbers = dict[str, float]
Put = Callable[[Plant, int, float, Sizes, np.random.Generator], tuple[Plant, Numbers]]
TORQUES = ("free_air", "wrist", "clamped")
POSES = ("poses", "verification")
EVERYWHERE = TORQUES + POSES


def _any(plant: Plant, load: Array) -> list[int]:
    return list(range(plant.n))


def _loaded(plant: Plant, load: Array) -> list[int]:
    """Joints that weight loads differently in different postures."""
    return [i for i in range(plant.n) if load[i] > 0.02 * load.max() > 0] or _any(plant, load)


def _inner(plant: Plant, load: Array) -> list[int]:
    return list(range(min(3, plant.n)))


def _wrist(plant: Plant, load: Array) -> list[int]:
    return list(range(min(3, plant.n - 1), plant.n))


def _long(plant: Plant, load: Array) -> list[int]:
    length = np.linalg.norm(plant.geometry.link_vectors, axis=1)
    return [int(i) for i in np.flatnonzero(length > 0.4 * length.max())]


def _beams(plant: Plant, load: Array) -> list[int]:
    return [i for i in _long(plant, load) if 0 < i < plant.n - 1] or [0]


@dataclass(frozen=True)
class Kind:
    """One kind of effect: how it is put in, where it usually sits, and which tables show it."""

    put: Put
    noun: str  # joint, link, or the only place there is
    tables: tuple[str, ...]
    places: Callable[[Plant, Array], list[int]] = _any

    @property
    def wanted(self) -> str:
        """The places that may be named."""
        return f"{self.noun}1, {self.noun}2, …" if self.noun in ("joint", "link") else self.noun

    def accepts(self, where: str) -> bool:
        """Whether a place has the right form."""
        if self.noun in ("joint", "link"):
            return where.startswith(self.noun) and where.removeprefix(self.noun).isdigit()
        return where == self.noun


def _set(values: Array, index: int, value: float | Array) -> Array:
    out = values.copy()
    out[index] = out[index] + value
    return out


def _shaft(plant: Plant, i: int) -> float:
    """Rated torque at motor i, Nm."""
    return float(plant.drive.rated[i] * abs(plant.drive.nominal[i, i]))


def _backlash(plant: Plant, i: int, m: float, s: Sizes, rng: np.random.Generator) -> tuple[Plant, Numbers]:
    gap = 2 * m * s.angle(i)  # half of it on either side
    return replace(plant, drive=replace(plant.drive, gap=_set(plant.drive.gap, i, gap))), {"gap_rad": gap}


def _compliance(plant: Plant, i: int, m: float, s: Sizes, rng: np.random.Generator) -> tuple[Plant, Numbers]:
    own = float(compliance_matrix(plant.drive)[i, i])
    seen = s.angle(i, 1.5) / s.load[i] if s.load[i] > 1.0 else 0.0  # rad/Nm
    extra = m * max(0.3 * own, seen)
    extra_compliance = _set(plant.drive.extra_compliance, i, extra)
    return replace(plant, drive=replace(plant.drive, extra_compliance=extra_compliance)), {"compliance_rad_Nm": extra}


def _eccentricity(plant: Plant, i: int, m: float, s: Sizes, rng: np.random.Generator) -> tuple[Plant, Numbers]:
    once, twice = m * s.angle(i, 2.5) * np.sqrt(2), m * s.angle(i, 1.0) * np.sqrt(2)
    a, b = rng.uniform(0, 2 * np.pi, 2)
    terms = np.array([once * np.cos(a), once * np.sin(a), twice * np.cos(b), twice * np.sin(b)])
    drive = replace(plant.drive, eccentricity=_set(plant.drive.eccentricity, i, terms))
    names = ("sin_q_rad", "cos_q_rad", "sin_2q_rad", "cos_2q_rad")
    return replace(plant, drive=drive), dict(zip(names, map(float, terms), strict=True))


def _expansion(plant: Plant, i: int, m: float, s: Sizes, rng: np.random.Generator) -> tuple[Plant, Numbers]:
    length = float(np.linalg.norm(plant.geometry.link_vectors[i]))
    spread = 2.5  # K, what a campaign's warming amounts to, as a standard deviation
    rate = m * max(1.8e-5, 1.5 * s.visible / (spread * max(length, 0.05)))
    structure = replace(plant.structure, expansion=_set(plant.structure.expansion, i, rate))
    return replace(plant, structure=structure), {"expansion_1_K": rate}


def _payload(plant: Plant, i: int, m: float, s: Sizes, rng: np.random.Generator) -> tuple[Plant, Numbers]:
    mass = 2.5 * m
    shift = m * np.array([0.02, -0.015, 0.03]) * rng.choice([-1.0, 1.0], 3)
    tool, com = plant.masses.tool, plant.masses.tool_com
    masses = replace(plant.masses, tool=tool + mass, tool_com=com + shift)
    first = (tool + mass) * (com + shift) - tool * com
    return replace(plant, masses=masses), {
        "mass_kg": mass,
        **{f"com_{a}_m": float(x) for a, x in zip("xyz", shift, strict=True)},
        **{f"moment_{a}_kg_m": float(x) for a, x in zip("xyz", first, strict=True)},
    }


def _friction(field: str, unit: str, value: Callable[[Plant, int], float]) -> Put:
    """Return the kind that sets one friction number of one motor or joint."""

    def put(plant: Plant, i: int, m: float, s: Sizes, rng: np.random.Generator) -> tuple[Plant, Numbers]:
        amount = m * value(plant, i)
        changed: dict[str, Any] = {field: _set(getattr(plant.friction, field), i, amount)}
        friction = replace(plant.friction, **changed)
        return replace(plant, friction=friction), {f"{field}_{unit}": amount}

    return put


def _stribeck(plant: Plant, i: int, m: float, s: Sizes, rng: np.random.Generator) -> tuple[Plant, Numbers]:
    amount = 0.35 * m * float(plant.friction.coulomb[i])
    friction = replace(plant.friction, stribeck=_set(plant.friction.stribeck, i, amount))
    speed = float(plant.friction.stribeck_speed[i])
    return replace(plant, friction=friction), {"stribeck_Nm": amount, "stribeck_speed_rad_s": speed}


def _ripple(plant: Plant, i: int, m: float, s: Sizes, rng: np.random.Generator) -> tuple[Plant, Numbers]:
    size = 1.5 * m * float(plant.instrument.torque_sigma[i] / abs(plant.drive.nominal[i, i]))
    a, b = rng.uniform(0, 2 * np.pi, 2)
    terms = size * np.array([np.cos(a), np.sin(a), 0.6 * np.cos(b), 0.6 * np.sin(b)])
    friction = replace(plant.friction, ripple=_set(plant.friction.ripple, i, terms))
    names = ("sin_motor_Nm", "cos_motor_Nm", "sin_2motor_Nm", "cos_2motor_Nm")
    return replace(plant, friction=friction), dict(zip(names, map(float, terms), strict=True))


def _fixture(plant: Plant, i: int, m: float, s: Sizes, rng: np.random.Generator) -> tuple[Plant, Numbers]:
    values = m * np.array([3e-7] * 3 + [8e-6] * 3) * rng.uniform(0.6, 1.4, 6)
    names = ("x_m_N", "y_m_N", "z_m_N", "rx_rad_Nm", "ry_rad_Nm", "rz_rad_Nm")
    fixture = replace(plant.fixture, compliance=plant.fixture.compliance + values)
    return replace(plant, fixture=fixture), dict(zip(names, map(float, values), strict=True))


def _base_tilt(plant: Plant, i: int, m: float, s: Sizes, rng: np.random.Generator) -> tuple[Plant, Numbers]:
    value = m * max(1.0e-7, 2.0 * s.visible / max(float(s.tilting[0]), 1.0))
    return replace(plant, structure=replace(plant.structure, base=plant.structure.base + value)), {"tilt_rad_Nm": value}


def _bearing(plant: Plant, i: int, m: float, s: Sizes, rng: np.random.Generator) -> tuple[Plant, Numbers]:
    value = m * 4.0 * s.visible / max(float(s.tilting[i]), 1.0)
    return replace(plant, structure=replace(plant.structure, bearing=_set(plant.structure.bearing, i, value))), {
        "tilt_rad_Nm": value
    }


def _bending(plant: Plant, i: int, m: float, s: Sizes, rng: np.random.Generator) -> tuple[Plant, Numbers]:
    value = 2.5e-7 * m
    structure = replace(plant.structure, bending=_set(plant.structure.bending, i, value))
    return replace(plant, structure=structure), {"flexibility_1_Nm2": value}


def _scale(plant: Plant, i: int, m: float, s: Sizes, rng: np.random.Generator) -> tuple[Plant, Numbers]:
    value = 3e-4 * m
    return replace(plant, instrument=replace(plant.instrument, scale=plant.instrument.scale + value)), {
        "scale_1": value
    }


def _ratio(plant: Plant, i: int, m: float, s: Sizes, rng: np.random.Generator) -> tuple[Plant, Numbers]:
    """Set a wrong entry in column i of T: the wrist couples joint i to the motor before it, others have a wrong ratio."""
    T = plant.drive.transmission.copy()
    j = i - 1 if i > 0 and T[i - 1, i] != 0 else i
    error = m * s.angle(i, 2.0)  # rad per rad of the joint that drives it
    T[j, i] += error * T[j, j]
    drive = replace(plant.drive, transmission=T)
    return replace(plant, drive=drive), {f"ratio_from_joint{j + 1}_1": error}


def _hardening(plant: Plant, i: int, m: float, s: Sizes, rng: np.random.Generator) -> tuple[Plant, Numbers]:
    lost = min(0.6 * m, 0.9) * float(compliance_matrix(plant.drive)[i, i])
    drive = replace(plant.drive, hardening=_set(plant.drive.hardening, i, lost))
    cubic = lost / 3 / float(plant.drive.rated[i]) ** 2
    return replace(plant, drive=drive), {"hardening_rad_Nm": lost, "cubic_rad_Nm3": cubic}


def _hysteresis(plant: Plant, i: int, m: float, s: Sizes, rng: np.random.Generator) -> tuple[Plant, Numbers]:
    own = float(compliance_matrix(plant.drive)[i, i])
    share = min(0.25 * m, 0.8) * np.array([0.5, 0.3, 0.2])
    limit = np.array([0.03, 0.08, 0.2]) * float(plant.drive.rated[i])
    drive = replace(
        plant.drive, slip=_set(plant.drive.slip, i, own * share), slip_torque=_at(plant.drive.slip_torque, i, limit)
    )
    loop = float(2 * np.sum(own * share * limit))
    return replace(plant, drive=drive), {"lost_motion_rad": loop}


def _at(values: Array, index: int, value: Array) -> Array:
    out = values.copy()
    out[index] = value
    return out


def _dress(plant: Plant, i: int, m: float, s: Sizes, rng: np.random.Generator) -> tuple[Plant, Numbers]:
    stiffness, rest = m * max(3.0, 0.015 * float(plant.drive.rated[i])), float(rng.uniform(-0.5, 0.5))
    a = plant.attachments
    a = replace(a, dress_stiffness=_set(a.dress_stiffness, i, stiffness), dress_rest=_set(a.dress_rest, i, rest))
    return replace(plant, attachments=a), {"stiffness_Nm_rad": stiffness, "rest_rad": rest}


def _balancer(plant: Plant, i: int, m: float, s: Sizes, rng: np.random.Generator) -> tuple[Plant, Numbers]:
    arms, length, angle = (
        plant.attachments.balancer_arms,
        plant.attachments.balancer_length,
        float(rng.uniform(-1.9, -1.3)),
    )
    rate = m * 0.25 * float(plant.drive.rated[i]) / (arms[0] * arms[1])
    a = replace(plant.attachments, balancer_rate=rate, balancer_joint=i, balancer_angle=angle)
    return replace(plant, attachments=a), {
        "rate_N_m": rate, "arm_1_m": arms[0], "arm_2_m": arms[1], "length_m": length, "angle_rad": angle,
    }  # fmt: skip


def _cross(plant: Plant, i: int, m: float, s: Sizes, rng: np.random.Generator) -> tuple[Plant, Numbers]:
    """Couple the springs of motor i and the one before it (the next one, for the first)."""
    j = i - 1 if i else min(1, plant.n - 1)
    value = min(0.3 * m, 0.8) / float(np.sqrt(plant.drive.spring[i] * plant.drive.spring[j]))
    coupling = plant.drive.coupling.copy()
    coupling[i, j] += value
    coupling[j, i] += value
    return replace(plant, drive=replace(plant.drive, coupling=coupling)), {
        f"compliance_motor{i + 1}_motor{j + 1}_rad_Nm": value
    }


def _lag(plant: Plant, i: int, m: float, s: Sizes, rng: np.random.Generator) -> tuple[Plant, Numbers]:
    return replace(plant, friction=replace(plant.friction, lag=plant.friction.lag + 0.05 * m)), {"lag_s": 0.05 * m}


def _outside(name: str) -> Put:
    place, unit, _ = OUTSIDE_KINDS[name]

    def put(plant: Plant, i: int, m: float, s: Sizes, rng: np.random.Generator) -> tuple[Plant, Numbers]:
        if plant.n < 6:
            raise ValueError(f"{name}: expected a robot with six joints, found {plant.n}")
        size = {
            "rad": s.angle(place, 1.7),
            "m": 1.5 * s.visible,
            "Nm": 2.0 * float(plant.instrument.torque_sigma[place]),
        }
        value = m * size[unit]
        outside = {**plant.outside, name: plant.outside.get(name, 0.0) + value}
        return replace(plant, outside=outside), {f"amplitude_{unit}": value}

    return put


KINDS: dict[str, Kind] = {
    "backlash": Kind(_backlash, "joint", ("clamped", *POSES), _inner),
    "joint_compliance": Kind(_compliance, "joint", EVERYWHERE, _loaded),
    "gear_eccentricity": Kind(_eccentricity, "joint", EVERYWHERE, _any),
    "thermal_expansion": Kind(_expansion, "link", POSES, _long),
    "payload": Kind(_payload, "tool", EVERYWHERE),
    "stribeck_friction": Kind(_stribeck, "joint", TORQUES),
    "fixture_compliance": Kind(_fixture, "fixture", ("clamped",)),
    "base_tilt": Kind(_base_tilt, "base", POSES),
    "torque_offset": Kind(_friction("offset", "Nm", lambda p, i: 0.03 * _shaft(p, i)), "joint", TORQUES),
    "instrument_scale": Kind(_scale, "instrument", POSES),
    "bearing_tilt": Kind(_bearing, "joint", POSES, _inner),
    "link_bending": Kind(_bending, "link", POSES, _beams),
    "coupling_ratio_error": Kind(_ratio, "joint", EVERYWHERE, _wrist),
    "nonlinear_stiffness": Kind(_hardening, "joint", ("clamped", *POSES), _inner),
    "hysteresis": Kind(_hysteresis, "joint", ("clamped", *POSES), _loaded),
    "asymmetric_friction": Kind(
        _friction("asymmetry", "Nm", lambda p, i: 0.35 * float(p.friction.coulomb[i])), "joint", TORQUES
    ),
    "load_dependent_friction": Kind(_friction("load", "1", lambda p, i: 0.06), "joint", TORQUES, _loaded),
    "temperature_dependent_friction": Kind(_friction("thermal", "1_K", lambda p, i: 0.03), "joint", TORQUES),
    "wrist_coupling_friction": Kind(
        _friction("arm", "Nm", lambda p, i: 0.03 * float(p.drive.rated[i])), "joint", EVERYWHERE, _wrist
    ),
    "torque_ripple": Kind(_ripple, "joint", TORQUES),
    "dress_pack": Kind(_dress, "joint", EVERYWHERE, _wrist),
    "gravity_compensator": Kind(_balancer, "joint", EVERYWHERE, lambda p, load: [min(1, p.n - 1)]),
    "cross_coupled_stiffness": Kind(_cross, "joint", EVERYWHERE, _wrist),
    "time_lag": Kind(_lag, "clock", ("free_air", "wrist")),
    **{
        name: Kind(_outside(name), f"joint{place + 1}" if unit == "rad" else "point", POSES)
        for name, (place, unit, _) in OUTSIDE_KINDS.items()
        if unit != "Nm"
    },
    "outside_torque_wave": Kind(_outside("outside_torque_wave"), "joint3", TORQUES),
}
