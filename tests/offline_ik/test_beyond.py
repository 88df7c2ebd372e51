"""Where a command is beyond what the model was identified on, answers say so and are less certain; inside as ever."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from ik_arms import drawn_arm, drawn_model, postures
from ik_general import campaign_of

from clampid.identification.identify import identify
from clampid.models.model import Model, save_model
from clampid.models.ranges import RANGE_MARGIN, Ranges
from clampid.stages.loads import gravity_signals
from experiments.campaign import read_campaign
from experiments.simulate import simulate
from offline_ik.arm.beyond import Outside
from offline_ik.arm.identified import arm_of
from offline_ik.inverse.detector import Detector
from offline_ik.inverse.opening import open_detector
from offline_ik.motion.approach import approach_through
from offline_ik.server.protocol import Session, Speaker

HERE = (0.3, 0.2, 0.8)
SOMEWHERE = ((0.3, 0.2, 0.8), (-0.2, 0.1, 0.7), (0.1, 0.4, 0.9), (0.3, 0.2, 0.8, 0.5))


def wide() -> Ranges:
    """Wider than anything that is asked for."""
    lower = np.array([[-3.2] * 6, [-5000.0] * 6, [20.0] * 6])
    return Ranges(lower, np.array([[3.2] * 6, [5000.0] * 6, [30.0] * 6]), ("revolute",) * 6, (12.0, 12.0))


def within(kind: int, index: int, lower: float, upper: float) -> Ranges:
    """The same, one of them narrower."""
    low, high = wide().lower.copy(), wide().upper.copy()
    low[kind, index], high[kind, index] = lower, upper
    return replace(wide(), lower=low, upper=high)


def on(ranges: Ranges | None) -> Model:
    model = drawn_model()
    return model.with_stage(replace(model.stages["poses"], ranges=ranges))


def opened(ranges: Ranges | None, cell: Path) -> Detector:
    return open_detector(on(ranges), cell)


@pytest.mark.slow
def test_inside_nothing_is_said_and_nothing_changes(detector: Detector, cell_file: Path) -> None:
    inside = opened(wide(), cell_file)
    for place in SOMEWHERE:
        for branch in ("nearest", "all"):
            found, known = (d.locate(*place, branch=branch).solutions for d in (inside, detector))
            assert len(found) == len(known) > 0
            for mine, other in zip(found, known, strict=True):
                assert mine.extrapolating == other.extrapolating == ()
                assert (mine.q == other.q).all()
                assert (mine.uncertainty.covariance == other.uncertainty.covariance).all()


@pytest.mark.slow
@pytest.mark.parametrize("branch", ["nearest", "all"])
def test_an_angle_outside_the_fitted_range_is_reported(detector: Detector, cell_file: Path, branch: str) -> None:
    q = detector.locate(*HERE).solutions[0].q
    beyond = opened(within(0, 1, q[1] - 1.0, q[1] - 0.1), cell_file)
    first = beyond.locate(*HERE, branch=branch).solutions[0]
    (said,) = first.extrapolating
    assert (said.quantity, said.at, said.unit) == ("angle", "joint2", "rad")
    assert said.value == pytest.approx(q[1], abs=1e-9)
    assert said.upper == q[1] - 0.1
    # No effect of this model is an empirical form of angles: its covariance grows by itself, if at all.
    same = detector.locate(*HERE, branch=branch).solutions[0].uncertainty
    np.testing.assert_allclose(first.uncertainty.covariance, same.covariance, rtol=1e-9, atol=1e-20)
    edge = opened(within(0, 1, q[1] - 1.0, q[1] - 0.5 * RANGE_MARGIN), cell_file)
    assert edge.locate(*HERE, branch=branch).solutions[0].extrapolating == ()


@pytest.mark.slow
def test_a_torque_and_a_tool_beyond_are_said(detector: Detector, cell_file: Path) -> None:
    q = detector.locate(*HERE).solutions[0].q
    torque = gravity_signals(campaign_of(detector.arm), q[None])["gravity_torque"][0, 1]
    narrow = replace(within(1, 1, torque - 300.0, torque - 200.0), tool_mass=(3.0, 5.0))
    first, second = opened(narrow, cell_file).locate(*HERE).solutions[0].extrapolating
    assert (first.quantity, first.at) == ("gravity torque", "joint2")
    assert first.value == pytest.approx(torque)
    assert (second.quantity, second.at, second.value, second.upper) == ("tool mass", "tool", 12.0, 5.0)


@pytest.mark.slow
@pytest.mark.parametrize("branch", ["nearest", "all"])
def test_the_uncertainty_grows_by_an_empirical_effects_own_size(cell_file: Path, branch: str) -> None:
    """Links that expand: of the model's effects the one whose form is known inside its temperatures alone."""
    detector = opened(wide(), cell_file)
    unknown = Detector(replace(detector.arm, ranges=None), detector.cell)
    effect = np.array([slot.effect == "thermal_expansion" for slot in detector.arm.slots])
    last = 0.0
    for above, share in ((0.0, 0.0), (0.1, 0.1), (0.4, 0.4), (5.0, 1.0)):  # in widths, of 10 K, beyond the margin
        warm = np.full(6, 25.0)
        warm[1] = 30.0 + 10.0 * (above + RANGE_MARGIN)
        there = detector.at_temperature(warm)
        first = there.locate(*HERE, branch=branch).solutions[0]
        J, _ = there.propagation.jacobian(first.q, replace(there.still, direction=first.direction))
        own = J[:3, effect][:, 1] * there.arm.theta[effect][1]
        alone = unknown.at_temperature(warm).locate(*HERE, branch=branch).solutions[0]
        grown = first.uncertainty.std_m**2 - alone.uncertainty.std_m**2
        assert grown == pytest.approx(share**2 * own @ own, rel=1e-6, abs=1e-20)
        assert grown > last or above == 0
        last = grown
        assert [b.at for b in first.extrapolating] == ([] if above == 0 else ["link2"])


