"""What `diagnose` must say of robots of the second world, which the first one does not have."""

import numpy as np
import pytest

from clampid.catalogue import catalogue
from clampid.diagnosis.diagnose import diagnose
from clampid.identification.identify import effects_in, identify, stage_rows, standard_effects
from clampid.stages.layout import layout_of
from clampid.stages.log_facts import log_parts
from clampid.stages.steady_share import steady_share
from experiments.campaign import read_campaign
from experiments.second_world import HIDDEN, draw_robot, magnitude_for, measure
from experiments.second_world.arrays import stream
from experiments.second_world.campaign_out import base_section
from experiments.second_world.session import open_session


def verdict_of(folder, without=""):
    campaign = read_campaign(folder)
    terms = {
        stage: [t.effect for t in found if t.effect != without] for stage, found in standard_effects([campaign]).items()
    }
    model = identify(campaign, terms)
    return diagnose(model, campaign, stages=["poses"]).stages["poses"]


def named(verdict):
    return [(c["name"], tuple(c["where"])) for c in verdict.candidates]


@pytest.mark.slow
def test_friction_that_winds_up_no_spring_is_named_and_no_negative_lost_motion(tmp_path):
    robot = draw_robot("big6", 1014, mounting="wall")
    measure(robot, tmp_path / "c", program="quick", noise="white", seed=3)
    verdict = verdict_of(tmp_path / "c")
    assert (verdict.verdict, {name for name, _ in named(verdict)}) == ("missing", {"unsprung_friction"})
    expected = 2.0 * robot.compliance_rad_Nm * robot.coulomb_Nm  # by which springs wound up would stand apart
    for p in verdict.candidates[0]["parameters"]:
        joint = int(p["name"].partition("@joint")[2])
        assert p["value"] > 0.0
        assert abs(p["value"] - expected[joint - 1]) < 4.0 * p["std"]


@pytest.mark.slow
def test_a_few_verification_poses_do_not_hide_what_all_poses_tell(tmp_path):
    robot = draw_robot("seven7", 1, compliance=False)
    session = {"program": "slow", "noise": "walk", "seed": 1}
    magnitude = magnitude_for(robot, "joint_compliance", "joint3", 0.4, beyond_standard=True, **session)
    measure(robot, tmp_path / "c", hidden=[("joint_compliance", "joint3", magnitude)], **session)
    verdict = verdict_of(tmp_path / "c", without="joint_compliance")
    assert verdict.verdict == "missing"
    assert ("joint_compliance", ("joint3",)) in named(verdict)


@pytest.mark.slow
def test_friction_that_only_poses_show_is_hardly_larger_than_that_of_the_log(tmp_path):
    """Flanks in one plane do not identify it: 139 Nm at joint 3, where the log has 3, distorted every load there."""
    robot = draw_robot("uncoupled6", 3700, compliance=False)
    session = {"program": "plane", "log": "five_speeds", "noise": "pink", "seed": 3700}
    measure(robot, tmp_path / "c", hidden=[("joint_compliance", "joint3", 5.0)], base_known=True, **session)
    verdict = verdict_of(tmp_path / "c", without="joint_compliance")
    assert named(verdict)[0] == ("joint_compliance", ("joint3",))
    friction = {s.place: v for s, v in verdict.fitted.model.values().items() if s.effect == "wrist_coupling_friction"}
    assert abs(friction["joint3"]) < 3.0 * robot.coulomb_Nm[2]


@pytest.mark.slow
def test_the_bearings_of_a_light_arm_may_tilt(tmp_path):
    robot = draw_robot("seven7", 1)
    measure(robot, tmp_path / "c", program="slow", noise="white", seed=1, hidden=[("bearing_tilt", "joint3", 1.2)])
    verdict = verdict_of(tmp_path / "c")
    assert verdict.verdict in ("missing", "ambiguous")
    assert ("bearing_tilt", ("joint3",)) in named(verdict)


@pytest.mark.slow
def test_a_light_arm_on_a_soft_stand_lacks_a_tilt_of_the_base_alone(tmp_path):
    robot = draw_robot("small6", 3)
    measure(robot, tmp_path / "c", program="slow", noise="white", seed=3, hidden=[("base_tilt", "base", 4.0)])
    verdict = verdict_of(tmp_path / "c")
    assert named(verdict)[0] == ("base_tilt", ("base",))
    assert "bearing_tilt" not in {name for name, _ in named(verdict)[1:]}
    values = {p["name"].partition("@")[0]: p["value"] for p in verdict.candidates[0]["parameters"]}
    assert min(values["base_tilt.cxx"], values["base_tilt.cyy"]) > 0.0


