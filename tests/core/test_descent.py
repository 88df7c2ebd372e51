"""Searches downhill: along a bent, stiff valley no fixed least damping makes them creep."""

from __future__ import annotations

import numpy as np
import pytest

from clampid.fitting import descent
from clampid.fitting.descent import Limits, descend

STIFF, SOFT = 1e3, 10.0


class Valley:
    """Rosenbrock's: the floor is the parabola y = x², along which the cost falls slowly to (1, 1)."""

    count = 2

    def __init__(self, theta: np.ndarray) -> None:
        x, y = theta
        self.theta = theta
        self.residual = np.array([STIFF * (y - x**2), SOFT * (1.0 - x)])
        self.jacobian = np.array([[2.0 * STIFF * x, -STIFF], [SOFT, 0.0]])

    @property
    def cost(self) -> float:
        return float(self.residual @ self.residual)

    def normal(self) -> tuple[np.ndarray, np.ndarray]:
        return self.jacobian.T @ self.jacobian, self.jacobian.T @ self.residual


def end_of_search() -> tuple[Valley, int]:
    free = Limits(np.ones(2), np.full(2, -np.inf), np.full(2, np.inf), np.zeros(2, dtype=bool))
    return descend(Valley, np.array([-1.2, 1.44]), 1e-12 * np.eye(2), np.zeros(2), free)


def test_a_stiff_bent_valley_is_followed_farther_than_with_a_fixed_least_damping(monkeypatch: pytest.MonkeyPatch):
    free, iterations = end_of_search()
    monkeypatch.setattr(descent, "LESS_DAMPING", 1.0)
    fixed, same = end_of_search()
    assert iterations == same == descent.ITERATIONS
    assert free.cost < 0.5 * fixed.cost < 0.5 * Valley(np.array([-1.2, 1.44])).cost
