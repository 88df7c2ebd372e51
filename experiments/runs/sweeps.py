"""Runs a plan for a clamped robot: one step, one reading, one line of the journal, and the limits before the next step.

A sweep stops at a reading beyond a limit, at a spring that does not wind up (the clamp is open), and at a clamp that
has shifted or rocks. The drives are then unwound step by step on the same way.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from experiments.plans.model import Sweep
from experiments.plans.motion import Array
from experiments.runs.clamp_state import ClampState, clamp_state
from experiments.runs.comparison import compared_places
from experiments.runs.context import Block, Context, place_on, straight_to
from experiments.runs.errors import RunStopped
from experiments.runs.least_torque import hold, least_torque_posture, placed
from experiments.runs.load import Watch, loaded
from experiments.runs.logs import check_torque
from experiments.runs.loosening import find_loosening
from experiments.runs.robot import ARRIVED, Reading
from experiments.runs.rocking import find_rocking
from experiments.runs.slips import SweepRows, find_shift

__all__ = ["run_sweeps"]

SETTLE = 0.3  # of the dwell, after which samples are taken
STEP_SHARE = 0.02  # of the top speeds: a step is small, and a reading is taken at rest
FALSE_ALARM = 1e-3  # per run: probability of a false alarm, half for rocking and half for a loose clamp
ASSUMED_MARGIN = 1.6  # by which the plan's springs are stiffer than described, if it does not say


def run_sweeps(context: Context) -> str | None:
    """Make the sweeps that have not been made; returns why it ended early, if enough was known.

    Raises
    ------
    RunStopped
        A limit, an open or shifted clamp, or a person, ended it; the drives are unwound.
    """
    check_torque(context.robot)
    plan = context.plan
    state = _resumed(context, clamp_state(context.journal.entries))
    total = len(plan.sweeps)
    for number, sweep in enumerate(plan.sweeps, 1):
        if number in state.done:
            continue
        name = f"sweep {number} of {total}: joint {sweep.joint + 1}"
        if state.clamping != sweep.clamping:
            if state.clamping:
                _release(context)
            _clamp(context, sweep, name, state)
        if plan.least_torque is not None and state.reference is None:
            context.progress((number - 1) / total, f"{name}, posture of least torque")
            least_torque_posture(context, sweep, plan.least_torque, state)
        _sweep(context, placed(sweep, state), number, name, state)
        state.done.add(number)
        enough = context.finished(Block(f"sweep {number}", "clamped", number / total))
        if enough is not None:
            _release(context)
            return enough
    if state.clamping:
        _release(context)
    for words in compared_places(plan, context.journal.entries):
        context.journal.add("note", words=words)
        context.say(words)
    return None


def _resumed(context: Context, state: ClampState) -> ClampState:
    """After a break: go on in the same clamping if it is surely the same; else the sweep that was cut is void."""
    if not state.clamping:
        return state
    planned = next(s for s in context.plan.sweeps if s.clamping == state.clamping)
    sweep = placed(planned, state)
    status = context.robot.rest()
    current = state.current
    way = [sweep.posture]
    if current is not None:
        sweep = placed(context.plan.sweeps[current - 1], state)
        way = [sweep.posture, *(_target(sweep, k) for k in range(1, state.step + 2) if k <= len(sweep.offset))]
    near = np.max(np.abs(status.joints - sweep.posture)) < ARRIVED or place_on(way[-3:], status.joints) is not None
    if context.plan.least_torque is not None and state.reference is None:  # the search was cut
        near = bool(np.all(np.abs(status.joints - planned.posture) <= context.plan.least_torque.within + ARRIVED))
    if status.boot == state.boot and near:
        context.person.confirm(
            f"The flange was clamped (place {state.clamping}) when the run ended.", "Is it still clamped as it was?"
        )
        context.begun = True
        return state
    if current is not None:
        why = "the controller was started again" if status.boot != state.boot else "the robot stands elsewhere"
        context.journal.add("void", table="clamped", sweeps=[current], why=why)
        context.say(f"Sweep {current} is made again from its start: {why} in the middle of it.")
    context.person.confirm("The flange may still be clamped, the drives wound up.", "Is the clamp to be opened now?")
    context.person.release()
    context.journal.add("released", clamping=state.clamping)
    return clamp_state(context.journal.entries)


def _clamp(context: Context, sweep: Sweep, name: str, state: ClampState) -> None:
    straight_to(context, sweep.posture, f"place {sweep.clamping} of the clamp")
    context.begun = True
    if context.plan.least_torque is not None:
        hold(context, sweep, context.plan.least_torque)
    status = context.robot.rest()
    context.person.clamp(f"{name}: the flange is to be clamped (place {sweep.clamping}).")
    context.journal.add("clamped", clamping=sweep.clamping, boot=status.boot, at=status.joints.tolist())
    fresh = clamp_state(context.journal.entries)
    state.clamping, state.boot = fresh.clamping, fresh.boot
    state.holding_torque, state.reference = fresh.holding_torque, fresh.reference


def _release(context: Context) -> None:
    context.person.release()
    context.journal.add("released")


def _target(sweep: Sweep, step: int) -> Array:
    """Where the joints are commanded at a step, from 1; 0: the clamped posture."""
    out = np.array(sweep.posture)
    out[sweep.joint] += float(sweep.offset[step - 1]) if step else 0.0
    return out


def _sweep(context: Context, sweep: Sweep, number: int, name: str, state: ClampState) -> None:
    watch = Watch.of(context.plan, sweep)
    state.current = number
    total = len(context.plan.sweeps)
    first = state.step + 1
    for step in range(first, len(sweep.offset) + 1):
        if (step - first) % 16 == 0:
            context.progress((number - 1 + step / len(sweep.offset)) / total, f"{name}, step {step}")
        context.robot.go(_target(sweep, step), STEP_SHARE, f"{name}, step {step}")
        reading = context.robot.read(SETTLE * sweep.dwell, sweep.dwell)
        context.journal.add(
            "row", table="clamped", key=["clamped", number, step], row=_row(context, sweep, number, reading)
        )
        state.step = step
        fault = watch.fault(reading.torque)
        if fault is not None:
            _unwind(context, sweep, step, name)
            context.journal.add("cut", sweep=number, step=step, why=fault)
            raise RunStopped(f"sweep {number}, step {step}: {fault}; the drives were unwound, the sweep ends here")
        if (way := _way_to(sweep, step)) is not None:
            _check_open(context, sweep, number, way, name)
    _check_shift(context, sweep, number, watch, name)
    _check_loosening(context, sweep, watch, name)
    _check_rocking(context, sweep, watch, name)
    context.journal.add("swept", sweep=number)
    state.current, state.step = None, 0


def _way_to(sweep: Sweep, step: int) -> slice | None:
    """The readings since the last turn, where a sweep turns back after this step; None: it does not."""
    steps = np.sign(np.diff(np.r_[0.0, sweep.offset]))
    if step < len(steps) and steps[step] == steps[step - 1]:
        return None
    other = np.flatnonzero(steps[:step] != steps[step - 1])
    return slice(int(other[-1]) + 1 if len(other) else 0, step)


def _unwind(context: Context, sweep: Sweep, step: int, name: str) -> None:
    """Go back through the steps that led away from the clamped posture, the last one first."""
    here = float(sweep.offset[step - 1])
    for earlier in (*reversed(sweep.offset[: step - 1].tolist()), 0.0):
        if earlier * here < 0.0 or abs(earlier) >= abs(here):
            break
        here = earlier
        to = np.array(sweep.posture)
        to[sweep.joint] += here
        context.robot.go(to, STEP_SHARE, f"{name}, unwinding")
    if here != 0.0:
        context.robot.go(sweep.posture, STEP_SHARE, f"{name}, unwinding")


def _row(context: Context, sweep: Sweep, number: int, reading: Reading) -> dict[str, Any]:
    robot = context.robot
    motor = reading.joints @ np.linalg.inv(np.asarray(robot.robot.transmission))
    row: dict[str, Any] = {"sweep": number, "joint": sweep.joint + 1, "time_s": round(reading.time, 4)}
    row |= {f"motor{i}_rad": float(v) for i, v in enumerate(motor, 1)}
    row |= {f"tau{i}_Nm": float(v) for i, v in enumerate(reading.torque, 1)}
    temperature = robot.status().temperature
    if temperature is not None:
        row |= {f"temp_motor{i}_C": round(float(v), 2) for i, v in enumerate(temperature, 1)}
    return row


def _rows_of(context: Context, number: int) -> SweepRows:
    """The readings of a sweep, from the journal."""
    plan, sweep = context.plan, context.plan.sweeps[number - 1]
    void = {n: i for i, e in enumerate(context.journal.entries) if e["what"] == "void" for n in e["sweeps"]}
    rows = [
        entry["row"]
        for i, entry in enumerate(context.journal.entries)
        if entry["what"] == "row" and entry["key"][1] == number and i > void.get(number, -1)
    ]
    n = plan.cell.robot.n
    offset = np.asarray(sweep.offset[: len(rows)], dtype=float)
    turn = np.zeros(n)
    turn[sweep.joint] = 1.0
    return SweepRows(
        number,
        np.array([row["time_s"] for row in rows]),
        offset,
        np.sign(np.diff(np.r_[0.0, offset])),
        np.array([[row[f"tau{i + 1}_Nm"] for i in range(n)] for row in rows]),
        np.abs(turn @ np.linalg.inv(np.asarray(plan.cell.robot.transmission))) > 1e-9,
    )


def _check_open(context: Context, sweep: Sweep, number: int, way: slice, name: str) -> None:
    stiffness = context.plan.stiffness
    if stiffness is None:
        return
    j, rows = sweep.joint, _rows_of(context, number)
    motor = rows.offset[way] * float(np.linalg.inv(np.asarray(context.plan.cell.robot.transmission))[j, j])
    if loaded(motor, rows.torque[way, j], _described(context)[j]) is not False:
        return
    _unwind(context, sweep, way.stop, name)
    context.journal.add("void", table="clamped", sweeps=[number], why="open")
    _release(context)
    raise RunStopped(
        f"sweep {number}: joint {j + 1} was driven by {math.degrees(np.ptp(sweep.offset[way])):.3f} deg and its "
        "motor's torque did not rise: the clamp is open, or there is more play than that. The sweep is void and will "
        "be made again; sweeps before it stand. Close the clamp"
    )


def _described(context: Context) -> Array:
    """Springs without the plan's margin, Nm/rad at the motors."""
    stiffness = context.plan.stiffness
    margin = float(context.plan.wished.get("margin", ASSUMED_MARGIN))
    return np.asarray(stiffness, dtype=float) / margin


