"""Parts of diagnosis and held-out errors: sizes on either side of a gear, and folds by one step."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from clampid.accuracy import FOLDS, cross_validated
from clampid.catalogue import catalogue
from clampid.fit import solve
from clampid.identify import identify
from clampid.reopen import reopen
from clampid.slots import Slot
from clampid.stages.experiment import parameter_of
from experiments.campaign import Campaign
from kinematics.description import load_robot


@settings(deadline=None)  # the first call reads the catalogue
@given(st.floats(1.0, 300.0), st.sampled_from(["joint_compliance.c", "nonlinear_stiffness.h"]))
def test_a_size_at_the_joint_is_the_same_behind_any_gear(ratio: float, name: str):
    effect, own = name.split(".")
    parameter = catalogue()[effect].by_name[own]
    geared = parameter.geared(ratio)
    # A spring at the motor winds by c (tau / N), and the joint by that over N.
    power = 2 if own == "c" else 4
    assert geared.size / ratio**power == pytest.approx(parameter.size)
    assert geared.bounds[1] / ratio**power == pytest.approx(parameter.bounds[1])
    assert geared.prior_std / geared.size == pytest.approx(parameter.prior_std / parameter.size)


@pytest.mark.parametrize(("robot", "ratio"), [("ur10", 1.0), ("kuka_kr20_r1810", 167.11538)])
def test_usual_springs_are_possible_on_robots_with_and_without_gears(robot: str, ratio: float):
    slot = Slot("joint_compliance", "c", "joint2")
    parameter = parameter_of(slot, catalogue(), load_robot(robot))
    for at_joint in (1e-7, 8.7e-6, 1e-3):  # rad/Nm: stiff, a UR10's as measured, soft
        assert parameter.bounds[0] < at_joint * ratio**2 < parameter.bounds[1]
    assert 1e-6 < parameter.size / ratio**2 < 1e-3


def test_folds_by_one_step_are_folds_refitted(simulated: Callable[..., Campaign]):
    campaign = simulated(seed=7, poses=60, tables=("poses",))
    estimate = reopen(identify(campaign), campaign).refit("poses").estimate
    rows, found = cross_validated(estimate, estimate.experiment.rows, seed=3)
    order = rows.shuffled_folds(3)
    part = dict(zip(order.tolist(), (np.arange(len(order)) % FOLDS).tolist(), strict=True))
    of_row = np.array([part[f] for f in rows.fold.tolist()])
    held = estimate.experiment.with_flanks(estimate.theta)
    for k in range(FOLDS):
        keep, out = np.flatnonzero(of_row != k), np.flatnonzero(of_row == k)
        fitted = solve(
            held.with_rows(held.rows.take(keep)),
            estimate.theta,
            estimate.noise.at(keep),
            estimate.prior_precision,
            estimate.prior_mean,
        )
        expected = held.with_rows(held.rows.take(out)).residual(fitted.theta)[0]
        off = (found[out] - expected) / estimate.noise.sigma[out]
        assert np.sqrt(np.mean(off**2)) < 0.02  # of the noise
