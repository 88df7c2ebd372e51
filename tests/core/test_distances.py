"""Distances from anchors of unknown place: what they tell of an arm, alone and beside points, and what not.

What is measured follows from kinematics alone, or from the virtual robot; no effect takes part in making it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from clampid.catalogue import catalogue
from clampid.comparison.compare import compare
from clampid.diagnosis.diagnose import diagnose
from clampid.fitting.accuracy import noise_floor
from clampid.fitting.fit import fit
from clampid.identification.identify import identify
from clampid.identification.model_on_campaign import on_campaign
from clampid.models.calibrated import calibrated_chain
from clampid.models.model import Model, load_model, save_model
from clampid.slots import Slot, slots_of
from clampid.stages.fit_problem import fit_problem
from clampid.stages.layout import layout_of
from clampid.stages.pose_rows import align, anchors_of, pose_rows
from experiments.campaign import Campaign, Instrument, Tool
from kinematics.description import load_robot
from kinematics.poe import forward
from kinematics.screws import adjoint, exp_se3

Simulated = Callable[..., Campaign]

ROBOT = load_robot("kuka_kr20_r1810")
TARGETS = {"T1": [0.10, 0.02, 0.12], "T2": [-0.05, 0.09, 0.10], "T3": [-0.06, -0.08, 0.14]}
ANCHORS = {"A1": [1.9, 0.3, 0.1], "A2": [-0.6, 1.7, 0.9], "A3": [0.2, -1.8, 0.4]}
SIGMA, POINT_SIGMA = 1e-5, 5e-5  # m


def another_arm(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Screws and home pose of an individual: axes off by a millimetre and a milliradian."""
    rng = np.random.default_rng(1000 + seed)
    moved = [adjoint(exp_se3(1e-3 * rng.standard_normal(6))) @ screw for screw in ROBOT.screws]
    return np.array(moved), exp_se3(1e-3 * rng.standard_normal(6)) @ ROBOT.flange


def measured(
    seed: int, poses: int = 70, anchors: tuple[str, ...] = ("A1", "A2", "A3"), points: bool = False,
    distances: bool = True, individual: bool = False, base: np.ndarray | None = None,
) -> Campaign:  # fmt: skip
    """A campaign on the described arm, or on one that deviates from it, with noise of the stated size."""
    rng = np.random.default_rng(seed)
    screws, home = another_arm(seed) if individual else (ROBOT.screws, ROBOT.flange)
    names = list(TARGETS)
    tables = {}
    for table, wanted in (("poses", points), ("distances", distances)):
        each = len(anchors) if table == "distances" else len(names)
        q = np.repeat(rng.uniform(0.8 * ROBOT.lower, 0.8 * ROBOT.upper, (poses, 6)), each, axis=0)
        pose = np.repeat(np.arange(1, poses + 1), each)
        which = (pose + np.tile(np.arange(each), poses)) % 3
        there = forward(screws, home, q)
        at = np.einsum("nij,nj->ni", there[:, :3, :3], np.array(list(TARGETS.values()))[which]) + there[:, :3, 3]
        frame = pd.DataFrame({"pose": pose, "visit": 1, "time_s": np.arange(len(q), dtype=float)})
        frame[[f"q{i + 1}_rad" for i in range(6)]] = q
        frame[[f"dir{i + 1}" for i in range(6)]] = 0
        frame["target"] = np.array(names)[which]
        if table == "poses":
            seen = np.eye(4) if base is None else base
            at = at @ seen[:3, :3].T + seen[:3, 3]
            frame[["x_m", "y_m", "z_m"]] = at + POINT_SIGMA * rng.standard_normal(at.shape)
        else:
            frame["anchor"] = np.tile(list(anchors), poses)
            places = np.tile([ANCHORS[a] for a in anchors], (poses, 1))
            frame["distance_m"] = np.linalg.norm(at - places, axis=1) + SIGMA * rng.standard_normal(len(q))
        if wanted:
            tables[table] = frame
    targets = {name: np.array(at) for name, at in TARGETS.items()}
    instrument = Instrument("made", POINT_SIGMA, None, None, SIGMA)
    gravity = np.array([0.0, 0.0, -9.81])
    return Campaign(
        "made", None, ROBOT, gravity, Tool(0.0, np.zeros(3)), targets, instrument, tables, f"{seed:064d}"
    )  # fmt: skip


