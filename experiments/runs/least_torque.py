"""Finds the posture of least torque of a clamped arm, by small steps of each joint until the clamp has no preload.

Closing a clamp leaves a preload: the block shifts the flange a little and so winds up the springs of the drives.
Before the clamp is closed, the torques that hold the arm there are measured. After it, each joint goes step by step
towards its torque of before,

    dq_j = -(tau_j - held_j) / k_j,   rounded to whole steps, one step at a time,

read from both sides at every place, so that Coulomb friction cancels in the mean. It ends when no joint would go by
half a step, and no joint leaves the bounds of the search. The posture found is the reference of
the clamping's sweeps.
Source: the thesis, 3.3 (incremental motions to the configuration of least torque, before backlash and stiffness).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from experiments.plans.model import LeastTorque, Sweep
from experiments.plans.motion import Array
from experiments.runs.clamp_state import ClampState
from experiments.runs.context import Context
from experiments.runs.errors import RunStopped
from experiments.runs.load import Watch

__all__ = ["hold", "least_torque_posture", "placed"]

PROBE = 4  # steps from which a place is approached on either side: beyond what friction needs to turn
ROUNDS_OF_JOINTS = 3  # over all joints: in a coupled wrist one joint's step moves another's motor
SHARE_OF_TOP_SPEED = 0.02  # of the top speeds
SETTLE = 0.3  # of the dwell


def placed(sweep: Sweep, state: ClampState) -> Sweep:
    """The sweep from the reference that was found, if one was."""
    return sweep if state.reference is None else replace(sweep, posture=np.array(state.reference))


def hold(context: Context, sweep: Sweep, search: LeastTorque) -> None:
    """Measure the torques that hold the free arm in the posture of a sweep, from both sides, and write them down.

    Raises
    ------
    RunStopped
        A reading is no number.
    """
    readings = []
    for side in (-1.0, 1.0):
        context.robot.go(sweep.posture + side * PROBE * search.step, SHARE_OF_TOP_SPEED, "least torque, free arm")
        context.robot.go(sweep.posture, SHARE_OF_TOP_SPEED, "least torque, free arm")
        readings.append(context.robot.read(SETTLE * sweep.dwell, sweep.dwell).torque)
    torque = np.mean(readings, axis=0)
    if not np.all(np.isfinite(torque)):
        raise RunStopped(f"least torque: expected torques of the free arm, found {torque.tolist()}")
    context.journal.add("held", clamping=sweep.clamping, torque=torque.tolist())


def least_torque_posture(context: Context, sweep: Sweep, search: LeastTorque, state: ClampState) -> None:
    """Search, from where the robot stands, and write down what was found; ``state`` gets its reference.

    Raises
    ------
    RunStopped
        A reading is beyond a limit of the plan, or the least torque is not within the search's bounds; the robot went
        back to where the clamp was closed, and the clamp was opened.
    """
    holding = np.array(state.holding_torque)
    here = _nearest(context.robot.rest().joints, sweep.posture, search)
    watch = Watch.of(context.plan, sweep)
    first, off = (np.full(len(here), np.nan) for _ in range(2))  # of each joint's own motor; others keep their friction
    for _ in range(ROUNDS_OF_JOINTS):
        moved = False
        for joint in range(len(here)):
            for _ in range(2 * round(float(search.within[joint] / search.step[joint])) + 1):
                torque = _from_both_sides(context, sweep, search, here, joint, watch)
                off[joint] = torque[joint] - holding[joint]
                first[joint] = off[joint] if np.isnan(first[joint]) else first[joint]
                way = _way(context, joint, off) / search.step[joint]
                if abs(way) < 0.5:
                    break
                here = _stepped(context, here, joint, float(np.sign(way)), sweep, search)
                moved = True
        if not moved:
            break
    context.robot.go(here, SHARE_OF_TOP_SPEED, "least torque, found")
    context.journal.add(
        "least_torque",
        clamping=sweep.clamping,
        posture=here.tolist(),
        before=first.tolist(),
        after=off.tolist(),
    )
    state.reference = here.tolist()
    largest = int(np.argmax(np.abs(first)))
    words = (
        f"least torque in place {sweep.clamping} of the clamp: the preload of motor {largest + 1}, the largest, went "
        f"from {abs(first[largest]):.2f} Nm to {abs(off[largest]):.2f} Nm"
    )
    context.journal.add("note", words=words)
    context.say(f"{words[0].upper()}{words[1:]}.")


def _nearest(joints: Array, posture: Array, search: LeastTorque) -> Array:
    """The nearest grid point of the search to the robot ``(n,)``; after a break it is not the clamped posture."""
    steps = np.clip(np.round((joints - posture) / search.step), *(s * _most(search) for s in (-1.0, 1.0)))
    return np.asarray(posture + steps * search.step)


def _most(search: LeastTorque) -> Array:
    return np.asarray(np.floor(search.within / search.step + 1e-9))


def _way(context: Context, joint: int, off: Array) -> float:
    """By how much a joint is to be turned so that its own motor carries what it did before, rad."""
    stiffness = context.plan.stiffness
    if stiffness is None:
        raise RunStopped("least torque: expected stiffness_Nm_rad in the plan, found none")
    turn = float(np.linalg.inv(np.asarray(context.plan.cell.robot.transmission)).T[joint, joint])
    return -float(off[joint]) / (float(stiffness[joint]) * turn)


def _stepped(context: Context, here: Array, joint: int, way: float, sweep: Sweep, search: LeastTorque) -> Array:
    """One step further; not beyond the bounds."""
    there = here.copy()
    there[joint] += way * search.step[joint]
    if abs(there[joint] - sweep.posture[joint]) > search.within[joint] * (1 + 1e-9):
        _give_up(
            context,
            sweep.posture,
            f"joint {joint + 1}: expected it within {search.within[joint]:.3g} rad of the clamped posture, found "
            "torque that leads further; close the clamp with less force",
        )
    return there


def _from_both_sides(
    context: Context, sweep: Sweep, search: LeastTorque, here: Array, joint: int, watch: Watch
) -> Array:
    """Mean torque ``(n,)``, Nm, of a place that one joint comes to from either side."""
    readings = []
    name = f"least torque, joint {joint + 1}"
    for side in (-1.0, 1.0):
        aside = here.copy()
        aside[joint] += side * PROBE * search.step[joint]
        context.robot.go(aside, SHARE_OF_TOP_SPEED, name)
        _check(context, sweep.posture, watch, context.robot.read(SETTLE * sweep.dwell, sweep.dwell).torque)
        context.robot.go(here, SHARE_OF_TOP_SPEED, name)
        torque = context.robot.read(SETTLE * sweep.dwell, sweep.dwell).torque
        _check(context, sweep.posture, watch, torque)
        readings.append(torque)
    return np.asarray(np.mean(readings, axis=0))


def _check(context: Context, posture: Array, watch: Watch, torque: Array) -> None:
    fault = watch.fault(torque)
    if fault is not None:
        _give_up(context, posture, fault)


def _give_up(context: Context, posture: Array, why: str) -> None:
    """Go back to where the clamp was closed, have it opened, and stop."""
    context.robot.go(posture, SHARE_OF_TOP_SPEED, "least torque, back")
    context.person.release()
    context.journal.add("released")
    raise RunStopped(f"least torque: {why}. The robot went back, and the clamp was opened")
