"""Effects of loads, structure, instrument and clamp, and those that no library knows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from experiments.virtual_robot.outside import OUTSIDE_KINDS
from experiments.virtual_robot.plant import Plant
from experiments.virtual_robot.puts import Numbers, Put, named, plus
from experiments.virtual_robot.sizes import Sight


def hide_payload(plant: Plant, i: int, m: float, s: Sight, rng: np.random.Generator) -> tuple[Plant, Numbers]:
    """Let the tool be heavier, and its centre of mass elsewhere, than declared."""
    old, mass = plant.masses, 2.0 * m
    shift = m * np.array([0.015, -0.012, 0.025]) * rng.choice([-1.0, 1.0], 3)
    new = replace(old, tool=old.tool + mass, tool_com=old.tool_com + shift)
    moment = new.tool * new.tool_com - old.tool * old.tool_com
    return replace(plant, masses=new), {
        "mass_kg": mass,
        **named(("com_x_m", "com_y_m", "com_z_m"), shift),
        **named(("moment_x_kg_m", "moment_y_kg_m", "moment_z_kg_m"), moment),
    }


def hide_dress_pack(plant: Plant, i: int, m: float, s: Sight, rng: np.random.Generator) -> tuple[Plant, Numbers]:
    """Hang a cable on a joint that pulls it like a spring."""
    at_joint = float(plant.instrument.torque_sigma[i] / abs(plant.drive.nominal[i, i]))
    stiffness, rest = 1.5 * m * at_joint, float(rng.uniform(-0.5, 0.5))
    a = plant.attachments
    a = replace(a, dress_stiffness=plus(a.dress_stiffness, i, stiffness), dress_rest=plus(a.dress_rest, i, rest))
    return replace(plant, attachments=a), {"stiffness_Nm_rad": stiffness, "rest_rad": rest}


def hide_balancer(plant: Plant, i: int, m: float, s: Sight, rng: np.random.Generator) -> tuple[Plant, Numbers]:
    """Add a spring between two links: k(l − l0)·dl/dq, with l from the cosine rule."""
    a, angle = plant.attachments, float(rng.uniform(-1.9, -1.3))
    rate = 0.12 * m * float(plant.drive.rated[i]) / (a.balancer_arms[0] * a.balancer_arms[1])
    names = ("rate_N_m", "arm_1_m", "arm_2_m", "free_length_m", "angle_rad")
    values = np.array([rate, *a.balancer_arms, a.balancer_length, angle])
    a = replace(a, balancer_rate=rate, balancer_joint=i, balancer_angle=angle)
    return replace(plant, attachments=a), named(names, values)


def hide_fixture(plant: Plant, i: int, m: float, s: Sight, rng: np.random.Generator) -> tuple[Plant, Numbers]:
    """Let the block yield, differently along each axis of the base: a poor block."""
    values = m * np.array([1.5e-7] * 3 + [4e-6] * 3) * rng.uniform(0.6, 1.4, 6)
    fixture = replace(plant.fixture, compliance=plant.fixture.compliance + values)
    names = ("x_m_N", "y_m_N", "z_m_N", "rx_rad_Nm", "ry_rad_Nm", "rz_rad_Nm")
    return replace(plant, fixture=fixture), named(names, values)


def hide_slip(plant: Plant, i: int, m: float, s: Sight, rng: np.random.Generator) -> tuple[Plant, Numbers]:
    """Let the block slip once, in the middle of a sweep of one of the first six."""
    shift = m * np.array([1.5e-4] * 3 + [2e-4] * 3) * rng.choice([-1.0, 1.0], 6) * rng.uniform(0.6, 1.4, 6)
    at = float(rng.integers(6) * 180.0 + rng.uniform(50.0, 110.0))  # a sweep takes 160 s, and 20 s pass to the next
    names = ("x_m", "y_m", "z_m", "rx_rad", "ry_rad", "rz_rad")
    recorded = named(names, shift) | {"at_s": at}
    return replace(plant, fixture=replace(plant.fixture, shift=plant.fixture.shift + shift, slips_at=at)), recorded


def hide_expansion(plant: Plant, i: int, m: float, s: Sight, rng: np.random.Generator) -> tuple[Plant, Numbers]:
    """Let a link grow along its vector, at least like aluminium."""

    def growing(p: Plant, rate: float) -> Plant:
        structure = p.structure
        return replace(p, structure=replace(structure, expansion=plus(structure.expansion, i, rate)))

    rate = m * min(max(2.3e-5, 1e-5 * s.factor(lambda p: growing(p, 1e-5))), 6e-5)
    return growing(plant, rate), {"expansion_1_K": rate}


def hide_base_tilt(plant: Plant, i: int, m: float, s: Sight, rng: np.random.Generator) -> tuple[Plant, Numbers]:
    """Let the base tilt under the arm's moment."""

    def tilting(p: Plant, value: float) -> Plant:
        return replace(p, structure=replace(p.structure, base=p.structure.base + value))

    value = m * 1e-8 * s.factor(lambda p: tilting(p, 1e-8))
    return tilting(plant, value), {"tilt_rad_Nm": value}


