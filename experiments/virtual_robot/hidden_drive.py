"""Effects between motor and joint: gaps, springs, gears."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from experiments.virtual_robot.description import Array
from experiments.virtual_robot.drive import compliance_matrix
from experiments.virtual_robot.plant import Plant
from experiments.virtual_robot.puts import Numbers, named, plus
from experiments.virtual_robot.sizes import Sight

SMALL_TURN = 1e-4  # rad, a change to measure sizes with


# If no weight loads a joint, friction winds up its spring like a gap: the three have equal columns, and none counts
# as absorbed by the others.
BY_DIRECTION = ("backlash", "joint_compliance", "wrist_coupling_friction")


def _own_compliance(plant: Plant, i: int) -> float:
    return float(compliance_matrix(plant.drive)[i, i])


def hide_backlash(plant: Plant, i: int, m: float, s: Sight, rng: np.random.Generator) -> tuple[Plant, Numbers]:
    """Widen the gap of a joint."""

    def wider(p: Plant, gap: float) -> Plant:
        return replace(p, drive=replace(p.drive, gap=plus(p.drive.gap, i, gap)))

    gap = m * SMALL_TURN * s.factor(lambda p: wider(p, SMALL_TURN), *BY_DIRECTION)
    return wider(plant, gap), {"gap_rad": gap}


def hide_reversal(plant: Plant, i: int, m: float, s: Sight, rng: np.random.Generator) -> tuple[Plant, Numbers]:
    """Let a joint stop short of its target on the side that it comes from, independent of its load."""

    def short(p: Plant, width: float) -> Plant:
        return replace(p, drive=replace(p.drive, reversal=plus(p.drive.reversal, i, width)))

    width = m * SMALL_TURN * s.factor(lambda p: short(p, SMALL_TURN), *BY_DIRECTION)
    return short(plant, width), {"width_rad": width}


def hide_compliance(plant: Plant, i: int, m: float, s: Sight, rng: np.random.Generator) -> tuple[Plant, Numbers]:
    """Make a joint softer; at least by a sixth, so that clamped sweeps show it where weight does not load the joint."""

    def softer(p: Plant, extra: float) -> Plant:
        drive = p.drive
        return replace(p, drive=replace(drive, extra_compliance=plus(drive.extra_compliance, i, extra)))

    own = _own_compliance(s.plant, i)
    extra = m * own * max(0.17, 0.01 * min(s.factor(lambda p: softer(p, 0.01 * own), *BY_DIRECTION), 100.0))
    return softer(plant, extra), {"compliance_rad_Nm": extra}


def hide_eccentricity(plant: Plant, i: int, m: float, s: Sight, rng: np.random.Generator) -> tuple[Plant, Numbers]:
    """Let a joint's angle err once and, less, twice per revolution, with random phases."""
    return _with_waves(plant, i, m, s, rng, "eccentricity", "q")


def hide_resolver(plant: Plant, i: int, m: float, s: Sight, rng: np.random.Generator) -> tuple[Plant, Numbers]:
    """Let a joint's angle err once and, less, twice per revolution of its motor, with random phases."""
    return _with_waves(plant, i, m, s, rng, "resolver", "motor")


def _with_waves(
    plant: Plant, i: int, m: float, s: Sight, rng: np.random.Generator, field: str, angle: str
) -> tuple[Plant, Numbers]:
    a, b = rng.uniform(0, 2 * np.pi, 2)
    shape = np.array([np.cos(a), np.sin(a), 0.6 * np.cos(b), 0.6 * np.sin(b)])

    def wavy(p: Plant, terms: Array) -> Plant:
        changed: dict[str, Any] = {field: plus(getattr(p.drive, field), i, terms)}
        return replace(p, drive=replace(p.drive, **changed))

    terms = m * SMALL_TURN * s.factor(lambda p: wavy(p, SMALL_TURN * shape)) * shape
    names = (f"sin_{angle}_rad", f"cos_{angle}_rad", f"sin_2{angle}_rad", f"cos_2{angle}_rad")
    return wavy(plant, terms), named(names, terms)


def hide_tooth(plant: Plant, i: int, m: float, s: Sight, rng: np.random.Generator) -> tuple[Plant, Numbers]:
    """Damage a tooth of a joint's last wheel: within 15 degrees the joint stands up to 0.8 mrad beside its angle."""
    height, width = m * 8e-4 * float(rng.choice([-1.0, 1.0])), float(np.deg2rad(15.0))
    middle = float(rng.uniform(-1.4, 1.4))  # where nearly every arm can go
    tooth = plant.drive.tooth.copy()
    tooth[i] = height, middle, width
    names = ("height_rad", "middle_rad", "width_rad")
    return replace(plant, drive=replace(plant.drive, tooth=tooth)), named(names, tooth[i])


def hide_disc(plant: Plant, i: int, m: float, s: Sight, rng: np.random.Generator) -> tuple[Plant, Numbers]:
    """Give all joints encoders with one and the same faulty disc, each turned and read from the side as it came."""
    return _with_discs(plant, m, s, rng, 1)


def hide_discs(plant: Plant, i: int, m: float, s: Sight, rng: np.random.Generator) -> tuple[Plant, Numbers]:
    """Give all joints encoders with faulty discs of which no two are alike."""
    return _with_discs(plant, m, s, rng, plant.n)


