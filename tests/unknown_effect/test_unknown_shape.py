"""What no effect explains: its shape with a band that holds, and the way from the verdict to a compensated command."""

from __future__ import annotations

import json
import shlex
import shutil
import subprocess
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import casadi as ca
import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from clampid.catalogue import catalogue
from clampid.comparison.compare import compare
from clampid.diagnosis.diagnose import diagnose
from clampid.diagnosis.probes import probes
from clampid.diagnosis.unknown_shape import _width, shape_of
from clampid.evidence.score import score
from clampid.evidence.space import space_of
from clampid.exports.dh_export import calibrated_chain
from clampid.fitting.fit import fit
from clampid.identification.fitted_stage import fit_stage
from clampid.identification.identify import identify, stage_rows
from clampid.models.model import load_model, save_model
from clampid.slots import Term
from clampid.stages.layout import layout_of
from experiments.simulate import hidden_file
from offline_ik.arm.identified import Conditions, IdentifiedArm, arm_of

NEAR = 1.15  # of the noise floor: what a smooth shape leaves of a sharp one, and what its factors cost
AMPLITUDE = 2e-4  # rad


def test_a_band_of_one_point_is_the_usual_one():
    assert _width(np.array([[2.0]]), 0) == pytest.approx(1.96, abs=0.05)


@given(points=st.integers(2, 30), seed=st.integers(0, 3))
def test_a_band_of_independent_points_holds_them_all(points: int, seed: int):
    exact = stats.norm.isf((1 - 0.95 ** (1 / points)) / 2)
    assert _width(np.eye(points), seed) == pytest.approx(exact, abs=0.12)


def test_points_that_nothing_is_known_of_do_not_count():
    assert _width(np.zeros((3, 2)), 0) == 0.0
    assert _width(np.array([[1.0], [0.0]]), 0) == pytest.approx(1.96, abs=0.05)


@pytest.fixture(scope="module")
def clean(simulated):
    """Rows of poses with nothing hidden, fitted with geometry: a pattern to put errors upon."""
    campaign = simulated(poses=120, tables=("poses",))
    rows = stage_rows([campaign], layout_of([campaign]), "poses")
    return fit_stage(rows, catalogue(), [Term("geometry")], {}).estimate


def lever_of(estimate, joint: int) -> np.ndarray:
    """What a unit of a joint's angle does to each point ``(N, 3)``, by turning it a little."""
    rows = estimate.problem.rows
    q = rows.signals["q"].copy()
    q[:, joint - 1] += 1e-6
    turned = estimate.problem.with_rows(replace(rows, signals={**rows.signals, "q": q}))
    return -(turned.residual(estimate.theta)[0] - estimate.residual)[:, :3] / 1e-6


@pytest.mark.slow
def test_the_band_holds_the_true_curve_as_often_as_it_says(clean):
    """Forty robots with the same error of joint 3 and noise of their own: about two may lie outside."""
    rows, lever = clean.problem.rows, lever_of(clean, 3)
    q3 = rows.signals["q"][:, 2]
    outside = 0
    for seed in range(40):
        rng = np.random.default_rng(seed)
        predicted = rows.measured - clean.residual
        each = 2e-5 * rng.standard_normal((int(rows.unit.max()) + 1, 3))[rows.unit]  # shared by a pose's points
        error = (AMPLITUDE * np.sin(3 * q3))[:, None] * lever + each + rng.normal(0.0, 5e-5, (len(rows), 3))
        trial = fit(clean.problem.with_rows(replace(rows, measured=predicted + error)))
        space = space_of(trial)
        probe = next(s for s in score(space, probes(trial)) if s.candidate.label == "harmonics of q3 at joint3@joint3")
        shape = shape_of(trial, space, probe, ["q3"], 0)
        (curve,) = shape["curves"]
        x, low, high = (np.array(curve[k]) for k in ("x", "low", "high"))
        truth = AMPLITUDE * (np.sin(3 * x) - np.sin(3 * q3).mean())
        outside += bool(np.any((truth < low) | (truth > high)))
        assert shape["at"] == "joint3"
        assert shape["depends_on"] == ["q3"]
    assert stats.binom.sf(outside - 1, 40, 0.05) > 0.01, outside