@pytest.mark.slow
def test_an_approach_gains_beyond_as_well(cell_file: Path) -> None:
    detector = opened(wide(), cell_file).at_temperature(np.full(6, 45.0))
    way = approach_through(detector, detector.locate(*HERE))
    assert len(way.answer.solutions[0].extrapolating) == 6
    assert way.gain > 0


def test_how_warm_the_links_are_is_assumed_only_where_it_matters(cell_file: Path) -> None:
    warm = replace(wide(), lower=np.where(np.arange(3)[:, None] == 2, 25.0, wide().lower))
    reads = Outside(drawn_arm(), warm)
    assert {(b.at, b.value) for b in reads.surroundings(None)} == {(f"link{i}", 20.0) for i in range(1, 7)}
    ignores = Outside(drawn_arm(effects=("geometry",)), warm)
    assert ignores.surroundings(None) == ()
    assert len(ignores.surroundings(np.full(6, 24.0))) == 6


def test_the_kernel_is_the_ranges_own_arithmetic() -> None:
    arm, rng = drawn_arm(), np.random.default_rng(3)
    half = rng.uniform(0.85, 0.99, (3, 6)) * np.array([[np.pi], [900.0], [5.0]])
    middle = rng.uniform(-0.5, 0.5, (3, 6))
    ranges = Ranges(middle - half, middle + half, ("revolute",) * 6, (0.0, 20.0))
    outside = Outside(arm, ranges)
    q = 2.0 * postures(arm, 200)
    torque = gravity_signals(campaign_of(arm), q)["gravity_torque"]
    values = np.stack([ranges.turned(q), torque, np.full_like(q, np.nan)], axis=1)
    said = [outside.posture(one) for one in q]
    assert 10 < sum(not s for s in said) < 190
    for one, s in zip(values, said, strict=True):
        expected = ranges.beyond(one)
        assert [(b.quantity, b.at) for b in s] == [(b.quantity, b.at) for b in expected]
        assert [b.value for b in s] == pytest.approx([b.value for b in expected], abs=1e-9)


def test_of_a_model_of_a_third_of_joint_2s_range_only_what_is_outside_is_said(tmp_path: Path) -> None:
    campaign = read_campaign(simulate(tmp_path / "arm", seed=5, poses=60, tables=("poses",)))
    rows = campaign.tables["poses"]
    third = rows["q2_rad"].between(-2.0, -0.8)
    part = replace(campaign, tables={"poses": rows[third].reset_index(drop=True)})
    model = identify(part, ("geometry", "joint_compliance"))
    outside = Outside(arm := arm_of(model, gravity=campaign.gravity, tool_com=campaign.tool.com), ranges_in(model))
    q = rows[[f"q{i}_rad" for i in range(1, arm.n + 1)]].to_numpy()
    rejected = {row - 1 for _, _, row in model.stages["poses"].outliers}
    fitted = np.delete(q[third], list(rejected), axis=0)
    assert len(fitted) > 40
    assert all(outside.posture(one) == () for one in fitted)
    for one in q[~third]:
        clear = not -2.1 < one[1] < -0.7
        assert ("angle", "joint2") in {(b.quantity, b.at) for b in outside.posture(one)} or not clear
    assert (~third).sum() > 60


def ranges_in(model: Model) -> Ranges:
    found = model.stages["poses"].ranges
    assert found is not None
    return found


def run_ik(model: Path, cell: Path) -> str:
    """What a person reads, joint angles left out."""
    program = Path(sys.executable).parent / "clampid"
    place = ("--gamma", "0.3", "--delta", "0.2", "--r", "0.8")
    done = subprocess.run(
        [program, "ik", model, *place, "--cell", cell], capture_output=True, text=True, check=True, timeout=300
    )
    return " ".join(done.stdout.split())


@pytest.mark.slow
def test_a_server_and_a_person_are_warned(detector: Detector, cell_file: Path, tmp_path: Path) -> None:
    q = detector.locate(*HERE).solutions[0].q
    ranges = within(0, 1, q[1] - 1.0, q[1] - 0.1)
    speaker = Speaker(opened(ranges, cell_file))
    told = json.loads(speaker.answer(b"where gamma=0.3 delta=0.2 r=0.8", Session(greeted=True)))["solutions"][0][
        "extrapolating"
    ]
    assert [(b["quantity"], b["at"], b["unit"]) for b in told] == [("angle", "joint2", "rad")]
    assert told[0]["identified"] == pytest.approx([q[1] - 1.0, q[1] - 0.1])
    save_model(on(ranges), tmp_path / "m.json")
    degrees = (f"{np.rad2deg(angle):.1f} deg" for angle in (q[1], q[1] - 0.1))
    assert "extrapolating: joint 2 (angle to {}, identified to {})".format(*degrees) in run_ik(
        tmp_path / "m.json", cell_file
    )
    save_model(on(wide()), tmp_path / "m.json")
    assert "extrapolating" not in run_ik(tmp_path / "m.json", cell_file)
