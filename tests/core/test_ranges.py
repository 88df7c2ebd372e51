"""A model says where it is asked beyond what it was identified on, and nothing inside."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from clampid.catalogue import catalogue
from clampid.comparison.compare import compare
from clampid.display import fixed
from clampid.effect import Effect, EffectError, Parameter
from clampid.identification.identify import identify
from clampid.models.model import Model, load_model, save_model
from clampid.models.ranges import RANGE_MARGIN, Ranges, doubt, empirical
from clampid.slots import Slot
from clampid.verbs.findings import extrapolating_text
from experiments.campaign import Campaign

Simulated = Callable[..., Campaign]

EDGES = (-2.0, -0.8)  # rad: of joint 2, a third of what it moved
NOTHING = {"rows": 0, "quantities": []}
EFFECTS = ("geometry", "joint_compliance", "backlash", "thermal_expansion")


@pytest.fixture(scope="module")
def whole(simulated: Simulated) -> Campaign:
    return simulated(seed=5, poses=60, tables=("poses",))


@pytest.fixture(scope="module")
def third(whole: Campaign) -> Campaign:
    """The same measurements where joint 2 is within a third of its range, and the tool's torques with it."""
    rows = whole.tables["poses"]
    part = rows[rows["q2_rad"].between(*EDGES)].reset_index(drop=True)
    return replace(whole, tables={"poses": part}, fingerprint="third")


@pytest.fixture(scope="module")
def model(third: Campaign) -> Model:
    return identify(third, EFFECTS)


def said(model: Model, campaign: Campaign) -> dict[str, Any]:
    found: dict[str, Any] = compare(model, campaign, refit=("base", "tool"), refit_fraction=0.5).tables["poses"]
    json.dumps(found, allow_nan=False)
    told: dict[str, Any] = found.get("extrapolating", {})
    return told


def test_outside_a_third_of_joint_2_it_says_so(whole: Campaign, model: Model):
    found = said(model, whole)
    angle, torque = found["quantities"][:2]
    assert (angle["quantity"], angle["at"], angle["unit"]) == ("angle", "joint2", "rad")
    q2 = whole.tables["poses"]["q2_rad"]
    inside = q2[q2.between(*EDGES)]
    assert angle["identified"] == [inside.min(), inside.max()]
    assert angle["value"] == pytest.approx(q2.max(), abs=0.2)
    assert angle["value"] > 0.5
    margin = RANGE_MARGIN * (inside.max() - inside.min())
    outside = ~q2.between(inside.min() - margin, inside.max() + margin)
    assert angle["rows"] == pytest.approx(0.5 * outside.sum(), abs=0.12 * len(q2))
    assert found["rows"] >= angle["rows"] > 0.4 * found["of"]
    assert (torque["quantity"], torque["at"]) == ("gravity torque", "joint2")
    text = extrapolating_text(found["quantities"])
    assert text.startswith(f"joint 2 (angle to {np.rad2deg(angle['value']):.1f} deg, identified to ")
    assert f" {fixed(np.rad2deg(inside.max()), 1)} deg; gravity torque " in text


def test_no_warning_inside_the_fitted_range(third: Campaign, model: Model):
    found = compare(model, third).tables["poses"]["extrapolating"]
    assert {**NOTHING, "of": found["of"]} == found
    assert found["of"] > 0
    rows = third.tables["poses"]
    middle = rows[rows["pose"].isin(rows["pose"].unique()[::2])].reset_index(drop=True)
    assert said(model, replace(third, tables={"poses": middle}, fingerprint="half"))["rows"] == 0


def test_temperature_and_tool_beyond_are_said(third: Campaign, model: Model):
    warm = third.tables["poses"].assign(temp_link3_C=35.0)
    heavy = replace(third.tool, mass=third.tool.mass + 3.0)
    found = said(model, replace(third, tables={"poses": warm}, tool=heavy, fingerprint="warm"))
    assert found["rows"] == found["of"]
    what = {(one["quantity"], one["at"]): one for one in found["quantities"]}
    assert what["link temperature", "link3"]["value"] == 35.0
    assert what["tool mass", "tool"]["identified"] == [third.tool.mass, third.tool.mass]
    assert ("link temperature", "link2") not in what
    text = extrapolating_text(found["quantities"])
    assert "link 3 (link temperature to 35.0 degC, identified to 2" in text
    assert "tool (tool mass to 15.00 kg, identified to 12.00 kg)" in text


def test_what_was_not_recorded_is_not_known(third: Campaign, whole: Campaign, model: Model):
    """A link without a sensor counts as of 20 degC where the prediction reads it, and as nothing where it does not."""
    columns = [c for c in third.tables["poses"] if c.startswith("temp_link")]
    blind = replace(third, tables={"poses": third.tables["poses"].drop(columns=columns)}, fingerprint="blind")
    assumed = {(one["quantity"], one["value"]) for one in said(model, blind)["quantities"]}
    assert assumed == {("link temperature", 20.0)}
    without = identify(blind, EFFECTS[:-1])
    assert np.isnan(without.stages["poses"].ranges.lower[2]).all()  # type: ignore[union-attr]
    hot = third.tables["poses"].assign(**dict.fromkeys(columns, 60.0))
    assert said(without, replace(third, tables={"poses": hot}, fingerprint="hot"))["rows"] == 0


