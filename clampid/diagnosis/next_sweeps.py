"""Sweeps to take next against a clamped flange: joints, amplitudes and postures to choose from, also as a plan."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from types import MappingProxyType

import numpy as np
import pandas as pd

from clampid.diagnosis.next_measurement import TEMPERATURES
from clampid.diagnosis.pools import Pool, cell_of, columns_seen_by, joined
from clampid.evidence.candidates import Candidate
from clampid.fitting.solve import Estimate
from clampid.planning.clamping import careful_limits, clamping_order, planned_sweep, postures_for
from clampid.planning.clamping_bench import PAUSE_S
from clampid.planning.press import Press, press_limits, stiffness_of
from clampid.planning.scene import Scene
from clampid.stages.clamped import standing_angles
from clampid.stages.clamped_rows import clamped_rows
from clampid.stages.rows import Array, Rows
from experiments.campaign import Campaign
from experiments.plans.limits import Limits
from experiments.plans.model import Cell, Plan, Sweep
from experiments.plans.press import holding_torque, rated_motor_torque
from experiments.plans.validate import sweep_fault, validate_plan

__all__ = ["sweeps_to_choose"]

AMPLITUDES = (0.05, 0.2, 0.4)  # of the rated motor torques
STEPS_PER_QUARTER = 8  # in a quarter of a sweep
NEW, USED = 3, 2  # postures: new ones, and those of the campaign
ALIKE = 0.02  # rad: two sweeps closer than this were one clamping
MARGIN = 1.3  # by how much stiffer drives may be than they have been found
CHUNK = 6  # sweeps worked out at once: each has unknowns of its own
MAX_SWEEPS = 16
CLAMPING = 600.0  # s, to clamp the flange


def sweeps_to_choose(
    campaign: Campaign, estimate: Estimate, candidates: Sequence[Candidate], state: str, seed: int
) -> Pool:
    """Sweeps that could be taken next, the robot ``warm`` or ``cold``.

    Raises
    ------
    PlanError
        Rated torques are not known, or no sweep keeps the limits of robot and clamp.
    """
    cell, free, assumed = cell_of(campaign)
    rated = rated_motor_torque(cell.robot)
    described, usual = stiffness_of(cell.robot, rated)
    press = Press(np.ones(cell.robot.n), rated, _stiffness(estimate, described), MARGIN, clamping_time=CLAMPING)
    limits = press_limits(free, rated)
    blank = Plan("clamping", cell, limits, 0.0, stiffness=MARGIN * press.stiffness)
    sweeps, shares = _sweeps(blank, press, _places(estimate, cell, limits, seed))
    information: list[Array] = []
    for start in range(0, len(sweeps), CHUNK):
        few = sweeps[start : start + CHUNK]
        rows = _imagined_rows(campaign, estimate, cell, few, press, state)

        def standing(theta: Array, rows: Rows = rows, few: Sequence[Sweep] = few) -> Array:
            return _standing(estimate, candidates, cell, rows, few, theta)

        information += columns_seen_by(estimate, candidates, rows, rows.series.run, standing)
    nuisance, columns = joined(information, candidates, len(estimate.slots))

    def plan(chosen: Sequence[int], wished: dict[str, float | int | str]) -> Plan:
        mine = clamping_order([sweeps[k] for k in chosen])
        made = replace(
            blank,
            duration=mine[-1].clamping * CLAMPING + sum(len(s.offset) * s.dwell + PAUSE_S for s in mine),
            sweeps=tuple(mine),
            assumed=(
                *assumed,
                *usual,
                f"the robot is {TEMPERATURES[state]}",
                "the floor is the only obstacle",
                f"drives may be {MARGIN:g} times as stiff as found; the clamp bears {limits.force:g} N, "
                f"{limits.moment:g} Nm",
            ),
            wished=MappingProxyType(wished),
        )
        validate_plan(made, "next sweeps")
        return made

    def words(chosen: Sequence[int]) -> str:
        places = {tuple(sweeps[k].posture) for k in chosen}
        listed = [
            f"joint {sweeps[k].joint + 1} to {100 * shares[k]:.2g} % of its rated torque"
            for k in sorted(chosen, key=lambda k: (sweeps[k].joint, shares[k]))
        ]
        counts = "; ".join(f"{listed.count(said)} × {said}" for said in dict.fromkeys(listed))
        many = "one posture" if len(places) == 1 else f"{len(places)} postures"
        return f"{counts}; in {many}; {TEMPERATURES[state]}"

    cost = np.array([len(s.offset) * s.dwell + PAUSE_S for s in sweeps])
    return Pool(nuisance, columns, cost, ("sweep", "sweeps"), 1, MAX_SWEEPS, words, plan)


def _stiffness(estimate: Estimate, described: Array) -> Array:
    """Springs at the motors ``(n,)``, Nm/rad: as found where they were, else as described."""
    out = described.copy()
    for k in estimate.problem.numbers_of("compliance"):
        if estimate.theta[k] > 0.0:
            out[estimate.slots[k].number] = 1.0 / estimate.theta[k]
    return out


def _places(estimate: Estimate, cell: Cell, limits: Limits, seed: int) -> Array:
    """Postures ``(k, n)``, rad: those in which the flange has been clamped, and others clear of the floor."""
    known: list[Array] = []
    for q in estimate.problem.rows.sweep.reference:
        inside = np.all((q >= limits.lower) & (q <= limits.upper))
        if inside and all(np.max(np.abs(q - other)) > ALIKE for other in known):
            known.append(np.round(q, 6))
    return np.array([*known[:USED], *postures_for(cell, limits, Scene.floor_only(cell), seed)[:NEW]])


def _sweeps(blank: Plan, press: Press, places: Array) -> tuple[list[Sweep], list[float]]:
    """Every joint, to each amplitude that keeps the limits, in every posture; of each the share of the rated torque."""
    found, shares = [], []
    for posture in places:
        bounded = careful_limits(blank, press, posture)
        for joint in range(blank.cell.robot.n):
            for share in AMPLITUDES:
                pressed = replace(press, amplitude=np.full(blank.cell.robot.n, share))
                sweep = planned_sweep(blank, pressed, posture, joint, STEPS_PER_QUARTER)
                if sweep_fault(bounded, sweep) is None:
                    found.append(sweep)
                    shares.append(share)
    return found, shares


def _imagined_rows(
    campaign: Campaign, estimate: Estimate, cell: Cell, sweeps: Sequence[Sweep], press: Press, state: str
) -> Rows:
    """Rows of planned sweeps, not yet measured, with the torques of the springs only."""
    robot, own = cell.robot, estimate.problem.rows
    T, n = np.asarray(robot.transmission), robot.n
    measured = campaign.tables["clamped"]
    parts = []
    for number, sweep in enumerate(sweeps, 1):
        dq = np.zeros((len(sweep.offset), n))
        dq[:, sweep.joint] = sweep.offset
        turned = dq @ np.linalg.inv(T)
        motor = (sweep.posture + dq) @ np.linalg.inv(T)
        tau = _load(cell, sweep.posture) @ T.T + turned * press.stiffness
        data = {"sweep": number, "joint": sweep.joint + 1, "time_s": sweep.dwell * np.arange(1.0, len(dq) + 1)}
        data |= {f"motor{i + 1}_rad": motor[:, i] for i in range(n)}
        data |= {f"tau{i + 1}_Nm": tau[:, i] for i in range(n)}
        at = -1 if state == "warm" else 0
        data |= {name: float(measured[name].iloc[at]) for name in measured.columns if name.startswith("temp_")}
        parts.append(pd.DataFrame(data))
    table = pd.concat(parts, ignore_index=True)
    rows = clamped_rows([replace(campaign, tables=MappingProxyType({"clamped": table}))], own.layout)
    since = float(own.signals["elapsed"].max()) if state == "warm" else 0.0
    soft = np.tile(np.median(own.signals["rest_direction"], axis=0), (len(rows), 1))
    signals = {**rows.signals, "rest_direction": soft, "elapsed": rows.signals["elapsed"] + since}
    return replace(rows, signals=signals)


def _load(cell: Cell, posture: Array) -> Array:
    return holding_torque(cell.robot, posture, cell.gravity, cell.tool_mass, cell.tool_com)


def _standing(
    estimate: Estimate, candidates: Sequence[Candidate], cell: Cell, rows: Rows, sweeps: Sequence[Sweep], theta: Array
) -> Array:
    """Offsets ``(K,)``, rad, with which the drives carry only the weight before a sweep begins."""
    slots = dict.fromkeys(estimate.slots)
    for c in candidates:
        slots |= dict.fromkeys([*c.slots, *c.shapes])
    chain = estimate.problem.with_rows(rows).with_slots(tuple(slots)).chain
    run = rows.series.run
    load = np.array([_load(cell, sweeps[s].posture) for s in run])
    at, _ = standing_angles(rows, chain, theta, load)
    still = at - rows.sweep.wound
    first = np.array([np.flatnonzero(run == s)[0] for s in range(len(sweeps))])
    return np.array([still[first[s], j] if j < cell.robot.n else 0.0 for s, j in rows.series.offset_keys])