def places_of(model: Model) -> tuple[dict[str, np.ndarray], np.ndarray, list[int]]:
    """Where the fitted anchors stand, with their covariance ``(3 K, 3 K)`` and the slots it is of."""
    stage = model.stages["poses"]
    values, anchors = stage.values(), model.sessions[0].anchors
    slots = [Slot("geometry", f"anchor_{a}", name) for name in anchors for a in "xyz"]
    at = [stage.slots.index(s) for s in slots]
    places = {n: p + [values[Slot("geometry", f"anchor_{a}", n)] for a in "xyz"] for n, p in anchors.items()}
    return places, stage.covariance[np.ix_(at, at)], at


@pytest.mark.parametrize("anchors", [("A1", "A2"), ("A1", "A2", "A3")])
def test_the_arm_is_recovered_from_distances_alone(anchors: tuple[str, ...]):
    campaign = measured(1, 90, anchors, individual=True)
    model = identify(campaign, ["geometry"])
    q = np.random.default_rng(50).uniform(0.8 * ROBOT.lower, 0.8 * ROBOT.upper, (200, 6))
    truth = forward(*another_arm(1), q)[:, :3, 3]
    off = {}
    # The point that the flange's origin is, seen through the model: the tool's place is part of what is fitted.
    tool = [model.stages["poses"].values().get(Slot("geometry", f"target_{a}", "T1"), 0.0) for a in "xyz"]
    corner = np.array(TARGETS["T1"]) + tool
    truth = truth + np.einsum("nij,j->ni", forward(*another_arm(1), q)[:, :3, :3], np.array(TARGETS["T1"]))
    for name, flange, point in (
        ("fitted", calibrated_chain(model).flange(q), corner),
        ("nominal", forward(ROBOT.screws, ROBOT.flange, q), np.array(TARGETS["T1"])),
    ):
        found = flange[:, :3, 3] + flange[:, :3, :3] @ point
        motion = align(found, truth)
        error = found @ motion[:3, :3].T + motion[:3, 3] - truth
        off[name] = float(np.sqrt(np.mean(np.sum(error**2, axis=1))))
    assert off["nominal"] > 1e-3
    assert off["fitted"] < 6e-5
    assert model.ledger[-1].rms == pytest.approx(SIGMA, rel=0.25)


def test_distances_between_anchors_are_right_within_their_stated_errors():
    z = []
    for seed in range(5):
        model = identify(measured(seed, individual=True), ["geometry"])
        places, covariance, _ = places_of(model)
        names = list(places)
        for a, b in combinations(range(3), 2):
            way = places[names[a]] - places[names[b]]
            u = way / np.linalg.norm(way)
            slope = np.zeros(9)
            slope[3 * a : 3 * a + 3], slope[3 * b : 3 * b + 3] = u, -u
            true = np.linalg.norm(np.subtract(ANCHORS[names[a]], ANCHORS[names[b]]))
            std = np.sqrt(slope @ covariance @ slope)
            assert std < 2e-4
            z.append((np.linalg.norm(way) - true) / std)
    assert np.max(np.abs(z)) < 4.0
    assert 0.5 < np.sqrt(np.mean(np.square(z))) < 1.6


def test_stated_errors_of_the_geometry_hold():
    """On an arm as described all that is fitted of it is zero, in any gauge."""
    z = []
    for seed in range(8):
        stage = identify(measured(100 + seed), ["geometry"]).stages["poses"]
        arm = np.array([s.place.startswith("link") for s in stage.slots])
        assert arm.sum() == 18  # with three anchors and three targets, 4 n + 18 - 6
        assert len(stage.slots) == 36
        z.append((stage.theta / stage.std)[arm])
    assert 0.8 < np.sqrt(np.mean(np.square(z))) < 1.2
    assert np.mean(np.abs(z) < 1.96) > 0.88