def hide_settling(plant: Plant, i: int, m: float, s: Sight, rng: np.random.Generator) -> tuple[Plant, Numbers]:
    """Let the base tilt and sink in the course of the session, in a direction of its own."""
    shape = np.r_[1e-4 * rng.standard_normal(3), 1e-4 * rng.standard_normal(3)]

    def settling(p: Plant, value: float) -> Plant:
        return replace(p, structure=replace(p.structure, settling=p.structure.settling + value * shape))

    value = m * 0.1 * s.factor(lambda p: settling(p, 0.1))
    names = ("rx_rad", "ry_rad", "rz_rad", "x_m", "y_m", "z_m")
    return settling(plant, value), named(names, value * shape)


def hide_bearing_tilt(plant: Plant, i: int, m: float, s: Sight, rng: np.random.Generator) -> tuple[Plant, Numbers]:
    """Let a joint's bearing tilt under the moment across its axis."""

    def tilting(p: Plant, value: float) -> Plant:
        structure = p.structure
        return replace(p, structure=replace(structure, bearing=plus(structure.bearing, i, value)))

    value = m * 1e-8 * s.factor(lambda p: tilting(p, 1e-8))
    return tilting(plant, value), {"tilt_rad_Nm": value}


def hide_bending(plant: Plant, i: int, m: float, s: Sight, rng: np.random.Generator) -> tuple[Plant, Numbers]:
    """Let a link bend like a beam."""

    def bending(p: Plant, value: float) -> Plant:
        structure = p.structure
        return replace(p, structure=replace(structure, bending=plus(structure.bending, i, value)))

    value = m * 1e-8 * s.factor(lambda p: bending(p, 1e-8))
    return bending(plant, value), {"flexibility_1_Nm2": value}


def hide_scale(plant: Plant, i: int, m: float, s: Sight, rng: np.random.Generator) -> tuple[Plant, Numbers]:
    """Let the instrument's scale be wrong; nearly all of it is absorbed by free geometry, whatever its size."""
    scale = 3e-4 * m
    return replace(plant, instrument=replace(plant.instrument, scale=plant.instrument.scale + scale)), {
        "scale_1": scale
    }


def hide_outside(name: str) -> Put:
    """Return the kind that is in no library."""
    joint, unit, _ = OUTSIDE_KINDS[name]

    def put(plant: Plant, i: int, m: float, s: Sight, rng: np.random.Generator) -> tuple[Plant, Numbers]:
        if plant.n < 6:
            raise ValueError(f"{name}: expected a robot with six joints, found {plant.n}")

        def strange(p: Plant, value: float) -> Plant:
            return replace(p, outside={**p.outside, name: p.outside.get(name, 0.0) + value})

        at_motor = 2.0 * float(plant.instrument.torque_sigma[joint])
        value = m * (at_motor if unit == "Nm" else 1e-4 * s.factor(lambda p: strange(p, 1e-4)))
        return strange(plant, value), {f"amplitude_{unit}": value}

    return put
