"""Exported DH tables and URDF are the model's static geometry, and their stated errors are true."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from clampid.chain.chain import Deviations
from clampid.exports.angle_export import angle_table
from clampid.exports.dh_export import COLUMNS, calibrated_chain, dh_table, read_dh, table_text
from clampid.exports.dh_export import _numbers as numbers
from clampid.exports.urdf_export import urdf_text
from clampid.models.model import Model, ModelError, save_model
from clampid.models.ranges import Ranges
from clampid.slots import Slot, Term
from clampid.stages.poses import predict
from clampid.stages.row_constants import PoseConstants
from clampid.stages.rows import Array, Rows
from clampid.verbs.export import dh, kuka, urdf
from kinematics.description import load_robot, robot_names
from kinematics.dh import Convention
from kinematics.dh import forward as dh_forward
from kinematics.dh_conversion import DHError
from kinematics.poe import forward
from kinematics.urdf import read_urdf

Make = Callable[..., Model]
AXES = ("rx", "ry", "rz", "x", "y", "z")


def postures(n: int, count: int = 40) -> Array:
    return np.random.default_rng(1).uniform(-np.pi, np.pi, (count, n))


def stage_prediction(model: Model, q: Array) -> Array:
    """Give the flange by the forward model that the fit uses, with the same geometry at its stations."""
    robot, count = load_robot(model.robot), len(q)
    values = {(s.parameter, s.place): v for s, v in model.stages["poses"].values().items()}
    link = np.array([[values[axis, f"link{i + 1}"] for axis in AXES] for i in range(robot.n)])
    link[-1] += [values[f"flange_{axis}", "session1"] for axis in AXES]
    sizes = {"joint_angle": robot.n, "base_twist": 6, "link_twist": 6 * robot.n, "target_shift": 3, "measurement": 3}
    ends = np.cumsum([0, *sizes.values()])
    offsets = {name: slice(int(a), int(b)) for name, a, b in zip(sizes, ends, ends[1:], strict=False)}
    stations = np.zeros((count, ends[-1]))
    stations[:, offsets["base_twist"]] = [values[f"base_{axis}", "session1"] for axis in AXES]
    stations[:, offsets["link_twist"]] = link.ravel()
    none, index = np.zeros((count, 0)), np.zeros(count, dtype=np.int64)
    reference = np.broadcast_to(np.asarray(model.sessions[0].base_reference), (count, 4, 4))
    constants = PoseConstants(
        time=np.zeros(count), target=np.zeros((count, 3)), base_reference=reference, ranged=none.any(axis=1),
        oriented=none.any(axis=1), rotation=np.tile(np.eye(3), (count, 1, 1)), anchor=np.zeros((count, 3)),
        link_recorded=np.zeros((count, robot.n), dtype=bool), tool_mass=np.zeros(count),
    )  # fmt: skip
    rows = Rows(
        "poses", robot, model.layout, {"q": q}, np.zeros((count, 6)), none, none.astype(bool), index, index,
        index.astype(np.str_), index, index, constants,
    )  # fmt: skip
    position, rotation, _ = predict(rows, Deviations(stations, none, index[:0], index[:0], None))
    out = np.zeros((count, 4, 4))
    out[:, :3, :3], out[:, :3, 3], out[:, 3, 3] = rotation, position, 1.0
    return out


@pytest.mark.parametrize("name", robot_names())
def test_the_chain_is_the_model_that_was_fitted(name: str, make_model: Make) -> None:
    model = make_model(name)
    robot = load_robot(name)
    q = postures(robot.n)
    there = calibrated_chain(model).flange(q @ np.asarray(robot.linkage).T)
    np.testing.assert_allclose(there, stage_prediction(model, q), atol=1e-12)


@pytest.mark.parametrize("name", robot_names())
def test_hayati_rows_are_exact(name: str, make_model: Make) -> None:
    model = make_model(name)
    q = postures(load_robot(name).n)
    text = table_text(dh_table(model, "hayati", fit="static"))
    np.testing.assert_allclose(dh_forward(read_dh(text), q), calibrated_chain(model).flange(q), atol=1e-9)


@pytest.mark.parametrize("name", robot_names())
def test_urdf_is_exact_in_the_frame_of_the_instrument(name: str, make_model: Make, tmp_path: Path) -> None:
    model = make_model(name)
    path = tmp_path / "robot.urdf"
    path.write_text(urdf_text(model))
    back, q = read_urdf(path, "flange"), postures(load_robot(name).n)
    there = forward(back.screws, back.flange, q)
    np.testing.assert_allclose(there, calibrated_chain(model).flange(q), atol=1e-9)


def test_standard_rows_have_no_beta_and_are_good_to_a_micrometre(make_model: Make) -> None:
    model = make_model("kuka_kr20_r1810")
    frame = dh_table(model, "standard", fit="static")
    assert (frame["beta_rad"].dropna() == 0.0).all()
    q = postures(6)
    np.testing.assert_allclose(dh_forward(read_dh(table_text(frame)), q), calibrated_chain(model).flange(q), atol=1e-6)


def test_standard_rows_of_nearly_parallel_axes_are_refused_with_the_reason(make_model: Make) -> None:
    model = make_model("kuka_kr20_r1810", size=1e-10)
    with pytest.raises(DHError, match=r"standard table would lose .* axes 2 and 3 are .* from parallel"):
        dh_table(model, "standard", fit="static")
    dh_table(model, "hayati", fit="static")


def test_the_columns_are_those_of_the_contract(make_model: Make) -> None:
    frame = dh_table(make_model("ur10"), "hayati", fit="static")
    assert tuple(frame.columns) == COLUMNS
    assert list(frame["row"]) == ["1", "2", "3", "4", "5", "6", "base", "tool"]
    joints, ends = frame.iloc[:6], frame.iloc[6:]
    for column in ("theta_offset_rad", "d_m", "a_m", "alpha_rad", "beta_rad"):
        assert joints[[column, f"std_{column}"]].notna().all(axis=None)
        assert ends[[column, f"std_{column}"]].isna().all(axis=None)
    for column in ("x_m", "y_m", "z_m", "rx_rad", "ry_rad", "rz_rad"):
        assert ends[[column, f"std_{column}"]].notna().all(axis=None)
        assert joints[[column, f"std_{column}"]].isna().all(axis=None)


@pytest.mark.parametrize("convention", ["hayati", "standard"])
def test_standard_errors_are_those_of_a_drawn_sample(convention: Convention, make_model: Make) -> None:
    model = make_model("kuka_kr20_r1810", std=1e-6)
    stage = model.stages["poses"]
    frame = dh_table(model, convention, fit="static")
    names = [c for c in COLUMNS if c.startswith("std_")]
    promised = frame[names].to_numpy(dtype=float).ravel()
    promised = promised[np.isfinite(promised)]
    rng = np.random.default_rng(3)
    drawn = [
        numbers(calibrated_chain(model, theta=stage.theta + 1e-6 * rng.standard_normal(len(stage.theta))), convention)[
            0
        ]
        for _ in range(400)
    ]
    sample = np.std(drawn, axis=0)
    clear = promised > 1e-11
    np.testing.assert_allclose(sample[clear], promised[clear], rtol=0.2)
    assert (sample[~clear] < 1e-10).all()


def test_a_model_without_geometry_is_refused(make_model: Make) -> None:
    model = make_model("ur10")
    with pytest.raises(ModelError, match="geometry"):
        dh_table(replace(model, stages={}), "hayati", fit="static")
    with pytest.raises(ModelError, match="session 2: the model has sessions 1 to 1"):
        dh_table(model, "hayati", session=1, fit="static")


def with_slots(model: Model, slots: dict[Slot, float]) -> Model:
    """Give the model further parameters, known to a millionth."""
    stage = model.stages["poses"]
    count = len(stage.slots) + len(slots)
    covariance = 1e-12 * np.eye(count)
    covariance[: len(stage.slots), : len(stage.slots)] = stage.covariance
    more = replace(
        stage,
        terms=(*stage.terms, *(Term(name) for name in dict.fromkeys(s.effect for s in slots))),
        slots=(*stage.slots, *slots),
        theta=np.r_[stage.theta, list(slots.values())],
        covariance=covariance,
        identified=(*stage.identified, *([True] * len(slots))),
    )
    return model.with_stage(more)


def test_at_a_temperature_links_have_grown_along_their_length(make_model: Make) -> None:
    alpha = 2.3e-5
    slots = {Slot("thermal_expansion", "alpha", f"link{i + 1}"): alpha for i in range(6)}
    bare = make_model("kuka_kr20_r1810", size=0.0)
    model = with_slots(bare, slots)
    cold, warm = calibrated_chain(model), calibrated_chain(model, temperature=45.0)
    robot = load_robot("kuka_kr20_r1810")
    # A chain of equal expansion is the same chain in larger units, but for what stands before the first joint.
    scale, first = 1 + 25 * alpha, robot.joints[0].point
    q = postures(6)
    inside = np.linalg.inv(cold.base)
    before, after = ((inside @ chain.flange(q))[:, :3, 3] - first for chain in (cold, warm))
    np.testing.assert_allclose(after, scale * before, atol=1e-12)
    table = dh_table(model, "hayati", temperature=45.0, fit="static")
    assert (table["temperature_C"] == 45.0).all()
    np.testing.assert_allclose(dh_forward(read_dh(table_text(table)), q), warm.flange(q), atol=1e-9)
    assert "at 45 degC" in urdf_text(model, temperature=45.0)
    with pytest.raises(ModelError, match="temperature 45 degC: expected a model with thermal_expansion"):
        calibrated_chain(bare, temperature=45.0)
    for kelvin in (293.15, np.nan):
        with pytest.raises(ModelError, match="expected one of a robot, -40 to 120 degC; is it in kelvin"):
            calibrated_chain(model, temperature=kelvin)


@pytest.mark.slow
def test_links_of_another_temperature_than_their_expansion_was_identified_on_are_named(
    make_model: Make, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    slots = {Slot("thermal_expansion", "alpha", f"link{i + 1}"): 2e-5 for i in range(6)}
    model = with_slots(make_model("kuka_kr20_r1810", size=0.0), slots)
    lower = np.full((3, 6), np.nan)
    lower[2] = 20.0
    upper = lower + 10.0
    upper[2, 1] = 50.0
    ranges = Ranges(lower, upper, ("revolute",) * 6, (12.0, 12.0))
    file = tmp_path / "model.json"
    save_model(model.with_stage(replace(model.stages["poses"], ranges=ranges)), file)
    for verb, name in ((dh, "dh.csv"), (urdf, "robot.urdf"), (kuka, "machine.dat")):
        verb(file, output=tmp_path / name, temperature=45.0, quiet=True)
        said = " ".join(capsys.readouterr().err.split())
        assert "extrapolating: link 1 (link temperature to 45.0 degC, identified to 30.0 degC), link 3" in said
        verb(file, output=tmp_path / name, temperature=25.0, quiet=True)
        assert "extrapolating" not in capsys.readouterr().err


@pytest.mark.slow
def test_a_lever_in_millimetres_is_the_same_lever(make_model: Make, tmp_path: Path) -> None:
    model = tmp_path / "model.json"
    save_model(make_model("kuka_kr20_r1810"), model)
    written = {}
    for name, options in (
        ("m", {"lever": 0.35}),
        ("mm", {"lever": 350.0, "mm": True}),
        ("none", {}),
        ("usual", {"lever": 0.2}),
    ):
        kuka(model, output=tmp_path / name, quiet=True, **options)  # type: ignore[arg-type]
        written[name] = (tmp_path / name).read_text(encoding="utf-8")
    assert written["m"] == written["mm"] != written["none"] == written["usual"]
    assert "350 mm from the flange" in " ".join(written["mm"].split())


def test_files_say_by_how_much_they_differ_when_read_back(make_model: Make) -> None:
    model = make_model("kuka_kr20_r1810")
    for convention, allowed in (("hayati", 1e-9), ("standard", 1e-6)):
        table = dh_table(model, convention, fit="static")  # type: ignore[arg-type]
        stated = float(table["difference_m"].iloc[0])
        q = postures(6)
        off = np.abs(dh_forward(read_dh(table_text(table)), q) - calibrated_chain(model).flange(q)).max()
        assert 0 < stated < allowed
        assert off < 20 * stated
    assert "differs by at most" in urdf_text(model).splitlines()[1]


def test_angle_errors_are_listed_joint_by_joint(make_model: Make) -> None:
    model = with_slots(make_model("ur10"), {Slot("gear_eccentricity", "a1", "joint3"): 2e-4})
    table = angle_table(model)
    assert set(table["joint"]) == {3}
    q = table["q_rad"].to_numpy()
    np.testing.assert_allclose(table["error_rad"], 2e-4 * np.sin(q), atol=1e-15)
    np.testing.assert_allclose(table["std_error_rad"], 1e-6 * np.abs(np.sin(q)), atol=1e-12)
    robot = load_robot("ur10")
    assert (q.min(), q.max()) == (robot.lower[2], robot.upper[2])
    with pytest.raises(ModelError, match="errors of joint angles"):
        angle_table(make_model("ur10"))
