"""Angle errors of any periodic shape: recovered from robots whose discs are known, not seen where there are none."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy import sparse

from clampid.catalogue import catalogue
from clampid.comparison.compare import compare
from clampid.diagnosis.candidate_scores import DICTIONARY_FALSE_ALARMS
from clampid.diagnosis.diagnose import diagnose
from clampid.diagnosis.probes import JOINT_ANGLE_PERIODIC, probes
from clampid.evidence.columns import Columns, Levers, Products, Sums
from clampid.evidence.flips import with_null
from clampid.evidence.joined import Joined
from clampid.evidence.score import score
from clampid.evidence.space import space_of
from clampid.identification.identify import identify
from clampid.identification.model_on_campaign import on_campaign
from clampid.models.curves import angle_errors
from clampid.models.model import Model
from experiments.campaign import Campaign, read_campaign
from experiments.virtual_robot import Hidden, measure
from kinematics.description import load_robot

Simulated = Callable[..., Campaign]

STANDARD = ("geometry", "joint_compliance", "backlash", "gravity", "wrist_coupling_friction")
DISC = "encoder_disc:3"
GRID = np.linspace(-np.pi, np.pi, 361)[:-1]


def true_curves(seed: int, robot: str = "ur10", hidden: str = DISC) -> np.ndarray:
    """What the hidden discs add to each joint's angle ``(M, n)``, rad, over a turn."""
    truth = measure(load_robot(robot), [Hidden.parse(hidden)], seed=seed, poses=2, tables=("poses",)).truth
    drive = truth.plant.drive
    marks = np.arange(drive.disc.shape[1] + 1) * 2 * np.pi / drive.disc.shape[1]
    turned = np.mod(drive.disc_sense * GRID[:, None] + drive.disc_turn, 2 * np.pi)
    read = [np.interp(turned[:, j], marks, np.r_[disc, disc[0]]) for j, disc in enumerate(drive.disc)]
    return np.asarray(drive.disc_sense * np.column_stack(read))


def slow_part(angle: np.ndarray) -> np.ndarray:
    """What geometry may take of a curve: a constant and once per revolution; and twice, that a few degrees decide."""
    return np.column_stack([np.ones_like(angle), *(f(k * angle) for k in (1, 2) for f in (np.sin, np.cos))])


@pytest.fixture(scope="module")
def disc(simulated: Simulated) -> tuple[Campaign, Model]:
    """A robot with faulty discs, and its model with the curves."""
    campaign = simulated(seed=2, poses=200, tables=("poses",), hidden=(DISC,), robot="ur10")
    return campaign, fitted(campaign)


def fitted(campaign: Campaign) -> Model:
    """The model with the curves; few poses are held out, so that nothing is cross-validated."""
    return identify(campaign, ("geometry", "joint_compliance", "backlash", "joint_angle_curve"), holdout=0.05)


def test_the_curve_is_the_hidden_disc_within_its_band(disc: tuple[Campaign, Model]):
    campaign, model = disc
    q = np.tile(GRID[:, None], (1, 6))
    found = angle_errors(model.stages["poses"], catalogue(), model.layout, campaign.robot, q)
    true = true_curves(seed=2)
    assert found.active.all()
    inside, left, whole = [], [], []
    for j in range(6):
        seen = ~found.extrapolated[:, j]
        assert seen.mean() > 0.5
        off = (found.error - true)[seen, j]
        slow = slow_part(GRID[seen])
        off = off - slow @ np.linalg.lstsq(slow, off, rcond=None)[0]
        left.append(np.mean(off**2))
        whole.append(np.mean(true[seen, j] ** 2))
        inside.append(np.mean(np.abs(off) < 2 * found.std[seen, j]))
    assert np.mean(left) < 0.5**2 * np.mean(whole)
    assert np.mean(inside) > 0.8


def test_where_no_pose_was_the_curve_fades_and_its_band_opens(disc: tuple[Campaign, Model]):
    campaign, _ = disc
    rows = campaign.tables["poses"]
    part = rows[np.sin(rows["q1_rad"]) > 0].reset_index(drop=True)  # the joint turns twice round
    half = replace(campaign, tables={"poses": part}, fingerprint="half")
    model = fitted(half)
    q = np.zeros((len(GRID), 6))
    q[:, 0] = GRID
    found = angle_errors(model.stages["poses"], catalogue(), model.layout, campaign.robot, q)
    never = (GRID < -0.3) & (GRID > -2.8)
    assert found.extrapolated[never, 0].all()
    assert np.allclose(found.std[never, 0], found.assumed[never, 0], rtol=0.35)
    visited = (GRID > 0.3) & (GRID < 2.8) & ~found.extrapolated[:, 0]
    assert np.std(found.error[never, 0]) < 0.5 * np.std(found.error[visited, 0])


@pytest.mark.parametrize(
    "seed", [pytest.param(0, marks=pytest.mark.slow), *(pytest.param(s, marks=pytest.mark.study) for s in (1, 2))]
)
def test_a_faulty_disc_is_named_at_every_joint(simulated: Simulated, seed: int):
    campaign = simulated(seed=seed, poses=250, tables=("poses", "verification"), hidden=(DISC,), robot="ur10")
    found = diagnose(identify(campaign, STANDARD), campaign).stages["poses"]
    first = found.candidates[0]
    assert (first["name"], first["effect"]) == ("joint_angle_curve", "gear_eccentricity")
    assert first["where"] == [f"joint{j}" for j in range(1, 7)]
    assert found.depends_on[:6] == [f"q{j}" for j in range(1, 7)]
    assert found.after < 0.4 * found.before