Run = Callable[..., str]


@pytest.fixture
def run(program: Path) -> Run:
    """The command as a user types it."""

    def typed(*arguments: str | Path, cwd: Path) -> str:
        words = [program, *map(str, arguments)]
        done = subprocess.run(words, cwd=cwd, capture_output=True, text=True, timeout=600, check=False)
        assert done.returncode == 0, done.stderr
        return done.stdout

    return typed


def flanges(arm: IdentifiedArm, q: np.ndarray) -> np.ndarray:
    """Where the flange is for a command's arm ``(N, 3)``, base frame."""
    symbol = ca.SX.sym("q", arm.n)
    position = arm.expression(symbol, ca.SX(ca.DM(Conditions.still(arm.n).vector)), np.eye(4))[0]
    return np.asarray(ca.Function("flange", [symbol], [position])(q.T)).T


@pytest.mark.slow
def test_from_a_verdict_to_a_command(simulated, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, run: Run):
    """Something that no effect of the catalogue explains is found, drawn, made an effect, fitted, and compensated."""
    campaign = simulated("outside_third_harmonic")
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    save_model(identify(campaign), tmp_path / "model.json")
    run("diagnose", "model.json", campaign.path, "--json", "found.json", "-q", cwd=tmp_path)
    found = json.loads((tmp_path / "found.json").read_text())["stages"]["poses"]
    assert (found["verdict"], found["depends_on"]) == ("unknown", ["q3"])
    shape = found["shape"]
    assert (shape["at"], shape["depends_on"]) == ("joint3", ["q3"])
    assert shape["command"] in found["summary"]
    truth = json.loads(hidden_file(campaign.path).read_text())[0]["parameters"]["amplitude_rad"]
    curve = shape["curves"][0]
    x, value, low, high = (np.array(curve[k]) for k in ("x", "value", "low", "high"))
    wave = truth * (np.sin(3 * x) - np.mean(np.sin(3 * campaign.tables["poses"]["q3_rad"])))
    assert np.all((low <= wave) & (wave <= high))
    assert np.mean(high - low) < 0.5 * np.ptp(value)

    run(*shlex.split(shape["command"])[1:], cwd=tmp_path)
    own = f"{shape['name']}.py"
    wrote = run(
        "add", shape["name"], "model.json", campaign.path, "-o", "mended.json", "--effects-from", own, "-q",
        "--json", "-", cwd=tmp_path,
    )  # fmt: skip
    part = json.loads(wrote)["stages"]["poses"]
    assert part["heldout_rms_before"] > 1.5 * part["noise_floor"]
    assert part["heldout_rms_after"] < NEAR * part["noise_floor"]
    run("effect", "trust", own, cwd=tmp_path)
    run("diagnose", "mended.json", campaign.path, "--json", "after.json", "-q", cwd=tmp_path)
    assert json.loads((tmp_path / "after.json").read_text())["stages"]["poses"]["verdict"] == "adequate"
    assert "unknown_joint3@joint3" in run("history", "mended.json", "--verbose", cwd=tmp_path)

    # The model names its file; from another folder it is found beside the model.
    mended, file = load_model(tmp_path / "mended.json"), tmp_path / own
    poses = compare(mended, campaign).tables["poses"]
    assert poses["heldout"]["rms"] == pytest.approx(part["heldout_rms_after"], rel=0.01)

    # Compensation: the arm's prediction holds the error, and commands are turned by it.
    arm = arm_of(mended, user_effects=file)
    q = np.tile(np.array([0.3, -0.5, 0.0, 0.4, 0.8, 0.2]), (9, 1))
    q[:, 2] = np.linspace(-1.5, 2.0, 9)
    shift = flanges(arm, q) - flanges(arm.without("unknown_joint3"), q)
    chain = calibrated_chain(mended)
    bent = q + np.eye(6)[2] * (truth * np.sin(3 * q[:, 2]))[:, None]
    moved = (chain.flange(bent)[:, :3, 3] - chain.flange(q)[:, :3, 3]) @ chain.base[:3, :3]
    left = np.linalg.norm((shift - shift.mean(axis=0)) - (moved - moved.mean(axis=0)), axis=1)
    assert left.max() < 0.25 * np.linalg.norm(moved, axis=1).max()
    run("ik", "mended.json", "--gamma", "0.3", "--delta", "0.4", "--r", "0.6", "-q", cwd=tmp_path)
    run("export", "dh", "mended.json", "-o", "table.csv", cwd=tmp_path)


