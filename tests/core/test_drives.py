"""Springs, clearances and the compliance matrix of a clamped stage, with their standard errors."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from clampid.catalogue import catalogue
from clampid.models.drives import DETECTION, clamped_drives, drives_of
from clampid.models.model import Model, ModelError, StageModel
from clampid.slots import Layout, Slot, Term
from clampid.verbs.output import Output
from clampid.verbs.show import parameter_rows, show_drives
from kinematics.description import RobotDescription, load_robot
from kinematics.transmission import Transmission

EFFECTS = (("joint_compliance", "c"), ("backlash", "gap"), ("coulomb_friction", "Fc"))


@pytest.fixture
def robot():
    return load_robot("kuka_kr20_r1810")


@pytest.fixture
def stage(robot) -> StageModel:
    rng = np.random.default_rng(0)
    slots = tuple(Slot(e, p, f"joint{j + 1}") for e, p in EFFECTS for j in range(6))
    theta = np.r_[1 / np.asarray(robot.motor_spring), np.full(6, 1e-4), np.full(6, 0.3)]
    root = np.diag(np.r_[0.01 * theta[:6], np.full(6, 1e-5), np.full(6, 0.01)]) @ (
        np.eye(18) + 0.1 * rng.random((18, 18))
    )
    return StageModel("clamped", tuple(Term(e) for e, _ in EFFECTS), slots, theta, root @ root.T, (True,) * 18)


def test_springs_are_those_of_the_transmission(stage: StageModel, robot):
    drives = drives_of(stage, robot)
    T = Transmission(robot.transmission)
    np.testing.assert_allclose(drives.stiffness, robot.motor_spring)
    np.testing.assert_allclose(drives.compliance, T.joint_compliance(robot.motor_spring), rtol=1e-12)
    # The joint side as ROBOT_FACTS has it, kNm/rad.
    np.testing.assert_allclose(drives.joint_stiffness / 1e3, [157, 396, 255, 13.1, 6.7, 1.3], rtol=0.02)


def test_standard_errors_are_those_of_a_sample(stage: StageModel, robot):
    rng = np.random.default_rng(1)
    sample = [
        drives_of(replace(stage, theta=rng.multivariate_normal(stage.theta, stage.covariance)), robot)
        for _ in range(4000)
    ]
    drives = drives_of(stage, robot)
    for name in ("stiffness", "joint_stiffness", "compliance", "gap", "friction"):
        spread = np.std([getattr(d, name) for d in sample], axis=0)
        np.testing.assert_allclose(getattr(drives, f"{name}_std"), spread, rtol=0.06, atol=1e-15)


def test_cross_springs_are_part_of_the_compliance(stage: StageModel, robot):
    x = Slot("cross_coupled_stiffness", "x", "joint5")
    wider = np.zeros((19, 19))
    wider[:18, :18] = stage.covariance
    with_x = replace(stage, slots=(*stage.slots, x), theta=np.r_[stage.theta, 0.1], covariance=wider)
    T, X = np.asarray(robot.transmission), np.zeros((6, 6))
    X[3, 4] = X[4, 3] = 0.1
    gained = drives_of(with_x, robot).compliance - drives_of(stage, robot).compliance
    np.testing.assert_allclose(gained, T.T @ X @ T, rtol=1e-9, atol=1e-18)


def test_a_clearance_differs_from_zero_beyond_its_limit(stage: StageModel, robot):
    drives = drives_of(stage, robot)
    np.testing.assert_allclose(drives.gap_limit, DETECTION * drives.gap_std)
    theta = stage.theta.copy()
    theta[6:12] = drives.gap_limit * [0.99, 1.01, 0.0, 3.0, 0.5, 1.5]
    assert drives_of(replace(stage, theta=theta), robot).gap_identified.tolist() == [
        False,
        True,
        False,
        True,
        False,
        True,
    ]


def test_what_is_not_in_the_model_is_not_known(stage: StageModel, robot, capsys: pytest.CaptureFixture[str]):
    part = replace(
        stage, slots=stage.slots[:5], theta=stage.theta[:5], covariance=stage.covariance[:5, :5], identified=(True,) * 5
    )
    drives = drives_of(part, robot)
    assert np.isnan(drives.gap).all()
    assert np.isnan(drives.stiffness[5])
    assert not drives.gap_identified.any()
    show_drives(drives, Output(False, None))
    assert "–" in capsys.readouterr().out
    friction = replace(part, slots=stage.slots[12:], theta=stage.theta[12:], covariance=stage.covariance[12:, 12:])
    with pytest.raises(ModelError, match="the stage clamped has no joint_compliance"):
        drives_of(friction, robot)
    model = Model(robot.name, Layout(6), {"clamped": friction}, ())
    assert clamped_drives(model, robot) is None
    assert clamped_drives(Model(robot.name, Layout(6), {}, ()), robot) is None


def test_tables_are_in_the_units_of_the_thesis(stage: StageModel, robot, capsys: pytest.CaptureFixture[str]):
    drives = drives_of(stage, robot)
    show_drives(drives, Output(False, None))
    shown = capsys.readouterr().out
    assert "9.92 ±" in shown
    assert "4 and 5" in shown
    assert f"{np.degrees(1e-4):.4f}" in shown
    data = json.loads(json.dumps(drives.to_json()))
    assert data["gap_limit_rad"] == pytest.approx(drives.gap_limit.tolist())
    assert set(data) >= {"stiffness_Nm_rad", "compliance_std_rad_Nm", "friction_Nm", "gap_told_from_zero"}


def test_a_clearance_on_its_limit_is_said_to_be(stage: StageModel, robot: RobotDescription):
    theta = stage.theta.copy()
    theta[8] = 0.0
    rows = parameter_rows(replace(stage, theta=theta), catalogue(), robot)
    assert {row[4] for row in rows if row[0] == "joint_compliance.c"} == {"mrad/Nm at the motor"}
    assert [row[:2] for row in rows if "one side" in row[-1]] == [("backlash.gap", "joint3")]
