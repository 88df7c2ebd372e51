"""The course of the axes: the moves of the last minutes, with the state of the drives after each.

Nothing is computed as time passes. A move stores the state of the dry friction at its start. Every motor turns in one
direction during a move, so the state at any later time follows in closed form.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from experiments.virtual_controller.moves import Limits, Move, braked
from experiments.virtual_robot import Plant
from experiments.virtual_robot.description import Array
from experiments.virtual_robot.drive import motor_angles

__all__ = ["Rows", "Track"]

CONTACTS = np.array([0.25, 1.0, 2.0, 4.0])[:, None]  # widths of contacts that creep, as `creeping_friction` has them
CREEP_STEP = 0.012  # s, in which creep during a move is worked out
REMEMBERED = 32  # places at which the robot stood, for springs with hysteresis


@dataclass(frozen=True)
class Rows:
    """The axes at some times: row by row, rad and s, (N, n).

    Attributes
    ----------
    q, qd, qdd
        Reported angles, speeds, accelerations.
    direction
        Last direction of each axis, ±1.
    motor_state, gear_state
        States of the dry friction at the motors and at the gears, −1 … 1.
    off
        How far the arm is beside its usual place (repeatability), rad.
    """

    q: Array
    qd: Array
    qdd: Array
    direction: Array
    motor_state: Array
    gear_state: Array
    off: Array


@dataclass(frozen=True)
class _Left:
    """The state of the drives after the earlier moves, (n,) each; ``contacts`` (4, n)."""

    direction: Array
    motor_state: Array
    gear_state: Array
    contacts: Array
    travel: Array  # rad, all that an axis ever went
    off: Array  # rad, before this move
    then: Array  # rad, after it
    turn: Array  # 1, by how much the motors' dry friction would be wound up by the whole move


class Track:
    """The course of the axes from switch-on.

    Parameters
    ----------
    plant, limits
        The robot.
    posture
        Where it stands, rad, (n,).
    rng
        Draws how it was left, and how it repeats.
    """

    def __init__(self, plant: Plant, limits: Limits, posture: Array, rng: np.random.Generator) -> None:
        self._plant, self._limits, self._rng = plant, limits, rng
        n = plant.n
        self._gear_width = plant.friction.presliding * np.abs(np.diag(plant.drive.nominal))
        self._creeps = bool(plant.friction.creep.any())
        direction, motor, gear = rng.choice([-1.0, 1.0], (3, n))
        first = _Left(
            direction,
            motor,
            gear,
            np.tile(motor, (len(CONTACTS), 1)),
            np.zeros(n),
            self._wobble(),
            self._wobble(),
            np.zeros(n),
        )
        self._moves = [Move(-1.0, np.array(posture, dtype=float), np.zeros(n), 0.5, 0.25)]
        self._left = [first]
        self._starts = [-1.0]

    @property
    def end(self) -> float:
        """When the last move that is planned ends, s."""
        return self._moves[-1].end

    @property
    def target(self) -> Array:
        """Where it ends, rad, (n,)."""
        return self._moves[-1].target

    def add(self, one: Move) -> None:
        """Plan a move; it starts where and not before the last one ends."""
        self._left.append(self._after(self._moves[-1], self._left[-1], one))
        self._moves.append(one)
        self._starts.append(one.start)

    def brake(self, time: float) -> None:
        """Stop at a time: the move under way is cut, later ones are forgotten."""
        while len(self._moves) > 1 and self._starts[-1] > time:
            for kept in (self._moves, self._left, self._starts):
                kept.pop()
        self._moves[-1] = braked(self._limits, self._moves[-1], time)

    def forget(self, time: float) -> None:
        """Forget moves that ended before a time, but for the last ones."""
        keep = min(bisect_right(self._starts, time) - 1, len(self._moves) - REMEMBERED)
        if keep > REMEMBERED:
            del self._moves[:keep], self._left[:keep], self._starts[:keep]

    def at(self, times: Sequence[float]) -> Rows:
        """Return the axes at times, s."""
        which = [max(bisect_right(self._starts, time) - 1, 0) for time in times]
        moves, left = [self._moves[k] for k in which], [self._left[k] for k in which]
        rates = np.array([one.progress(time) for one, time in zip(moves, times, strict=True)])
        s, moved = rates[:, :1], rates[:, :1] > 0.0
        step = np.array([one.step for one in moves])
        motor = np.array([each.motor_state + part * each.turn for each, part in zip(left, rates[:, 0], strict=True)])
        motor = np.minimum(np.maximum(motor, -1.0), 1.0)
        gear = np.array([each.gear_state for each in left]) + s * step / self._gear_width
        if self._creeps:
            motor = np.array(
                [self._friction(*row)[0] for row in zip(moves, left, times, rates[:, 0].tolist(), strict=True)]
            )
        before = np.array([each.direction for each in left])
        off = [each.off if part == 0.0 else each.then for each, part in zip(left, rates[:, 0], strict=True)]
        return Rows(
            q=np.array([one.origin for one in moves]) + s * step,
            qd=rates[:, 1:2] * step,
            qdd=rates[:, 2:] * step,
            direction=np.where(moved & (step != 0.0), np.sign(step), before),
            motor_state=motor,
            gear_state=np.minimum(np.maximum(gear, -1.0), 1.0),
            off=np.array(off),
        )

    def stands(self, begin: float, end: float) -> bool:
        """Return whether the robot stands still all the time between two times, s."""
        k = max(bisect_right(self._starts, end) - 1, 0)
        return self._starts[k] <= begin and self._moves[k].end <= begin

    def travel(self, time: float) -> Array:
        """Return how far each axis has gone in all until a time, rad, (n,)."""
        k = max(bisect_right(self._starts, time) - 1, 0)
        return np.asarray(self._left[k].travel + self._moves[k].progress(time)[0] * np.abs(self._moves[k].step))

    def stood(self, time: float) -> tuple[Array, Array]:
        """Return where the robot stood before a time and now, rad, (m, n), and from which directions it came."""
        k = max(bisect_right(self._starts, time) - 1, 0)
        first = max(k - REMEMBERED, 0)
        ends = [one.origin for one in self._moves[first + 1 : k + 1]]
        came = [left.direction for left in self._left[first + 1 : k + 1]]
        now = self.at([time])
        return np.array([*ends, now.q[0]]), np.array([*came, now.direction[0]])

    def _after(self, one: Move, left: _Left, following: Move) -> _Left:
        """The state of the drives after a move, when the next one begins."""
        s = one.progress(one.end)[0]
        motor, contacts = self._friction(one, left, following.start, s)
        return _Left(
            direction=np.where(one.step == 0.0, left.direction, np.sign(one.step)) if s > 0.0 else left.direction,
            motor_state=motor,
            gear_state=np.clip(left.gear_state + s * one.step / self._gear_width, -1.0, 1.0),
            contacts=contacts,
            travel=left.travel + s * np.abs(one.step),
            off=left.then if s > 0.0 else left.off,
            then=self._wobble(),
            turn=motor_angles(self._plant.drive, following.step[None])[0] / self._plant.friction.presliding,
        )

    def _friction(self, one: Move, left: _Left, time: float, s: float) -> tuple[Array, Array]:
        """States of the motors' dry friction, (n,), and of the contacts that creep, (4, n)."""
        turn, creep = left.turn, self._plant.friction.creep
        state = np.clip(left.motor_state + s * turn, -1.0, 1.0)
        if not self._creeps:
            return state, left.contacts
        now, moving = left.contacts, max(min(time, one.end), one.start)
        done = 0.0
        for begin in np.arange(one.start, moving, CREEP_STEP):
            upto = min(begin + CREEP_STEP, moving)
            further = one.progress(upto)[0]
            kept = np.exp(-(upto - begin) * creep / CONTACTS)
            now = np.clip(now * kept + (further - done) * turn / CONTACTS, -1.0, 1.0)
            done = further
        now = now * np.exp(-max(time - moving, 0.0) * creep / CONTACTS)
        return np.where(creep > 0.0, now.mean(axis=0), state), now

    def _wobble(self) -> Array:
        """A draw of the robot's repeatability, rad, (n,)."""
        return np.asarray(self._plant.instrument.repeatability * self._rng.standard_normal(self._plant.n), dtype=float)
