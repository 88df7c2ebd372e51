"""Code of a file that a model names runs only if the caller names the file, or the user trusts what it holds."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from clampid import catalogue as catalogue_module
from clampid.catalogue import with_user_effects
from clampid.cli import run
from clampid.diagnosis.effect_new import effect_new
from clampid.effect import EffectError
from clampid.identification.identify import identify
from clampid.models.model import Model, load_model, save_model
from clampid.models.own_effects import effects_of
from clampid.trusted import distrust, hash_of, list_of_trusted, trust, trust_file
from experiments.campaign import read_campaign
from experiments.simulate import simulate

OPENS = (
    "ik MODEL --gamma 0.1 --delta 0.1 --r 0.8",
    "serve MODEL --listen 127.0.0.1:0",
    "compare MODEL arm",
    "diagnose MODEL arm",
    "add gear_eccentricity MODEL arm -o better.json",
    "undo MODEL arm -o before.json",
    "export dh MODEL -o table.csv",
    "export urdf MODEL -o robot.urdf",
    "export angles MODEL -o angles.csv",
    "base arm --model MODEL",
)
"""Calls that read the effects of a model. (``sample`` goes the same way, with peaks of its own.)"""


@pytest.fixture(scope="module")
def workshop(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Model]:
    """A folder with a campaign, and a model of it."""
    folder = tmp_path_factory.mktemp("workshop")
    simulate(folder / "arm", "ur10", seed=3, poses=30, tables=("poses", "verification"))
    return folder, identify(read_campaign(folder / "arm"))


@pytest.fixture
def named(workshop: tuple[Path, Model], monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Callable[[], Path]:
    """Write a model that names an effect file beside it; the file leaves a mark when it runs."""
    folder, model = workshop
    monkeypatch.chdir(folder)
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    monkeypatch.setattr(catalogue_module, "_named", set())
    (tmp_path / "ran").unlink(missing_ok=True)

    def write() -> Path:
        own = effect_new("snag", ["q3"], "joint3", path=tmp_path / "snag.py")
        own.write_text(own.read_text() + f"\nopen({str(tmp_path / 'ran')!r}, 'w').close()\n")
        again = replace(model.ledger[-1], added=("gear_eccentricity@joint2",))
        spoiled = replace(model, user_effects="/nowhere/snag.py", ledger=(*model.ledger, again))
        save_model(spoiled, tmp_path / "model.json")
        return tmp_path / "model.json"

    return write


@pytest.mark.parametrize("call", OPENS)
def test_opening_a_model_runs_no_code_of_its_own(call: str, named: Callable[[], Path], capsys):
    model = named()
    assert run([*call.replace("MODEL", str(model)).split(), "--quiet"]) == 2
    said = capsys.readouterr().err
    assert not model.with_name("ran").exists()
    assert f"clampid effect trust {model.with_name('snag.py')}" in said
    assert "--effects-from" in said
    assert len(said.strip().splitlines()) == 1


def test_history_and_report_need_no_code(named: Callable[[], Path]):
    model = named()
    assert run(["history", str(model)]) == 0
    assert not model.with_name("ran").exists()


def test_named_by_the_caller_it_runs(named: Callable[[], Path]):
    model = named()
    own = model.with_name("snag.py")
    assert run(["compare", str(model), "arm", "--quiet", "--effects-from", str(own)]) == 0
    assert model.with_name("ran").exists()


def test_trusted_it_runs_until_it_is_changed(named: Callable[[], Path], capsys):
    model = named()
    own = model.with_name("snag.py")
    assert run(["effect", "trust", str(own)]) == 0
    assert not model.with_name("ran").exists()  # trusting reads it and does not run it
    assert "snag" in effects_of(load_model(model))
    assert model.with_name("ran").exists()
    own.write_text(own.read_text() + "# another word\n")
    assert run(["compare", str(model), "arm", "--quiet"]) == 2
    assert "effect trust" in capsys.readouterr().err


def test_trust_can_be_taken_back(named: Callable[[], Path]):
    own = named().with_name("snag.py")
    trust(own)
    assert distrust(own) == 1
    assert list_of_trusted() == {}


def test_compiled_code_beside_an_effect_is_never_run(named: Callable[[], Path]):
    own = named().with_name("snag.py")
    with_user_effects(own)
    assert not (own.parent / "__pycache__").exists()


def test_a_missing_effect_is_refused_by_name(named: Callable[[], Path], capsys):
    model = named()
    data = json.loads(model.read_text())
    stage = data["stages"]["poses"]
    stage["effects"].append("wave@joint3")
    for own in ("/nowhere/else.py", None):
        model.write_text(json.dumps({**data, "user_effects": own}))
        assert run(["compare", str(model), "arm", "--quiet"]) == 2
        said = capsys.readouterr().err
        assert "an effect 'wave'" in said
        assert "--effects-from" in said


def test_an_effect_with_a_name_of_the_catalogue_is_refused(tmp_path: Path):
    own = effect_new("snag", ["q3"], "joint3", path=tmp_path / "snag.py")
    own.write_text(
        own.read_text().replace('name="snag"', 'name="backlash"').replace('family="snag"', 'family="backlash"')
    )
    with pytest.raises(EffectError, match="the catalogue has an effect 'backlash'"):
        with_user_effects(own)


def test_a_list_that_others_may_write_is_refused(named: Callable[[], Path]):
    own = named().with_name("snag.py")
    trust(own)
    os.chmod(trust_file(), 0o666)
    with pytest.raises(EffectError, match="writable by you alone"):
        list_of_trusted()
    os.chmod(trust_file(), 0o600)
    os.chmod(trust_file().parent, 0o777)
    with pytest.raises(EffectError, match="writable by you alone"):
        list_of_trusted()


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() != 0, reason="giving a file away needs root")
def test_a_list_of_another_user_is_refused(named: Callable[[], Path]):
    trust(named().with_name("snag.py"))
    os.chown(trust_file(), 12345, 12345)
    with pytest.raises(EffectError, match="belong to you"):
        list_of_trusted()


@pytest.mark.parametrize(
    "text", ["", "{", "[]", '{"format": "x"}', '{"format": "clampid-trusted-effects/1"}', "[" * 99999]
)
def test_a_spoiled_list_is_refused(text: str, named: Callable[[], Path]):
    own = named().with_name("snag.py")
    trust(own)
    trust_file().write_text(text)
    with pytest.raises(EffectError, match="list of trusted effects"):
        list_of_trusted()


def test_the_list_keeps_what_it_had(named: Callable[[], Path]):
    own = named().with_name("snag.py")
    first = trust(own)
    own.write_text(own.read_text() + "\n")
    assert list(list_of_trusted()) == [first]
    assert set(list_of_trusted()) < {first, trust(own)}
    assert first == hash_of(own.read_bytes()[:-1])