def test_distances_and_points_agree_and_together_determine_more():
    base = exp_se3(np.array([0.4, -0.7, 1.1, 3.0, -1.0, 0.5]))
    both = measured(7, individual=True, points=True, base=base)
    models = {
        name: identify(replace(both, tables={t: both.tables[t] for t in tables}), ["geometry"])
        for name, tables in (("points", ["poses"]), ("distances", ["distances"]), ("both", ["poses", "distances"]))
    }
    stages = {name: model.stages["poses"] for name, model in models.items()}
    shared = [s for s in stages["points"].slots if s.place.startswith("link")]
    assert shared == [s for s in stages["distances"].slots if s.place.startswith("link")]
    assert {s.parameter for s in stages["both"].slots} >= {"base_x", "anchor_x", "target_x"}
    value, std = (
        {n: np.array([getattr(m, what)[m.slots.index(s)] for s in shared]) for n, m in stages.items()}
        for what in ("theta", "std")
    )
    z = (value["points"] - value["distances"]) / np.hypot(std["points"], std["distances"])
    assert np.max(np.abs(z)) < 4.0
    assert np.all(std["both"] < 1.1 * np.minimum(std["points"], std["distances"]))
    assert np.mean(std["both"]) < np.mean(std["distances"]) < 0.5 * np.mean(std["points"])
    # The base is the points' matter; anchors stand in their frame.
    places, covariance, _ = places_of(models["both"])
    for k, (name, place) in enumerate(places.items()):
        true = base[:3, :3] @ np.array(ANCHORS[name]) + base[:3, 3]
        assert np.all(np.abs(place - true) < 4.5 * np.sqrt(np.diag(covariance)[3 * k : 3 * k + 3]))


def test_distances_and_points_are_weighed_by_their_own_noise():
    rows = pose_rows([both := measured(3, points=True)], layout_of([both]), "poses")
    slots = identify(both, ["geometry"]).stages["poses"].slots
    estimate = fit(fit_problem(rows, catalogue(), slots))
    sigma = estimate.noise.sigma
    assert np.median(sigma[~rows.ranged, :3]) == pytest.approx(POINT_SIGMA, rel=0.15)
    assert np.median(sigma[rows.ranged, 6]) == pytest.approx(SIGMA, rel=0.15)
    floor = noise_floor(rows, estimate.residual)
    assert floor.norm == pytest.approx(np.sqrt(0.5 * 3 * POINT_SIGMA**2 + 0.5 * SIGMA**2), rel=1e-6)
    assert noise_floor(rows.take(rows.ranged), estimate.residual[rows.ranged]).norm == pytest.approx(SIGMA)


def test_derivatives_are_differences(simulated: Simulated):
    campaign = simulated(seed=5, poses=12, tables=("poses", "distances"))
    layout = layout_of([campaign])
    rows = pose_rows([campaign], layout, "poses")
    assert rows.measured.shape[1] == 7
    names = ("geometry", "joint_compliance", "backlash", "thermal_expansion", "instrument_scale")
    slots = [s for name in names for s in slots_of(catalogue()[name], layout)]
    trial = fit_problem(rows, catalogue(), slots)
    size = trial.sizes()
    theta = trial.start() + 0.3 * size * np.random.default_rng(0).uniform(-1, 1, len(slots))
    trial = trial.with_flanks(theta)
    residual, jacobian = trial.residual(theta)
    assert np.all(residual[rows.ranged, :6] == 0.0)
    assert np.all(residual[~rows.ranged, 3:] == 0.0)
    for k, slot in enumerate(slots):
        step = 1e-3 * size[k] * np.eye(len(slots))[k]
        slope = (trial.residual(theta - step)[0] - trial.residual(theta + step)[0]) / 2
        np.testing.assert_allclose(slope, 1e-3 * size[k] * jacobian[:, :, k], atol=2e-11, rtol=1e-5, err_msg=slot.label)
    moved = np.abs(jacobian[rows.ranged, 6]).max(axis=0)
    of = {s.effect for s, m in zip(slots, moved, strict=True) if m > 0}
    assert of == {"geometry", "joint_compliance", "backlash", "thermal_expansion"}  # their scale is another's


