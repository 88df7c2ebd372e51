"""Fixtures of the exports' tests: models with given errors of geometry."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from clampid.effect import Stage
from clampid.models.model import Model, Session, StageModel
from clampid.slots import Layout, Slot, Term
from kinematics.description import load_robot
from kinematics.screws import exp_se3

AXES = ("rx", "ry", "rz", "x", "y", "z")


@pytest.fixture
def make_model() -> Callable[..., Model]:
    """Give a model of a robot whose geometry deviates at random; nothing is fitted."""

    def make(name: str, size: float = 1e-3, seed: int = 0, std: float = 1e-5) -> Model:
        rng = np.random.default_rng(seed)
        robot = load_robot(name)
        slots = [Slot("geometry", f"base_{axis}", "session1") for axis in AXES]
        slots += [Slot("geometry", f"flange_{axis}", "session1") for axis in AXES]
        slots += [Slot("geometry", axis, f"link{i + 1}") for i in range(robot.n) for axis in AXES]
        slots += [Slot("backlash", "gap", "joint1")]
        theta = size * rng.standard_normal(len(slots))
        stage: Stage = "poses"
        fitted = StageModel(
            stage, (Term("geometry"), Term("backlash")), tuple(slots), theta, std**2 * np.eye(len(slots)),
            (True,) * len(slots),
        )  # fmt: skip
        base = exp_se3(np.array([0.1, -0.2, 2.0, 1.0, -2.0, 0.5]))
        return Model(name, Layout(robot.n), {stage: fitted}, (Session("made", "", base, (), 0.0),))

    return make
