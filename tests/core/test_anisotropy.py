"""Noise that is larger along one of the instrument's axes is learned so; a sag that the model lacks is no noise."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from types import MappingProxyType

import numpy as np
import pytest

from clampid.fitting.anisotropy import relative_axes
from clampid.fitting.solve import Estimate
from clampid.identification.identify import identify
from clampid.identification.model_on_campaign import on_campaign
from experiments.campaign import Campaign

Simulated = Callable[..., Campaign]
XYZ = ["x_m", "y_m", "z_m"]
STANDARD = ["geometry", "joint_compliance", "backlash", "gravity", "wrist_coupling_friction"]
DEEP = 3e-4  # m


@pytest.fixture(scope="module")
def campaign(simulated: Simulated) -> Campaign:
    return simulated(seed=7, poses=80, tables=("poses",))


def seen_deep(campaign: Campaign, seed: int) -> Campaign:
    """The same with more noise along the instrument's z."""
    poses = campaign.tables["poses"]
    deep = poses["z_m"] + DEEP * np.random.default_rng(seed).standard_normal(len(poses))
    return replace(campaign, tables=MappingProxyType({**campaign.tables, "poses": poses.assign(z_m=deep)}))


def estimate_of(campaign: Campaign, effects: list[str] = STANDARD) -> Estimate:
    return on_campaign(identify(campaign, effects), campaign).refit("poses").estimate


def test_noise_along_z_is_learned_and_none_of_its_rows_is_wrong(campaign: Campaign):
    alike, deep = estimate_of(campaign), estimate_of(seen_deep(campaign, 1))
    assert len(np.unique(alike.noise.sigma[:, :3])) == 1
    own = float(alike.noise.sigma[0, 0])
    x, y, z = deep.noise.sigma[0, :3]
    assert z == pytest.approx(np.hypot(own, DEEP), rel=0.15)
    assert (x, y) == pytest.approx((own, own), rel=0.25)
    white = deep.whitened.residual
    rms = [float(np.std(white[deep.whitened.channel == c])) for c in range(3)]
    assert rms == pytest.approx([1.0] * 3, rel=0.25)
    assert not deep.outliers.any()
    used = deep.problem.rows.used[:, :3].all(axis=1)
    # It was learned from what equal weights leave, a little less than what these do.
    assert np.mean(deep.noise.sigma[0, :3] ** 2) == pytest.approx(np.mean(deep.residual[used, :3] ** 2), rel=0.1)


@pytest.mark.slow
def test_information_of_other_axes_is_not_lost_in_the_noise_of_z(campaign: Campaign):
    """Errors of the fit's parameters, by its own account and by those of the fit without that noise."""
    alike, deep = estimate_of(campaign), estimate_of(seen_deep(campaign, 2))
    told = alike.identified & deep.identified
    off = (deep.theta - alike.theta)[told] / deep.std[told]
    assert np.sqrt(np.mean(off**2)) < 1.3
    flat = np.sqrt(np.mean(deep.noise.sigma[:, :3] ** 2)) / alike.noise.sigma[0, 0]  # what one number would make of it
    assert np.median(deep.std[told] / alike.std[told]) < 0.6 * flat


def test_a_sag_that_the_model_lacks_is_no_noise(campaign: Campaign):
    stiff = estimate_of(campaign, ["geometry"])
    z = np.sqrt(np.mean(stiff.residual[:, :3] ** 2, axis=0))
    assert z.max() > 1.4 * z.min()  # its errors do differ from axis to axis
    sigma = stiff.noise.sigma[0, :3]
    assert sigma.max() < 1.1 * sigma.min()


def test_false_alarm_rate_of_anisotropic_noise(campaign: Campaign):
    rows, rng = estimate_of(campaign).problem.rows, np.random.default_rng(3)
    found = [relative_axes(rows, 5e-5 * rng.standard_normal((len(rows), 3))) for _ in range(1000)]
    assert sum(bool(np.any(r != 1.0)) for r in found) <= 5  # of a mean of 1, more in 0.06 % of all cases
