"""What the points of one visit share: two variances told apart, and errors of a fit that count it."""

from __future__ import annotations

import numpy as np
import pytest

from clampid.fitting.noise import Whitened
from clampid.fitting.repeatability import Scatter, clustered_covariance, visit_scatter

VISITS, NUMBERS, JOINTS, PARAMETERS = 300, 9, 3, 40
JOINT_STD = np.array([0.6, 0.0, 1.2])


class Design:
    """A linear fit whose numbers share, visit by visit, where some joints have stopped."""

    def __init__(self, seed: int) -> None:
        rng = np.random.default_rng(seed)
        self.visit = rng.permutation(np.repeat(np.arange(VISITS), NUMBERS))
        # The joints' effect on a visit's numbers, and columns of the fit that look much like it.
        of_visit = rng.normal(size=(VISITS, JOINTS))
        self.by_joint = of_visit[self.visit] + 0.3 * rng.normal(size=(VISITS * NUMBERS, JOINTS))
        mixing = rng.normal(size=(JOINTS, PARAMETERS))
        slow = rng.normal(size=(VISITS, PARAMETERS))
        self.X = 0.3 * self.by_joint @ mixing + slow[self.visit] + 0.5 * rng.normal(size=(len(self.visit), PARAMETERS))
        self.precision = np.diag(np.full(PARAMETERS, 1e-2))
        self.inverse = np.linalg.inv(self.X.T @ self.X + self.precision)

    def errors(self, rng: np.random.Generator) -> np.ndarray:
        stops = JOINT_STD * rng.normal(size=(VISITS, JOINTS))
        return rng.normal(size=len(self.visit)) + np.einsum("mj,mj->m", self.by_joint, stops[self.visit])

    def white(self, errors: np.ndarray) -> Whitened:
        nothing = np.zeros(len(errors), dtype=np.int64)
        return Whitened(errors - self.X @ (self.inverse @ (self.X.T @ errors)), self.X, nothing, nothing)


@pytest.fixture(scope="module")
def design() -> Design:
    return Design(0)


def test_noise_and_every_joints_scatter_are_separated(design: Design) -> None:
    rng = np.random.default_rng(1)
    found = [
        visit_scatter(design.white(design.errors(rng)), design.by_joint, design.visit, design.inverse)
        for _ in range(20)
    ]
    told = [s for s in found if s is not None]
    assert len(told) == len(found)
    assert np.mean([s.noise for s in told]) == pytest.approx(1.0, abs=0.04)
    variance = np.mean([s.joints**2 for s in told], axis=0)
    # A fit of 40 parameters to 300 visits has absorbed up to a seventh of what visits share; none is below zero.
    assert variance == pytest.approx(JOINT_STD**2, abs=PARAMETERS / VISITS * JOINT_STD.max() ** 2)


def test_the_covariance_is_that_of_many_repeated_fits(design: Design) -> None:
    rng = np.random.default_rng(2)
    white = design.white(design.errors(rng))
    scatter = Scatter(1.0, JOINT_STD)
    C = clustered_covariance(white, design.by_joint, design.visit, design.precision, scatter, design.inverse)
    estimates = np.array([design.inverse @ (design.X.T @ design.errors(rng)) for _ in range(2000)])
    # With a prior this weak nearly all of it is the data's.
    assert np.sqrt(np.mean(estimates**2, axis=0)) == pytest.approx(np.sqrt(np.diag(C)), rel=0.12)
    assert (np.diag(C) > 1.5 * np.diag(design.inverse)).mean() > 0.5  # independent numbers would be far too sure


def test_independent_numbers_have_the_usual_covariance(design: Design) -> None:
    white = design.white(np.random.default_rng(3).normal(size=len(design.visit)))
    found = visit_scatter(white, design.by_joint, design.visit, design.inverse)
    assert found is not None
    C = clustered_covariance(white, design.by_joint, design.visit, design.precision, found, design.inverse)
    assert np.sqrt(np.diag(C)) == pytest.approx(np.sqrt(np.diag(design.inverse)), rel=0.12)
    usual = clustered_covariance(
        white, design.by_joint, design.visit, design.precision, Scatter(1.0, np.zeros(JOINTS)), design.inverse
    )
    assert usual == pytest.approx(design.inverse, rel=1e-9, abs=1e-12)


def test_one_point_a_visit_or_few_visits_do_not_determine_it(design: Design) -> None:
    white = design.white(np.random.default_rng(4).normal(size=len(design.visit)))
    alone = np.arange(len(design.visit)) // 3
    assert visit_scatter(white, design.by_joint, alone, design.inverse) is None
    few = np.flatnonzero(design.visit < 10)
    part = Whitened(white.residual[few], white.jacobian[few], white.entry[few], white.channel[few])
    assert visit_scatter(part, design.by_joint[few], design.visit[few], design.inverse) is None