def _check_shift(context: Context, sweep: Sweep, number: int, watch: Watch, name: str) -> None:
    """Look whether the clamp has shifted during this sweep or the one before; if so, unwind, open and stop."""
    plan = context.plan
    rows = [_rows_of(context, k) for k in _since_clamped(context)]
    found = find_shift(rows, plan.cell.robot, _described(context), watch.jacobian)
    if found is None:
        return
    bad = [row.number for row in rows if row.number >= found.sweep]
    context.robot.go(sweep.posture, STEP_SHARE, f"{name}, unwinding")
    words = (
        f"the clamp shifted by about {found.size * 1e3:.2f} mm in sweep {found.sweep}, before step {found.step} "
        f"(p = {found.p_value:.1g}): from there on, torques of every joint are off"
    )
    before = [row.number for row in rows if row.number < found.sweep]
    _stop_for(context, words, bad, before, "Tighten the clamp")


def _check_loosening(context: Context, sweep: Sweep, watch: Watch, name: str) -> None:
    """Look whether the clamp gives way more than in earlier sweeps of its joints; if so, unwind, open and stop."""
    plan, numbers = context.plan, _since_clamped(context)
    found = find_loosening(
        [_rows_of(context, k) for k in numbers],
        plan.cell.robot,
        _described(context),
        watch.jacobian,
        [plan.sweeps[k - 1].joint for k in numbers],
        looks=len(plan.sweeps),
        level=FALSE_ALARM / 2,
    )
    if found is None:
        return
    context.robot.go(sweep.posture, STEP_SHARE, f"{name}, unwinding")
    words = (
        f"the clamp rocks or has come loose: in {_sweeps_words(found.first, found.last)} the flange moved by about "
        f"{found.size * 1e3:.2f} mm more from end to end than until sweep {found.before} (p = {found.p_value:.1g} for "
        "the whole run): drives look softer than they are, and backlash seems larger"
    )
    bad = [k for k in numbers if k > found.before]
    _stop_for(context, words, bad, [k for k in numbers if k <= found.before], "Tighten the clamp on firm feet")


