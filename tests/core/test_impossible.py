"""Values that a fit puts clearly beyond their physical bounds."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from clampid.catalogue import catalogue
from clampid.diagnosis.impossible import SURE, impossible_values
from clampid.fitting.solve import Estimate
from clampid.identification.identify import identify
from clampid.identification.model_on_campaign import on_campaign
from clampid.slots import Slot
from clampid.stages.fit_problem import parameter_of
from experiments.campaign import Campaign
from kinematics.description import load_robot
from kinematics.masses import own_moment


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


@pytest.mark.parametrize(("effect", "name", "place"), [("bearing_tilt", "c", "joint"), ("link_bending", "f", "link")])
def test_the_structure_of_a_wrist_may_yield_as_much_more_as_it_carries_less(effect: str, name: str, place: str):
    robot, effects = load_robot("ur10"), catalogue()
    shoulder, wrist = (parameter_of(Slot(effect, name, f"{place}{k}"), effects, robot) for k in (2, 5))
    ratio = own_moment(robot, 1) / own_moment(robot, 4)
    assert ratio > 5.0
    assert wrist.size == shoulder.size
    assert wrist.bounds[1] / shoulder.bounds[1] == pytest.approx(ratio)
