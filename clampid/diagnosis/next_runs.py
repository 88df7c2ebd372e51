"""Programs to log next in free air: short runs of many kinds to choose from, and as a plan to run.

All joints at once or one joint alone, each at several speeds, short ways where it goes slowly, the robot as warm as at
the end of the log or as cold as at its start.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from clampid.diagnosis.next_measurement import TEMPERATURES
from clampid.diagnosis.pools import Pool, cell_of, columns_seen_by, joined
from clampid.effect import Effect
from clampid.evidence.candidates import Candidate
from clampid.fitting.solve import Estimate
from clampid.identification.identify import effects_in
from clampid.planning.logs import TorqueNoise, planned_log, planned_rows
from clampid.planning.sampling import configurations
from clampid.planning.scene import Scene
from clampid.slots import Term
from clampid.stages.counting import explained
from clampid.stages.rows import Array, Rows
from clampid.stages.torques import torque_rows
from experiments.campaign import Campaign
from experiments.plans.limits import Limits, course_of
from experiments.plans.model import Cell, Plan, Run
from experiments.plans.motion import Course
from experiments.plans.validate import validate_plan
from experiments.signals import typical_step

__all__ = ["runs_to_choose"]

SHARES = (0.01, 0.04, 0.15, 0.4)  # of the top speeds; none above that of the log, which would make its slow rows creep
TIME, MOVE, DWELL = 60.0, 20.0, 1.0  # s: of a run, of its longest move, at each stop
ROWS = 4000  # of a run, at most
PATHS = 2  # of each speed
ALONE = 2  # of the speeds, the fastest ones, at which one joint goes alone
STOPS = 200  # configurations to go through
CHUNK = 4  # runs looked at together
MAX_RUNS = 10
REST = 60.0  # s, between runs in the sum of what they cost


@dataclass(frozen=True)
class _Kind:
    """A run to choose: its course, at which share of the top speeds, and of which joint, from 0, or of all."""

    course: Course
    share: float
    joint: int | None

    @property
    def words(self) -> str:
        """For people."""
        who = "all joints" if self.joint is None else f"joint {self.joint + 1} alone"
        return f"{who} at {100 * self.share:g} % of the top speed"


def runs_to_choose(
    campaign: Campaign, estimate: Estimate, candidates: Sequence[Candidate], state: str, seed: int
) -> Pool:
    """Runs that could be logged next, the robot ``warm`` or ``cold``.

    Raises
    ------
    PlanError
        The campaign's robot lets no motion be.
    """
    cell, limits, assumed = cell_of(campaign)
    table = campaign.tables["free_air" if "free_air" in campaign.tables else "wrist"]
    rate = 1.0 / typical_step(table["time_s"].to_numpy(float), table["run"].to_numpy())
    rate = float(f"{rate:.4g}")
    fastest = _fastest(estimate, limits)
    kinds = _kinds(cell, limits, [*(s for s in SHARES if s < 0.9 * fastest), fastest], min(TIME, ROWS / rate), seed)
    # Of a dense log several rows are one number to the noise: one row is imagined for each of these.
    noise = estimate.noise
    sparse = replace(estimate, noise=replace(noise, together=1))
    information: list[Array] = []
    for start in range(0, len(kinds), CHUNK):
        few = [kind.course for kind in kinds[start : start + CHUNK]]
        rows = _imagined_rows(campaign, estimate, cell, few, rate / noise.together, state, fastest)
        information += columns_seen_by(sparse, candidates, rows, rows.series.run)
    nuisance, columns = joined(information, candidates, len(estimate.slots))
    assumed = (*assumed, f"the robot is {TEMPERATURES[state]}", "the floor is the only obstacle")

    def plan(chosen: Sequence[int], wished: dict[str, float | int | str]) -> Plan:
        mine = sorted(chosen, key=lambda k: kinds[k].share)
        made = Plan(
            kind="free_air",
            cell=cell,
            limits=limits,
            duration=sum(kinds[k].course.length for k in mine),
            runs=tuple(Run(kinds[k].course, kinds[k].share) for k in mine),
            rate=rate,
            assumed=assumed,
            wished=MappingProxyType(wished),
        )
        validate_plan(made, "next runs")
        return made

    def words(chosen: Sequence[int]) -> str:
        listed = [kinds[k].words for k in sorted(chosen, key=lambda k: kinds[k].share)]
        counts = {said: listed.count(said) for said in listed}
        return f"{'; '.join(f'{n} × {said}' for said, n in counts.items())}; {TEMPERATURES[state]}"

    cost = np.array([kind.course.length + REST for kind in kinds])
    return Pool(nuisance, columns, cost, ("run", "runs"), 1, MAX_RUNS, words, plan)


def _fastest(estimate: Estimate, limits: Limits) -> float:
    """The share of its top speed at which the fastest joint of the log moves, two digits, rounded down."""
    rows = estimate.problem.rows
    share = float(np.max(np.abs(rows.signals["joint_speed"]) / limits.speed, initial=SHARES[0]))
    return min(max(float(np.floor(100.0 * share)) / 100.0, SHARES[0]), 1.0)


def _kinds(cell: Cell, limits: Limits, shares: Sequence[float], time: float, seed: int) -> list[_Kind]:
    scene, rng = Scene.floor_only(cell), np.random.default_rng(seed)
    stops = configurations(limits, STOPS, scene.clear, seed, why="clear of the floor")
    found = []
    for share in shares:
        for _ in range(PATHS):
            found.append(_Kind(_through(cell, limits, scene, stops, share, time, rng), share, None))
        for joint in range(cell.robot.n) if share in shares[-ALONE:] else ():
            found.append(_Kind(_alone(cell, limits, scene, stops, joint, share, time, rng), share, joint))
    return found


def _through(
    cell: Cell, limits: Limits, scene: Scene, stops: Array, share: float, time: float, rng: np.random.Generator
) -> Course:
    """A course towards one stop after the other, each move cut at its longest duration."""
    knots, spent, fails = [stops[int(rng.integers(len(stops)))]], DWELL, 0
    while fails < STOPS:
        to = stops[int(rng.integers(len(stops)))]
        step = _shortened(cell, limits, knots[-1], to, share)
        length = _length(cell, limits, knots[-1], step, share)
        if np.array_equal(step, knots[-1]) or not scene.way_clear(knots[-1], step):
            fails += 1
            continue
        if len(knots) > 2 and spent + length > time:
            break
        knots.append(step)
        spent += length
    return course_of(cell.robot, limits, np.array(knots), speed_share=share, dwell=DWELL)


def _alone(
    cell: Cell, limits: Limits, scene: Scene, stops: Array, joint: int, share: float, time: float,
    rng: np.random.Generator,
) -> Course:  # fmt: skip
    """A course of one joint there and back, from where it has the longest way of a few tries."""
    best: tuple[float, Array, Array] | None = None
    for k in rng.permutation(len(stops))[:PATHS]:
        ends = np.tile(stops[k], (2, 1))
        ends[:, joint] = limits.lower[joint], limits.upper[joint]
        for _ in range(6):
            if scene.way_clear(ends[0], ends[1]):
                break
            ends[:, joint] = stops[k][joint] + 0.6 * (ends[:, joint] - stops[k][joint])
        way = abs(ends[1, joint] - ends[0, joint])
        if best is None or way > best[0]:
            best = way, ends[0], ends[1]
    _, first, last = best if best is not None else (0.0, stops[0], stops[0])
    there = _shortened(cell, limits, first, last, share, longest=(time - 3 * DWELL) / 2)
    return course_of(cell.robot, limits, np.array([first, there, first]), speed_share=share, dwell=DWELL)


def _shortened(cell: Cell, limits: Limits, start: Array, to: Array, share: float, longest: float = MOVE) -> Array:
    """The way from ``start``, as much of it as its longest move allows, µrad."""
    length = _length(cell, limits, start, to, share) - DWELL
    part = min(1.0, longest / max(length, 1e-9))
    return np.clip(np.round(start + part * (to - start), 6), limits.lower, limits.upper)


def _length(cell: Cell, limits: Limits, start: Array, to: Array, share: float) -> float:
    return float(course_of(cell.robot, limits, np.array([start, to]), speed_share=share, dwell=0.0).length) + DWELL


def _imagined_rows(
    campaign: Campaign, estimate: Estimate, cell: Cell, courses: Sequence[Course], rate: float, state: str,
    fastest: float,
) -> Rows:  # fmt: skip
    """Rows of planned logs, not yet measured."""
    own = estimate.problem.rows
    table = planned_log(courses, rate)
    like = campaign.tables["free_air" if "free_air" in campaign.tables else "wrist"]
    at = -1 if state == "warm" else 0
    for name in like.columns:
        if name.startswith("temp_"):
            table[name] = like[name].iloc[at]
    effects: dict[str, Effect] = dict(estimate.problem.effects)
    terms = [Term(slot.effect, slot.place) for slot in estimate.slots]
    rows = torque_rows(
        [replace(campaign, tables=MappingProxyType({"free_air": table}))],
        own.layout,
        *explained(effects_in(terms, effects)),
    )
    since = float(own.signals["elapsed"].max()) if state == "warm" else 0.0
    signals = {**rows.signals, "elapsed": rows.signals["elapsed"] + since}
    noise = _neighbouring(estimate)
    used = planned_rows(cell, noise, rate, signals, courses, rows.series.run, fastest)
    return replace(rows, signals=signals, used=used)


def _neighbouring(estimate: Estimate) -> TorqueNoise:
    """The log's noise, as far as it is correlated between neighbouring rows."""
    noise, used = estimate.noise, estimate.problem.rows.used
    sigma = np.array([np.median(noise.sigma[used[:, c], c]) if used[:, c].any() else 1.0 for c in range(used.shape[1])])
    lag = [a[1] / a[0] for a in noise.autocorrelations if len(a) > 1 and a[0] > 0]
    shared = float(np.clip(np.median(lag), 0.0, 0.99)) if lag else 0.0
    return TorqueNoise(sigma, shared, np.inf)
