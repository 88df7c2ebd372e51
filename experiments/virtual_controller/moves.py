"""Point-to-point moves of a controller, and how they end early: all axes start and stop together.

A move goes s = 0 … 1 along a straight line in joint space, with trapezoidal speed of duration T and ramp r at both
ends: top rate 1/(T − r). Braking leaves the line nowhere: the rate falls at a steeper, constant slope.
Source: Lynch & Park, Modern Robotics, section 9.2.2.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from experiments.virtual_robot import RobotDescription
from experiments.virtual_robot.description import Array

__all__ = ["Limits", "Move", "beyond", "braked", "limits_of", "move"]

RAMP_TIME = 0.5  # s to the top speed: no description has accelerations
SPEED = 1.0  # rad/s, where a description has no top speed
SHORTEST_MOVE = 0.012  # s: one cycle of the interpolator
ROUND = 1e-6  # rad, what a four-byte float may add to an angle at its limit
BRAKE = 2.0  # times the acceleration of a usual move, when a move is stopped


@dataclass(frozen=True)
class Limits:
    """Ranges, top speeds and accelerations of the axes, rad and s, (n,)."""

    lower: Array
    upper: Array
    speed: Array
    acceleration: Array


def limits_of(robot: RobotDescription) -> Limits:
    """Return the limits that a description promises."""
    speed = np.array([SPEED if j.max_speed is None else float(j.max_speed) for j in robot.joints])
    lower, upper = (np.array([float(getattr(j, side)) for j in robot.joints]) for side in ("lower", "upper"))
    return Limits(lower, upper, speed, speed / RAMP_TIME)


def beyond(limits: Limits, target: Array) -> bool:
    """Return whether a target, rad, (n,), is out of the axes' ranges."""
    return bool(np.any(target < limits.lower - ROUND) or np.any(target > limits.upper + ROUND))


@dataclass(frozen=True)
class Move:
    """One move, and the memory of the drives when it began.

    Attributes
    ----------
    start
        When it begins, s.
    origin, step
        Where it begins and how far it would go, rad, (n,).
    duration, ramp
        T and r, s.
    cut
        Seconds after the start at which it is stopped; infinite if it is not.
    slope
        How fast its rate falls then, 1/s².
    """

    start: float
    origin: Array
    step: Array
    duration: float
    ramp: float
    cut: float = math.inf
    slope: float = 0.0

    @property
    def end(self) -> float:
        """When it stands, s."""
        return self.start + (self.duration if self.cut >= self.duration else self.cut + self._rate_at_cut / self.slope)

    @property
    def target(self) -> Array:
        """Where it stands in the end, rad, (n,)."""
        return np.asarray(self.origin + self.progress(self.end)[0] * self.step, dtype=float)

    @property
    def _rate_at_cut(self) -> float:
        return self._planned(self.cut)[1]

    def progress(self, time: float) -> tuple[float, float, float]:
        """Return s and its first two derivatives at a time, s."""
        since = time - self.start
        if since <= self.cut:
            return self._planned(since)
        s, rate, _ = self._planned(self.cut)
        if rate <= 0.0:
            return s, 0.0, 0.0
        late = min(since - self.cut, rate / self.slope)
        still = late >= rate / self.slope
        return (
            s + rate * late - 0.5 * self.slope * late**2,
            0.0 if still else rate - self.slope * late,
            0.0 if still else -self.slope,
        )

    def _planned(self, t: float) -> tuple[float, float, float]:
        T, r = self.duration, self.ramp
        if t <= 0.0:
            return 0.0, 0.0, 0.0
        if t >= T:
            return 1.0, 0.0, 0.0
        top = 1.0 / (T - r)
        if t < r:
            return 0.5 * top * t**2 / r, top * t / r, top / r
        if t > T - r:
            left = T - t
            return 1.0 - 0.5 * top * left**2 / r, top * left / r, -top / r
        return top * (t - 0.5 * r), top, 0.0


def move(limits: Limits, start: float, origin: Array, target: Array, share: float) -> Move:
    """Return the quickest move from standing to standing within ``share`` of the top speeds."""
    step = np.asarray(target - origin, dtype=float)
    size = np.maximum(np.abs(step), 1e-12)
    rate = float(np.min(share * limits.speed / size))
    gain = float(np.min(limits.acceleration / size))
    duration, ramp = (1 / rate + rate / gain, rate / gain) if rate**2 < gain else (2 / gain**0.5, 1 / gain**0.5)
    slower = max(SHORTEST_MOVE / duration, 1.0)
    return Move(start, np.array(origin, dtype=float), step, duration * slower, ramp * slower)


def braked(limits: Limits, one: Move, time: float) -> Move:
    """Return a move that is stopped at a time; one that is over then is returned as it is."""
    since = max(time - one.start, 0.0)
    if since >= min(one.duration, one.cut):
        return one
    slope = float(np.min(BRAKE * limits.acceleration / np.maximum(np.abs(one.step), 1e-12)))
    return replace(one, cut=since, slope=slope)
