"""Torques at which springs, gaps and the clamp take up what the motors of a clamped arm do."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pytest

from clampid.catalogue import catalogue
from clampid.effect import Stage
from clampid.slots import slots_of
from clampid.stages.clamped import joint_torques
from clampid.stages.fit_problem import FitProblem, fit_problem
from clampid.stages.rows import Rows

STIFF = 0.1  # of its loops' compliance has a drive without a spring in the model


def trial(rows: Rows, *names: str) -> FitProblem:
    effects = catalogue()
    return fit_problem(rows, effects, tuple(s for name in names for s in slots_of(effects[name], rows.layout)))


def torques(of: FitProblem, theta: np.ndarray) -> np.ndarray:
    count = len(of.slots)
    return joint_torques(of.rows, of.chain, theta[:count], theta[count:])


def loops(rows: Rows) -> np.ndarray:
    """The loops' compliance at the joints, rad/Nm."""
    T = np.asarray(rows.robot.transmission)
    return np.asarray(np.diag(T.T @ np.diag(rows.sweep.loop_compliance) @ T))


def test_a_drive_without_a_spring_is_ten_times_as_stiff_as_its_loops(few_rows: Mapping[Stage, Rows]) -> None:
    rows = few_rows["clamped"]
    of = trial(rows, "coulomb_friction")
    np.testing.assert_allclose(torques(of, of.start()), rows.sweep.wound / (STIFF * loops(rows)), rtol=1e-9)


def test_nothing_stiffens_a_drive_with_a_spring(few_rows: Mapping[Stage, Rows]) -> None:
    rows = few_rows["clamped"]
    of = trial(rows, "joint_compliance")
    theta, T = of.start(), np.asarray(rows.robot.transmission)
    theta[: len(of.slots)] = c = np.linspace(0.05, 2.0, len(of.slots))
    # q = T' diag(c) T tau, for row vectors
    expected = rows.sweep.wound @ np.linalg.inv(T.T @ np.diag(c) @ T)
    np.testing.assert_allclose(torques(of, theta), expected, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("joint", [0, 3])
def test_hysteresis_turns_the_joint_by_its_loop(few_rows: Mapping[Stage, Rows], joint: int) -> None:
    """On an arm with linear springs, torques are those of the angle that it adds, and of the joint alone."""
    rows = few_rows["clamped"]
    of = trial(rows, "joint_compliance", "hysteresis")
    theta, T = of.start(), np.asarray(rows.robot.transmission)
    springs = [k for k, s in enumerate(of.slots) if s.effect == "joint_compliance"]
    theta[springs] = c = np.linspace(0.05, 2.0, len(springs))
    before = torques(of, theta)
    parts = [k for k, s in enumerate(of.slots) if s.effect == "hysteresis" and s.place == f"joint{joint + 1}"]
    theta[parts] = a = np.array([1e-4, 3e-4, 2e-4])
    turned = np.zeros_like(before)
    turned[:, joint] = rows.signals["slip"].reshape(len(rows), -1, 3)[:, joint] @ a
    expected = before + turned @ np.linalg.inv(T.T @ np.diag(c) @ T)
    np.testing.assert_allclose(torques(of, theta), expected, rtol=1e-8, atol=1e-8)


def test_what_slips_slips_with_the_load(few_rows: Mapping[Stage, Rows]) -> None:
    """A drive that stands still has no loop of its own, but its load may change with that of coupled ones."""
    rows = few_rows["clamped"]
    slip = rows.signals["slip"].reshape(len(rows), -1, 3)
    driven = rows.sweep.driven
    for joint in np.unique(driven):
        mine = slip[driven == joint]
        assert np.abs(mine[:, joint]).max() == pytest.approx(1.0)  # it slips, both ways
        assert mine[:, joint].min() < -0.5
        if joint < 3:
            assert not slip[driven == joint][:, np.arange(slip.shape[1]) != joint].any()
