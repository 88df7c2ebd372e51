"""What an exported form leaves of the whole model, against what each effect moves by hand."""

from __future__ import annotations

import csv
import io
import xml.etree.ElementTree as ET
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from clampid.catalogue import catalogue
from clampid.effect import Effect
from clampid.exports.dh_export import calibrated_chain, dh_export, read_dh
from clampid.exports.form_error import CHECKED, LeftOut, form_error, left_out, postures
from clampid.exports.urdf_export import urdf_export
from clampid.models.model import Model, ModelError
from clampid.slots import Layout, Slot, Term, find_parameter, slots_of
from clampid.stages.rows import Array
from experiments.campaign import Campaign, Instrument, Tool
from experiments.plans.press import holding_torque
from kinematics.description import load_robot
from kinematics.poe import joint_transforms

Make = Callable[..., Model]
ROBOT = "kuka_kr20_r1810"
GRAVITY = np.array([0.0, 0.0, -9.81])


def with_slots(model: Model, slots: dict[Slot, float]) -> Model:
    """Give the model further parameters in its poses."""
    stage = model.stages["poses"]
    return model.with_stage(
        replace(
            stage,
            terms=(*stage.terms, *(Term(s.effect) for s in slots)),
            slots=(*stage.slots, *slots),
            theta=np.r_[stage.theta, list(slots.values())],
            covariance=1e-12 * np.eye(len(stage.slots) + len(slots)),
            identified=(*stage.identified, *([True] * len(slots))),
        )
    )


def left(model: Model, **options: object) -> LeftOut:
    robot = load_robot(model.robot)
    return left_out(calibrated_chain(model).flange, model, robot, **options)  # type: ignore[arg-type]


def lever(model: Model, joint: int) -> Array:
    """Give the distance of the nominal flange from a joint's axis at the postures that are checked, m."""
    robot = load_robot(model.robot)
    q = postures(robot, CHECKED, seed=1)
    G = joint_transforms(robot.screws, q)
    at = (G[:, -1] @ robot.flange)[:, :3, 3]
    axis = np.einsum("nij,j->ni", G[:, joint, :3, :3], robot.joints[joint].axis)
    point = np.einsum("nij,j->ni", G[:, joint, :3, :3], robot.joints[joint].point) + G[:, joint, :3, 3]
    return np.asarray(np.linalg.norm(np.cross(axis, at - point), axis=1))


def rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def test_play_about_an_upright_axis_is_half_a_gap_either_way(make_model: Make) -> None:
    gap = 4e-4
    model = make_model(ROBOT, size=0.0)
    theta = np.zeros(len(model.stages["poses"].slots))
    theta[-1] = gap  # backlash of joint 1, which no weight presses on
    model = model.with_stage(replace(model.stages["poses"], theta=theta))
    found = left(model)
    expected = 0.5 * gap * lever(model, 0)
    assert found.error.position_rms == pytest.approx(rms(expected), rel=1e-6)
    assert found.error.position_max == pytest.approx(expected.max(), rel=1e-6)
    assert found.error.orientation_rms == pytest.approx(0.5 * gap, rel=1e-6)
    assert found.effects == {"backlash": pytest.approx(rms(expected), rel=1e-6)}


@pytest.mark.parametrize("told", ["by the session", "by the campaign"])
def test_springs_yield_under_the_declared_tool(told: str, make_model: Make) -> None:
    compliance, tool = 1e-4, Tool(16.0, np.array([0.05, 0.0, 0.2]))
    model = with_slots(make_model(ROBOT, size=0.0), {Slot("joint_compliance", "c", "joint2"): compliance})
    robot = load_robot(ROBOT)
    options = {}
    if told == "by the session":
        kept = replace(model.sessions[0], tool_mass=tool.mass, tool_com=tuple(tool.com.tolist()))
        model = replace(model, sessions=(kept,))
    else:
        none = Instrument("none", None, None)
        options["campaign"] = Campaign("made", None, robot, GRAVITY, tool, {}, none, {}, "")
    found = left(model, **options)
    q = postures(robot, CHECKED, seed=1)
    ratio = np.asarray(robot.transmission)[1, 1]
    turn = compliance * ratio**2 * holding_torque(robot, q, GRAVITY, tool.mass, tool.com)[:, 1]
    # The weight where the arm has yielded is other than at the angles that were asked for, by thousandths.
    assert found.error.position_rms == pytest.approx(rms(turn * lever(model, 1)), rel=5e-3)
    assert found.tool == tool.mass
    bare = compliance * ratio**2 * holding_torque(robot, q, GRAVITY, 0.0, tool.com)[:, 1]
    assert found.error.position_rms > 1.1 * rms(bare * lever(model, 1))


