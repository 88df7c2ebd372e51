"""Model files: what is written is read back exactly, and what is no model is refused by name."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from clampid.catalogue import catalogue
from clampid.identification.fitted_stage import fit_stage
from clampid.identification.identify import identify
from clampid.models.model import FORMAT, Model, ModelError, load_model, save_model
from clampid.slots import Term, find_parameter
from clampid.stages.layout import layout_of
from clampid.stages.pose_rows import pose_rows
from experiments.campaign import Campaign
from experiments.outputs import write_text

Simulated = Callable[..., Campaign]


@pytest.fixture(scope="module")
def model(simulated: Simulated) -> Model:
    campaign = simulated(seed=2, poses=40, tables=("poses", "verification"), outliers=0.02)
    return identify(campaign, holdout=0.2, seed=3)


def same(a: Any, b: Any) -> bool:
    """Equality to the last digit, arrays and nested values included."""
    if is_dataclass(a):
        return type(a) is type(b) and all(same(getattr(a, f.name), getattr(b, f.name)) for f in fields(a))
    if isinstance(a, np.ndarray):
        return isinstance(b, np.ndarray) and np.array_equal(a, b)
    if isinstance(a, dict):
        return a.keys() == b.keys() and all(same(v, b[k]) for k, v in a.items())
    if isinstance(a, tuple):
        return isinstance(b, tuple) and len(a) == len(b) and all(map(same, a, b))
    return bool(a == b)


def test_round_trip_is_exact(model: Model, tmp_path: Path):
    path = tmp_path / "m.json"
    save_model(model, path)
    again = load_model(path)
    assert same(model, again)
    save_model(again, tmp_path / "n.json")
    assert path.read_bytes() == (tmp_path / "n.json").read_bytes()


def test_a_person_can_read_it(model: Model, tmp_path: Path):
    save_model(model, tmp_path / "m.json")
    data = json.loads((tmp_path / "m.json").read_text())
    assert data["format"] == FORMAT
    first = data["stages"]["poses"]["parameters"][0]
    assert set(first) == {"effect", "parameter", "at", "value", "std", "identified"}
    assert data["sessions"][0]["fingerprint"]
    assert data["ledger"][0]["stage"] == "poses"
    assert data["stages"]["poses"]["held_out"][0]


def test_unreadable(tmp_path: Path):
    missing = tmp_path / "none.json"
    with pytest.raises(ModelError, match=r"none\.json.*found none"):
        load_model(missing)
    with pytest.raises(ModelError, match=str(tmp_path)):
        load_model(tmp_path)
    binary = tmp_path / "binary.json"
    binary.write_bytes(b"\xff\xfe\x00PAR1")
    with pytest.raises(ModelError, match=r"binary\.json"):
        load_model(binary)


@pytest.mark.parametrize(
    "text", ["", "[]", "3", "{}", '{"format": "clampid-campaign/1"}', '{"format": "clampid-model/9"}']
)
def test_foreign(tmp_path: Path, text: str):
    path = tmp_path / "foreign.json"
    path.write_text(text)
    with pytest.raises(ModelError, match=r"foreign\.json"):
        load_model(path)


@settings(derandomize=True, deadline=None, max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(share=st.floats(0.0, 0.999))
def test_truncated(model: Model, tmp_path: Path, share: float):
    path = tmp_path / "cut.json"
    save_model(model, path)
    text = path.read_text().rstrip()
    path.write_text(text[: int(share * len(text))])
    with pytest.raises(ModelError, match=r"cut\.json"):
        load_model(path)


@pytest.mark.parametrize("key", ["robot", "layout", "seed", "holdout", "user_effects", "sessions", "stages", "ledger"])
def test_a_part_missing_or_spoiled(model: Model, tmp_path: Path, key: str):
    path = tmp_path / "part.json"
    save_model(model, path)
    data = json.loads(path.read_text())
    for spoil in ("missing", "spoiled"):
        changed = dict(data)
        if spoil == "missing":
            del changed[key]
        elif key in ("layout", "sessions", "stages", "ledger", "seed", "holdout"):
            changed[key] = "?"
        else:
            continue
        path.write_text(json.dumps(changed))
        with pytest.raises(ModelError, match=r"part\.json"):
            load_model(path)


def test_unknown_stage_or_short_covariance(model: Model, tmp_path: Path):
    path = tmp_path / "odd.json"
    save_model(model, path)
    data = json.loads(path.read_text())
    stage = data["stages"]["poses"]
    for changed in ({"pose": stage}, {"poses": {**stage, "covariance": stage["covariance"][:-1]}}):
        path.write_text(json.dumps({**data, "stages": changed}))
        with pytest.raises(ModelError, match=r"odd\.json"):
            load_model(path)


def test_written_whole_or_not_at_all(model: Model, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    path = tmp_path / "m.json"
    save_model(model, path)
    before = path.read_bytes()

    def fail(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "replace", fail)
    monkeypatch.setattr(os, "link", lambda *_, **__: fail())
    with pytest.raises(OSError, match="No space"):
        save_model(model, path)
    with pytest.raises(OSError, match="No space"):
        save_model(model, tmp_path / "new.json")
    assert path.read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["m.json"]


def test_folders_are_made(tmp_path: Path):
    write_text(tmp_path / "a" / "b" / "c.txt", "µ\n")
    assert (tmp_path / "a" / "b" / "c.txt").read_text(encoding="utf-8") == "µ\n"


def test_observability_of_a_fit_is_that_of_its_whitened_jacobian(simulated: Simulated) -> None:
    campaign = simulated(seed=6, poses=60, tables=("poses",))
    rows = pose_rows([campaign], layout_of([campaign]), "poses")
    fitted = fit_stage(rows, catalogue(), (Term("geometry"),), {})
    sizes = [find_parameter(slot, catalogue()).size for slot in fitted.model.slots]
    s = np.linalg.svd(fitted.estimate.whitened.jacobian * sizes, compute_uv=False)
    found = fitted.model.observability
    assert found["parameters"] == len(s)
    assert found["O1"] == pytest.approx(np.exp(np.mean(np.log(s))) / np.sqrt(len(fitted.estimate.whitened.residual)))
    assert (found["O2"], found["O3"]) == (pytest.approx(s[-1] / s[0]), pytest.approx(s[-1]))
    assert found["O4"] == pytest.approx(s[-1] ** 2 / s[0])
    assert found["O5"] == pytest.approx(1 / np.sum(1 / s))
