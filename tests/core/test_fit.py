"""The fit: what is recovered on robots whose truth is known, what is rejected, and what is said to be untold."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from clampid.catalogue import catalogue
from clampid.diagnosis.diagnose import diagnose
from clampid.effect import EffectError, Parameter
from clampid.fitting.fit import fit
from clampid.fitting.nulls import null_directions
from clampid.fitting.solve import FitError
from clampid.identification.identify import identify, stage_rows
from clampid.slots import Prior, Slot, slots_of
from clampid.stages.fit_problem import fit_problem
from clampid.stages.layout import layout_of
from clampid.stages.rows import Rows
from experiments.campaign import Campaign
from experiments.virtual_robot import Truth, measure
from kinematics.description import load_robot

Simulated = Callable[..., Campaign]

STANDARD = ("geometry", "joint_compliance", "backlash", "gravity", "wrist_coupling_friction")
POSES = ("poses", "verification")


def truth_of(campaign_seed: int, tables: tuple[str, ...], poses: int = 60) -> Truth:
    return measure(load_robot("kuka_kr20_r1810"), seed=campaign_seed, poses=poses, tables=tables).truth


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_clamped_recovers_springs_gaps_and_friction(simulated: Simulated, seed: int):
    campaign = simulated(seed=seed, tables=("clamped",))
    stage = identify(campaign).stages["clamped"]
    plant = truth_of(seed, ("clamped",)).plant
    true = {
        "joint_compliance": 1.0 / plant.drive.spring,
        "backlash": plant.drive.gap,
        "coulomb_friction": plant.friction.coulomb,
    }
    for slot, value, std in zip(stage.slots, stage.theta, stage.std, strict=True):
        expected = true[slot.effect][int(slot.place.removeprefix("joint")) - 1]
        assert abs(value - expected) < 4 * std, f"{slot.label}: {value:.4g} ± {std:.2g}, true {expected:.4g}"
        if slot.effect == "joint_compliance":  # within 4 errors, and those are small
            assert std < 0.02 * expected


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_poses_of_a_clean_robot_come_down_to_the_noise(simulated: Simulated, seed: int):
    campaign = simulated(seed=seed, poses=150, tables=POSES)
    model = identify(campaign, {"poses": STANDARD})
    line = model.ledger[-1]
    assert line.heldout_rms <= 1.15 * line.noise_floor
    assert line.rms <= line.heldout_rms * 1.02


@pytest.mark.slow
def test_outliers_are_found_and_listed(simulated: Simulated):
    campaign = simulated(seed=1, poses=150, tables=POSES, outliers=0.02)
    truth = measure(load_robot("kuka_kr20_r1810"), seed=1, poses=150, tables=POSES, outliers=0.02).truth
    model = identify(campaign, {"poses": STANDARD})
    found = {row - 1 for _, table, row in model.stages["poses"].outliers if table == "poses"}
    spoilt = set(truth.outliers["poses"])
    assert len(spoilt) > 5
    assert spoilt <= found
    assert len(found - spoilt) <= 1


@pytest.mark.slow
@pytest.mark.parametrize("hidden", [(), pytest.param(("gear_eccentricity@joint2",), marks=pytest.mark.study)])
def test_outliers_change_no_verdict(simulated: Simulated, hidden: tuple[str, ...]):
    verdicts = []
    for outliers in (0.0, 0.02):
        campaign = simulated(seed=1, poses=150, tables=POSES, hidden=hidden, outliers=outliers)
        found = diagnose(identify(campaign, {"poses": STANDARD}), campaign).stages["poses"]
        # Alternatives that explain the rows equally well have no order of their own.
        verdicts.append((found.verdict, {(c["effect"], tuple(c["where"])) for c in found.candidates}))
        assert bool(found.outliers) == bool(outliers)
    assert verdicts[0] == verdicts[1]


@pytest.mark.slow
def test_the_same_twice(simulated: Simulated):
    campaign = simulated(seed=1, poses=60, tables=POSES)
    one, two = (identify(campaign, {"poses": STANDARD}, holdout=0.2, seed=5) for _ in range(2))
    np.testing.assert_array_equal(one.stages["poses"].theta, two.stages["poses"].theta)
    np.testing.assert_array_equal(one.stages["poses"].covariance, two.stages["poses"].covariance)
    assert one.ledger == two.ledger
    three = identify(campaign, {"poses": STANDARD}, holdout=0.2, seed=6)
    assert three.stages["poses"].held_out != one.stages["poses"].held_out


@pytest.fixture(scope="module")
def arm(simulated: Simulated) -> Campaign:
    return simulated(seed=1, poses=60, tables=POSES)


def test_a_prior_is_kept_where_it_is_tight_and_left_where_it_is_loose(arm: Campaign):
    rows = stage_rows([arm], layout_of([arm]), "poses")
    slots = (*slots_of(catalogue()["geometry"], rows.layout)[:6], Slot("gear_eccentricity", "a1", "joint2"))
    trial = fit_problem(rows, catalogue(), slots)
    last = slots[-1:]
    free = fit(trial).theta[-1]
    tight = fit(trial, (Prior(last, np.array([3e-3]), np.array([[1e-18]])),)).theta[-1]
    loose = fit(trial, (Prior(last, np.array([3e-3]), np.array([[1.0]])),)).theta[-1]
    assert tight == pytest.approx(3e-3, rel=1e-3)
    assert loose == pytest.approx(free, rel=1e-2)
    # A prior of slots that are not active says nothing.
    foreign = Prior((Slot("gear_eccentricity", "b1", "joint5"),), np.array([1.0]), np.array([[1e-18]]))
    assert fit(trial, (foreign,)).theta[-1] == free


def test_a_prior_and_rows_weigh_by_their_precision(arm: Campaign):
    """A linear fit with a prior as good as the rows ends in the middle."""
    rows = stage_rows([arm], layout_of([arm]), "poses")
    slot = Slot("instrument_scale", "s", "instrument")
    trial = fit_problem(rows, catalogue(), (slot,))
    noise = fit(trial, reject=False).noise
    alone = fit(trial, reject=False, noise=noise)
    white = noise.whiten(rows, *trial.residual(alone.theta))
    variance = 1.0 / float(white.jacobian[:, 0] @ white.jacobian[:, 0])
    weak = (10 * trial.sizes()[0]) ** 2
    data = float(white.jacobian[:, 0] @ (white.residual + white.jacobian[:, 0] * alone.theta[0])) * variance
    assert alone.theta[0] == pytest.approx(data * weak / (weak + variance), rel=1e-6)
    prior = Prior((slot,), np.array([0.0]), np.array([[variance]]))
    assert fit(trial, (prior,), reject=False, noise=noise).theta[0] == pytest.approx(data / 2, rel=1e-6)


def _spoiled(campaign: Campaign, **columns: float) -> Campaign:
    """The campaign with some columns of its pose table constant."""
    return replace(campaign, tables={"poses": campaign.tables["poses"].assign(**columns)})


def test_a_joint_that_never_moves_is_named(arm: Campaign):
    """Joint 6 at rest: nothing of its angle can be told from the tool."""
    robot = arm.robot
    frozen = _spoiled(arm, q6_rad=0.3, dir6=1)
    rows = stage_rows([frozen], layout_of([frozen]), "poses")
    rows = replace(rows, measured=_nominal(rows))
    slots = slots_of(catalogue()["gear_eccentricity"], rows.layout)
    targets = tuple(Slot("geometry", f"target_{a}", t) for t in rows.layout.targets for a in "xyz")
    estimate = fit(fit_problem(rows, catalogue(), (*targets, *slots)))
    assert robot.n == 6
    untold = [s.place for s, known in zip(estimate.slots, estimate.identified, strict=False) if not known]
    assert set(untold) <= {"joint6", *rows.layout.targets}
    assert "joint6" in untold
    assert any("joint6" in line for line in null_directions(estimate))
    assert not any("joint3" in line for line in null_directions(estimate))


def test_a_target_on_the_last_axis_leaves_the_last_joint_undetermined(arm: Campaign):
    table = arm.tables["poses"]
    one = replace(
        arm,
        tables={"poses": table[table["target"] == "T1"].reset_index(drop=True)},
        targets={"T1": np.array([0.0, 0.0, 0.12])},
    )
    rows = stage_rows([one], layout_of([one]), "poses")
    rows = replace(rows, measured=_nominal(rows))
    slots = slots_of(catalogue()["gear_eccentricity"], rows.layout)
    estimate = fit(fit_problem(rows, catalogue(), slots))
    untold = {s.place for s, known in zip(estimate.slots, estimate.identified, strict=False) if not known}
    assert untold == {"joint6"}
    lines = null_directions(estimate)
    assert any("joint6" in line and "do not depend" in line for line in lines)


def _nominal(rows: Rows) -> np.ndarray:
    """What a perfect robot would have measured there, with noise."""
    trial = fit_problem(rows, catalogue(), (Slot("instrument_scale", "s", "instrument"),))
    noise = 5e-5 * np.random.default_rng(0).standard_normal(rows.measured.shape)
    return rows.measured - trial.residual(np.zeros(1))[0] + noise


def test_nothing_to_fit_is_said(arm: Campaign):
    rows = stage_rows([arm], layout_of([arm]), "poses")
    trial = fit_problem(replace(rows, used=np.zeros_like(rows.used)), catalogue(), (Slot("geometry", "x", "link2"),))
    with pytest.raises(FitError, match="no rows"):
        fit(trial)


def test_a_tight_prior_keeps_what_rows_leave_open(arm: Campaign):
    """Of a parameter with a spread of 1 the fit knows its size where no row tells it, and says so."""
    rows = stage_rows([arm], layout_of([arm]), "poses")
    rows = replace(rows, signals={**rows.signals, "q": np.zeros_like(rows.signals["q"])})
    first = catalogue()["gear_eccentricity"]
    assumed = tuple(replace(p, spread=1.0) for p in first.parameters)
    effects = {**catalogue(), first.name: replace(first, parameters=assumed)}
    sine, cosine = Slot(first.name, "a1", "joint2"), Slot(first.name, "b1", "joint2")
    trial = fit_problem(rows, effects, (sine, cosine))
    off, _ = trial.residual(np.array([0.0, 2e-4]))
    noise = np.random.default_rng(0).normal(0.0, rows.sigma)
    trial = trial.with_rows(replace(rows, measured=rows.measured - off + noise))
    estimate = fit(trial, reject=False)  # at q = 0 the sine is not seen, and the cosine is
    scale = np.sqrt(np.mean(estimate.whitened.residual**2))
    assert estimate.std[0] == pytest.approx(assumed[0].size * scale, rel=0.02)
    assert estimate.std[1] < 0.2 * assumed[0].size
    assert abs(estimate.theta[1] - 2e-4) < 4 * estimate.std[1]
    assert list(estimate.identified) == [False, True]
    assert fit_problem(rows, catalogue(), (sine,)).prior_std()[0] == 10 * first.parameters[0].size


def test_a_spread_must_be_positive():
    with pytest.raises(EffectError, match="spread must be positive"):
        Parameter("a", "rad", 1e-4, spread=0.0)
