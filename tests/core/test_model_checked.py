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
    (put(f"{P0}.effect", "geometry\n"), "expected printable text"),
    (lambda d: d["stages"]["poses"]["parameters"].insert(1, first(d)), "comes twice"),
    (put(f"{P0}.value", True), "expected a number"),
    (put(f"{P0}.value", "1.0"), "expected a number"),
    (put(f"{P0}.value", None), "expected a number"),
    (put(f"{P0}.value", 1e30), "expected a number from -100 to 100"),
    (put(f"{P0}.std", -1.0), "expected a number"),
    (put(f"{P0}.identified", 1), "expected true or false"),
    (put(f"{P0}.vlaue", 1.0), "the key 'vlaue' is not known; did you mean 'value'?"),
    (put("stages.poses.efects", []), "did you mean 'effects'?"),
    (put("stages.pose", {}), "stage 'pose' is not known"),
    (put("user_effect", "x.py"), "did you mean 'user_effects'?"),
    (put("sessions.0.tool_mass_kg", -1e30), "expected a number from 0 to 10000, found -1e+30"),
    (put("sessions.0.tool_mass_kg", True), "expected a number"),
    (put("layout.joints", 1000000000), "layout.joints: expected 1 to 50, found 1000000000"),
    (put("layout.joints", True), "layout.joints"),
    (put("layout.joints", 6.5), "layout.joints"),
    (put("layout.targets", ["T1", "T1", "T3"]), "comes twice"),
    (put("layout.wrist", [7]), "layout.wrist"),
    (put("robot", "ur10\x1b[2J"), "expected printable text"),
    (put("robot", 3), "expected printable text"),
    (put("stages.poses.covariance.0.0", -1.0), "covariance"),
    (put("stages.poses.covariance.0.0", True), "covariance"),
    (put("stages", []), "expected an object"),
    (put("sessions", {}), "expected a list"),
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


def test_a_device_is_no_model() -> None:
    with pytest.raises(ModelError, match="/dev/zero"):
        load_model("/dev/zero")
