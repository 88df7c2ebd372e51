"""How many further poses part two confusable effects: those that ``clampid run --adaptive`` takes, against random ones.

    python benchmarks/adaptive_parting.py [--seeds 20] [--first 0] [--pair wrist|arm]

Two pairs. `wrist`: the forearm up to the wrist grows with its temperature, or with the time since switch-on. `arm`:
joint 2 yields, or link 2 bends. Which of the two is true alternates with the seed. A virtual robot measures 30 poses
first, and ten more at a time until the suite itself says that the two explain the same: before, there is nothing to
part. Robots of which it never says so are left out, and counted.

Adaptive: `clampid.loop.separating.Separating.next` gets the campaign so far and nothing else. It does not know the
pair, and what it spends on other pairs counts: it chooses for all open pairs together, and decides itself whether the
robot rests first. What it proposes is measured in the order of the plan, after a rest where it asks for a cold robot;
then it is asked again. From the same state the same robot measures random poses of the same limits instead; for the
pair `wrist` each batch of five is measured warm, or after a rest, by the toss of a coin.

Parted: the fit with the true effect is likelier than the fit with the other one by `SAME` (odds of e^10), in all rows
so far, looked at after every fifth pose. Counted are the further poses until then, to one. At `MOST` poses it ends, and
where adaptive measures nothing more while the pair is not parted: the count is `MOST`.
"""

from __future__ import annotations

import argparse
import copy
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from types import MappingProxyType
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
import numpy.typing as npt
import pandas as pd

from clampid.diagnosis.diagnose import diagnose
from clampid.diagnosis.next_measurement import COOLING, SAME
from clampid.diagnosis.pools import cell_of as cell_of_campaign
from clampid.identification.fitted_stage import FittedStage
from clampid.identification.identify import identify
from clampid.identification.model_on_campaign import on_campaign
from clampid.loop.adaptive import rested
from clampid.loop.confusable import confusable_pairs, evidence_apart
from clampid.loop.separating import Separating
from clampid.planning.sampling import configurations
from clampid.planning.scene import Scene
from clampid.slots import Term
from experiments.campaign import Campaign
from experiments.plans import cell_of, limits_of
from experiments.plans.limits import course_of
from experiments.simulate import declared_campaign
from experiments.virtual_robot import Hidden, Session
from experiments.virtual_robot.heat import History, Temperatures
from experiments.virtual_robot.session import BRISK
from kinematics.description import load_robot

Array = npt.NDArray[np.float64]
ROBOT = "kuka_kr20_r1810"
MOST = 120
LONGEST_START = 60  # poses
BATCH = 5
RANDOM_POSES = 200
APPROACH = 0.05  # rad
HOUR = 3600.0
MIDDLE = np.array([-1.2, 1.5])  # rad, of the narrow ranges of joints 2 and 3


@dataclass(frozen=True)
class Pair:
    """Two effects that look alike, and the campaign in which they do.

    Attributes
    ----------
    names
        Of the effects, with their places.
    model
        What is fitted besides, by name.
    start
        Least number of poses.
    narrow
        rad, half the range of joints 2 and 3 that the plan lets them have, first and further poses alike; None: all.
    pause
        s between them, in which all joints swing.
    """

    names: tuple[str, str]
    model: tuple[str, ...]
    start: int
    narrow: float | None
    pause: float


OTHERS = tuple(f"joint_compliance@joint{j}" for j in (1, 3, 4, 5, 6))
DRAG = ("backlash", "wrist_coupling_friction@joint4", "wrist_coupling_friction@joint5")
PAIRS = {
    "wrist": Pair(
        ("thermal_expansion@link4", "warm_up_expansion@link4"),
        ("geometry", "joint_compliance", *DRAG),
        30,
        None,
        120.0,
    ),
    "arm": Pair(("joint_compliance@joint2", "link_bending@link2"), ("geometry", *OTHERS, *DRAG), 30, 0.6, 0.0),
}
GROWTH = 4e-5  # 1/K, of the forearm up to the wrist
LINK = 3
WARM = 10.0, HOUR  # K and s, of a link that grows with time
SIZE = 1.0  # of the virtual robot's usual size


class _OfTime:
    """Temperatures whose link `LINK` follows the clock for those who ask first, and is as it is for the sensors."""

    def __init__(self, true: History) -> None:
        self.true, self.asked = true, False

    def at(self, time: Array) -> Temperatures:
        found = self.true.at(time)
        if self.asked:
            return found
        self.asked = True
        link = found.link.copy()
        link[:, LINK] = self.true.link[0, LINK] + WARM[0] * (1 - np.exp(-np.asarray(time) / WARM[1]))
        return replace(found, link=link)


