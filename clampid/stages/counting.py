"""Which rows of a torque log count, the signals of its motion, and its folds: for logs held whole and by windows alike.

Static friction is indeterminate, so rows of a motor at rest do not count, unless the model has a state of friction. Dry
friction builds up over a distance: between rest and clear motion its torque is unknown too. If a motor turns while a
joint coupled with it has not moved in the whole run, the dry friction of that joint's arm side is an unknown constant
of the run.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import Protocol

import numpy as np

from clampid.effect import Effect
from clampid.roles import INERTIAS
from clampid.stages.log_facts import LogFacts
from clampid.stages.log_motion import Motion
from clampid.stages.rows import Array, Bools, Integers
from experiments.signals import carried_sign

__all__ = [
    "FIFTHS",
    "INERTIA_SHARE",
    "counting",
    "explained",
    "explains_acceleration",
    "explains_rest",
    "folds_of",
    "motion_signals",
    "needs_whole_log",
    "negligible",
    "standing_joints",
]

FIFTHS = 5  # a log of one run is held out by contiguous fifths
INERTIA_SHARE = 0.5  # of the noise between neighbouring rows


class Thresholds(Protocol):
    """The thresholds by which rows count, of a recorded (:class:`clampid.stages.log_facts.LogFacts`) or planned log.

    ``(n,)`` each: speeds of rest and of clear motion of joints and of motors, rad/s; accelerations of steady motion,
    rad/s²; noise of the torques between neighbouring rows, Nm. ``(R, n)``: whether the joint moves in that run.
    """

    @property
    def rest(self) -> Array: ...
    @property
    def rest_motor(self) -> Array: ...
    @property
    def clear(self) -> Array: ...
    @property
    def clear_motor(self) -> Array: ...
    @property
    def steady(self) -> Array: ...
    @property
    def noise(self) -> Array: ...
    @property
    def moved(self) -> Bools: ...


def motion_signals(
    motion: Motion, transmission: Array, facts: LogFacts, run: Integers, time: Array
) -> dict[str, Array]:
    """Signals of :data:`clampid.effect.SIGNALS` that depend on motion only, ``(N, n)`` each, ``elapsed`` ``(N,)``.

    Parameters
    ----------
    motion
        Of ``N`` rows that follow each other.
    transmission
        ``(n, n)``, T.
    run, time
        The log's number of each row's run ``(N,)``, and stamps ``(N,)``, s.
    """
    to_motor = np.linalg.inv(transmission)  # rows: w_joint @ T^-1 = (T^-T w_joint)'
    joint_speed, motor_speed = motion.speed, motion.speed @ to_motor
    motor = motion.position @ to_motor
    joint_motion = carried_sign(joint_speed, facts.rest, run, motion.position, time)
    gear = np.diag(transmission)
    return {
        "q": motion.position,
        "motor": motor,
        "joint_speed": joint_speed,
        "motor_speed": motor_speed,
        "joint_motion": joint_motion,
        "motor_motion": carried_sign(motor_speed, facts.rest_motor, run, motor, time),
        "own_speed": joint_speed / gear,
        "own_motion": joint_motion * np.sign(gear),
        "joint_acceleration": motion.acceleration,
        "elapsed": time - facts.since,
        "rest_direction": np.zeros_like(motion.position),
    }


def explains_acceleration(active: Collection[Effect]) -> bool:
    """Whether some effects explain torques of acceleration, so that such rows can be used."""
    return any(effect.roles & set(INERTIAS) for effect in active)


def explains_rest(active: Collection[Effect]) -> bool:
    """Whether some effects model the friction at rest, so that such rows can be used."""
    return any("friction_state" in effect.acts for effect in active)


def needs_whole_log(active: Collection[Effect]) -> bool:
    """Whether a fit needs all rows in memory: friction states follow whole runs, orders are sought in all residuals."""
    return explains_rest(active) or any(effect.order is not None for effect in active)


def explained(active: Collection[Effect]) -> tuple[bool, bool]:
    """Which rows count beside those of steady motion: in acceleration, and of motors at rest."""
    return explains_acceleration(active), explains_rest(active)


def counting(
    signals: Mapping[str, Array],
    transmission: Array,
    facts: Thresholds,
    run: Integers,
    wrist: Sequence[int],
    accelerating: bool,
    resting: bool = False,
) -> Bools:
    """Motors' rows ``(N, n)`` that count by their motion; `negligible` inertia is not asked for here.

    Parameters
    ----------
    signals
        Of :func:`motion_signals`, their signs carried on from before the rows.
    run
        The log's number of each row's run ``(N,)``.
    wrist
        Joints whose transmission is coupled.
    accelerating
        Use rows in acceleration.
    resting
        Use rows of motors at rest, except before a motor's first motion in a run: its friction is unknown there.
    """
    out = np.abs(signals["motor_speed"]) > np.maximum(facts.rest_motor, facts.clear_motor)
    if resting:
        out |= signals["motor_motion"] != 0
    for j in wrist:
        speed = np.abs(signals["joint_speed"][:, j])
        creeping = (speed > facts.rest[j]) & (speed <= facts.clear[j])
        unmoved = signals["joint_motion"][:, j] == 0  # not moved yet in this run
        out[np.ix_(facts.moved[run, j] & (creeping | unmoved), transmission[:, j] != 0)] = False
    if not accelerating:
        out &= np.abs(signals["joint_acceleration"]) <= facts.steady  # rotors and links have inertia of their own
    return np.asarray(out)


def negligible(inertia: Array, facts: Thresholds) -> Bools:
    """Whether motor torques of inertia ``(N, n)``, Nm, are small compared with the noise.

    The described masses are accurate enough for gravity, not for full dynamics. Their torque of acceleration is
    subtracted; rows in which it exceeds a fraction of the noise are left out.
    """
    return np.asarray(np.abs(inertia) <= INERTIA_SHARE * facts.noise)


def standing_joints(facts: LogFacts, wrist: Sequence[int]) -> Integers:
    """``(K, 2)``: run and joint of the coupled joints that stand still for a whole run."""
    joints = np.array(wrist, dtype=np.int64)
    which, run = np.nonzero(~facts.moved[:, joints].T)
    return np.asarray(np.c_[run, joints[which]], dtype=np.int64)


def folds_of(facts: LogFacts, run: Integers, row: Integers) -> Integers:
    """The folds ``(N,)`` of rows of the log ``(N,)``, from 0: runs, or contiguous fifths where there is one run."""
    return run if len(facts.runs) > 1 else (row * FIFTHS // facts.rows).astype(np.int64)
