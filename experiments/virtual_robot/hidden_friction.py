"""Effects in torque readings only."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from experiments.virtual_robot.plant import Plant
from experiments.virtual_robot.puts import Numbers, Put, named, plus
from experiments.virtual_robot.sizes import Sight


def hide_friction(field: str, unit: str, value: Callable[[Plant, int], float]) -> Put:
    """Return the kind that adds to one number of one motor's or joint's friction."""

    def put(plant: Plant, i: int, m: float, s: Sight, rng: np.random.Generator) -> tuple[Plant, Numbers]:
        amount = m * value(plant, i)
        changed: dict[str, Any] = {field: plus(getattr(plant.friction, field), i, amount)}
        return replace(plant, friction=replace(plant.friction, **changed)), {f"{field}_{unit}": amount}

    return put


def hide_stribeck(plant: Plant, i: int, m: float, s: Sight, rng: np.random.Generator) -> tuple[Plant, Numbers]:
    """Let a motor's dry friction be larger when slow or standing."""
    amount = 0.35 * m * float(plant.friction.coulomb[i])
    friction = replace(plant.friction, stribeck=plus(plant.friction.stribeck, i, amount))
    speed = float(plant.friction.stribeck_speed[i])
    return replace(plant, friction=friction), {"stribeck_Nm": amount, "stribeck_speed_rad_s": speed}


def hide_creep(plant: Plant, i: int, m: float, s: Sight, rng: np.random.Generator) -> tuple[Plant, Numbers]:
    """Let a motor's dry friction creep away at rest."""
    rate = m * float(rng.uniform(0.8, 1.6))
    creep = plus(plant.friction.creep, i, rate)
    return replace(plant, friction=replace(plant.friction, creep=creep)), {"creep_rate_1_s": rate}


def hide_ripple(plant: Plant, i: int, m: float, s: Sight, rng: np.random.Generator) -> tuple[Plant, Numbers]:
    """Let a joint's torque ripple once and, less, twice per revolution of its motor."""
    size = 1.5 * m * float(plant.instrument.torque_sigma[i] / abs(plant.drive.nominal[i, i]))
    a, b = rng.uniform(0, 2 * np.pi, 2)
    terms = size * np.array([np.cos(a), np.sin(a), 0.6 * np.cos(b), 0.6 * np.sin(b)])
    every = np.zeros(plant.friction.ripple.shape[1])
    every[:4] = terms
    friction = replace(plant.friction, ripple=plus(plant.friction.ripple, i, every))
    names = ("sin_motor_Nm", "cos_motor_Nm", "sin_2motor_Nm", "cos_2motor_Nm")
    return replace(plant, friction=friction), named(names, terms)


def hide_poles(plant: Plant, i: int, m: float, s: Sight, rng: np.random.Generator) -> tuple[Plant, Numbers]:
    """Let a joint's torque ripple with the poles of its motor: three and, less, six times per revolution."""
    size = 1.5 * m * float(plant.instrument.torque_sigma[i] / abs(plant.drive.nominal[i, i]))
    a, b = rng.uniform(0, 2 * np.pi, 2)
    terms = size * np.array([np.cos(a), np.sin(a), 0.6 * np.cos(b), 0.6 * np.sin(b)])
    every = np.zeros(plant.friction.ripple.shape[1])
    every[[4, 5, 10, 11]] = terms
    friction = replace(plant.friction, ripple=plus(plant.friction.ripple, i, every))
    return replace(plant, friction=friction), named(
        ("sin_3motor_Nm", "cos_3motor_Nm", "sin_6motor_Nm", "cos_6motor_Nm"), terms
    )


def hide_lag(plant: Plant, i: int, m: float, s: Sight, rng: np.random.Generator) -> tuple[Plant, Numbers]:
    """Log torques late."""
    lag = 0.1 * m
    return replace(plant, friction=replace(plant.friction, lag=plant.friction.lag + lag)), {"lag_s": lag}
