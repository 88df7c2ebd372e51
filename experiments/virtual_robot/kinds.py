"""The kinds of hidden effects: each sets a few true numbers of the plant that are zero in a baseline robot.

Default sizes make an effect clearly visible. In points the residual of a fit of the standard model (`sizes.Sight`) is
`sizes.VISIBLE` times the instrument's noise. In torques the effect is about one to three times the noise.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from experiments.virtual_robot.bodies import Bodies
from experiments.virtual_robot.description import Array
from experiments.virtual_robot.hidden_drive import (
    hide_backlash,
    hide_compliance,
    hide_coupled_springs,
    hide_disc,
    hide_discs,
    hide_distant_ratio,
    hide_eccentricity,
    hide_hardening,
    hide_hysteresis,
    hide_ratio,
    hide_resolver,
    hide_reversal,
    hide_soft,
    hide_tooth,
)
from experiments.virtual_robot.hidden_elsewhere import (
    hide_balancer,
    hide_base_tilt,
    hide_bearing_tilt,
    hide_bending,
    hide_dress_pack,
    hide_expansion,
    hide_fixture,
    hide_outside,
    hide_payload,
    hide_scale,
    hide_settling,
    hide_slip,
)
from experiments.virtual_robot.hidden_friction import (
    hide_creep,
    hide_friction,
    hide_lag,
    hide_poles,
    hide_ripple,
    hide_stribeck,
)
from experiments.virtual_robot.outside import OUTSIDE_KINDS
from experiments.virtual_robot.plant import Plant
from experiments.virtual_robot.puts import Put

POSES = ("poses", "verification")
TORQUES = ("free_air", "wrist", "clamped")
EVERYWHERE = TORQUES + POSES
Places = Callable[[Plant], list[int]]


def _any(plant: Plant) -> list[int]:
    return list(range(plant.n))


def _postures(plant: Plant) -> Array:
    return np.random.default_rng(2).uniform(-1.5, 1.5, (50, plant.n))


def _loaded(plant: Plant) -> list[int]:
    """Joints on which the weight of the arm changes with posture."""
    q = _postures(plant)
    spread: Array = np.std(Bodies(plant.geometry, plant.masses).gravity(q), axis=0)
    return [int(i) for i in np.flatnonzero(spread > 0.02 * max(float(spread.max()), 1e-9))] or _any(plant)


def _inner(plant: Plant) -> list[int]:
    return list(range(min(3, plant.n)))


def _inner_loaded(plant: Plant) -> list[int]:
    return [i for i in _loaded(plant) if i < 3] or _inner(plant)


def _wrist(plant: Plant) -> list[int]:
    return list(range(min(3, plant.n - 1), plant.n))


def _last(plant: Plant) -> list[int]:
    return [plant.n - 1]


def _tilted(plant: Plant) -> list[int]:
    """Joints whose bearings the weight of the arm would tilt: across their axes it is heavy."""
    moment = Bodies(plant.geometry, plant.masses).wrenches(_postures(plant)).moment
    axes = plant.geometry.axes
    across = moment - np.einsum("nij,ij->ni", moment, axes)[..., None] * axes
    rms: Array = np.sqrt(np.mean(np.sum(across**2, axis=2), axis=0))
    return [int(i) for i in np.flatnonzero(rms > 0.1 * rms.max())]


def _second(plant: Plant) -> list[int]:
    return [min(1, plant.n - 1)]


def _long(plant: Plant) -> list[int]:
    length = np.linalg.norm(plant.geometry.link_vectors, axis=1)
    return [int(i) for i in np.flatnonzero(length > 0.4 * length.max())]


def _beams(plant: Plant) -> list[int]:
    return [i for i in _long(plant) if 0 < i < min(3, plant.n - 1)] or [0]


@dataclass(frozen=True)
class Kind:
    """One kind of effect.

    Attributes
    ----------
    put
        Puts it into a plant.
    noun
        ``joint`` or ``link``, which are numbered, or the only place that there is.
    tables
        The tables that it visibly changes.
    places
        Joints or links, from 0, among which it is drawn where none is named.
    """

    put: Put
    noun: str
    tables: tuple[str, ...]
    places: Places = _any

    @property
    def numbered(self) -> bool:
        """Whether the place has a number."""
        return self.noun in ("joint", "link")

    @property
    def wanted(self) -> str:
        """The places that may be named."""
        return f"{self.noun}1, {self.noun}2, …" if self.numbered else self.noun

    def accepts(self, where: str) -> bool:
        """Whether a place has the right form."""
        if self.numbered:
            return where.startswith(self.noun) and where.removeprefix(self.noun).isdigit()
        return where == self.noun


_FRICTION: dict[str, tuple[str, str, Callable[[Plant, int], float], tuple[str, ...], Places]] = {
    "torque_offset": ("offset", "Nm", lambda p, i: 2.0 * float(p.instrument.torque_sigma[i]), TORQUES, _any),
    "torque_gain": ("gain", "1", lambda p, i: 0.03, TORQUES, _inner_loaded),
    "asymmetric_friction": ("asymmetry", "Nm", lambda p, i: 0.3 * float(p.friction.coulomb[i]), TORQUES, _any),
    "load_dependent_friction": ("load", "1", lambda p, i: 0.06, TORQUES, _loaded),
    "temperature_dependent_friction": ("thermal", "1_K", lambda p, i: 0.04, TORQUES, _any),
    "wrist_coupling_friction": ("arm", "Nm", lambda p, i: 0.02 * float(p.drive.rated[i]), EVERYWHERE, _wrist),
}

KINDS: dict[str, Kind] = {
    "backlash": Kind(hide_backlash, "joint", ("clamped", *POSES), _inner),
    "lost_motion": Kind(hide_reversal, "joint", POSES, _loaded),
    "joint_compliance": Kind(hide_compliance, "joint", ("clamped", *POSES), _loaded),
    "gear_eccentricity": Kind(hide_eccentricity, "joint", POSES),
    "motor_eccentricity": Kind(hide_resolver, "joint", ("clamped", *POSES), _inner),
    "encoder_disc": Kind(hide_disc, "joints", POSES),
    "different_encoder_discs": Kind(hide_discs, "joints", POSES),
    "damaged_tooth": Kind(hide_tooth, "joint", POSES, _inner),
    "thermal_expansion": Kind(hide_expansion, "link", POSES, _long),
    "payload": Kind(hide_payload, "tool", EVERYWHERE),
    "stribeck_friction": Kind(hide_stribeck, "joint", TORQUES),
    "presliding_friction": Kind(hide_creep, "joint", ("free_air", "wrist")),
    "fixture_compliance": Kind(hide_fixture, "fixture", ("clamped",)),
    "base_tilt": Kind(hide_base_tilt, "base", POSES),
    "base_settling": Kind(hide_settling, "base", POSES),
    "instrument_scale": Kind(hide_scale, "instrument", POSES),
    "bearing_tilt": Kind(hide_bearing_tilt, "joint", POSES, _tilted),
    "link_bending": Kind(hide_bending, "link", POSES, _beams),
    "coupling_ratio_error": Kind(hide_ratio, "joint", POSES, _wrist),
    "distant_coupling_error": Kind(hide_distant_ratio, "joint", POSES, _last),
    "nonlinear_stiffness": Kind(hide_hardening, "joint", ("clamped", *POSES), _inner_loaded),
    "soft_near_zero": Kind(hide_soft, "joint", ("clamped", *POSES), _inner_loaded),
    "fixture_shift": Kind(hide_slip, "fixture", ("clamped",)),
    "hysteresis": Kind(hide_hysteresis, "joint", ("clamped", *POSES), _loaded),
    "torque_ripple": Kind(hide_ripple, "joint", TORQUES),
    "higher_torque_ripple": Kind(hide_poles, "joint", TORQUES),
    "dress_pack": Kind(hide_dress_pack, "joint", EVERYWHERE, _wrist),
    "gravity_compensator": Kind(hide_balancer, "joint", EVERYWHERE, _second),
    "cross_coupled_stiffness": Kind(hide_coupled_springs, "joint", ("clamped", *POSES), _wrist),
    "time_lag": Kind(hide_lag, "clock", ("free_air", "wrist")),
}
KINDS |= {
    name: Kind(hide_friction(field, unit, value), "joint", tables, places)
    for name, (field, unit, value, tables, places) in _FRICTION.items()
}
KINDS |= {
    name: Kind(
        hide_outside(name),
        f"joint{joint + 1}" if unit != "m" else "point",
        TORQUES if unit == "Nm" else POSES,
    )
    for name, (joint, unit, _) in OUTSIDE_KINDS.items()
}