def test_directions_undetermined_by_one_anchor_on_the_first_axis_are_named():
    """From a point on joint 1's axis nothing shows how far joint 1 has turned."""
    axis = {"A1": [0.0, 0.0, -0.2]}
    campaign = measured(4, 150, ("A1",))
    q = campaign.tables["distances"][[f"q{i + 1}_rad" for i in range(6)]].to_numpy()
    there = forward(ROBOT.screws, ROBOT.flange, q)
    target = np.array([TARGETS[t] for t in campaign.tables["distances"]["target"]])
    at = np.einsum("nij,nj->ni", there[:, :3, :3], target) + there[:, :3, 3]
    noise = SIGMA * np.random.default_rng(0).standard_normal(len(q))
    table = campaign.tables["distances"].assign(distance_m=np.linalg.norm(at - axis["A1"], axis=1) + noise)
    stage = identify(replace(campaign, tables={"distances": table}), ["geometry", "backlash@joint1"]).stages["poses"]
    told = " ".join(stage.null_directions)
    assert "backlash" in told
    assert "geometry" in told
    assert not any(s.parameter.startswith("base_") for s in stage.slots)


def test_wrong_distances_are_left_out():
    campaign = measured(2)
    table = campaign.tables["distances"].copy()
    bad = [10, 77, 140]
    table.loc[bad, "distance_m"] += [3e-3, -2e-3, 0.05]
    campaign = replace(campaign, tables={"distances": table})
    stage = identify(campaign, ["geometry"]).stages["poses"]
    found = {(t, r - 1) for _, t, r in stage.outliers}
    assert found >= {("distances", k) for k in bad}
    assert len(found) <= 5
    clean = identify(measured(2), ["geometry"]).stages["poses"]
    assert not clean.outliers
    assert np.max(np.abs(stage.theta - clean.theta)[18:] / clean.std[18:]) < 2.0
    verdict = diagnose(identify(campaign, ["geometry"]), campaign).stages["poses"]
    assert {o["row"] - 1 for o in verdict.outliers} >= set(bad)
    assert verdict.verdict == "adequate"


def test_a_model_file_keeps_where_the_anchors_were(tmp_path: Path):
    base = exp_se3(np.array([0.1, 0.2, -0.3, 1.0, 2.0, 0.5]))
    first, second = measured(11, individual=True), measured(12, points=True, base=base)
    model = identify([first, second], ["geometry"])
    save_model(model, tmp_path / "model.json")
    again = load_model(tmp_path / "model.json")
    assert again.layout.anchors == tuple(f"session{s}:{a}" for s in (1, 2) for a in ANCHORS)
    for before, after in zip(model.sessions, again.sessions, strict=True):
        assert list(after.anchors) == list(ANCHORS)
        for name in ANCHORS:
            np.testing.assert_array_equal(before.anchors[name], after.anchors[name])
    opened = on_campaign(again, second)
    assert opened.layout.anchors == tuple(ANCHORS)
    found = anchors_of(opened.rows("poses"))[0]
    assert all(np.array_equal(found[n], model.sessions[1].anchors[n]) for n in ANCHORS)
    rows = pose_rows([first, second], model.layout, "poses", {0: np.eye(4), 1: base}, opened.anchors | {1: found})
    assert set(anchors_of(rows)) == {0, 1}
    whole = compare(model, second).tables
    assert whole["distances"]["measured"] == "distances"
    assert "measured" not in whole["poses"]
    assert whole["distances"]["noise_floor"] == pytest.approx(SIGMA)
    assert set(whole["poses"]) - set(whole["distances"]) >= {"iso9283", "universal"}


