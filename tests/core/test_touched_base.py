"""The base from touches: exact on a stiff arm, within its interval on one that bends; and what is open is named."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from circle_arms import known_drives
from touch_arms import SIGMA, base_of, nominal_links, plant_of, touched_by

from clampid.base_frames.touched_base import base_from_touches
from clampid.models.model import Model, ModelError, StageModel
from clampid.slots import Slot, Term
from experiments.campaign import Campaign, CampaignError, Instrument, Tool
from experiments.touched import Feature, Touched, read_touched
from kinematics.description import load_robot
from kinematics.poe import forward
from kinematics.robot import RobotDescription
from kinematics.screws import exp_se3, inverse, log_se3

WHERE = exp_se3(np.array([0.3, -0.2, 1.9, 2.0, -1.0, 0.4]))
TIP, BALL, SPHERE = np.array([0.02, 0.01, 0.2]), 0.003, 0.02
ROBOT = "kuka_kr20_r1810"


def touched_of(
    kinds: tuple[str, ...], seed: int = 0, real: RobotDescription | None = None, tip: np.ndarray = TIP
) -> Touched:
    """A stiff arm's touches of a feature each, anywhere and any way round, as the real arm and tip make them."""
    robot, rng = load_robot(ROBOT), np.random.default_rng(seed)
    arm = real or robot
    q = rng.uniform(-1, 1, (len(kinds), 6)) * [0.8, 0.5, 0.5, 1, 1, 1] + [0, -1.2, 1.2, 0, 0.4, 0]
    pose = WHERE @ forward(arm.screws, arm.flange, q @ np.asarray(arm.linkage).T)
    there = (pose @ np.r_[tip, 1.0])[:, :3]
    features = []
    for k, (kind, c) in enumerate(zip(kinds, there, strict=True)):
        n = rng.standard_normal(3)
        n /= np.linalg.norm(n)
        if kind == "point":
            features.append(Feature(f"f{k}", "point", c, np.zeros(3), 0.0, 0.0))
        elif kind == "plane":
            beside = np.cross(n, rng.standard_normal(3))
            features.append(Feature(f"f{k}", "plane", c - BALL * n + beside, n, 0.0, 0.0))
        else:
            features.append(Feature(f"f{k}", "sphere", c - (SPHERE + BALL) * n, np.zeros(3), SPHERE, 0.0))
    frame = pd.DataFrame({f"q{i + 1}_rad": q[:, i] for i in range(6)})
    frame[[f"dir{i + 1}" for i in range(6)]] = 0
    frame["pose"], frame["visit"], frame["time_s"] = np.arange(1, len(q) + 1), 1, np.arange(float(len(q)))
    frame[["x_m", "y_m", "z_m"]], frame["target"] = 0.0, "tip"
    campaign = Campaign(
        "touched", None, robot, np.array([0, 0, -9.81]), Tool(0.0, np.zeros(3)), {"tip": TIP},
        Instrument("touch", SIGMA, None), {"poses": frame}, "",
    )  # fmt: skip
    return Touched(campaign, tuple(features), np.arange(len(kinds)), BALL)


@pytest.mark.parametrize(
    "kinds",
    [("point",) * 3, ("plane",) * 9, ("point", "plane", "sphere") * 3],
    ids=["points", "planes", "all"],
)
def test_a_stiff_arm_gives_its_base_exactly_from_anywhere(kinds: tuple[str, ...]) -> None:
    found = base_from_touches(touched_of(kinds), rigid=True)
    np.testing.assert_allclose(found.base, WHERE, atol=1e-9)
    assert found.rms < 1e-10
    assert found.freedom == sum(3 if kind == "point" else 1 for kind in kinds) - 6


@pytest.mark.slow
def test_covariance_is_that_of_repeated_touches() -> None:
    clean = touched_of(("point", "plane", "sphere", "plane", "point", "sphere", "plane"))
    rng, off = np.random.default_rng(0), []
    for _ in range(150):
        moved = [replace(f, point=f.point + SIGMA * rng.standard_normal(3)) for f in clean.features]
        noisy = replace(clean, features=tuple(moved), start=WHERE)
        off.append(log_se3(inverse(WHERE) @ base_from_touches(noisy, rigid=True).base))
    found = base_from_touches(clean, rigid=True)
    # A covariance of 150 samples has entries to 12 %: two standard errors of each, and of its trace far less.
    whitened = np.linalg.solve(np.linalg.cholesky(found.covariance), np.array(off).T)
    np.testing.assert_allclose(np.mean(whitened**2, axis=1), 1.0, atol=0.35)
    assert np.mean(whitened**2) == pytest.approx(1.0, abs=0.15)