def test_links_have_the_temperatures_of_the_session(make_model: Make) -> None:
    alpha, (low, high) = 1e-5, (24.0, 30.0)
    slots = {Slot("thermal_expansion", "alpha", f"link{i + 1}"): alpha for i in range(6)}
    model = with_slots(make_model(ROBOT, size=0.0), slots)
    assert left(model).error.position_max < 1e-12  # a session that knows of none: 20 degC
    model = replace(model, sessions=(replace(model.sessions[0], temperature=(low, high)),))
    found = left(model)
    robot = load_robot(ROBOT)
    inside = np.linalg.inv(calibrated_chain(model).base) @ calibrated_chain(model).flange(postures(robot, CHECKED, 1))
    reach = np.linalg.norm(inside[:, :3, 3] - robot.joints[0].point, axis=1)
    assert alpha * (low - 20) * rms(reach) < found.error.position_rms < alpha * (high - 20) * rms(reach)
    assert found.temperature == (low, high)
    assert "24 to 30 degC" in str(found)


OWN = """
from clampid.algebra import rows
from clampid.effect import Effect, Parameter

EFFECT = Effect(
    name="refraction", family="instrument_scale", acts={"measurement": lambda p, x: rows(p.a * x.q[0], 0, 0)},
    parameters=(Parameter("a", "m", 1e-3, meaning="by the angle of joint 1"),), needs=("q",), stages=("poses",),
    equation="dx = a q_1", source=("ISO9283",), at="instrument",
)
"""


def test_what_is_the_instruments_is_not_the_robots(make_model: Make, tmp_path: Path) -> None:
    (tmp_path / "own.py").write_text(OWN)
    slots = {Slot("instrument_scale", "s", "instrument"): 1e-3, Slot("refraction", "a", "instrument"): 1e-3}
    found = left(with_slots(make_model(ROBOT, size=0.0), slots), user_effects=tmp_path / "own.py")
    assert found.error.position_max < 1e-12
    assert set(found.effects) == {"backlash"}


ROBOTS_OWN = [e for e in catalogue().values() if "poses" in e.stages and set(e.acts) - {"measurement"}]


@pytest.mark.parametrize("effect", [e for e in ROBOTS_OWN if e.name != "geometry"], ids=lambda e: e.name)
def test_every_effect_of_poses_counts(effect: Effect, make_model: Make) -> None:
    """At its usual size, on an arm with springs through which loads act: it is worth something, and no nan."""
    bare = make_model(ROBOT, size=0.0)
    known, there = {effect.name: effect}, set(bare.stages["poses"].slots)
    slots = {Slot("joint_compliance", "c", f"joint{i + 1}"): 1e-5 for i in range(6)}
    for slot in slots_of(effect, bare.layout, "poses"):
        parameter = find_parameter(slot, known)
        slots[slot] = parameter.start if parameter.shape else parameter.size
    model = with_slots(bare, {s: v for s, v in slots.items() if s not in there})
    values = np.array([slots.get(s, 0.0) for s in model.stages["poses"].slots])
    model = model.with_stage(replace(model.stages["poses"], theta=values))
    model = replace(model, sessions=(replace(model.sessions[0], tool_mass=10.0, temperature=(20.0, 25.0)),))
    found = left(model)
    assert 0.0 < found.effects[effect.name] < 0.1
    assert found.error.position_rms >= 0.5 * max(found.effects.values())


def test_a_later_session_has_its_own_base_and_tool(make_model: Make) -> None:
    model = make_model(ROBOT)
    stage = model.stages["poses"]
    there = [replace(s, place="session2") if s.place == "session1" else s for s in stage.slots]
    model = replace(
        model.with_stage(replace(stage, slots=tuple(there))),
        layout=Layout(6, (), ("session1", "session2")),
        sessions=(replace(model.sessions[0], base_reference=np.eye(4)), model.sessions[0]),
    )
    chain = calibrated_chain(model, session=1)
    gap = model.stages["poses"].values()[Slot("backlash", "gap", "joint1")]
    found = left_out(chain.flange, model, chain.robot, session=1)
    assert found.error.position_rms == pytest.approx(abs(0.5 * gap) * rms(lever(model, 0)), rel=0.02)