def _with_discs(plant: Plant, m: float, s: Sight, rng: np.random.Generator, kinds: int) -> tuple[Plant, Numbers]:
    """Faulty discs of one kind, or of as many as there are joints."""
    n, marks = plant.n, plant.drive.disc.shape[1]
    error = rng.normal(size=(kinds, marks))
    turn, sense = rng.uniform(0.0, 2 * np.pi, n), rng.choice([-1.0, 1.0], n)
    error -= error.mean(axis=1, keepdims=True)
    error /= np.sqrt(np.mean(error**2, axis=1, keepdims=True))

    def faulty(p: Plant, rms: float) -> Plant:
        discs = np.broadcast_to(rms * error, (n, marks))
        return replace(p, drive=replace(p.drive, disc=discs, disc_turn=turn, disc_sense=sense))

    rms = m * SMALL_TURN * s.factor(lambda p: faulty(p, SMALL_TURN))
    recorded = {"marks_rms_rad": rms, **{f"turn{j + 1}_rad": float(turn[j]) for j in range(n)}}
    return faulty(plant, rms), recorded | {f"sense{j + 1}_1": float(sense[j]) for j in range(n)}


def hide_ratio(plant: Plant, i: int, m: float, s: Sight, rng: np.random.Generator) -> tuple[Plant, Numbers]:
    """Make an entry of T wrong: of the wrist's coupling to the joint before, or else of the joint's own ratio."""
    T = s.plant.drive.transmission
    return _with_wrong_entry(plant, i - 1 if i > 0 and T[i - 1, i] != 0 else i, i, m, s)


def hide_distant_ratio(plant: Plant, i: int, m: float, s: Sight, rng: np.random.Generator) -> tuple[Plant, Numbers]:
    """Make the entry of T wrong by which the joint two before turns a joint."""
    if i < 2:
        raise ValueError(f"distant_coupling_error@joint{i + 1}: expected joint3 or a later one, with one two before it")
    return _with_wrong_entry(plant, i - 2, i, m, s)


def _with_wrong_entry(plant: Plant, j: int, i: int, m: float, s: Sight) -> tuple[Plant, Numbers]:
    T = s.plant.drive.transmission

    def wrong(p: Plant, error: float) -> Plant:
        new = p.drive.transmission.copy()
        new[j, i] += error * T[j, j]  # rad per rad of joint j
        return replace(p, drive=replace(p.drive, transmission=new))

    error = m * SMALL_TURN * s.factor(lambda p: wrong(p, SMALL_TURN))
    return wrong(plant, error), {f"joint{i + 1}_per_joint{j + 1}_rad_rad": error}


def hide_hardening(plant: Plant, i: int, m: float, s: Sight, rng: np.random.Generator) -> tuple[Plant, Numbers]:
    """Let a spring harden; at most so far that at 0.8 of the rated torque a tenth of its compliance is left."""
    cubic = min(0.25 * m, 0.45) * _own_compliance(s.plant, i) / (3 * (0.45 * float(s.plant.drive.rated[i])) ** 2)
    cubic = min(cubic, 0.9 * _own_compliance(s.plant, i) / (3 * (0.8 * float(s.plant.drive.rated[i])) ** 2))

    drive = replace(plant.drive, hardening=plus(plant.drive.hardening, i, cubic))
    return replace(plant, drive=drive), {"cubic_rad_Nm3": cubic}


def hide_soft(plant: Plant, i: int, m: float, s: Sight, rng: np.random.Generator) -> tuple[Plant, Numbers]:
    """Let a spring be soft below a tenth of the rated torque."""
    soft, below = min(0.4 * m, 2.0) * _own_compliance(s.plant, i), 0.1 * float(s.plant.drive.rated[i])
    thresholds = plant.drive.soft_torque.copy()
    thresholds[i] = below
    drive = replace(plant.drive, soft=plus(plant.drive.soft, i, soft), soft_torque=thresholds)
    return replace(plant, drive=drive), {"soft_rad_Nm": soft, "below_Nm": below}


def hide_hysteresis(plant: Plant, i: int, m: float, s: Sight, rng: np.random.Generator) -> tuple[Plant, Numbers]:
    """Let part of a spring slip, at three torques, the highest a fifth of the rated one."""
    share = min(0.25 * m, 0.8) * _own_compliance(s.plant, i) * np.array([0.5, 0.3, 0.2])
    limit = np.array([0.03, 0.08, 0.2]) * float(s.plant.drive.rated[i])
    thresholds = plant.drive.slip_torque.copy()
    thresholds[i] = limit
    drive = replace(plant.drive, slip=plus(plant.drive.slip, i, share), slip_torque=thresholds)
    return replace(plant, drive=drive), {
        **named(tuple(f"slip{k}_rad_Nm" for k in (1, 2, 3)), share),
        **named(tuple(f"limit{k}_Nm" for k in (1, 2, 3)), limit),
        "lost_motion_rad": float(2 * share @ limit),
    }


def hide_coupled_springs(plant: Plant, i: int, m: float, s: Sight, rng: np.random.Generator) -> tuple[Plant, Numbers]:
    """Couple the spring of a motor with that of the motor before it (the first: with the second)."""
    j = i - 1 if i else min(1, plant.n - 1)
    value = min(0.2 * m, 0.8) / float(np.sqrt(plant.drive.spring[i] * plant.drive.spring[j]))
    coupling = plant.drive.coupling.copy()
    coupling[[i, j], [j, i]] += value
    name = f"motor{min(i, j) + 1}_motor{max(i, j) + 1}_rad_Nm"
    return replace(plant, drive=replace(plant.drive, coupling=coupling)), {name: value}