@pytest.mark.parametrize(
    ("kinds", "open_"),
    [
        (("point",), ["turn about"] * 3),
        (("point", "point"), ["turn about"]),
        (("plane",), ["turn about"] * 3 + ["shift along"] * 2),
    ],
)
def test_what_touches_leave_open_is_named(kinds: tuple[str, ...], open_: list[str]) -> None:
    touched = touched_of(kinds)
    with pytest.raises(CampaignError, match="leave the base free to") as error:
        base_from_touches(touched, rigid=True)
    for word in ("turn about", "shift along"):
        assert str(error.value).count(word) == open_.count(word)
    if kinds == ("point", "point"):  # about the line through both
        line = touched.features[1].point - touched.features[0].point
        line *= np.sign(line[np.argmax(np.abs(line))]) / np.linalg.norm(line)
        assert f"turn about ({', '.join(f'{x:.3f}' for x in line)})" in str(error.value)


def test_parallel_planes_leave_shifts_along_them_open() -> None:
    touched = touched_of(("plane",) * 6)
    n = np.array([0.0, 0.0, 1.0])
    tips = [f.point + BALL * f.normal - np.cross(f.normal, np.zeros(3)) for f in touched.features]
    flat = [replace(f, normal=n, point=p) for f, p in zip(touched.features, tips, strict=True)]
    with pytest.raises(CampaignError, match=r"shift along .* shift along|turn about \(0.000, 0.000, 1.000\)"):
        base_from_touches(replace(touched, features=tuple(flat), start=WHERE), rigid=True)


def test_six_numbers_may_mean_another_base_and_a_start_says_which() -> None:
    touched = touched_of(("plane",) * 6, seed=3)
    with pytest.raises(CampaignError, match=r"two bases agree .* start_m and start_rad"):
        base_from_touches(touched, rigid=True)
    near = WHERE @ exp_se3(np.array([0.05, -0.05, 0.05, 0.1, -0.1, 0.1]))
    found = base_from_touches(replace(touched, start=near), rigid=True)
    np.testing.assert_allclose(found.base, WHERE, atol=1e-8)
    assert found.freedom == 0


def test_an_arm_that_bends_gives_its_base_within_the_interval() -> None:
    """Millimetres off without, right with: the virtual robot's physics against the model's."""
    squares, ratios = [], []
    for seed in range(3):
        plant = nominal_links(plant_of(seed))
        found = base_from_touches(touched_by(plant, seed, each=5), known_drives(plant, seed))
        off = log_se3(inverse(base_of(plant)) @ found.base)
        whitened = np.linalg.solve(np.linalg.cholesky(found.covariance), off)
        squares.append(whitened @ whitened)
        ratios.append(found.chi2 / found.freedom)
        assert np.linalg.norm(found.bias[3:]) > 1e-3
        assert found.outliers == ()
        parts = np.array(list(found.sources.values()))
        np.testing.assert_allclose(np.sqrt(found.scale * np.sum(parts**2, axis=0)), found.std, rtol=1e-6)
    # Chi-square of 18 numbers over 18: 1 within three times sqrt(2 / 18). Misfits: three times sqrt(2 / 42).
    assert sum(squares) / 18 == pytest.approx(1.0, abs=1.0)
    assert np.mean(ratios) == pytest.approx(1.0, abs=0.66)


def test_features_that_are_not_known_well_are_counted() -> None:
    plant = nominal_links(plant_of(1))
    touched = touched_by(plant, 1, each=5, feature_std=3e-4)
    found = base_from_touches(touched, known_drives(plant, 1))
    off = log_se3(inverse(base_of(plant)) @ found.base)
    assert np.linalg.norm(found.sources["features"][3:]) > 1e-4
    assert np.all(np.abs(off) < 3 * found.std)
    exact = replace(touched, features=tuple(replace(f, std=0.0) for f in touched.features))
    # Told that features are exact, the misfits say that they are not.
    assert base_from_touches(exact, known_drives(plant, 1)).scale > 10 * found.scale


def test_a_wrong_touch_is_left_out_and_listed() -> None:
    touched = touched_of(("point", "plane", "sphere") * 6)
    wrong = list(touched.features)
    wrong[9] = replace(wrong[9], point=wrong[9].point + np.array([0.0, 4e-3, 0.0]))
    found = base_from_touches(replace(touched, features=tuple(wrong)), rigid=True)
    assert found.outliers == (10,)
    np.testing.assert_allclose(found.base, WHERE, atol=1e-9)