def _check_rocking(context: Context, sweep: Sweep, watch: Watch, name: str) -> None:
    """Look whether the block rocked in the last sweeps of this joint; if so, unwind, open and stop."""
    plan, numbers = context.plan, _since_clamped(context)
    found = find_rocking(
        [_rows_of(context, k) for k in numbers],
        plan.cell.robot,
        _described(context),
        watch.jacobian,
        sweep.joint,
        looks=len(plan.sweeps),
        level=FALSE_ALARM / 2,
    )
    if found is None:
        return
    context.robot.go(sweep.posture, STEP_SHARE, f"{name}, unwinding")
    words = (
        f"the clamp rocks: in {_sweeps_words(found.first, found.last)} it tilted {found.turns} times by about "
        f"{found.size * 1e3:.2f} mm between two rests, where joint {sweep.joint + 1} was wound up by "
        f"{math.degrees(found.forward):.3f} deg on the way forward and {math.degrees(found.backward):.3f} deg on the "
        f"way back (p = {found.p_value:.1g} for the whole run): there the drive looks softer than it is, and backlash "
        "seems larger"
    )
    bad = [k for k in numbers if k >= found.first]
    before = [k for k in numbers if k < found.first]
    _stop_for(context, words, bad, before, "Put the block on firm feet before it is clamped again")


