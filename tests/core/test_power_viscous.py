"""Friction that grows with a power of speed below 1."""

from __future__ import annotations

from types import SimpleNamespace

import casadi as ca
import pytest

from clampid.catalogue import catalogue

EFFECT = catalogue()["power_viscous_friction"]


def torque(w: float, Fp: float, a: float, wr: float) -> float:
    speed = ca.SX.sym("w")
    law = EFFECT.acts["motor_torque"](SimpleNamespace(Fp=Fp, a=a, wr=wr), SimpleNamespace(motor_speed=speed))
    return float(ca.Function("law", [speed], [law])(w))


@pytest.mark.parametrize("w", [0.02, 0.3, 1.0, 4.0])
def test_friction_is_a_power_of_speed_against_the_motion(w: float):
    assert torque(w, 2.0, 0.55, 1.0) == pytest.approx(2.0 * w**0.55, rel=2e-3)
    assert torque(-w, 2.0, 0.55, 1.0) == -torque(w, 2.0, 0.55, 1.0)


def test_friction_at_rest_is_zero_and_its_slope_is_finite():
    assert torque(0.0, 2.0, 0.4, 1.0) == 0.0
    assert torque(1e-6, 2.0, 0.4, 1.0) < 2e-3


def test_the_amplitude_is_the_friction_at_the_joints_reference_speed_whatever_the_gear():
    parameters = {p.name: p.geared(100.0) for p in EFFECT.parameters}
    assert parameters["wr"].grid[0] == pytest.approx(100.0)
    assert torque(100.0, 0.3, 0.6, parameters["wr"].grid[0]) == pytest.approx(0.3, rel=1e-6)
    assert parameters["Fp"].size == pytest.approx(EFFECT.parameters[0].size / 100.0)


def test_it_only_thins():
    bounds = {p.name: p.bounds for p in EFFECT.parameters}
    assert bounds["Fp"][0] == 0.0
    assert bounds["a"][1] < 1.0  # at 1 it would be viscous friction, and not be identified beside it