def test_a_models_links_and_target_say_where_the_tip_is_but_not_its_base() -> None:
    robot, up = load_robot(ROBOT), np.array([0.0, 0.0, 1.5e-3])
    joints = tuple(replace(j, point=j.point + up) if k > 1 else j for k, j in enumerate(robot.joints))
    flange = robot.flange.copy()
    flange[:3, 3] += up
    real, tip = replace(robot, joints=joints, flange=flange, dh=None), TIP + np.array([0.0, 1e-3, 0.0])
    touched = touched_of(("point", "plane", "sphere") * 3, real=real, tip=tip)
    slots = (
        Slot("geometry", "z", "link2"), Slot("geometry", "base_x", "session1"), Slot("geometry", "target_x", "T9"),
        Slot("geometry", "target_y", "tip"), Slot("joint_compliance", "c", "joint1"),
    )  # fmt: skip
    theta, std = np.array([1.5e-3, 0.7, 0.4, 1e-3, 0.0]), np.array([1e-4, 1e-3, 1e-3, 1e-5, 1e-12])
    terms = tuple(Term(name) for name in dict.fromkeys(s.effect for s in slots))
    stage = StageModel("poses", terms, slots, theta, np.diag(std**2), (True,) * len(slots))
    model = replace(known_drives(plant_of(0), 0), stages={"poses": stage})
    found = base_from_touches(touched, model)
    np.testing.assert_allclose(found.base, WHERE, atol=1e-8)
    assert 0.5e-3 < found.put_back < 2.5e-3
    assert found.arm.endswith("the tip is where the model has tip")
    assert found.sources["arm"][3:].max() > 1e-6
    with pytest.raises(ModelError, match="touches of kuka_kr20_r1810"):
        base_from_touches(touched, replace(model, robot="ur10"))


HEADER = """
format = "clampid-touched/1"
robot = "kuka_kr20_r1810"
gravity_m_s2 = [0.0, 0.0, -9.81]
touches = "touches.csv"
tip_radius_m = 0.003
[targets_m]
tip = [0.02, 0.01, 0.2]
[instrument]
position_std_m = 2e-5
"""


def written(folder: Path, touched: Touched) -> Path:
    """The touches as a user's files."""
    text = HEADER
    for f in touched.features:
        key = "centre_m" if f.kind == "sphere" else "point_m"
        text += f'[features.{f.name}]\nkind = "{f.kind}"\n{key} = {f.point.tolist()}\n'
        text += f"normal = {(3 * f.normal).tolist()}\n" if f.kind == "plane" else ""
        text += f"radius_m = {f.radius}\n" if f.kind == "sphere" else ""
    table = touched.campaign.tables["poses"][[f"q{i + 1}_rad" for i in range(6)]]
    table.assign(feature=[touched.features[k].name for k in touched.feature]).to_csv(
        folder / "touches.csv", index=False
    )
    (folder / "touched.toml").write_text(text)
    return folder / "touched.toml"


def test_a_file_is_read_as_it_was_meant(tmp_path: Path) -> None:
    touched = touched_of(("point", "plane", "sphere") * 3)
    read = read_touched(written(tmp_path, touched))
    np.testing.assert_allclose(base_from_touches(read, rigid=True).base, WHERE, atol=1e-8)
    path = tmp_path / "touched.toml"
    path.write_text("start_m = [1, 2, 3]\nstart_rad = [0, 0, 0]\n" + path.read_text())
    np.testing.assert_array_equal(read_touched(path).start[:3, 3], [1, 2, 3])


def _degrees(table: pd.DataFrame) -> pd.DataFrame:
    return table.assign(q3_rad=np.degrees(table["q3_rad"]))


@pytest.mark.parametrize(
    ("text", "table", "words"),
    [
        (("clampid-touched/1", "clampid-campaign/1"), None, r"touched\.toml, key format: expected 'clampid-touched/1'"),
        (("position_std_m = 2e-5", ""), None, "position_std_m: expected one sigma of a touch in m, found none"),
        (('kind = "plane"', 'kind = "cone"'), None, r"features\.f1\.kind: expected one of plane, sphere, point"),
        (
            ("radius_m = 0.02", "radius_mm = 20"),
            None,
            r"features\.f2\.radius_m: expected .* found no such key, but 'radius_mm'",
        ),
        (("point_m = [", "point_m = [2000.0, 0.0, 0.0] #"), None, r"point_m: .* from -100 to 100, .*millimetres"),
        (("tip = [0.02", 'tip = ["x"'), None, r"targets_m\.tip: expected 3 finite numbers"),
        (None, _degrees, r"touches\.csv, row \d+ .*column q3_rad: expected radians.*are they degrees"),
        (None, lambda t: t.replace("f2", "f77"), r"row 3 .*column feature: expected one of the features f0, .*'f77'"),
        (None, lambda t: t.drop(columns="q2_rad"), "q2_rad"),
        (None, lambda t: t.drop(columns="feature"), "feature"),
    ],
)
def test_what_cannot_be_meant_is_refused(
    tmp_path: Path,
    text: tuple[str, str] | None,
    table: Callable[[pd.DataFrame], pd.DataFrame] | None,
    words: str,
) -> None:
    path = written(tmp_path, touched_of(("point", "plane", "sphere")))
    if text is not None:
        path.write_text(path.read_text().replace(*text, 1))
    if table is not None:
        frame: Any = pd.read_csv(tmp_path / "touches.csv")
        table(frame).to_csv(tmp_path / "touches.csv", index=False)
    with pytest.raises(CampaignError, match=words):
        read_touched(path)


def test_a_model_without_springs_is_refused() -> None:
    model: Model = known_drives(plant_of(0), 0)
    with pytest.raises(ModelError, match="expected a model with joint_compliance"):
        base_from_touches(touched_of(("point",) * 3), replace(model, stages={"free_air": model.stages["free_air"]}))
