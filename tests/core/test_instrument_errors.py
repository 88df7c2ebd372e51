"""Instruments that err along their axes or by range: the tables of a measured campaign, seen through such a camera."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from types import MappingProxyType

import numpy as np
import pytest

from clampid.diagnosis.diagnose import diagnose
from clampid.diagnosis.result import StageDiagnosis
from clampid.identification.identify import identify
from experiments.campaign import Campaign

Simulated = Callable[..., Campaign]
STANDARD = ["geometry", "joint_compliance", "backlash", "gravity", "wrist_coupling_friction"]
XYZ = ["x_m", "y_m", "z_m"]
FAR = np.array([0.3, -0.2, 2.5])  # m: the middle of what the camera sees, in its frame


def seen_by_camera(campaign: Campaign, error: Callable[[np.ndarray], np.ndarray]) -> Campaign:
    """The same points seen by a camera that looks along its z and is off by ``error`` of the points ``(N, 3)``, m."""
    tables = {}
    first = campaign.tables["poses"][XYZ].to_numpy()
    rough = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))[0]
    turn = rough * np.linalg.det(rough)
    for name, table in campaign.tables.items():
        points = (table[XYZ].to_numpy() - first.mean(axis=0)) @ turn.T + FAR
        tables[name] = table.assign(**dict(zip(XYZ, (points + error(points)).T, strict=True)))
    return replace(campaign, tables=MappingProxyType(tables))


def verdict_of(campaign: Campaign) -> StageDiagnosis:
    return diagnose(identify(campaign, STANDARD), campaign).stages["poses"]


def shear(axis: np.ndarray, share: float) -> Callable[[np.ndarray], np.ndarray]:
    """A metre that is too long by a share along an axis."""
    axis = axis / np.linalg.norm(axis)
    return lambda points: share * (points @ axis)[:, None] * axis


CAMERAS: dict[str, tuple[Callable[[np.ndarray], np.ndarray], dict[str, float]]] = {
    "instrument_axis_scale": (shear(np.array([0.0, 0.0, 1.0]), 3e-4), {"x": -1e-4, "y": -1e-4}),
    "instrument_oblique_scale": (
        shear(np.array([1.0, 0.0, 1.0]), 3e-4), {"x": 0.5e-4, "y": -1e-4, "xy": 0.0, "xz": 1.5e-4, "yz": 0.0},
    ),
    "instrument_range_offset": (
        lambda points: 1.5e-3 * points / np.linalg.norm(points, axis=1, keepdims=True), {"c": 1.5e-3},
    ),
    "instrument_range_square": (
        lambda points: 3e-4 * points * np.linalg.norm(points, axis=1, keepdims=True), {"k": 3e-4},
    ),
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("effect", CAMERAS)
def test_what_errs_in_depth_is_named(effect: str, simulated: Simulated):
    error, truth = CAMERAS[effect]
    campaign = simulated(seed=7, poses=80, tables=("poses",))
    found, right = verdict_of(seen_by_camera(campaign, error)), identify(campaign, STANDARD).ledger[0].heldout_rms
    assert found.verdict == "missing"
    assert [(c["effect"], c["name"]) for c in found.candidates] == [("instrument_scale", effect)]
    assert found.after < 1.05 * right < 0.5 * found.before
    told = {p["name"].partition(".")[2].partition("@")[0]: p for p in found.candidates[0]["parameters"]}
    for name, value in truth.items():
        assert abs(told[name]["value"] - value) < 4.0 * told[name]["std"], name


def test_what_a_metre_is_too_long_by_everywhere_is_absorbed(simulated: Simulated):
    """Without a certified distance a larger arm is the same."""
    found = verdict_of(seen_by_camera(simulated(seed=7, poses=80, tables=("poses",)), lambda points: 3e-4 * points))
    assert found.verdict == "adequate"
    states = {t["name"]: t["state"] for t in found.testability}
    assert states["instrument_scale"] == "absorbed"
    assert states["instrument_axis_scale"] == "testable"
