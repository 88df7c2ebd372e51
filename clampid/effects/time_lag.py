"""Torques logged late, or early, against the positions."""

from __future__ import annotations

from typing import Any

from clampid.effect import Effect, Parameter


def torque(p: Any, x: Any) -> Any:
    """tau(t - dt) = tau(t) - dt dtau/dt, tau of gravity: the rate of the measured torque would be mostly noise."""
    return -p.dt * x.torque_rate


EFFECT = Effect(
    name="time_lag",
    family="time_lag",
    acts={"motor_torque": torque},
    parameters=(Parameter("dt", "s", 0.02, bounds=(-1.0, 1.0), meaning="delay of the logged torques"),),
    needs=("torque_rate",),
    stages=("free_air",),
    equation="d tau_motor = -dt d(tau_motor)/dt, of the weight described",
    source=("Armstrong1994",),
    at="log",
)
