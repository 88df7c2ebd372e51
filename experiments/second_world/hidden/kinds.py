"""The kinds of hidden effects: places, variables, and the laws that they add to a robot."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from experiments.second_world.arrays import Array
from experiments.second_world.chain import Bend
from experiments.second_world.individual import Robot
from experiments.second_world.instrument import Instrument
from experiments.second_world.states import BendLaw, PoseState, ReadingLaw, TorqueLaw

__all__ = [
    "Active",
    "HiddenEffect",
    "Parameter",
    "Places",
    "Setting",
    "angle_law",
    "everywhere",
    "fixed",
    "joints",
    "pairs",
]


@dataclass(frozen=True)
class Parameter:
    """A true value of a hidden effect."""

    name: str
    value: float
    unit: str


@dataclass(frozen=True)
class Active:
    """A hidden effect in force: its true values, and the laws by which it acts."""

    parameters: tuple[Parameter, ...]
    bend: BendLaw | None = None
    reading: ReadingLaw | None = None
    torque: TorqueLaw | None = None
    alter: Callable[[Robot], Robot] | None = None  # the robot differs from what its maker or its user declares
    lag_s: float = 0.0  # torques are logged that much late
    gain: tuple[int, float] | None = None  # index of a joint, and the factor of its logged torques


@dataclass(frozen=True)
class Setting:
    """What a hidden effect is built from."""

    robot: Robot
    where: str
    magnitude: float  # factor on the default size
    rng: np.random.Generator
    visited_rad: Array  # (P, n) postures of the pose programme; (0, n) where there is none
    instrument: Instrument

    def index(self, part: int = 0) -> int:
        """Index from 0 of a joint or link in `where`: `joint2+joint3` has two parts."""
        return int("".join(c for c in self.where.split("+")[part] if c.isdigit())) - 1

    def typical_rad(self, joint: int, quantile: float = 0.5) -> float:
        """An angle that the joint visits, rad; the middle of its range where there are no poses."""
        if len(self.visited_rad):
            return float(np.quantile(self.visited_rad[:, joint], quantile))
        return float(np.clip(self.robot.nominal.limits(), -2.6, 2.6)[:, joint].mean())


Places = Callable[[int], tuple[str, ...]]  # number of joints -> values of `where`, the default first


@dataclass(frozen=True)
class HiddenEffect:
    """A hidden effect as a benchmark chooses it."""

    name: str
    family: str | None  # of CAMPAIGN_FORMAT.md; None: outside any library
    tables: tuple[str, ...]  # "poses" (with it "verification") and "free_air"
    places: Places
    build: Callable[[Setting], Active]
    depends_on: Callable[[str], tuple[str, ...]]


def joints(*numbers: int) -> Places:
    """Places at joints, the default first; those beyond the arm's last are left out."""
    return lambda n: tuple(f"joint{i}" for i in numbers if i <= n)


def fixed(*places: str) -> Places:
    """Places that every arm has."""
    return lambda n: places


def pairs(*numbers: tuple[int, int]) -> Places:
    """Places at two joints."""
    return lambda n: tuple(f"joint{i}+joint{k}" for i, k in numbers)


def everywhere(first: int) -> Places:
    """Any joint, by default this one."""
    return lambda n: tuple(f"joint{i}" for i in (first, *(k for k in range(1, n + 1) if k != first)))


def angle_law(joint: int, error_rad: Callable[[PoseState], Array]) -> BendLaw:
    """Law that adds an error (N,) to one joint's angle."""

    def law(state: PoseState) -> Bend:
        bend = Bend.none(*state.visits.q.shape)
        bend.angle_rad[:, joint] = error_rad(state)
        return bend

    return law
