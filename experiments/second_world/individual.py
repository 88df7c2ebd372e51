"""One robot: the true machine as it was built, and the nominal machine as its maker describes it."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from experiments.second_world.arms import ARMS, Arm, Body
from experiments.second_world.arrays import Array, signed_log_normal, stream
from experiments.second_world.climate import Climate

__all__ = ["ROBOTS", "Robot", "draw_robot"]

ROBOTS = tuple(ARMS)
_MOUNTINGS = {"floor": (0.0, 0.0, -1.0), "wall": (-1.0, 0.0, 0.0), "ceiling": (0.0, 0.0, 1.0)}  # of gravity


@dataclass(frozen=True)
class Robot:
    """An individual: nominal and true arm, tool, drives, and where it stands. Units are in the names."""

    seed: int
    nominal: Arm
    arm: Arm
    tool: Body  # in the flange frame
    declared_tool: Body
    targets_m: Array  # (4, 3) true, in the flange frame
    nominal_targets_m: Array  # (4, 3)
    gravity_m_s2: Array  # (3,)
    compliance_rad_Nm: Array  # (n,)
    clearance_rad: Array  # (n,)
    coulomb_Nm: Array  # (n,)
    viscous_Nm: Array  # (n,) at full speed
    stated_friction: tuple[tuple[float, float], ...]  # Nm and Nm s/rad, as the maker states them
    friction_law: str  # "tanh" or "dahl"
    rotor_kg_m2: Array  # (n,) seen at the joint
    torque_std_Nm: Array  # (n,)
    repeatability_rad: float
    climate: Climate

    @property
    def n(self) -> int:
        """Number of joints."""
        return self.arm.n


def _as_built(arm: Arm, rng: np.random.Generator) -> Arm:
    """Shift, twist and reweigh every link by what manufacture leaves: 0.1–1 mm, 0.1–1 mrad, a few per cent."""
    joints = tuple(
        replace(
            j,
            xyz_m=j.xyz_m + signed_log_normal(rng, 3e-4, 0.6, 1e-4, 1e-3, (3,)),
            rpy_rad=j.rpy_rad + signed_log_normal(rng, 3e-4, 0.6, 1e-4, 1e-3, (3,)),
        )
        for j in arm.joints
    )
    bodies = []
    for b in arm.bodies:
        factor = float(np.exp(0.03 * rng.standard_normal()))
        size = np.sqrt(np.trace(b.inertia_kg_m2) / b.mass_kg)
        com = b.com_m + 0.02 * size * rng.standard_normal(3)
        bodies.append(Body(b.mass_kg * factor, com, b.inertia_kg_m2 * factor))
    return replace(arm, joints=joints, bodies=tuple(bodies))


def _tool(arm: Arm, rng: np.random.Generator) -> Body:
    """Draw a tool that suits the arm: about a fifth of what the forearm and wrist weigh."""
    mass = 0.2 * sum(b.mass_kg for b in arm.bodies[2:]) * float(np.exp(0.2 * rng.standard_normal()))
    size = 0.03 + 0.03 * mass ** (1 / 3)
    com = np.array([0.25 * size * rng.standard_normal(), 0.25 * size * rng.standard_normal(), size])
    return Body(round(mass, 2), np.round(com, 4), 0.4 * mass * size**2 * np.eye(3))


def _targets(arm: Arm, rng: np.random.Generator) -> Array:
    """Place four targets (4, 3), m, in the flange frame: three round the axis and one ahead of them."""
    radius = 0.06 + 0.03 * np.linalg.norm(arm.joints[2].xyz_m) * np.exp(0.2 * rng.standard_normal()) * 2
    turn = rng.uniform(0, 2 * np.pi) + np.array([0.0, 2.0, 4.2])
    ring = np.stack([radius * np.cos(turn), radius * np.sin(turn), 0.08 + 0.3 * radius * rng.random(3)], axis=1)
    return np.round(np.vstack([ring, [0.4 * radius, -0.3 * radius, 0.12 + radius]]), 4)


def draw_robot(
    name: str,
    seed: int,
    *,
    compliance: bool = True,
    backlash: bool = True,
    clearance_range_rad: tuple[float, float] | None = None,
    mounting: str = "floor",
) -> Robot:
    """
    Build one individual robot.

    Parameters
    ----------
    name
        One of `ROBOTS`.
    seed
        Number of the individual. All that is drawn for it follows from name and seed.
    compliance, backlash
        Whether its drives yield and have clearances. Without, the hidden effects of these names start from nothing.
    clearance_range_rad
        Bounds of the clearances. By default 400–500 µrad for big6, and log-normal about 110 µrad (arm) and
        220 µrad (wrist) for the others.
    mounting
        "floor", "wall" (gravity along −x of the base) or "ceiling".

    Returns
    -------
    Robot
        The individual.
    """
    if name not in ARMS:
        raise ValueError(f"robot {name!r}: expected one of {', '.join(ROBOTS)}")
    if mounting not in _MOUNTINGS:
        raise ValueError(f"mounting {mounting!r}: expected one of {', '.join(_MOUNTINGS)}")
    nominal = ARMS[name]
    n, torque = nominal.n, nominal.max_torques()
    rng = stream(seed, f"robot {name}")
    arm = _as_built(nominal, rng)
    tool = _tool(nominal, rng)
    targets = _targets(nominal, rng)

    def log_normal(spread: float) -> Array:
        return np.asarray(np.exp(spread * rng.standard_normal(n)))

    wrist = np.arange(n) >= 3
    gap = np.where(wrist, 2.2e-4, 1.1e-4) * log_normal(0.4)
    if clearance_range_rad is None and name == "big6":
        clearance_range_rad = (4e-4, 5e-4)
    if clearance_range_rad is not None:
        low, high = clearance_range_rad
        gap = low + (high - low) * rng.beta(2.0, 2.0, n)
    yielding = 2.2e-3 / torque * log_normal(0.35)
    coulomb = 0.014 * torque * log_normal(0.35)
    viscous = 0.02 * torque * log_normal(0.35)
    stated_coulomb, stated_viscous = coulomb * log_normal(0.25), viscous / nominal.max_speeds() * log_normal(0.25)
    stated: Sequence[tuple[float, float]] = list(zip(stated_coulomb.tolist(), stated_viscous.tolist(), strict=True))
    return Robot(
        seed=seed,
        nominal=nominal,
        arm=arm,
        tool=tool,
        declared_tool=tool,
        targets_m=targets + signed_log_normal(rng, 4e-4, 0.5, 1e-4, 1.5e-3, targets.shape),
        nominal_targets_m=targets,
        gravity_m_s2=9.81 * np.array(_MOUNTINGS[mounting]),
        compliance_rad_Nm=yielding if compliance else np.zeros(n),
        clearance_rad=gap if backlash else np.zeros(n),
        coulomb_Nm=coulomb,
        viscous_Nm=viscous,
        stated_friction=tuple(stated),
        friction_law=str(rng.choice(["tanh", "dahl"])),
        rotor_kg_m2=0.03 * torque / nominal.max_speeds() * log_normal(0.3),
        torque_std_Nm=1.5e-3 * torque * log_normal(0.25),
        repeatability_rad=8e-6 * float(np.exp(0.3 * rng.standard_normal())),
        climate=Climate.draw(seed, n),
    )