def _sweeps_words(first: int, last: int) -> str:
    return f"sweep {last}" if first == last else f"sweeps {first} to {last}"


def _since_clamped(context: Context) -> list[int]:
    """Numbers of the sweeps that were begun since the clamp was closed."""
    since = max((i for i, e in enumerate(context.journal.entries) if e["what"] == "clamped"), default=0)
    return sorted({e["key"][1] for e in context.journal.entries[since:] if e["what"] == "row"})


def _stop_for(context: Context, words: str, bad: Sequence[int], before: Sequence[int], remedy: str) -> None:
    """Declare sweeps void, open the clamp, and stop; say which sweeps stand."""
    context.journal.add("note", words=words)
    context.journal.add("void", table="clamped", sweeps=list(bad), why=words)
    _release(context)
    stand = f"{_named(before)} of this clamping {'stand' if len(before) > 1 else 'stands'}"
    raise RunStopped(f"{words}. {_named(bad)} will be made again; {stand}. {remedy}")


def _named(sweeps: Sequence[int]) -> str:
    """``sweep 3``, ``sweeps 1, 2`` or ``no sweep``."""
    if not sweeps:
        return "no sweep"
    return f"sweep{'s' if len(sweeps) > 1 else ''} {', '.join(map(str, sweeps))}"