class _ByTime(Session):
    def _history(self) -> Any:
        return _OfTime(super()._history())


class Robot:
    """A virtual robot with one effect of a pair, and the table of what it has measured."""

    def __init__(self, pair: str, truth: int, seed: int) -> None:
        description = load_robot(ROBOT)
        self.cell, self.limits = cell_of(ROBOT)[0], limits_of(description)[0]
        narrow = PAIRS[pair].narrow
        if narrow is not None:
            lower, upper = self.limits.lower.copy(), self.limits.upper.copy()
            lower[1:3], upper[1:3] = MIDDLE - narrow, MIDDLE + narrow
            self.limits = replace(self.limits, lower=lower, upper=upper)
        hidden = [Hidden.parse(f"{PAIRS['arm'].names[truth]}:{SIZE}")] if pair == "arm" else []
        made = _ByTime if pair == "wrist" and truth == 1 else Session
        self.session = made(description, hidden, seed=seed)
        plant = self.session.plant
        if pair == "wrist":
            expansion = plant.structure.expansion.copy()
            expansion[LINK] = GROWTH
            plant = replace(plant, structure=replace(plant.structure, expansion=expansion))
        else:  # the spring of joint 2 itself is out of the way
            spring = plant.drive.spring.copy()
            spring[1] *= 1e4
            plant = replace(plant, drive=replace(plant.drive, spring=spring))
        self.session.plant = plant
        self.here: Array | None = None
        self.parts: list[pd.DataFrame] = []

    def visit(self, q: Array, direction: Array, rest: float = 0.0) -> None:
        """Measure a pose from a side, after a rest."""
        if rest:
            self.session.wait(rest)
        via = q - APPROACH * direction
        knots = np.array([via if self.here is None else self.here, via, q])
        course = course_of(self.cell.robot, self.limits, knots)
        table = self.session.visit(course, tuple(self.cell.targets), 3.0)
        number = len(self.parts) + 1
        self.parts.append(table.assign(pose=number, visit=1))
        self.here = q

    def swing(self, seconds: float) -> None:
        """Turn all joints back and forth, so fast that the motors warm up to their full rise in the end."""
        self.session._spend(seconds, BRISK * self.session.site.speed)

    def campaign(self, visits: int | None = None) -> Campaign:
        """What it has measured, or the first so many visits."""
        header: Any = self.session.header()
        table = pd.concat(self.parts[:visits], ignore_index=True)
        ranges = zip(self.cell.robot.joints, self.limits.lower, self.limits.upper, strict=True)
        joints = tuple(replace(joint, lower=float(a), upper=float(b)) for joint, a, b in ranges)
        robot = replace(self.cell.robot, joints=joints)
        return declared_campaign(header, MappingProxyType({"poses": table}), robot)


class Judge:
    """Fits a campaign with what is there in any case, and says which effect of a pair is there besides."""

    def __init__(self, pair: Pair, campaign: Campaign) -> None:
        self.campaign, self._pair = campaign, pair

    def confused(self, seed: int) -> bool:
        """Whether the suite, with the seed that the chooser has, says that the two explain the same."""
        model = identify(self.campaign)
        found = diagnose(model, self.campaign, seed=seed, stages=("poses",)).stages["poses"]
        if found.fitted is None or found.scores is None:
            return False
        searched = {s.candidate.name for s in found.scores.named}
        pairs = confusable_pairs(found.fitted, searched, {})
        return any(set(p.terms) == set(self._terms) and abs(p.apart) < SAME for p in pairs)

    @cached_property
    def apart(self) -> float:
        """By how much the first one is likelier than the second."""
        first, second = self._terms
        return evidence_apart(self._fitted(first.label), first, second, {})

    @property
    def _terms(self) -> tuple[Term, Term]:
        first, second = (Term(*name.split("@")) for name in self._pair.names)
        return first, second

    def _fitted(self, *more: str) -> FittedStage:
        model = identify(self.campaign, [*self._pair.model, *more])
        return on_campaign(model, self.campaign).refit("poses")


