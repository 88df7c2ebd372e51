"""Fixtures of the virtual robot's tests."""

import numpy as np
import pytest

from experiments.virtual_robot import Measured, measure
from experiments.virtual_robot.bodies import Bodies
from experiments.virtual_robot.plant import Plant
from experiments.virtual_robot.sampling import Site
from kinematics.description import RobotDescription, load_robot


@pytest.fixture(scope="session")
def robot() -> RobotDescription:
    return load_robot("kuka_kr20_r1810")


@pytest.fixture(scope="session")
def site(robot: RobotDescription) -> Site:
    return Site(robot)


@pytest.fixture(scope="session")
def clean(robot: RobotDescription) -> Measured:
    return measure(robot, seed=3, poses=60)


@pytest.fixture(scope="session")
def plant(clean: Measured) -> Plant:
    return clean.truth.plant


@pytest.fixture(scope="session")
def bodies(plant: Plant) -> Bodies:
    return Bodies(plant.geometry, plant.masses)


@pytest.fixture
def q(site: Site) -> np.ndarray:
    return site.configurations(20, 0.85, 2 * np.pi, np.random.default_rng(5))
