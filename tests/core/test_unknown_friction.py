"""Dry friction that poses do not tell: what is known of the product with the spring stays known in predictions."""

from __future__ import annotations

import numpy as np
import pytest

from clampid.catalogue import catalogue
from clampid.identification.identify import identify, stage_rows
from clampid.models.model import StageModel
from clampid.stages.fit_problem import fit_problem
from clampid.stages.layout import layout_of
from experiments.campaign import Campaign
from experiments.simulate import measured_campaign
from experiments.virtual_robot import measure
from kinematics.description import load_robot

EFFECTS = ("geometry", "joint_compliance", "backlash", "gravity", "wrist_coupling_friction")


@pytest.fixture(scope="module")
def campaign() -> Campaign:
    robot = load_robot("kuka_kr20_r1810")
    return measured_campaign(measure(robot, seed=5, poses=120, tables=("poses",)), robot)


@pytest.fixture(scope="module")
def stage(campaign: Campaign) -> StageModel:
    return identify(campaign, {"poses": EFFECTS}).stages["poses"]


def test_a_friction_that_no_row_determines_is_none(stage: StageModel) -> None:
    """Joint 1 is upright: it bears no load, and its friction winds up its spring by what its gap could be as well."""
    values = {s.label: (v, ok) for s, v, ok in zip(stage.slots, stage.theta, stage.identified, strict=True)}
    value, identified = values["wrist_coupling_friction.F@joint1"]
    assert not identified
    assert abs(value) < 1e-6


def test_what_is_stated_of_a_measured_pose_is_what_the_poses_determine(campaign: Campaign, stage: StageModel) -> None:
    """Of P parameters told by rows, predictions of these rows know P of their variances, not thousands."""
    rows = stage_rows([campaign], layout_of([campaign]), "poses")
    trial = fit_problem(rows, catalogue(), stage.slots).with_flanks(stage.theta)
    _, jacobian = trial.residual(stage.theta)
    stated = np.einsum("nip,pq,niq->n", jacobian[:, :3], stage.covariance, jacobian[:, :3])
    noise = float(np.mean(rows.sigma[:, 0] ** 2))
    assert stated.sum() / noise < 3.0 * len(stage.slots)