def start(name: str, seed: int) -> Robot | None:
    """A robot after its first campaign; None where that never leaves the pair open."""
    pair, rng = PAIRS[name], np.random.default_rng([seed, 1])
    robot = Robot(name, seed % 2, seed)
    lower, upper = robot.limits.lower + 1.5 * APPROACH, robot.limits.upper - 1.5 * APPROACH
    within = replace(robot.limits, lower=lower, upper=upper)
    scene = Scene.floor_only(robot.cell)
    poses = configurations(within, LONGEST_START, scene.clear, seed, why="clear of the floor")
    for number, q in enumerate(poses, 1):
        robot.visit(q, rng.choice([-1.0, 1.0], len(q)))
        if pair.pause:
            robot.swing(pair.pause)
        if number < pair.start or number % (2 * BATCH):
            continue
        judge = Judge(pair, robot.campaign())
        if abs(judge.apart) < SAME and judge.confused(seed):
            return robot
    return None


Visits = Sequence[tuple[Array, Array, float]]


def counted(robot: Robot, name: str, seed: int, batch: Callable[[Campaign, int], Visits]) -> int:
    """Further poses until the pair is parted; what is next is asked for with what is known."""
    pair, truth = PAIRS[name], seed % 2
    begin = len(robot.parts)
    while len(robot.parts) - begin < MOST:
        before = len(robot.parts)
        left = MOST - (before - begin)
        for q, direction, rest in batch(robot.campaign(), left)[:left]:
            robot.visit(q, direction, rest)
        if len(robot.parts) == before:
            return MOST
        done = before
        while done < len(robot.parts):
            last, done = done, min(done + BATCH, len(robot.parts))
            if _parted(Judge(pair, robot.campaign(done)), truth):
                inner = range(last + 1, done)
                return next((k for k in inner if _parted(Judge(pair, robot.campaign(k)), truth)), done) - begin
    return MOST


def _parted(judge: Judge, truth: int) -> bool:
    return (judge.apart if truth == 0 else -judge.apart) >= SAME


def _random_poses(campaign: Campaign, seed: int) -> tuple[Array, Array]:
    """More than are needed, anywhere within the limits that the chooser has, and from which side their joints come."""
    cell, limits, _ = cell_of_campaign(campaign)
    within = replace(limits, lower=limits.lower + 1.5 * APPROACH, upper=limits.upper - 1.5 * APPROACH)
    q = configurations(within, RANDOM_POSES, Scene.floor_only(cell).clear, seed, why="clear of the floor")
    return q, np.random.default_rng(seed).choice([-1.0, 1.0], q.shape)


def trial(name: str, seed: int) -> dict[str, Any]:
    """Both counts for one robot."""
    row: dict[str, Any] = {"pair": name, "seed": seed, "true": PAIRS[name].names[seed % 2]}
    robot = start(name, seed)
    if robot is None:
        return row
    first = Judge(PAIRS[name], robot.campaign())
    said: list[str] = []
    chooser = Separating(seed)

    def adaptive(campaign: Campaign, left: int) -> Visits:
        found = chooser.next(campaign, "poses", left)
        said.append(found.why)
        if found.proposed is None:
            return []
        return [(v.q, v.direction, v.wait) for v in rested(found.proposed).visits]

    q, sides = _random_poses(robot.campaign(), seed)
    rng = np.random.default_rng([seed, 2])
    order = rng.permutation(len(q)).tolist()

    def random(campaign: Campaign, left: int) -> Visits:
        mine = [order.pop() for _ in range(BATCH)]
        rest = COOLING if name == "wrist" and rng.random() < 0.5 else 0.0
        return [(q[k], sides[k], rest if n == 0 else 0.0) for n, k in enumerate(mine)]

    row |= {"start": len(robot.parts), "before": first.apart if seed % 2 == 0 else -first.apart}
    row["adaptive"] = counted(copy.deepcopy(robot), name, seed, adaptive)
    row["random"] = counted(copy.deepcopy(robot), name, seed, random)
    return row | {"said": said}


def main() -> None:
    """Print a row for each robot, then medians."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--pair", choices=list(PAIRS))
    given = parser.parse_args()
    for name in [given.pair] if given.pair else PAIRS:
        rows = []
        for seed in range(given.first, given.first + given.seeds):
            row = trial(name, seed)
            print({k: round(v, 1) if isinstance(v, float) else v for k, v in row.items()}, flush=True)
            if "random" in row:
                rows.append(row)
        if rows:
            total = {k: sum(r[k] for r in rows) for k in ("adaptive", "random")}
            median = float(np.median([r["adaptive"] / r["random"] for r in rows]))
            share = total["adaptive"] / total["random"]
            print(f"{name}: {len(rows)} robots; further poses {total}, {share:.2f}; median of the ratios {median:.2f}")


if __name__ == "__main__":
    main()
