"""What the benchmark of hidden effects hides, in which stage it must be found, and how large it is made.

A size is the rms of what the start model leaves of an effect, in units of the noise (all of it, as the fit of a robot
without the effect finds it): in poses over all coordinates, in torques of the motor that shows it most. The magnitude
that gives it is found seed by seed from noise-free measurements with and without the effect.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from clampid.effect import Stage
from clampid.fitting.solve import Estimate
from clampid.identification.identify import identify, standard_effects
from clampid.identification.model_on_campaign import on_campaign
from clampid.models.model import Model
from experiments.campaign import Campaign, read_campaign
from experiments.simulate import hidden_file, simulate
from experiments.virtual_robot import Hidden, Measured, Plant, measure
from kinematics.description import load_robot

ROBOT = "kuka_kr20_r1810"
TORQUES, POSES = ("free_air", "wrist"), ("poses", "verification")
TABLES: Mapping[Stage, tuple[str, ...]] = {"free_air": TORQUES, "clamped": ("clamped",), "poses": (*TORQUES, *POSES)}
LARGEST = 100.0  # of the virtual robot's own sizes: nothing is hidden that is larger
CLOSE, STEPS = 0.03, 4  # a size is met to 3 %, or as well as four steps of the secant reach

Alter = Callable[[Plant, float], Plant]


def _gaps(plant: Plant, factor: float) -> Plant:
    return replace(plant, drive=replace(plant.drive, gap=factor * plant.drive.gap))


def _springs(plant: Plant, factor: float) -> Plant:
    # Stiff beyond measure stands for none: a drive without any spring has no torque.
    return replace(plant, drive=replace(plant.drive, spring=plant.drive.spring / max(factor, 1e-6)))


def _arm_friction(plant: Plant, factor: float) -> Plant:
    return replace(plant, friction=replace(plant.friction, arm=factor * plant.friction.arm))


LACKING: Mapping[str, Alter] = {
    "backlash": _gaps,
    "joint_compliance": _springs,
    "wrist_coupling_friction": _arm_friction,
}
"""Effects that every robot and the standard set have: missing where the start model leaves them out, at all joints."""


@dataclass(frozen=True)
class Case:
    """One or several effects, or none, and the stage in which they must be found.

    Attributes
    ----------
    hidden
        Names of the virtual robot.
    effects
        Names of the catalogue, by which they must be called.
    depends_on
        Of an effect outside the library, the variables of which at least one must be named.
    """

    stage: Stage
    hidden: tuple[str, ...]
    effects: tuple[str, ...] = ()
    depends_on: tuple[str, ...] = ()

    @property
    def label(self) -> str:
        return f"{'+'.join(self.hidden)}/{self.stage}"

    @property
    def names(self) -> tuple[str, ...]:
        return self.effects or self.hidden

    @property
    def lacking(self) -> bool:
        return len(self.hidden) == 1 and self.hidden[0] in LACKING


FAMILIES: tuple[Case, ...] = (
    *(
        Case("free_air", (name,))
        for name in (
            "stribeck_friction", "asymmetric_friction", "load_dependent_friction", "temperature_dependent_friction",
            "torque_ripple", "dress_pack", "torque_offset", "torque_gain", "gravity_compensator", "time_lag", "payload",
            "wrist_coupling_friction",
        )
    ),
    *(
        Case("clamped", (name,))
        for name in (
            "fixture_compliance", "nonlinear_stiffness", "hysteresis", "cross_coupled_stiffness", "backlash",
            "joint_compliance",
        )
    ),
    *(
        Case("poses", (name,))
        for name in (
            "gear_eccentricity", "thermal_expansion", "base_tilt", "bearing_tilt", "link_bending",
            "coupling_ratio_error", "backlash", "joint_compliance", "instrument_scale",
        )
    ),
    Case("poses", ("encoder_disc",), ("joint_angle_curve",)),
)  # fmt: skip

NOTHING = Case("poses", ())

OUTSIDE: tuple[Case, ...] = (
    Case("poses", ("outside_q4_direction",), depends_on=("q4", "dir4")),
    Case("poses", ("outside_third_harmonic",), depends_on=("q3",)),
    Case("poses", ("outside_saturating_sag",), depends_on=("q2", "q3", "tau2", "tau3", "x", "y")),
    Case("poses", ("outside_posture_product",), depends_on=("q1", "q5")),
    Case("free_air", ("outside_torque_wave",), depends_on=("q1",)),
)

SEVERAL: tuple[Case, ...] = (
    Case("poses", ("gear_eccentricity", "thermal_expansion")),
    Case("poses", ("base_tilt", "gear_eccentricity")),
    Case("poses", ("link_bending", "coupling_ratio_error")),
    Case("free_air", ("stribeck_friction", "torque_ripple")),
    Case("free_air", ("load_dependent_friction", "temperature_dependent_friction")),
    Case("poses", ("gear_eccentricity", "thermal_expansion", "base_tilt")),
    Case("free_air", ("stribeck_friction", "torque_ripple", "dress_pack")),
)


def start_model(case: Case, campaign: Campaign) -> Model:
    """The standard set, without what is to be missing."""
    wanted = {
        stage: [t.effect for t in terms if not (case.lacking and stage == case.stage and t.effect == case.hidden[0])]
        for stage, terms in standard_effects([campaign]).items()
    }
    return identify(campaign, wanted)


_WITHOUT: dict[tuple[Stage, str, int, int], tuple[Estimate, Measured]] = {}
"""The last robot without an effect: cases of one stage and seed share it."""


class Bench:
    """One virtual robot of a seed, and how large effects of some magnitude are on it."""

    present: frozenset[str] = frozenset()  # effects that it has without being asked, beyond the start model

    def __init__(self, case: Case, seed: int, poses: int, folder: Path) -> None:
        self.case, self.seed, self.poses, self.folder = case, seed, poses, folder
        self.setup: Mapping[str, str] = {"robot": ROBOT}

    def places(self) -> list[str]:
        """Where each hidden effect of the last campaign sits; empty where it sits everywhere."""
        if self.case.lacking:
            return [""]
        told: list[dict[str, Any]] = json.loads(hidden_file(self.folder).read_text())
        return [str(h["where"]) for h in told]

    def depends_on(self) -> tuple[str, ...]:
        """The variables that what was hidden depends on."""
        return self.case.depends_on

    def _alter(self, magnitude: float) -> Callable[[Plant], Plant]:
        if not self.case.lacking:
            return lambda plant: plant
        change = LACKING[self.case.hidden[0]]
        return lambda plant: change(plant, magnitude)

    def measured(self, name: str, magnitude: float) -> Measured:
        """What the robot's instruments would read, with the noise-free truth."""
        hidden = [Hidden(name, None, magnitude)] if magnitude and not self.case.lacking else []
        return measure(
            load_robot(ROBOT),
            hidden,
            seed=self.seed,
            poses=self.poses,
            tables=[t for t in TABLES[self.case.stage] if t != "verification"],
            alter=self._alter(magnitude),
        )

    def campaign(self, magnitudes: Sequence[float]) -> Campaign:
        """A campaign on the robot with the case's effects in it; all tables where the case has none."""
        if not self.case.hidden:
            simulate(self.folder, seed=self.seed, poses=self.poses)
            return read_campaign(self.folder)
        hidden = [Hidden(n, None, m) for n, m in zip(self.case.hidden, magnitudes, strict=True) if m]
        alter = self._alter(magnitudes[0] if magnitudes else 0.0)
        simulate(
            self.folder,
            ROBOT,
            [] if self.case.lacking else hidden,
            seed=self.seed,
            poses=self.poses,
            tables=TABLES[self.case.stage],
            alter=alter,
            overwrite=True,
        )
        return read_campaign(self.folder)

    @cached_property
    def _without(self) -> tuple[Estimate, Measured]:
        """The start model's fit of the robot without the effect, and that robot's noise-free truth."""
        what = self.case.hidden[0] if self.case.lacking else ""
        key = (self.case.stage, what, self.seed, self.poses)
        if key not in _WITHOUT:
            _WITHOUT.clear()
            campaign = self.campaign([0.0] * len(self.case.hidden))
            estimate = on_campaign(start_model(self.case, campaign), campaign).refit(self.case.stage).estimate
            _WITHOUT[key] = estimate, self.measured(self.case.hidden[0], 0.0)
        return _WITHOUT[key]

    def size(self, name: str, magnitude: float) -> float:
        """The rms that the start model leaves of an effect, in units of the noise."""
        clean, without = self._without
        rows, truth = clean.problem.rows, (without.truth, self.measured(name, magnitude).truth)
        change = np.zeros_like(rows.measured)
        for table in np.unique(rows.table):
            mine = rows.table == table
            difference = truth[1].noise_free[table] - truth[0].noise_free[table]
            change[mine, : difference.shape[1]] = difference[rows.row[mine] - 1]
        relative = left_of(clean, change) / clean.noise.sigma
        used = rows.used & np.isfinite(relative)
        squares = np.where(used, relative, 0.0) ** 2
        if rows.stage == "poses":
            return float(np.sqrt(squares[:, :3].sum() / used[:, :3].sum()))
        return float(np.sqrt(np.max(squares.sum(axis=0) / np.maximum(used.sum(axis=0), 1))))

    def magnitude(self, name: str, size: float) -> tuple[float, float]:
        """The magnitude that has a size, and the size that it has (less where an effect cannot be so large)."""
        m, found = 1.0, self.size(name, 1.0)
        best = (m, found)
        for _ in range(STEPS):
            if abs(found / size - 1) < CLOSE or found < 1e-6:
                break
            # Sizes grow at most linearly; one that no longer grows has met a limit of the physics.
            m = min(m * float(np.clip(size / found, 0.02, 10.0)), LARGEST)
            found = self.size(name, m)
            if abs(found - size) < abs(best[1] - size):
                best = (m, found)
            elif found > 0 and abs(found - best[1]) < CLOSE * best[1]:
                break
        return best


def left_of(estimate: Estimate, change: np.ndarray) -> np.ndarray:
    """What a fit leaves of a change ``(N, m)`` of its measurements, to first order."""
    _, jacobian = estimate.problem.residual(estimate.theta)
    white = estimate.noise.whiten(estimate.problem.rows, change, jacobian)
    size = estimate.problem.sizes()
    values, vectors = np.linalg.eigh(estimate.prior_precision * np.outer(size, size))
    root = np.sqrt(np.maximum(values, 0.0))[:, None] * vectors.T
    # By the rows themselves: in normal equations what geometry hardly tells, as of a scale, looks as if it were left.
    A = np.vstack([white.jacobian * size, root])
    step = size * np.linalg.lstsq(A, np.r_[white.residual, np.zeros(len(root))], rcond=None)[0]
    return np.asarray(change - jacobian @ step)
