"""How many further poses part two confusable effects: those that diagnose proposes, against random ones.

    python benchmarks/adaptive_parting.py [--seeds 20] [--first 0] [--pair wrist|arm]

Two pairs. `wrist`: the forearm up to the wrist grows with its temperature, or with the time since switch-on. `arm`:
joint 2 yields, or link 2 bends. Which of the two is true alternates with the seed. A virtual robot measures 40 poses
first, and ten more at a time until either effect explains twice `SAME`: before, there is nothing to part. Then
`clampid.diagnosis.next_plan.parting_plan`, which diagnose calls for look-alikes, proposes poses. They are measured in
the order of the plan, after a rest where it asks for a cold robot. From the same state the same robot measures random
poses of the same pool instead, in batches of five; for the pair `wrist` each batch is measured warm, or after a rest,
by the toss of a coin.

Parted: the true effect explains more than the other one by `SAME` (odds of e^10) in all rows so far. Counted are the
further poses until then; a proposal that is used up is followed by another, made from all rows. Of one that is not
expected to part them, the first five poses are measured. At `MOST` poses it ends, and the count is `MOST`.
"""

from __future__ import annotations

import argparse
import copy
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
import numpy.typing as npt
import pandas as pd

from clampid.catalogue import catalogue
from clampid.diagnosis.next_measurement import COOLING, SAME
from clampid.diagnosis.next_plan import parting_plan
from clampid.diagnosis.next_poses import _choices
from clampid.effect import Effect
from clampid.evidence.candidates import named_candidates
from clampid.evidence.score import score
from clampid.evidence.space import space_of
from clampid.identification.identify import identify
from clampid.identification.model_on_campaign import on_campaign
from clampid.planning.sampling import configurations
from clampid.planning.scene import Scene
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
LONGEST_START = 150  # poses
SHOWN = 2 * SAME  # explained by either effect, before there is anything to part
BATCH = 5
APPROACH = 0.05  # rad
HOUR = 3600.0


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
        rad, half the range of joints 2 and 3 in them; None: all of it.
    pause
        s between them, in which all joints swing.
    """

    names: tuple[str, str]
    model: tuple[str, ...]
    start: int
    narrow: float | None
    pause: float


OTHERS = tuple(f"joint_compliance@joint{j}" for j in (1, 3, 4, 5, 6))
PAIRS = {
    "wrist": Pair(
        ("thermal_expansion@link4", "warm_up_expansion@link4"),
        ("geometry", "joint_compliance", "backlash"),
        40,
        None,
        120.0,
    ),
    "arm": Pair(("joint_compliance@joint2", "link_bending@link2"), ("geometry", *OTHERS, "backlash"), 40, 0.6, 0.0),
}
GROWTH = 4e-5  # 1/K, of the forearm up to the wrist
LINK = 3
WARM = 10.0, HOUR  # K and s, of a link that grows with time
SIZE = 4.0  # of the virtual robot's usual size


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
        return declared_campaign(header, MappingProxyType({"poses": table}), self.cell.robot)


def _always_searched(effect: Effect) -> Effect:
    """An effect as diagnosis looks for it where no recorded temperature shows the same better."""
    return replace(effect, search=replace(effect.search, superseded_by=None))


class Judge:
    """Fits a campaign without either effect of a pair, and scores both."""

    def __init__(self, pair: Pair, campaign: Campaign) -> None:
        self.campaign = campaign
        model = identify(campaign, list(pair.model))
        self.estimate = on_campaign(model, campaign).refit("poses").estimate
        self.space = space_of(self.estimate)
        names = [name.split("@") for name in pair.names]
        effects = {name: _always_searched(catalogue()[name]) for name, _ in names}
        found = score(self.space, named_candidates(self.estimate, effects))
        self.scored = []
        for name, place in names:
            mine = [s for s in found if s.candidate.name == name and s.candidate.places == (place,)]
            self.scored.append(max(mine, key=lambda s: s.explained))  # of the time constants, the best

    @property
    def apart(self) -> float:
        """By how much the first one explains more than the second."""
        return float(self.scored[0].explained - self.scored[1].explained)


def start(name: str, seed: int) -> Robot:
    """A robot after its first campaign."""
    pair, rng = PAIRS[name], np.random.default_rng([seed, 1])
    robot = Robot(name, seed % 2, seed)
    middle = (robot.limits.lower + robot.limits.upper) / 2
    lower, upper = robot.limits.lower + 1.5 * APPROACH, robot.limits.upper - 1.5 * APPROACH
    if pair.narrow is not None:
        middle[1:3] = -1.2, 1.5
        lower[1:3], upper[1:3] = middle[1:3] - pair.narrow, middle[1:3] + pair.narrow
    within = replace(robot.limits, lower=lower, upper=upper)
    scene = Scene.floor_only(robot.cell)
    poses = configurations(within, LONGEST_START, scene.clear, seed, why="clear of the floor")
    for number, q in enumerate(poses, 1):
        robot.visit(q, rng.choice([-1.0, 1.0], len(q)))
        if pair.pause:
            robot.swing(pair.pause)
        if number < pair.start or number % 10:
            continue
        if max(s.explained for s in Judge(pair, robot.campaign()).scored) >= SHOWN:
            break
    return robot


def counted(robot: Robot, name: str, seed: int, batch: Callable[[Judge], Sequence[tuple[Array, Array, float]]]) -> int:
    """Further poses until the pair is parted; what is next is asked for with what is known."""
    pair, truth = PAIRS[name], seed % 2
    begin = len(robot.parts)
    judge = Judge(pair, robot.campaign())
    while len(robot.parts) - begin < MOST:
        before = len(robot.parts)
        for q, direction, rest in batch(judge)[: MOST - (before - begin)]:
            robot.visit(q, direction, rest)
        if len(robot.parts) == before:
            return MOST
        judge = Judge(pair, robot.campaign())
        if _parted(judge, truth):
            done = before + 1
            while done < len(robot.parts) and not _parted(Judge(pair, robot.campaign(done)), truth):
                done += 1
            return done - begin
    return MOST


def _parted(judge: Judge, truth: int) -> bool:
    return (judge.apart if truth == 0 else -judge.apart) >= SAME


def trial(name: str, seed: int) -> dict[str, Any]:
    """Both counts for one robot."""
    robot = start(name, seed)
    first = Judge(PAIRS[name], robot.campaign())
    q, sides = _choices(robot.campaign(), seed)
    states: list[str] = []

    def proposed(judge: Judge) -> list[tuple[Array, Array, float]]:
        found = parting_plan(judge.campaign, judge.estimate, judge.scored, judge.space.scale, seed)
        if found is None or not found.chosen:
            states.append("nothing")
            return []
        states.append(f"{len(found.chosen)} {found.state}")
        rest = COOLING if found.state == "cold" else 0.0
        if found.plan is None:
            return [(q[k], sides[k], rest if n == 0 else 0.0) for n, k in enumerate(found.chosen[:BATCH])]
        return [(v.q, v.direction, rest if n == 0 else 0.0) for n, v in enumerate(found.plan.visits)]

    rng = np.random.default_rng([seed, 2])
    order = rng.permutation(len(q)).tolist()

    def random(judge: Judge) -> list[tuple[Array, Array, float]]:
        mine = [order.pop() for _ in range(BATCH)]
        rest = COOLING if name == "wrist" and rng.random() < 0.5 else 0.0
        return [(q[k], sides[k], rest if n == 0 else 0.0) for n, k in enumerate(mine)]

    row: dict[str, Any] = {"pair": name, "seed": seed, "true": PAIRS[name].names[seed % 2]}
    row["before"] = first.apart if seed % 2 == 0 else -first.apart
    row |= {"start": len(robot.parts), "explained": first.scored[seed % 2].explained}
    if _parted(first, seed % 2):
        return row | {"proposed": 0, "random": 0, "proposals": "parted already"}
    row["proposed"] = counted(copy.deepcopy(robot), name, seed, proposed)
    row["random"] = counted(copy.deepcopy(robot), name, seed, random)
    return row | {"proposals": ", ".join(states)}


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
            if row["random"]:
                rows.append(row)
        if rows:
            median = {k: float(np.median([r[k] for r in rows])) for k in ("proposed", "random")}
            ratio = float(np.median([r["proposed"] / r["random"] for r in rows]))
            print(f"{name}: {len(rows)} robots; median further poses {median}; median of the ratios {ratio:.2f}")


if __name__ == "__main__":
    main()
