"""The second virtual world as the benchmark of hidden effects hides in it: its cases, its robots, its programs.

Robots, noises, programs, logs and mountings follow from the seed, so that twenty seeds in a row meet all of them in
many pairs. Sizes are what a refit of the standard model leaves, as in the first world; in torques of the motor with
the effect.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from hidden_cases import CLOSE, Case

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

MOUNTINGS = ("floor", "floor", "wall", "floor", "ceiling")
LARGEST = 10.0  # of this world's own sizes, which are those of real machines: nothing is hidden that is larger
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
    "time_lag": "time_lag",
    "ambient_torque": "ambient_torque_offset",
    "backlash": "backlash",
    "joint_compliance": "joint_compliance",
    "hardening_spring": "nonlinear_stiffness",
    "gear_eccentricity": "gear_eccentricity",
    "coupling_ratio_error": "coupling_ratio_error",
    "bearing_tilt": "bearing_tilt",
    "hysteresis": "lost_motion",
    "link_bending": "link_bending",
    "base_tilt": "base_tilt",
    "base_settling": "base_settling",
    "thermal_expansion": "thermal_expansion",
    "depth_scale": "instrument_axis_scale",
    "damaged_tooth": "local_angle_error",
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
    if effect.family is None and name not in IN_CATALOGUE
)


def _turn(names: Sequence[str], seed: int) -> str:
    """One of some names by seed: each in turn, and after each round one further, so that lists do not march in step."""
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
            "log": _turn(tuple(LOG_PROGRAMS), seed),
            "noise": _turn(tuple(NOISES), seed),
            "seed": seed,
        }
        self.setup: Mapping[str, str] = {"robot": name, "mounting": mounting} | {
            k: v for k, v in self.session.items() if k != "seed"
        }
        places = [HIDDEN[h].places(self.robot.n) for h in case.hidden]
        self._places = [_turn(p, seed) for p in places]

    @property
    def present(self) -> frozenset[str]:
        """Families that every robot of this world has, or this one: they are true where they are named."""
        return frozenset({"inertia"} | ({"hysteresis"} if self.robot.friction_law == "dahl" else set()))

    def places(self) -> list[str]:
        """Where each hidden effect sits."""
        return list(self._places)

    def depends_on(self) -> tuple[str, ...]:
        """The variables that what was hidden depends on."""
        return tuple(
            v for h, where in zip(self.case.hidden, self._places, strict=True) for v in HIDDEN[h].depends_on(where)
        )

    def magnitude(self, name: str, size: float) -> tuple[float, float]:
        """The magnitude that has a size, and the size that it has (less where it would be larger than any real one)."""
        where = self._places[self.case.hidden.index(name)]
        torque = _FIRST_TABLE[name] == "free_air"
        # This world's size is the rms over all motors: an effect of one motor shows on that one root n times as much.
        share = self.robot.n**-0.5 if torque and where not in OF_ALL_MOTORS else 1.0
        wanted = size * share
        found = magnitude_for(self.robot, name, where, wanted, beyond_standard=True, **self.session)
        m = min(found, LARGEST)
        table = _FIRST_TABLE[name]
        got = size_in_sigma(
            self.robot, [(name, where, m)], tables=[table], beyond_standard=True, **self.session
        )[table]
        return m, size if abs(got / wanted - 1) < CLOSE else got / share

    def campaign(self, magnitudes: Sequence[float]) -> Campaign:
        """A campaign on the robot with the case's effects in it."""
        tables = ("free_air",) if self.case.hidden and self.case.stage == "free_air" else _ALL
        hidden = list(zip(self.case.hidden, self._places, magnitudes, strict=True))
        measure(self.robot, self.folder, hidden=hidden, tables=tables, base_known=self.seed % 2 == 0, **self.session)
        return read_campaign(self.folder)


_ALL = ("free_air", "poses", "verification")
