"""Derivatives that no search changes, computed once, are those that are computed at every point."""

from __future__ import annotations

import numpy as np
import pytest

from clampid.catalogue import catalogue
from clampid.chain import steady
from clampid.identification.fitted_stage import active_slots
from clampid.slots import Term
from clampid.stages import poses
from clampid.stages.fit_problem import FitProblem, fit_problem
from clampid.stages.layout import layout_of
from clampid.stages.pose_rows import pose_rows
from experiments.campaign import Campaign

CURVES = ("joint_angle_curve", "shared_angle_curve")


def arm(campaign: Campaign, *names: str) -> FitProblem:
    rows = pose_rows([campaign], layout_of([campaign]), "poses")
    return fit_problem(rows, catalogue(), active_slots(rows, catalogue(), [Term(name, None) for name in names]))


@pytest.mark.parametrize("curve", CURVES)
def test_parted_derivatives_are_those_of_one_function(tiny: Campaign, curve: str, monkeypatch: pytest.MonkeyPatch):
    names = ("geometry", "joint_compliance", "backlash", curve)
    parted = arm(tiny, *names)
    monkeypatch.setattr(steady, "WORTH", 10**6)
    whole = arm(tiny, *names)
    assert parted.chain.steady is not None
    assert whole.chain.steady is None
    rng = np.random.default_rng(5)
    for _ in range(2):
        theta = parted.start() + 0.1 * parted.sizes() * rng.normal(size=len(parted.sizes()))
        mine, expected = (poses.evaluate(e.rows, e.chain, theta) for e in (parted, whole))
        np.testing.assert_allclose(mine.values, expected.values, rtol=1e-12, atol=1e-15)
        np.testing.assert_array_equal(mine.parameter, expected.parameter)
        np.testing.assert_allclose(mine.partials, expected.partials, rtol=1e-12, atol=1e-15)
        held, other = (poses.frozen_flanks(e.rows, e.chain, theta) for e in (parted, whole))
        for name in other:
            np.testing.assert_allclose(held[name], other[name], rtol=1e-12, atol=1e-12)


def test_cached_fit_is_not_reused_for_other_rows_or_fixed_parameters(tiny: Campaign):
    trial = arm(tiny, "geometry", "joint_angle_curve")
    rng = np.random.default_rng(6)
    theta = trial.start() + 0.1 * trial.sizes() * rng.normal(size=len(trial.sizes()))
    first = poses.evaluate(trial.rows, trial.chain, theta)
    few = trial.rows.take(np.arange(0, len(trial.rows), 3))
    np.testing.assert_array_equal(poses.evaluate(few, trial.chain, theta).partials, first.partials[::3])
    rms = next(k for k, slot in enumerate(trial.slots) if slot.parameter == "rms")
    twice = theta.copy()
    twice[rms] *= 2.0
    changed = poses.evaluate(trial.rows, trial.chain, twice)
    curve = trial.chain.steady
    assert curve is not None
    own = np.isin(changed.parameter, [k for k, s in enumerate(trial.slots) if s.effect == "joint_angle_curve"])
    np.testing.assert_allclose(changed.partials[:, own], 2.0 * first.partials[:, own], rtol=1e-12)