def test_held_out_distances_show_how_good_the_model_is():
    campaign = measured(21, individual=True, points=True)
    poor = identify(campaign, ["geometry"], holdout=0.3)
    tables = compare(poor, campaign).tables
    assert tables["distances"]["heldout"]["rows"] == 63
    assert tables["distances"]["heldout"]["rms"] == pytest.approx(SIGMA, rel=0.5)
    assert tables["poses"]["heldout"]["rms"] == pytest.approx(POINT_SIGMA * np.sqrt(3), rel=0.3)
    fresh = measured(22, individual=False, points=True)
    moved = compare(poor, replace(fresh, name="elsewhere"), refit=("base", "tool")).tables
    assert moved["distances"]["heldout"]["rms"] > 1e-4  # another individual


@pytest.mark.slow
def test_a_hidden_effect_is_found_from_distances(simulated: Simulated):
    campaign = simulated(seed=2, poses=120, tables=("distances",), hidden=("gear_eccentricity@joint1",))
    effects = ["geometry", "joint_compliance", "backlash", "wrist_coupling_friction"]
    found = diagnose(identify(campaign, effects), campaign).stages["poses"].to_json()
    names = {(c["effect"], tuple(c["where"])) for c in found["candidates"]}
    assert ("gear_eccentricity", ("joint1",)) in names
    assert found["heldout_rms_after"] < 0.6 * found["heldout_rms_before"]


@pytest.mark.slow
def test_repeatability_beside_a_fine_instrument_is_nothing_unknown(simulated: Simulated):
    """Distances to 10 um of a robot that repeats within 20: no return says so, and "unknown" would be a false alarm."""
    campaign = simulated(seed=0, poses=90, tables=("distances",))
    effects = ["geometry", "joint_compliance", "backlash", "wrist_coupling_friction"]
    found = diagnose(identify(campaign, [*effects, "gravity"]), campaign).stages["poses"]
    assert (found.verdict, found.candidates) == ("adequate", [])
    assert found.before > 1.5 * found.noise_floor
    assert "the floor is the instrument's stated noise alone" in found.summary
    # The masses are not those of the description, so that springs sag otherwise: without it, that is what is missing.
    lacking = diagnose(identify(campaign, effects), campaign).stages["poses"]
    assert (lacking.verdict, [c["name"] for c in lacking.candidates]) == ("missing", ["gravity"])
    assert lacking.after < 1.1 * found.before < 0.8 * lacking.before


@pytest.mark.parametrize("points", [False, True])
def test_the_zero_of_a_draw_wire_is_found_and_does_not_move_the_arm(points: bool):
    campaign, zeros = measured(2, 90, individual=True, points=points), {"A1": 0.03, "A2": -0.012, "A3": 0.004}
    table = campaign.tables["distances"]
    longer = table.assign(distance_m=table["distance_m"] + table["anchor"].map(zeros))
    campaign = replace(campaign, tables={**campaign.tables, "distances": longer})
    model = identify(campaign, ["geometry"])
    found = diagnose(model, campaign).stages["poses"]
    assert found.verdict == "missing"
    assert [c["name"] for c in found.candidates] == ["additive_constant"]
    assert found.after < 1.1 * found.noise_floor < 0.1 * found.before
    stage = identify(campaign, ["geometry", "additive_constant"]).stages["poses"]
    at = [stage.slots.index(Slot("additive_constant", "c", name)) for name in zeros]
    assert all(stage.identified[k] for k in at)
    assert np.all(np.abs(stage.theta[at] - list(zeros.values())) < 3.5 * stage.std[at])


def test_points_do_not_determine_the_zero_of_distances():
    campaign = measured(1, 40, points=True, distances=False)
    found = diagnose(identify(campaign, ["geometry"]), campaign).stages["poses"]
    assert "additive_constant" not in {str(t["name"]) for t in found.testability if t["state"] != "absent"}
