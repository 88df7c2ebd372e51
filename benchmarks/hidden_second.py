"""The second virtual world in the benchmark of hidden effects: its cases, robots and programs.

Robots, noises, programs, logs and mountings follow from the seed, so that twenty seeds in a row meet all of them in
many pairs. Sizes are what a refit of the standard model leaves, as in the first world; in torques of the motor with
the effect.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from hidden_cases import Case

from experiments.campaign import Campaign, read_campaign
from experiments.second_world import (
    HIDDEN,
    LOG_PROGRAMS,
    NOISES,
    POSE_PROGRAMS,
    ROBOTS,
    draw_robot,
    magnitude_for,
    measure,
    size_in_sigma,
)
from experiments.second_world.sizing import NOTHING

MOUNTINGS = ("floor", "floor", "wall", "floor", "ceiling")
LARGEST = 5.0  # of this world's own sizes, which are those of real machines: nothing is hidden that is larger
LOGS = tuple(name for name in LOG_PROGRAMS if name != "fourier_1khz")  # a verdict on it takes minutes
SHOWN = 0.5  # of the size asked for: what stays below is left out of the counts
OF_ALL_MOTORS = ("all",)  # places of effects that all motors show

IN_CATALOGUE: Mapping[str, str] = {
    "asymmetric_friction": "asymmetric_friction",
    "stribeck_friction": "stribeck_friction",
    "power_viscous_friction": "quadratic_friction",
    "load_dependent_friction": "load_dependent_friction",
    "temperature_dependent_friction": "temperature_dependent_friction",
    "warm_up_friction": "warm_up_friction",
    "torque_ripple": "torque_ripple",
    "dress_pack": "dress_pack",
    "gravity_compensator": "gravity_compensator",
    "torque_offset": "torque_offset",
    "torque_gain": "torque_gain",
    "time_lag": "time_lag",
    "ambient_torque": "ambient_torque_offset",
    "backlash": "backlash",
    "joint_compliance": "joint_compliance",
    "hardening_spring": "nonlinear_stiffness",
    "gear_eccentricity": "gear_eccentricity",
    "coupling_ratio_error": "coupling_ratio_error",
    "bearing_tilt": "bearing_tilt",
    "link_bending": "link_bending",
    "base_tilt": "base_tilt",
    "base_settling": "base_settling",
    "thermal_expansion": "thermal_expansion",
    "depth_scale": "instrument_axis_scale",
    "damaged_tooth": "local_angle_error",
    "hysteresis": "presliding_lost_motion",
}
"""The catalogue's name for each; a tool other than declared is absorbed by the standard set and is not among them."""

_FIRST_TABLE = {name: effect.tables[0] for name, effect in HIDDEN.items()}
_STAGE_OF = {"poses": "poses", "free_air": "free_air"}
SECOND_FAMILIES: tuple[Case, ...] = tuple(
    Case(_STAGE_OF[_FIRST_TABLE[name]], (name,), (effect,))  # type: ignore[arg-type]
    for name, effect in IN_CATALOGUE.items()
)
SECOND_OUTSIDE: tuple[Case, ...] = tuple(
    Case(_STAGE_OF[_FIRST_TABLE[name]], (name,), depends_on=effect.depends_on(effect.places(6)[0]))  # type: ignore[arg-type]
    for name, effect in HIDDEN.items()
    if name not in (*IN_CATALOGUE, "payload")
)


def _turn(names: Sequence[str], seed: int) -> str:
    """One of some names by seed: each in turn, and after each round one further.

    Lists of different lengths thus do not go in step. Those of one length do: each log always has the same noise.
    """
    return names[(seed + seed // len(names)) % len(names)]


class SecondBench:
    """One robot of the second world by seed, with the programs and the noise of that seed."""

    def __init__(self, case: Case, seed: int, poses: int, folder: Path) -> None:
        self.case, self.seed, self.folder = case, seed, folder
        name, mounting = ROBOTS[seed % len(ROBOTS)], _turn(MOUNTINGS, seed // len(ROBOTS))
        lacks = case.hidden[0] if case.lacking else ""
        self.robot = draw_robot(
            name, seed, mounting=mounting, compliance=lacks != "joint_compliance", backlash=lacks != "backlash"
        )
        self.session: dict[str, Any] = {
            "program": _turn(tuple(POSE_PROGRAMS), seed),
            "log": _turn(LOGS, seed),
            "noise": _turn(tuple(NOISES), seed),
            "seed": seed,
        }
        self.setup: Mapping[str, str] = {"robot": name, "mounting": mounting} | {
            k: v for k, v in self.session.items() if k != "seed"
        }
        self._places = [_turn(HIDDEN[h].places(self.robot.n), seed) for h in case.hidden]

    @property
    def present(self) -> frozenset[str]:
        """Effects that every robot of this world has, or this one: they are true where they are named.

        The axes of each arm as built are tilted: the first one by 0.15 to 1.4 mrad, which is what `base_inclination`
        states, and the others less, which is what `axis_misalignment` states.
        """
        always = {"inertia", "link_inertia", "unsprung_friction", "base_inclination", "axis_misalignment"}
        return frozenset(always | ({"presliding_friction"} if self.robot.friction_law == "dahl" else set()))

    def places(self) -> list[str]:
        """Where each hidden effect sits."""
        return list(self._places)

    def depends_on(self) -> tuple[str, ...]:
        """The variables that what was hidden depends on."""
        return tuple(
            v for h, where in zip(self.case.hidden, self._places, strict=True) for v in HIDDEN[h].depends_on(where)
        )

    def magnitude(self, name: str, size: float) -> tuple[float, float]:
        """The magnitude that has a size, and the size that it has (less where it would be larger than any real one).

        Where the effect shows too little at the place that is its turn, it sits at the next one.

        Raises
        ------
        ValueError
            It shows at no place.
        """
        k = self.case.hidden.index(name)
        places = HIDDEN[name].places(self.robot.n)
        first = places.index(self._places[k])
        best = (LARGEST, 0.0)
        for where in (*places[first:], *places[:first]):
            found = self._magnitude_at(name, where, size)
            if found[1] > best[1]:
                best, self._places[k] = found, where
            if best[1] >= SHOWN * size:
                return best
        if best[1] < NOTHING:
            raise ValueError(f"{name}: it changes nothing in {_FIRST_TABLE[name]} of this robot and program")
        return best

    def _magnitude_at(self, name: str, where: str, size: float) -> tuple[float, float]:
        """The same at one place."""
        table = _FIRST_TABLE[name]
        # This world's size is the rms over all motors: an effect of one motor shows on that one root n times as much.
        share = self.robot.n**-0.5 if table == "free_air" and where not in OF_ALL_MOTORS else 1.0
        hidden = [(name, where, LARGEST)]
        most = size_in_sigma(self.robot, hidden, tables=[table], beyond_standard=True, **self.session)[table] / share
        if most <= size:
            return LARGEST, most
        return magnitude_for(self.robot, name, where, size * share, beyond_standard=True, **self.session), size

    def campaign(self, magnitudes: Sequence[float]) -> Campaign:
        """A campaign on the robot with the case's effects in it."""
        tables = ("free_air",) if self.case.hidden and self.case.stage == "free_air" else _ALL
        hidden = list(zip(self.case.hidden, self._places, magnitudes, strict=True))
        measure(self.robot, self.folder, hidden=hidden, tables=tables, base_known=self.seed % 2 == 0, **self.session)
        return read_campaign(self.folder)


_ALL = ("free_air", "poses", "verification")
