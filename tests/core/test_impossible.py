"""Values that a fit puts clearly beyond their physical bounds."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from clampid.diagnosis.impossible import SURE, impossible_values
from clampid.fitting.solve import Estimate
from clampid.identification.identify import identify
from clampid.identification.model_on_campaign import on_campaign
from experiments.campaign import Campaign


@pytest.fixture(scope="module")
def fitted(simulated: Callable[..., Campaign]) -> Estimate:
    arm = simulated(seed=3, poses=60, tables=("poses",), hidden=(), robot="ur10")
    return on_campaign(identify(arm, ("geometry", "joint_compliance")), arm).refit("poses").estimate


def test_a_spring_of_negative_stiffness_is_impossible_only_if_its_error_is_small(fitted: Estimate):
    number = next(k for k, s in enumerate(fitted.slots) if s.effect == "joint_compliance" and s.place == "joint2")
    std = float(np.sqrt(fitted.covariance[number, number]))
    assert impossible_values(fitted) == frozenset()
    for errors, expected in ((-0.9 * SURE, set()), (-1.1 * SURE, {fitted.slots[number]})):
        theta = fitted.theta.copy()
        theta[number] = fitted.problem.bounds()[0][number] + errors * std
        assert impossible_values(replace(fitted, theta=theta)) == expected