def test_the_stated_base_is_the_one_that_the_first_joint_shows():
    robot = draw_robot("offset6", 2)
    session = open_session(robot, "few", "five_speeds", "pink", 2)
    text = base_section(session, stream(2, "base"))
    stated = np.array([float(v) for v in text.partition("position_m = [")[2].partition("]")[0].split(",")])
    shown = session.instrument.position_m + session.instrument.rotation @ robot.arm.joints[0].xyz_m
    assert np.linalg.norm(stated - shown) < 5.0 * 2e-4
    assert np.linalg.norm(stated - session.instrument.position_m) > np.linalg.norm(stated - shown)


def test_no_link_without_length_bends():
    for name in ("seven7", "offset6"):
        arm = draw_robot(name, 1).nominal
        for place in HIDDEN["link_bending"].places(arm.n):
            assert np.linalg.norm(arm.joints[int(place.removeprefix("link"))].xyz_m) > 0.05


@pytest.mark.slow
def test_a_log_that_is_accelerated_nearly_everywhere_has_inertia_from_the_start(tmp_path):
    """Two runs of quick moves: without inertia 2 % of their rows count, and one run says nothing of the other."""
    robot = draw_robot("small6", 58)
    measure(robot, tmp_path / "c", log="trapezoids_250hz", tables=("free_air",), noise="white", seed=58)
    campaign = read_campaign(tmp_path / "c")
    assert {"inertia", "link_inertia"} <= {t.effect for t in standard_effects([campaign])["free_air"]}
    errors = identify(campaign).ledger[-1]
    assert errors.heldout_rms < 1.5 * errors.noise_floor  # without inertia: 14


def test_a_log_of_which_half_is_accelerated_has_inertia_from_the_start(tmp_path):
    """Its steady rows are enough for friction and weight, but not for what shows where a joint begins to move."""
    robot = draw_robot("offset6", 3702)
    measure(robot, tmp_path / "c", log="two_warmths", tables=("free_air",), noise="white", seed=3702)
    campaign = read_campaign(tmp_path / "c")
    assert 0.3 < steady_share(log_parts([campaign])) < 0.7
    assert {"inertia", "link_inertia"} <= {t.effect for t in standard_effects([campaign])["free_air"]}


@pytest.mark.slow
def test_the_fast_runs_of_a_log_are_not_lost_because_most_rows_are_slow(tmp_path):
    """Five speeds: 72 % of the rows count without inertia, and of the fastest run none."""
    robot = draw_robot("uncoupled6", 3700)
    measure(robot, tmp_path / "c", log="five_speeds", tables=("free_air",), noise="white", seed=3700)
    campaign = read_campaign(tmp_path / "c")
    standard = standard_effects([campaign])["free_air"]
    assert {"inertia", "link_inertia"} <= {t.effect for t in standard}
    layout = layout_of([campaign])
    calm, every = (stage_rows([campaign], layout, "free_air", active=active).used
                   for active in ((), effects_in(standard, catalogue())))  # fmt: skip
    run = campaign.tables["free_air"]["run"].to_numpy()
    fastest = run == run[0]
    assert calm.sum() > 0.5 * every.sum()
    assert calm[fastest].sum() < 0.05 * every[fastest].sum()


@pytest.mark.slow
def test_a_refused_name_does_not_block_a_confirmed_one(tmp_path):
    """Rotors explain more of the fitted rows and nothing of others; an offset that follows warmth does both."""
    robot = draw_robot("seven7", 41, mounting="ceiling")
    session = {"log": "two_warmths", "noise": "stereo", "seed": 41}
    magnitude = magnitude_for(
        robot, "ambient_torque", "joint5", 0.8 * robot.n**-0.5, beyond_standard=True, program="quick", **session
    )
    hidden = [("ambient_torque", "joint5", magnitude)]
    measure(robot, tmp_path / "c", tables=("free_air",), program="quick", hidden=hidden, **session)
    campaign = read_campaign(tmp_path / "c")
    effects = ("gravity", "coulomb_friction", "viscous_friction")
    found = diagnose(identify(campaign, effects), campaign).stages["free_air"]
    assert found.verdict in ("missing", "ambiguous")
    families = {(c["effect"], tuple(c["where"])) for c in found.candidates}
    assert ("torque_offset", ("joint5",)) in families