def test_the_file_keeps_them_and_older_ones_are_read(third: Campaign, model: Model, tmp_path: Path):
    save_model(model, tmp_path / "m.json")
    data = json.loads((tmp_path / "m.json").read_text())
    q = third.tables["poses"][[f"q{i}_rad" for i in range(1, 7)]].to_numpy()
    kept = np.array(data["stages"]["poses"]["ranges"]["q_rad"])
    assert (kept >= q.min(axis=0)[:, None]).all()
    assert (kept <= q.max(axis=0)[:, None]).all()
    assert np.ptp(kept[1]) == pytest.approx(np.ptp(q[:, 1]), rel=0.05)
    del data["stages"]["poses"]["ranges"]
    data["format"] = "clampid-model/1"
    (tmp_path / "old.json").write_text(json.dumps(data))
    old = load_model(tmp_path / "old.json")
    assert old.stages["poses"].ranges is None
    assert said(old, third) == {}


def ranges() -> Ranges:
    """Of a joint that turns, a slide and a joint that stood still."""
    lower = np.array([[-1.0, 0.1, 0.5], [-10.0, 0.0, 0.0], [20.0, np.nan, 25.0]])
    upper = np.array([[2.0, 0.9, 0.5], [30.0, 0.0, 0.0], [30.0, np.nan, 25.5]])
    return Ranges(lower, upper, ("revolute", "prismatic", "revolute"), (5.0, 8.0))


def test_a_distance_is_in_widths_beyond_the_margin():
    one = ranges()
    values = np.stack([one.lower, one.upper, one.upper + 0.999 * RANGE_MARGIN * one.width])
    assert (one.distance(values) == 0).all()
    found = one.distance(one.upper + (RANGE_MARGIN + 0.5) * one.width)
    np.testing.assert_allclose(found, [[0.5] * 3, [0.5] * 3, [0.5, 0.0, 0.5]])
    np.testing.assert_allclose(one.distance(one.lower - (RANGE_MARGIN + 2.0) * one.width)[0], 2.0)
    assert one.distance(one.lower - 0.06 * one.width)[0, 0] == pytest.approx(0.04)


def test_whole_turns_do_not_count_but_on_a_slide():
    one = ranges()
    np.testing.assert_allclose(one.turned(np.array([1.5 - 2 * np.pi, 7.0, 0.5 + 4 * np.pi])), [1.5, 7.0, 0.5])
    beyond = one.beyond(np.array([[2.5, 7.0, 0.5], [0.0, 0.0, 0.0], [25.0, 99.0, 25.0]]))
    assert [(b.quantity, b.at, b.value, b.unit) for b in beyond] == [
        ("angle", "joint1", 2.5, "rad"),
        ("angle", "joint2", 7.0, "m"),
    ]
    assert one.beyond_mass(8.05) == one.beyond_mass(5.0) == ()
    assert one.beyond_mass(4.8)[0].to_json()["identified"] == [5.0, 8.0]


def test_empirical_amplitudes_are_in_doubt_by_their_own_size_and_laws_are_not():
    effects = catalogue()
    slots = (
        Slot("geometry", "d", "joint1"), Slot("gear_eccentricity", "a1", "joint2"),
        Slot("joint_compliance", "c", "joint2"), Slot("soft_near_zero", "a", "joint1"),
        Slot("soft_near_zero", "s", "joint1"), Slot("thermal_expansion", "alpha", "link3"),
        Slot("joint_angle_curve", "a1", "joint1"),
    )  # fmt: skip
    which = empirical(slots, effects)
    assert which.parameter.tolist() == [1, 3, 5]
    assert which.kind.tolist() == [0, 1, 2]
    assert which.place.tolist() == [1, 0, 2]
    theta = np.array([1.0, -2.0, 3.0, 4.0, 5.0, 6.0, 7.0])
    assert (doubt(which, theta, np.zeros((3, 3))) == 0).all()
    distance = np.zeros((3, 3))
    distance[0, 1], distance[1, 0], distance[2, 2], distance[2, 0] = 0.25, 1.0, 40.0, 9.0
    assert doubt(which, theta, distance).tolist() == [0.5, 4.0, 6.0]


@pytest.mark.parametrize(("needs", "per"), [(("direction",), "joint"), (("q",), "robot")])
def test_a_range_that_an_effect_does_not_read_is_refused(needs: tuple[str, ...], per: Any):
    with pytest.raises(EffectError, match="known_within"):
        Effect(
            "bent", "dress_pack", {}, (Parameter("a", "rad", 1e-4, per),), needs, ("poses",), "", (), known_within="q"
        )
