"""What the verbs give to programs: the keys of the contract, stdout with nothing but JSON, equal numbers for a seed."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import pytest
from cli_runner import Clampid

from clampid.display import error_text


@pytest.mark.slow
def test_check(clampid: Clampid, whole: Path) -> None:
    ran = clampid("check", whole, "--json", "-")
    assert ran.code == 0, ran.err
    assert set(ran.json["tables"]) == {"free_air", "wrist", "clamped", "poses", "verification"}
    assert ran.json["stages"]["free_air"]["tables"] == ["free_air", "wrist"]
    assert "geometry" in ran.json["stages"]["poses"]["standard"]


@pytest.mark.slow
def test_iso_9283_of_the_robot_itself(clampid: Clampid, poses_only: Path, whole: Path) -> None:
    ran = clampid("check", whole, "--iso9283", "--json", "-")
    assert ran.code == 0, ran.err
    poses = ran.json["iso9283"]["poses"]
    assert poses["position"]["AP"]["mean"] > 10 * poses["position"]["RP"]["mean"]
    assert poses["returns_wanted"] == 30
    shown = clampid("check", whole, "--iso9283", "-q", "--verbose").out
    shown = " ".join(shown.split())
    assert "dRP not determinable from these data: no pose was visited four times" in shown
    assert "RP as 30 returns would show it" in shown
    assert "verification: ISO 9283: not determinable from these data: no pose was visited twice" in shown
    assert "iso9283" not in clampid("check", poses_only, "--json", "-").json


def test_effects(clampid: Clampid) -> None:
    ran = clampid("effects", "--json", "-")
    assert ran.code == 0, ran.err
    assert {"geometry", "backlash", "gear_eccentricity"} <= {effect["name"] for effect in ran.json}
    for effect in ran.json:
        assert {"name", "family", "parameters", "needs", "equation", "source"} <= set(effect)
        assert all({"name", "unit"} <= set(p) for p in effect["parameters"])


def test_effects_of_a_users_own(clampid: Clampid, tmp_path: Path) -> None:
    own = tmp_path / "own.py"
    own.write_text(
        "from clampid.effect import Effect, Parameter\n"
        "EFFECT = Effect(name='my_slack', family='backlash',\n"
        "    acts={'joint_angle': lambda p, x: p.slack * x.direction},\n"
        "    parameters=(Parameter('slack', 'rad', 1e-4, 'joint'),), needs=('direction',), stages=('poses',),\n"
        "    equation='dq = s d', source=('own',))\n"
    )
    ran = clampid("effects", "--effects-from", own, "--json", "-")
    assert "my_slack" in {effect["name"] for effect in ran.json}


@pytest.mark.slow
def test_json_on_stdout_is_alone_and_equal_to_the_file(clampid: Clampid, poses_only: Path, tmp_path: Path) -> None:
    there = clampid("identify", poses_only, "-o", tmp_path / "m.json", "--json", "-")
    assert there.code == 0, there.err
    assert there.json["stages"]["poses"]["unit"] == "m"
    clampid("identify", poses_only, "-o", tmp_path / "m.json", "--json", tmp_path / "i.json", "-q")
    assert json.loads((tmp_path / "i.json").read_text()) == there.json
    assert sorted(p.name for p in tmp_path.iterdir()) == ["i.json", "m.json"]


@pytest.mark.slow
def test_quiet_silences_progress(clampid: Clampid, poses_only: Path, tmp_path: Path) -> None:
    loud = clampid("identify", poses_only, "-o", tmp_path / "m.json")
    quiet = clampid("identify", poses_only, "-o", tmp_path / "m.json", "--quiet")
    assert "identifying" in loud.err
    assert "identifying" not in quiet.err
    assert loud.out == quiet.out


@pytest.mark.slow
def test_equal_seeds_give_equal_files(clampid: Clampid, installed: Clampid, poses_only: Path, tmp_path: Path) -> None:
    """The two processes hash strings each in its own way: no order of a set is in what they write."""
    for name, program in (("a.json", clampid), ("b.json", installed)):
        program("identify", poses_only, "-o", tmp_path / name, "--holdout", "0.2", "--seed", "5", "-q")
    assert (tmp_path / "a.json").read_bytes() == (tmp_path / "b.json").read_bytes()
    held = json.loads((tmp_path / "a.json").read_text())["stages"]["poses"]["held_out"]
    assert len(held[0]) == 16


@pytest.mark.slow
def test_the_loop_on_one_campaign(clampid: Clampid, poses_only: Path, model: Path, tmp_path: Path) -> None:
    compared = clampid("compare", model, poses_only, "--json", "-")
    assert compared.code == 0, compared.err
    table = compared.json["tables"]["poses"]
    assert table["unit"] == "m"
    assert {"rows", "rms", "mean", "p95", "max", "noise_floor", "noise_source", "heldout"} <= set(table)
    assert {"rows", "rms", "mean", "max"} <= set(table["heldout"])

    found = clampid("diagnose", model, poses_only, "--json", tmp_path / "d.json")
    assert found.code == 0, found.err
    diagnosis = json.loads((tmp_path / "d.json").read_text())["stages"]["poses"]
    assert {
        "verdict", "unit", "noise_floor", "heldout_rms_before", "heldout_rms_after", "candidates", "considered",
        "depends_on", "outliers", "next_measurement", "summary",
    } <= set(diagnosis)  # fmt: skip
    assert {
        "effect", "where", "alternative", "p_value", "p_familywise", "heldout_rms_before", "heldout_rms_after",
        "parameters", "confusable_with",
    } <= set(diagnosis["candidates"][0])  # fmt: skip
    assert ("gear_eccentricity", ["joint2"]) in [(c["effect"], c["where"]) for c in diagnosis["candidates"]]

    mended = tmp_path / "m2.json"
    added = clampid("add", "gear_eccentricity@joint2", model, poses_only, "-o", mended, "--json", "-")
    assert added.code == 0, added.err
    part = added.json["stages"]["poses"]
    assert {"unit", "added", "noise_floor", "heldout_rms_before", "heldout_rms_after"} <= set(part)
    assert part["added"][0]["effect"] == "gear_eccentricity"
    assert part["heldout_rms_after"] < part["heldout_rms_before"]

    rounds = clampid("history", mended, "--json", "-").json["rounds"]
    assert len(rounds) == 2
    assert all({"stage", "effects", "rms", "heldout_rms", "noise_floor"} <= set(r) for r in rounds)


@pytest.mark.slow  # it diagnoses; that `report` writes what was kept is tested below
def test_compare_writes_a_report(clampid: Clampid, poses_only: Path, model: Path, tmp_path: Path) -> None:
    report = tmp_path / "report.html"
    assert clampid("compare", model, poses_only, "--report", report, "-q").code == 0
    assert "<html" in report.read_text()[:2000]


@pytest.mark.slow
def test_auto_reports_every_step_and_what_was_rejected(clampid: Clampid, poses_only: Path, tmp_path: Path) -> None:
    model, report = tmp_path / "m.json", tmp_path / "r.html"
    wanted = ("--effects", "poses=geometry,joint_compliance")
    ran = clampid("auto", poses_only, *wanted, "-o", model, "--report", report, "--json", tmp_path / "a.json", "-q")
    assert ran.code == 0, ran.err
    assert f"Report: {report}" in " ".join(ran.out.split())
    rounds = clampid("history", model, "--json", "-").json["rounds"]
    confirmed = [
        (c["name"], tuple(c["where"]))
        for c in json.loads((tmp_path / "a.json").read_text())["diagnosis"]["stages"]["poses"]["candidates"]
        if not c["alternative"]
    ]
    steps = rounds[1:]
    assert len(steps) == len(confirmed) >= 1
    for (name, where), step in zip(confirmed, steps, strict=True):
        assert step["added"] == [f"{name}@{place}" for place in where]
        assert {"p_value", "p_familywise", "p_held_out", "stability", "confusable_with"} <= set(step["evidence"])
    page = report.read_text(encoding="utf-8")
    assert "Every step, and what was rejected" in page
    rejected = [r for step in steps for r in step["evidence"]["rejected"]]
    assert rejected
    assert all(r["reason"] in page for r in rejected)


@pytest.mark.parametrize("refit", ["base,tool", "base", "tool"])
def test_compare_with_refit_holds_the_rest_out(refit: str, clampid: Clampid, poses_only: Path, model: Path) -> None:
    ran = clampid("compare", model, poses_only, "--refit", refit, "--json", "-")
    assert ran.code == 0, ran.err
    table = ran.json["tables"]["poses"]
    share = table["rows"] / (table["rows"] + table["heldout"]["rows"])
    assert 0.15 < share < 0.25


@pytest.mark.slow
def test_export_dh_to_stdout_and_to_a_file(clampid: Clampid, model: Path, tmp_path: Path) -> None:
    printed = clampid("export", "dh", model, "--convention", "hayati")
    assert printed.code == 0, printed.err
    rows = list(csv.DictReader(printed.out.splitlines()))
    assert [row["row"] for row in rows] == ["1", "2", "3", "4", "5", "6", "base", "tool"]
    path = tmp_path / "dh.csv"
    assert clampid("export", "dh", model, "--convention", "hayati", "-o", path).code == 0
    assert path.read_text() == printed.out


@pytest.mark.slow
def test_the_table_is_the_best_for_a_controller_that_knows_tables_only(
    clampid: Clampid, model: Path, tmp_path: Path
) -> None:
    path = tmp_path / "dh.csv"
    ran = clampid("export", "dh", model, "-o", path, "--json", tmp_path / "best.json")
    assert ran.code == 0, ran.err
    fit = json.loads((tmp_path / "best.json").read_text())["fit"]
    assert 0 < fit["rms_m"] < 0.9 * fit["static_rms_m"]
    assert f"{error_text(fit['rms_m'], 'm')} rms where the model was measured" in ran.out
    assert f"({error_text(fit['static_rms_m'], 'm')} with the model's own geometry)" in " ".join(ran.out.split())
    ran = clampid("export", "dh", model, "--fit", "static", "--json", "-")
    assert ran.code == 0, ran.err
    assert ran.json["fit"] is None


@pytest.mark.slow
def test_exports_tell_programs_what_they_leave(clampid: Clampid, model: Path, poses_only: Path, tmp_path: Path) -> None:
    ran = clampid("export", "dh", model, "--campaign", poses_only, "--fit", "static", "--json", "-")
    assert ran.code == 0, ran.err
    data = ran.json
    assert 0 < data["left_by_table_m"]["rms"] < data["left_by_table_m"]["max"]
    assert "backlash" in [entry["effect"] for entry in data["not_in_table"]]
    assert [row["row"] for row in data["rows"]] == ["1", "2", "3", "4", "5", "6", "base", "tool"]
    assert data["measured"]["table"] == "verification"
    ran = clampid("export", "dh", model, "--layout", "thesis")
    assert ran.code == 0, ran.err
    assert ran.out.startswith("| link |  | θ [rad] | d [m] | a [m] | α [rad] | β [rad] |")
    path = tmp_path / "arm.urdf"
    ran = clampid("export", "urdf", model, "-o", path, "--json", tmp_path / "u.json")
    assert ran.code == 0, ran.err
    told = json.loads((tmp_path / "u.json").read_text())
    assert told["file"] == str(path)
    assert told["measured"] is None
    assert told["left_by_table_m"]["max"] == pytest.approx(data["left_by_table_m"]["max"], rel=1e-6)
    assert f"max {1e3 * told['left_by_table_m']['max']:.4f} mm" in path.read_text()
    lines = ran.out.splitlines()
    assert len(lines) <= 24
    assert all(len(line) <= 80 or str(tmp_path) in line for line in lines)  # a path is not broken
    assert f"{1e3 * told['left_by_table_m']['max']:.2f} mm at most" in ran.out
    assert f"only this URDF errs by {1e3 * told['left_by_table_m']['rms']:.2f} mm (rms) over the workspace" in ran.out


@pytest.mark.slow
def test_the_universal_models_cost(clampid: Clampid, poses_only: Path, tmp_path: Path) -> None:
    call = ("identify", poses_only, "--effects", "poses=geometry", "--cost", "mean-norm")
    ran = clampid(*call, "-o", tmp_path / "m.json", "-q", "--verbose")
    assert ran.code == 0, ran.err
    assert "poses by mean-norm, fitted points: P_mean" in ran.out
    assert "poses by least-squares, fitted points: P_mean" in ran.out
    ran = clampid(*call, "--joint", "-o", tmp_path / "j.json", "-q")
    assert ran.code == 2
    assert "cost mean-norm" in ran.complaint
    assert not (tmp_path / "j.json").exists()


def test_export_urdf(clampid: Clampid, model: Path, tmp_path: Path) -> None:
    path = tmp_path / "robot.urdf"
    assert clampid("export", "urdf", model, "-o", path).code == 0
    assert path.read_text().startswith("<?xml")


@pytest.mark.slow
def test_simulate_tells_what_was_hidden_beside_the_folder_only(clampid: Clampid, tmp_path: Path) -> None:
    folder = tmp_path / "c"
    ran = clampid("simulate", "-o", folder, "--robot", "ur10", "--hide", "backlash@joint2:2", "--poses", "20", "-q")
    assert ran.code == 0, ran.err
    hidden: list[dict[str, Any]] = json.loads((tmp_path / "c.hidden.json").read_text())
    assert [(item["effect"], item["where"]) for item in hidden] == [("backlash", "joint2")]
    assert set(hidden[0]) == {"effect", "where", "parameters"}
    assert not [p for p in folder.iterdir() if "hidden" in p.name or "backlash" in p.read_bytes().decode("latin1")]


@pytest.mark.slow
def test_simulate_with_the_same_seed_is_the_same_campaign(clampid: Clampid, installed: Clampid, tmp_path: Path) -> None:
    from experiments.campaign import read_campaign

    for name, program in (("a", clampid), ("b", installed)):
        program("simulate", "-o", tmp_path / name, "--robot", "ur10", "--poses", "20", "--seed", "9", "-q")
    a, b = (read_campaign(tmp_path / name) for name in ("a", "b"))
    assert a.fingerprint == b.fingerprint


@pytest.mark.slow
def test_dynamics_of_a_campaign_with_torques(clampid: Clampid, tmp_path: Path, whole: Path) -> None:
    wanted = ("--effects", "poses=geometry", "--effects", "clamped=joint_compliance")
    written = ("-o", tmp_path / "m.json", "--json", tmp_path / "i.json")
    ran = clampid("identify", whole, *wanted, *written, "-q", "--verbose")
    assert ran.code == 0, ran.err
    assert "m·c_x of link 2 + 0.78 m · m of links 3, 4, 5 and 6" in ran.out
    told = json.loads((tmp_path / "i.json").read_text())["stages"]["free_air"]["base_parameters"]
    ran = clampid("export", "dynamics", tmp_path / "m.json")
    assert json.loads(ran.out)["base_parameters"] == told
    ran = clampid("export", "dynamics", tmp_path / "m.json", "--consistent", "--campaign", whole, "-o", tmp_path / "d")
    assert ran.code == 0, ran.err
    assert "what it costs: chi-square" in ran.out
    assert all(link["mass_kg"] > 0 for link in json.loads((tmp_path / "d").read_text())["links"])


def test_dynamics_refuses_what_it_cannot_do(clampid: Clampid, model: Path, whole: Path) -> None:
    ran = clampid("export", "dynamics", model)
    assert ran.code == 2
    assert "gravity identified" in ran.err
    ran = clampid("export", "dynamics", model, "--campaign", whole)
    assert ran.code == 2
    assert "--consistent" in ran.err


@pytest.mark.slow
def test_a_report_is_written_from_the_diagnosis_that_was_kept(
    clampid: Clampid, model: Path, poses_only: Path, tmp_path: Path
) -> None:
    own = tmp_path / "m.json"
    own.write_bytes(model.read_bytes())
    early = clampid("report", own, poses_only, "-q")
    assert early.code == 0, early.err
    assert "without a diagnosis" in " ".join(early.out.split())
    assert f"clampid diagnose {own} {poses_only}" in early.out.replace("\\\n", "").replace("    ", "")
    found = clampid("diagnose", own, poses_only, "--json", tmp_path / "d.json", "-q")
    assert found.code == 0, found.err
    kept = json.loads((tmp_path / "m.diagnosis.json").read_text())
    assert kept["diagnosis"] == json.loads((tmp_path / "d.json").read_text())
    assert clampid("report", own, poses_only, "-o", tmp_path / "r.html", "-q").code == 0
    page = (tmp_path / "r.html").read_text(encoding="utf-8")
    assert "gear eccentricity at joint 2" in page[: page.index("<script")]
    own.write_text(own.read_text() + "\n")  # another model, as far as anybody knows
    assert "without a diagnosis" in " ".join(clampid("report", own, poses_only, "-q").out.split())


def test_one_effect_is_explained_in_words(clampid: Clampid) -> None:
    ran = clampid("effects", "gear_eccentricity")
    assert ran.code == 0, ran.err
    assert "Angle error periodic in a joint's revolution" in ran.out
    assert "a1" in ran.out
    assert len(ran.out.splitlines()) <= 24
    wrong = clampid("effects", "gear_eccentrcity")
    assert wrong.code == 2
    assert "did you mean gear_eccentricity" in wrong.complaint


@pytest.mark.slow
def test_a_fit_that_predicts_nothing_is_called_one(clampid: Clampid, tmp_path: Path) -> None:
    clampid("simulate", "-o", tmp_path / "few", "--robot", "ur10", "--poses", "10", "--tables", "poses", "-q")
    ran = clampid("identify", tmp_path / "few", "-o", tmp_path / "m.json", "-q")
    assert ran.code == 0, ran.err
    said = " ".join(ran.out.split())
    assert "do not use it" in said
    assert "Measure 37 poses or more, or fit fewer effects" in said  # 45 parameters, six numbers a pose
    assert f"clampid plan poses --robot ur10 --like {tmp_path / 'few'} --poses 37 -o" in said.replace(chr(92) + " ", "")
    assert "clampid diagnose" not in said
    # The number that is given would do.
    clampid("simulate", "-o", tmp_path / "enough", "--robot", "ur10", "--poses", "37", "--tables", "poses", "-q")
    assert "do not use it" not in clampid("identify", tmp_path / "enough", "-o", tmp_path / "e.json", "-q").out
