"""Temperatures: of the room, of the links that the motors warm, of the motors, and of the steel under a sensor."""

from dataclasses import dataclass

import numpy as np

from experiments.second_world.arrays import Array, stream

__all__ = ["Climate", "lagged"]


@dataclass(frozen=True)
class Climate:
    """How warm the room and the robot get; temperatures follow the time that the robot has worked."""

    ambient_C: float
    swing_K: float  # half of the room's slow swing
    swing_s: float
    swing_phase_rad: float
    link_rise_K: Array  # (n,) final rise of each link
    link_s: Array  # (n,) time constants
    motor_rise_K: Array  # (n,)
    motor_s: Array  # (n,)

    @staticmethod
    def draw(seed: int, n: int) -> "Climate":
        """Draw the climate of a robot of n joints."""
        rng = stream(seed, "climate")
        return Climate(
            ambient_C=21.5 + 1.5 * rng.standard_normal(),
            swing_K=1.3 * float(np.exp(0.3 * rng.standard_normal())),
            swing_s=2600.0 * float(np.exp(0.25 * rng.standard_normal())),
            swing_phase_rad=rng.uniform(0, 2 * np.pi),
            link_rise_K=8.0 * np.exp(0.3 * rng.standard_normal(n)),
            link_s=1800.0 * np.exp(0.3 * rng.standard_normal(n)),
            motor_rise_K=22.0 * np.exp(0.25 * rng.standard_normal(n)),
            motor_s=1200.0 * np.exp(0.3 * rng.standard_normal(n)),
        )

    def ambient(self, time_s: Array) -> Array:
        """Temperature of the room (S,), °C: a slow swing on its mean."""
        return self.ambient_C + self.swing_K * np.sin(2 * np.pi * time_s / self.swing_s + self.swing_phase_rad)

    def links(self, time_s: Array, work_s: Array) -> Array:
        """Surface temperatures of the links (S, n), °C, after `work_s` seconds of work (S,)."""
        return np.asarray(self.ambient(time_s)[:, None] + self.link_rise_K * -np.expm1(-work_s[:, None] / self.link_s))

    def motors(self, time_s: Array, work_s: Array) -> Array:
        """Temperatures of the motors (S, n), °C."""
        rise = self.motor_rise_K * -np.expm1(-work_s[:, None] / self.motor_s)
        return np.asarray(self.ambient(time_s)[:, None] + rise)


def lagged(values: Array, time_s: Array, lag_s: float) -> Array:
    """
    Follow a signal with a first-order lag.

    Parameters
    ----------
    values
        Signal (S,).
    time_s
        Its times (S,), s, not falling.
    lag_s
        Time constant.

    Returns
    -------
    Array
        The lagged signal (S,); it begins at the signal's own first value.
    """
    out = np.array(values, dtype=float)
    for k in range(1, len(out)):
        keep = np.exp(-(time_s[k] - time_s[k - 1]) / lag_s)
        out[k] = values[k] + (out[k - 1] - values[k]) * keep
    return out
