"""A model file that cannot be meant is refused: nothing in it is dropped, nor taken for something else."""

from __future__ import annotations

import copy
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from clampid.identification.identify import identify
from clampid.models.model import ModelError, load_model, save_model
from clampid.slots import Slot
from experiments.campaign import read_campaign
from experiments.simulate import simulate


@pytest.fixture(scope="module")
def good(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    folder = tmp_path_factory.mktemp("checked")
    simulate(folder / "arm", "ur10", seed=3, poses=30, tables=("poses",))
    save_model(identify(read_campaign(folder / "arm")), folder / "model.json")
    return dict(json.loads((folder / "model.json").read_text()))


def first(data: dict[str, Any]) -> dict[str, Any]:
    return dict_of(data["stages"]["poses"]["parameters"][0])


def dict_of(part: Any) -> dict[str, Any]:
    assert isinstance(part, dict)
    return part


def put(where: str, value: Any) -> Callable[[dict[str, Any]], None]:
    def change(data: dict[str, Any]) -> None:
        *path, last = where.split(".")
        part: Any = data
        for key in path:
            part = part[int(key)] if isinstance(part, list) else part[key]
        part[int(last) if isinstance(part, list) else last] = value

    return change


P0 = "stages.poses.parameters.0"
WRONG = [
    (put(f"{P0}.at", "link99"), "cannot sit at 'link99'; it can at:"),
    (put(f"{P0}.parameter", "bsae_x"), "has no parameter 'bsae_x'"),
    (put(f"{P0}.effect", "geometry\n"), "key stages.poses.parameters[1].effect: expected printable text"),
    (lambda d: d["stages"]["poses"]["parameters"].insert(1, first(d)), "expected a parameter of its own"),
    (put(f"{P0}.value", True), "expected a finite number"),
    (put(f"{P0}.value", "1.0"), "expected a finite number"),
    (put(f"{P0}.value", None), "expected a finite number"),
    (put(f"{P0}.value", 1e30), "expected a finite number from -100 to 100"),
    (put(f"{P0}.std", -1.0), "expected a finite number"),
    (put(f"{P0}.identified", 1), "expected true or false"),
    (put(f"{P0}.vlaue", 1.0), "the unknown key 'vlaue'; did you mean 'value'?"),
    (put("stages.poses.efects", []), "did you mean 'effects'?"),
    (put("stages.pose", {}), "key stages.pose: expected one of free_air"),
    (put("user_effect", "x.py"), "did you mean 'user_effects'?"),
    (
        put("sessions.0.tool_mass_kg", -1e30),
        "tool_mass_kg: expected a finite number of kg from 0 to 10000, found -1e",
    ),
    (put("sessions.0.tool_mass_kg", True), "expected a finite number"),
    (put("layout.joints", 1000000000), "layout.joints: expected an integer from 1 to 50, found 1000000000"),
    (put("layout.joints", True), "layout.joints"),
    (put("sessions.0.base_reference.0.0", 1e300), "base_reference: expected a rotation and a shift"),
    (put("sessions.0.base_reference", [[0.0] * 4] * 4), "base_reference: expected a rotation and a shift"),
    (put("sessions.0.base_reference.2.3", 1e9), "base_reference: expected a rotation and a shift"),
    (put("sessions.0.base_reference.3", [0.0, 0.0, 0.0]), "base_reference[4]: expected 4 finite numbers"),
    (put("layout.joints", 6.5), "layout.joints"),
    (put("layout.targets", ["T1", "T1", "T3"]), "layout.targets: expected names that differ, found 'T1' twice"),
    (put("layout.wrist", [7]), "layout.wrist"),
    (put("robot", "ur10\x1b[2J"), "expected printable text"),
    (put("robot", 3), "expected printable text"),
    (put("stages.poses.covariance.0.0", -1.0), "covariance"),
    (put("stages.poses.covariance.0.0", True), "covariance"),
    (put("stages.poses.covariance.0.0", [0.0]), "key stages.poses.covariance[1]: expected "),
    (put("stages.poses.covariance.0.0", {}), "key stages.poses.covariance[1]: expected "),
    (put("stages.poses.covariance.0", [0.0]), "finite numbers, found [0.0]"),
    (put("stages.poses.covariance", []), "key stages.poses.covariance: expected "),
    (put("stages.poses.lean_rad", [0.0, 0.0, 0.0]), "key stages.poses.lean_rad: expected 6 lists of 3 finite numbers"),
    (put("stages.poses.by_springs", [[0.0]]), "key stages.poses.by_springs: expected "),
    (put("stages", []), "key stages: expected a table"),
    (put("sessions", {}), "key sessions: expected tables"),
    (put("stages.poses.held_out", [[True]]), "key stages.poses.held_out: expected lists of finite numbers, found True"),
    (put("stages.poses.observability", {"O1": True}), "observability: expected numbers and names, found True"),
    (put("sessions.0.base_reference", [["1"]]), "base_reference: expected lists of finite numbers, found '1'"),
    (put("sessions.0.gravity_m_s2", [0.0, -9.81]), "gravity_m_s2: expected 3 finite numbers"),
    (put("holdout", 2.0), "key holdout: expected a finite number from 0 to 1, found 2.0"),
    (put("joint", 1), "key joint: expected true or false, found 1"),
    (put("format", "clampid-model/3"), "found 'clampid-model/3' (of a newer clampid)"),
    (lambda d: d.pop("ledger"), "key ledger: expected a list, found no such key"),
]


def test_the_model_itself_is_read(good: dict[str, Any], tmp_path: Path) -> None:
    (tmp_path / "m.json").write_text(json.dumps(good))
    assert load_model(tmp_path / "m.json").robot == "ur10"


@pytest.mark.parametrize(("change", "says"), WRONG, ids=[f"{k}-{says[:20]}" for k, (_, says) in enumerate(WRONG)])
def test_what_cannot_be_meant_is_refused(
    change: Callable[[dict[str, Any]], None], says: str, good: dict[str, Any], tmp_path: Path
) -> None:
    data = copy.deepcopy(good)
    change(data)
    (tmp_path / "m.json").write_text(json.dumps(data))
    with pytest.raises(ModelError) as raised:
        load_model(tmp_path / "m.json")
    assert says in str(raised.value)
    assert str(raised.value).startswith(str(tmp_path / "m.json"))
    assert len(str(raised.value)) < 1000


@pytest.mark.parametrize(
    "text",
    ["[" * 100_000, '{"a":' * 100_000, '{"format": "clampid-model/1", "format": "clampid-model/1"}', "NaN", "9" * 5000],
)
def test_text_that_exhausts_a_parser_is_refused(text: str, tmp_path: Path) -> None:
    (tmp_path / "m.json").write_text(text)
    with pytest.raises(ModelError, match=r"m\.json: expected"):
        load_model(tmp_path / "m.json")


@pytest.mark.parametrize("stated", ["clampid-model/1", "clampid-model", None])
def test_a_model_of_version_1_is_brought_to_the_newest(
    stated: str | None, good: dict[str, Any], tmp_path: Path
) -> None:
    data = copy.deepcopy(good)
    data.pop("format")
    data |= {"format": stated} if stated else {}
    for key in ("robot_file", "joint"):  # the first versions did not know these
        data.pop(key)
    data["layout"].pop("anchors")
    for key in ("anchors_m", "tool_com_m", "gravity_m_s2"):
        data["sessions"][0].pop(key)
    for key in ("base_parameters", "bootstrap", "told", "lean_rad", "by_springs", "ranges"):
        data["stages"]["poses"].pop(key)
    (tmp_path / "old.json").write_text(json.dumps(data))
    model = load_model(tmp_path / "old.json")
    assert model.stages["poses"].values() == {
        Slot(p["effect"], p["parameter"], p["at"]): p["value"] for p in good["stages"]["poses"]["parameters"]
    }
    assert (model.robot_file, model.joint, model.sessions[0].gravity, model.stages["poses"].ranges) == (
        None, False, None, None,
    )  # fmt: skip
    save_model(model, tmp_path / "new.json")
    assert json.loads((tmp_path / "new.json").read_text())["format"] == "clampid-model/2"
    save_model(load_model(tmp_path / "new.json"), tmp_path / "again.json")
    assert (tmp_path / "again.json").read_bytes() == (tmp_path / "new.json").read_bytes()


def test_a_device_is_no_model() -> None:
    with pytest.raises(ModelError, match="/dev/zero"):
        load_model("/dev/zero")


@pytest.mark.slow
@pytest.mark.parametrize("joint", [False, True])
def test_models_of_every_stage_are_read_as_they_were_written(tmp_path: Path, joint: bool) -> None:
    simulate(tmp_path / "arm", "kuka_kr20_r1810", seed=3, poses=40, tables=("free_air", "wrist", "clamped", "poses"))
    model = identify(read_campaign(tmp_path / "arm"), joint=joint)
    assert model.stages["free_air"].base  # which says of each whether it is identified
    save_model(model, tmp_path / "model.json")
    again = load_model(tmp_path / "model.json")
    assert list(again.stages) == ["free_air", "clamped", "poses"]
    save_model(again, tmp_path / "again.json")
    assert (tmp_path / "again.json").read_bytes() == (tmp_path / "model.json").read_bytes()
