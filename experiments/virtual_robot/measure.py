"""Measures a whole campaign on one individual robot, with or without something hidden in it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypedDict

import numpy as np
import pandas as pd

from experiments.virtual_robot.bodies import Bodies
from experiments.virtual_robot.description import Array, RobotDescription
from experiments.virtual_robot.distance_tables import DISTANCE_SIGMA, draw_anchors, measure_distances
from experiments.virtual_robot.draw import GRAVITY, TARGETS, TOOL_COM, TOOL_MASS, draw_plant
from experiments.virtual_robot.heat import History
from experiments.virtual_robot.heat import session as warmed
from experiments.virtual_robot.hidden import Hidden, hide
from experiments.virtual_robot.outliers import spoil
from experiments.virtual_robot.plant import Plant
from experiments.virtual_robot.pose_tables import measure_poses
from experiments.virtual_robot.programs import (
    PoseProgram,
    Run,
    clamp_program,
    free_air_program,
    pose_program,
    wrist_program,
)
from experiments.virtual_robot.remeasured import FIRST_VISIT, seeds_of, set_up_anew
from experiments.virtual_robot.sampling import Site
from experiments.virtual_robot.torque_tables import Logged, log_runs, log_sweeps, sweep_amplitudes

TORQUE_TABLES = ("free_air", "wrist", "clamped")
POSE_TABLES = ("poses", "verification")
USUAL = TORQUE_TABLES + POSE_TABLES
TABLES = (*USUAL, "distances")  # distances only where they are asked for; last, so that the others' streams stay
VERIFICATION_POSES = 80

MOST_POSES = 100_000  # a robot visits as many in a year


@dataclass(frozen=True)
class Truth:
    """The true values, which are unknown for a real robot; for tests and benchmarks.

    Attributes
    ----------
    plant
        Every true parameter, hidden effects included.
    baseline
        The same robot without them.
    noise_free
        For each table, its points, m, (rows, 3), distances, m, (rows, 1), or torques, Nm, (rows, n), without noise,
        repeatability and outliers.
    outliers
        For each table, the rows that were spoilt.
    """

    plant: Plant
    baseline: Plant
    noise_free: Mapping[str, Array]
    outliers: Mapping[str, tuple[int, ...]]


@dataclass(frozen=True)
class Measured:
    """A measured campaign: tables as the campaign contract has them, and the content of ``campaign.toml``."""

    tables: dict[str, pd.DataFrame]
    header: dict[str, Any]
    hidden: list[dict[str, Any]]
    truth: Truth


class MeasurementChoice(TypedDict, total=False):
    """What is chosen of a measured campaign; see :func:`measure`."""

    seed: int
    session: int
    poses: int
    tables: Sequence[str] | None
    outliers: float
    alter: Callable[[Plant], Plant]


def measure(
    robot: RobotDescription,
    hidden: Sequence[Hidden] = (),
    *,
    seed: int = 0,
    session: int = FIRST_VISIT,
    poses: int = 250,
    tables: Sequence[str] | None = None,
    outliers: float = 0.0,
    alter: Callable[[Plant], Plant] = lambda plant: plant,
) -> Measured:
    """Measure a campaign on a virtual robot.

    Plant, programs and noise have streams of their own: with the same seed, hiding an effect, leaving out a table or
    adding outliers changes nothing else.

    Parameters
    ----------
    robot
        The nominal robot; an individual with errors of its own is drawn from it.
    hidden
        Effects that this individual has and a baseline one has not.
    seed
        Which individual, programs and noise.
    session
        Which session of this individual, from 1: later ones have programs, noise, tool, air and place of the instrument
        of their own.
    poses
        Number of poses in the table ``poses``, and in ``distances``.
    tables
        Which tables to measure; by default all that the description allows (without links: no torques) but
        ``distances``.
    outliers
        Share of rows, 0 … 1, that are wrong; the verification table has none.
    alter
        Gives the individual numbers of one's choice, such as printed springs or a clearance of known size, before
        anything is hidden in it; it still is a baseline one.

    Returns
    -------
    Measured
        Tables, header, what was hidden, and the truth.
    """
    if poses < 1:
        raise ValueError(f"poses: expected at least 1, found {poses}")
    if poses > MOST_POSES:
        raise ValueError(f"poses: expected at most {MOST_POSES}, found {poses}")
    if not 0.0 <= outliers < 1.0:
        raise ValueError(f"outliers: expected a share from 0 to below 1, found {outliers}")
    site = Site(robot)
    wanted = _tables(site, tables)
    seeds = seeds_of(seed, session)
    streams = {
        kind: dict(zip(TABLES, (np.random.default_rng(s) for s in seq.spawn(len(TABLES))), strict=True))
        for kind, seq in (("program", seeds.program), ("noise", seeds.noise), ("outliers", seeds.spoil))
    }
    baseline = alter(draw_plant(robot, np.random.default_rng(seeds.plant)))
    plant, recorded = hide(site, baseline, hidden, seeds.hidden)
    baseline, plant = (set_up_anew(robot, each, seeds.place) for each in (baseline, plant))
    logged = _torques(site, baseline, plant, wanted, streams) | _poses(site, plant, wanted, poses, streams)
    frames = {name: logged[name].table for name in wanted}
    spoilt: dict[str, tuple[int, ...]] = {}
    for name in wanted:
        share = 0.0 if name == "verification" else outliers
        frames[name], spoilt[name] = spoil(frames[name], share, streams["outliers"][name])
    truth = Truth(plant, baseline, {name: logged[name].noise_free for name in wanted}, spoilt)
    return Measured(frames, _header(robot, plant, "distances" in wanted), recorded, truth)


def _tables(site: Site, tables: Sequence[str] | None) -> tuple[str, ...]:
    possible = TABLES if site.weighed else (*POSE_TABLES, "distances")
    for name in tables or ():
        if name not in TABLES:
            raise ValueError(f"table {name!r}: expected some of {', '.join(TABLES)}")
        if name not in possible:
            raise ValueError(f"table {name!r}: the description {site.robot.name!r} has no links, so no torques")
    return tuple(name for name in possible if name in (USUAL if tables is None else tables))


_Streams = Mapping[str, Mapping[str, np.random.Generator]]


def _torques(site: Site, baseline: Plant, plant: Plant, wanted: Sequence[str], streams: _Streams) -> dict[str, Logged]:
    """One session: free air, wrist, clamped, from switch-on. Programs are made even where a table is left out."""
    if not set(wanted) & set(TORQUE_TABLES):
        return {}
    bodies, program = Bodies(plant.geometry, plant.masses), streams["program"]
    free, wrist = free_air_program(site, program["free_air"]), wrist_program(site, program["wrist"])
    clamp = clamp_program(site, program["clamped"])
    time, work = _work(free, 0.0)
    wrist_start = time[-1] + 300.0
    wrist_time, wrist_work = _work(wrist, wrist_start)
    clamp_start = wrist_time[-1] + 900.0
    work = np.vstack([work, 0 * work[:1], wrist_work, 0.1 + 0 * work[:1]])
    work = work / np.mean(work[: len(time)])
    ends = np.concatenate([time, [wrist_start], wrist_time, [clamp_start + clamp.time[-1]]])
    history = warmed(plant.heat, ends, work)
    out = {}
    noise = streams["noise"]
    if "free_air" in wanted:
        out["free_air"] = log_runs(plant, bodies, free, history=history, since=0.0, rng=noise["free_air"])
    if "wrist" in wanted:
        out["wrist"] = log_runs(plant, bodies, wrist, history=history, since=wrist_start, rng=noise["wrist"])
    if "clamped" in wanted:
        amplitude = sweep_amplitudes(baseline, Bodies(baseline.geometry, baseline.masses), clamp)
        out["clamped"] = log_sweeps(
            plant, bodies, clamp, amplitude, history=history, since=clamp_start, rng=noise["clamped"]
        )
    return out


def _work(runs: Sequence[Run], since: float) -> tuple[Array, Array]:
    """Return ends of ten-second pieces of the runs, s of the session, (m,), and mean joint speeds in them, (m, n)."""
    time, work = [], []
    for run in runs:
        if since + run.start > 0:  # the pause before it
            time.append(since + run.start)
            work.append(np.zeros(run.path.knots.shape[1]))
        edges = np.arange(10.0, run.path.length, 10.0)
        for end in (*edges, run.path.length):
            _, speed, _ = run.path.at(np.linspace(max(end - 10.0, 0.0), end, 20))
            time.append(since + run.start + end)
            work.append(np.mean(np.abs(speed), axis=0))
    return np.array(time), np.array(work)


def _poses(site: Site, plant: Plant, wanted: Sequence[str], poses: int, streams: _Streams) -> dict[str, Logged]:
    """Another day, again from switch-on: poses, then verification, then distances."""
    if not set(wanted) & {*POSE_TABLES, "distances"}:
        return {}
    bodies, program = Bodies(plant.geometry, plant.masses), streams["program"]
    first = pose_program(site, poses, 60.0, True, program["poses"])
    second = pose_program(site, VERIFICATION_POSES, first.time[-1] + 120.0, False, program["verification"])
    both = [first, second]
    usual = np.vstack([visits.travel for visits in both]).mean(axis=0)

    def warmth(programs: Sequence[PoseProgram]) -> History:
        travel = np.vstack([visits.travel for visits in programs])
        return warmed(plant.heat, np.concatenate([visits.time for visits in programs]), travel / usual)

    history, noise = warmth(both), streams["noise"]
    out = {
        name: measure_poses(plant, bodies, visits, history, noise[name])
        for name, visits in zip(POSE_TABLES, both, strict=True)
        if name in wanted
    }
    if "distances" in wanted:
        third = pose_program(site, poses, second.time[-1] + 120.0, True, program["distances"])
        anchors = draw_anchors(plant.geometry, program["distances"])
        history = warmth([*both, third])
        out["distances"] = measure_distances(plant, bodies, third, history, anchors, noise["distances"])
    return out


def _header(robot: RobotDescription, plant: Plant, distances: bool) -> dict[str, Any]:
    stated = declared(plant)
    if distances:
        stated["instrument"] |= {"distance_std_m": DISTANCE_SIGMA}
    return {"format": "clampid-campaign/1", "robot": robot.name, **stated}


def declared(plant: Plant) -> dict[str, Any]:
    """Return gravity, tool, targets and instrument as the cell declares them in ``campaign.toml``."""
    return {
        "gravity_m_s2": [float(g) for g in GRAVITY],
        "tool": {"mass_kg": TOOL_MASS, "com_m": [float(c) for c in TOOL_COM]},
        "targets_m": {name: list(p) for name, p in TARGETS.items()},
        "instrument": {"name": "virtual laser tracker", "position_std_m": plant.instrument.sigma},
    }