@pytest.mark.slow
def test_a_column_beyond_the_contract_is_found_and_made_an_effect(simulated, tmp_path: Path, run: Run):
    """Readings that shift with the humidity, which the campaign's author thought of recording."""
    folder = tmp_path / "arm"
    shutil.copytree(simulated().path, folder)
    rng = np.random.default_rng(5)
    for table in ("poses", "verification"):
        frame = pd.read_parquet(folder / f"{table}.parquet")
        _, visit = np.unique(frame[["pose", "visit"]].to_numpy(), axis=0, return_inverse=True)
        humidity = rng.uniform(30.0, 60.0, visit.max() + 1)[visit.ravel()]
        frame["x_m"] += 2e-5 * (humidity - 45.0)
        frame["humidity_percent"], frame["remark"] = humidity, "fine"
        frame.loc[:2, "humidity_percent"] = np.nan
        frame.to_parquet(folder / f"{table}.parquet")
    run("identify", "arm", "-o", "model.json", "-q", cwd=tmp_path)
    run("diagnose", "model.json", "arm", "--json", "found.json", "-q", cwd=tmp_path)
    found = json.loads((tmp_path / "found.json").read_text())["stages"]["poses"]
    assert (found["verdict"], found["depends_on"]) == ("unknown", ["humidity_percent"])
    shape = found["shape"]
    run(*shlex.split(shape["command"])[1:], cwd=tmp_path)
    own = f"{shape['name']}.py"
    wrote = run(
        "add", shape["name"], "model.json", "arm", "-o", "mended.json", "--effects-from", own, "-q", "--json", "-",
        cwd=tmp_path,
    )  # fmt: skip
    part = json.loads(wrote)["stages"]["poses"]
    assert part["heldout_rms_before"] > 1.3 * part["noise_floor"]
    assert part["heldout_rms_after"] < NEAR * part["noise_floor"]
    command = ("mended.json", "--gamma", "0.3", "--delta", "0.4", "--r", "0.6", "-q", "--effects-from", own)
    run("ik", *command, cwd=tmp_path)  # a command needs no error of the instrument
    run("export", "dh", "mended.json", "-o", "table.csv", "--effects-from", own, cwd=tmp_path)


OTHERS = {
    "outside_posture_product": (("q1", "q5"), "joint4"),
    "outside_q4_direction": (("q4", "dir4"), "joint5"),
}


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, *(pytest.param(s, marks=pytest.mark.study) for s in (2, 3))])
@pytest.mark.parametrize("hidden", OTHERS)
def test_a_shape_over_two_variables_brings_the_error_to_the_noise(hidden: str, seed: int, simulated, tmp_path: Path):
    """An engineer who suspects on what it depends: what the effect file brings, on poses that no fit saw."""
    from clampid.diagnosis.effect_new import effect_new
    from clampid.loop.add import add

    campaign = simulated(hidden, seed=seed)
    variables, at = OTHERS[hidden]
    own = effect_new("suspect", variables, at, path=tmp_path / "suspect.py")
    _, addition = add(identify(campaign), campaign, ["suspect"], user_effects=own)
    part = addition.to_json()["stages"]["poses"]
    assert part["heldout_rms_before"] > 1.5 * part["noise_floor"]
    assert part["heldout_rms_after"] < NEAR * part["noise_floor"]


@pytest.mark.slow
def test_a_diagnosis_looks_for_an_effect_of_ones_own(simulated, tmp_path: Path):
    """Handed to diagnose, it is a candidate like any other, and goes by its own name."""
    from clampid.diagnosis.effect_new import effect_new

    campaign = simulated("outside_third_harmonic")
    own = effect_new("third_wave", ["q3"], "joint3", path=tmp_path / "third_wave.py")
    found = diagnose(identify(campaign), campaign, user_effects=own).stages["poses"]
    assert found.verdict == "missing"
    assert [(c["effect"], c["where"]) for c in found.candidates] == [("third_wave", ["joint3"])]
    assert found.shape is None