@pytest.mark.timeout(1800)
@pytest.mark.parametrize(
    ("robot", "first", "robots", "most"),
    [
        pytest.param("kuka_kr20_r1810", 0, 6, 1, marks=pytest.mark.study),
        pytest.param("kuka_kr20_r1810", 0, 20, 3, marks=pytest.mark.study),
        pytest.param("ur10", 100, 20, 3, marks=pytest.mark.study),
    ],
)
def test_without_a_faulty_disc_the_probe_is_silent(
    simulated: Simulated, robot: str, first: int, robots: int, most: int
):
    """At a rate of 1 % more than one alarm of six has a chance of 0.1 %, and more than three of twenty less."""
    alarms = 0
    for seed in range(first, first + robots):
        campaign = simulated(seed=seed, poses=100, tables=("poses",), robot=robot)
        model = identify(campaign, STANDARD)
        estimate = on_campaign(model, campaign).refit("poses").estimate
        space = space_of(estimate)
        scored, null = with_null(space, score(space, probes(estimate)), 199, seed)
        probe = next(s for s in scored if s.candidate.name == JOINT_ANGLE_PERIODIC)
        alarms += null.p_familywise(probe.log_p) <= DICTIONARY_FALSE_ALARMS
    assert alarms <= most


def test_products_are_the_columns_that_they_stand_for():
    rng = np.random.default_rng(0)
    entry = np.repeat(np.arange(20), 3)
    levers = Levers(rng.normal(size=(60, 2)), entry, 20)
    columns = Products(levers, (0, 1), (rng.normal(size=(20, 5)), rng.normal(size=(20, 12))))
    D = columns.dense(64)
    assert D.shape == (64, 17)
    assert not D[60:].any()
    for j, first in enumerate((0, 5)):
        for f in range(columns.functions[j].shape[1]):
            expected = levers.values[:, j] * columns.functions[j][entry, f]
            np.testing.assert_allclose(D[:60, first + f], expected)
    other, by_unit = rng.normal(size=(64, 4)), sparse.csc_matrix(rng.normal(size=(7, 64)))
    np.testing.assert_allclose(columns.gram(), D.T @ D)
    np.testing.assert_allclose(columns.times(other), D.T @ other)
    np.testing.assert_allclose(columns.times(other[:, 0]), D.T @ other[:, 0])
    np.testing.assert_allclose(Joined([columns]).summed(Sums(by_unit)).T, by_unit @ D)
    dense = Columns(((0, other[:60]),), 4)
    np.testing.assert_allclose(columns.cross(dense), D[:60].T @ other[:60])
    np.testing.assert_allclose(dense.cross(columns), other[:60].T @ D[:60])
    np.testing.assert_allclose(columns.cross(columns), D.T @ D)
    weights = rng.normal(size=(17, 3))
    np.testing.assert_allclose(columns.combined(weights, 64), D @ weights, atol=1e-12)
    np.testing.assert_allclose(dense.combined(weights[:4], 64), dense.dense(64) @ weights[:4], atol=1e-12)
    one = Products(levers, (1,), (columns.functions[0],))
    joined = Joined([dense, columns, one])
    all_of_them = np.hstack([dense.dense(64), D, one.dense(64)])
    np.testing.assert_allclose(joined.times(other), all_of_them.T @ other)
    np.testing.assert_allclose(joined.summed(Sums(by_unit)).T, by_unit @ all_of_them)
    assert [len(lines) for lines in joined.own(joined.times(other))] == [4, 17, 5]
    assert Joined([]).own(np.zeros((0, 4))) == []


@pytest.mark.timeout(3600)
@pytest.mark.study
@pytest.mark.parametrize("splits", [1, 5])
def test_the_ur10_of_the_public_measurements(splits: int, shared_folder: Path):
    """The effect of a real robot is found by name, and its error falls, also in another session."""
    folders = [shared_folder / "real" / f"ur10_series_{s}" for s in "cd"]
    if not all(f.is_dir() for f in folders):
        pytest.skip(f"no measurements of a UR10 in {shared_folder}")
    c, d = (read_campaign(f) for f in folders)
    found = diagnose(identify(d), d).stages["poses"]
    assert found.candidates[0]["name"] == "joint_angle_curve"
    assert found.depends_on[0].startswith("q")
    effects = ("geometry", "joint_compliance", "joint_angle_curve")
    means = np.zeros((splits, 4))
    for seed in range(splits):
        for k, campaign in enumerate((c, d)):
            model = identify(campaign, effects, holdout=0.2, seed=seed)
            means[seed, k] = compare(model, campaign).tables["poses"]["heldout"]["mean"]
        both = identify([c, d], effects, holdout=0.2, seed=seed)
        means[seed, 2:] = [compare(both, x).tables["poses"]["heldout"]["mean"] for x in (c, d)]
    assert np.all(means.mean(axis=0) <= np.array([1.2e-4, 1.8e-4, 1.2e-4, 1.9e-4]))
    old, new = (
        compare(identify(c, e), d, refit=("base", "tool")).tables["poses"]["heldout"]["mean"]
        for e in (("geometry",), effects)
    )
    assert new < 0.67 * old