def test_a_linkage_stands_between_controller_and_chain(make_model: Make) -> None:
    model = make_model("abb_irb2400_12_155", size=1e-3)
    stage = model.stages["poses"]
    still = stage.theta.copy()
    still[-1] = 0.0
    model = model.with_stage(replace(stage, theta=still))
    assert left(model).error.position_max < 1e-9


def test_the_table_says_what_it_leaves(make_model: Make) -> None:
    model = make_model(ROBOT)
    for convention in ("hayati", "standard"):
        found = dh_export(model, convention, fit="static")  # type: ignore[arg-type]
        records = list(csv.DictReader(io.StringIO(found.text)))
        told = {float(r["left_by_table_rms_m"]) for r in records}
        assert told == {found.left.error.position_rms}
        gap = model.stages["poses"].values()[Slot("backlash", "gap", "joint1")]
        assert told.pop() == pytest.approx(abs(0.5 * gap) * rms(lever(model, 0)), rel=0.02)
        assert float(records[0]["left_by_table_max_m"]) > float(records[0]["left_by_table_rms_m"])
        assert {r["not_in_table"] for r in records} == {"backlash"}
        data = found.to_json()
        assert data["left_by_table_m"] == {"rms": found.left.error.position_rms, "max": found.left.error.position_max}
        assert [entry["effect"] for entry in data["not_in_table"]] == ["backlash"]
        assert data["rows"][0]["d_m"] == read_dh(found.text).rows[0].d
        assert "x_m" not in data["rows"][0]


def test_urdf_says_what_it_leaves_and_stays_xml(make_model: Make) -> None:
    found = urdf_export(make_model(ROBOT))
    assert ET.fromstring(found.text).tag == "robot"
    assert str(found.left) in found.text
    assert "not in it: backlash (rms " in found.text
    table = dh_export(make_model(ROBOT), "hayati", fit="static")
    assert found.left.error.position_rms == pytest.approx(table.left.error.position_rms, rel=1e-6)


def test_residual_of_measured_points_by_one_form_alone(make_model: Make) -> None:
    """Points where the static chain has them, but for 2 mm: the table leaves just these."""
    model = make_model(ROBOT, size=1e-4)
    robot, target = load_robot(ROBOT), np.array([0.1, 0.0, 0.2])
    q = postures(robot, 40, seed=5)
    pose = calibrated_chain(model).flange(q)
    point = pose[:, :3, :3] @ target + pose[:, :3, 3] - [0.0, 0.0, 2e-3]
    table = pd.DataFrame(np.c_[q, point], columns=[*(f"q{i + 1}_rad" for i in range(6)), "x_m", "y_m", "z_m"])
    tables = {"verification": table.assign(target="T1")}
    campaign = Campaign(
        "made", None, robot, GRAVITY, Tool(7.0, np.zeros(3)), {"T1": target}, Instrument("none", 1e-5, None), tables,
        model.sessions[0].fingerprint,
    )  # fmt: skip
    for found in (dh_export(model, "hayati", campaign=campaign, fit="static"), urdf_export(model, campaign=campaign)):
        assert found.measured is not None
        assert (found.measured.table, found.measured.rows) == ("verification", 40)
        assert found.measured.mean == pytest.approx(2e-3, abs=1e-8)
        assert found.left.tool == 7.0
    assert "mean 2.0000 mm" in found.text
    with pytest.raises(ModelError, match="made: expected a campaign with a table poses or verification"):
        dh_export(model, "hayati", campaign=replace(campaign, tables={}), fit="static")
    with pytest.raises(ModelError, match="expected the campaign that session 1 of the model was fitted on"):
        urdf_export(model, campaign=replace(campaign, fingerprint="other"))


def test_an_effect_that_is_not_known_is_asked_for(make_model: Make) -> None:
    model = with_slots(make_model(ROBOT), {Slot("my_effect", "a", "joint1"): 1e-4})
    with pytest.raises(ModelError, match=r"'my_effect' that is not known.*--effects-from"):
        dh_export(model, "hayati", fit="static")


def test_errors_are_norms_of_position_and_turn() -> None:
    there = np.tile(np.eye(4), (2, 1, 1))
    here = there.copy()
    here[0, :3, 3] = [3e-3, 4e-3, 0.0]
    here[1, :3, :3] = [[0, -1, 0], [1, 0, 0], [0, 0, 1]]
    found = form_error(there, here)
    assert found.position_max == pytest.approx(5e-3)
    assert found.position_rms == pytest.approx(5e-3 / np.sqrt(2))
    assert found.orientation_max == pytest.approx(np.pi / 2)
