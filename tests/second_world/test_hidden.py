"""Every hidden effect changes the measurement by the size that was asked for, and where it acts."""

import numpy as np
import pytest

from experiments.second_world import HIDDEN, draw_robot, magnitude_for, size_in_sigma
from experiments.second_world.hidden.kinds import Setting
from experiments.second_world.session import activate, open_session, points_seen, torques

SMALL = {"program": "few", "log": "warm_up", "noise": "white", "seed": 3}
ROBOT = draw_robot("uncoupled6", 3)
SEVEN = draw_robot("seven7", 3)
FAMILIES = [
    "geometry",
    "gravity",
    "payload",
    "gravity_compensator",
    "inertia",
    "coulomb_friction",
    "viscous_friction",
    "stribeck_friction",
    "asymmetric_friction",
    "load_dependent_friction",
    "temperature_dependent_friction",
    "wrist_coupling_friction",
    "torque_ripple",
    "dress_pack",
    "torque_offset",
    "backlash",
    "joint_compliance",
    "nonlinear_stiffness",
    "hysteresis",
    "cross_coupled_stiffness",
    "fixture_compliance",
    "bearing_tilt",
    "link_bending",
    "base_tilt",
    "gear_eccentricity",
    "coupling_ratio_error",
    "thermal_expansion",
    "instrument_scale",
    "torque_gain",
    "time_lag",
]


@pytest.mark.parametrize("name", HIDDEN)
def test_an_effect_has_the_size_asked_for(name):
    table = HIDDEN[name].tables[0]
    magnitude = magnitude_for(ROBOT, name, None, 0.8, **SMALL)
    size = size_in_sigma(ROBOT, [(name, None, magnitude)], **SMALL)
    assert size[table] == pytest.approx(0.8, rel=0.02)
    assert set(size) == set(HIDDEN[name].tables)


@pytest.mark.parametrize("name", [n for n, e in HIDDEN.items() if "poses" in e.tables])
def test_pose_effects_act_on_seven_axes_wherever_they_may_sit(name):
    session = open_session(SEVEN, "few", "warm_up", "white", 3)
    visits = session.visits
    plain = points_seen(session, visits, [])
    for where in HIDDEN[name].places(SEVEN.n):
        active = activate(session, [(name, where, 1.0)])[0][2]
        moved = points_seen(session, visits, [active]) - plain
        assert np.isfinite(moved).all()
        assert 0 < np.abs(moved).max() < 5e-3


def test_torque_effects_act_at_their_motor_only():
    session = open_session(SEVEN, "few", "warm_up", "white", 3)
    log = session.motion
    plain = torques(session, log, [])
    for name, effect in HIDDEN.items():
        if effect.tables != ("free_air",):
            continue
        for where in effect.places(SEVEN.n)[:2]:
            active = activate(session, [(name, where, 1.0)])[0][2]
            touched = np.flatnonzero(np.abs(torques(session, log, [active]) - plain).max(0) > 1e-9)
            expected = range(7) if where == "all" else [int(where.split("+")[0].removeprefix("joint")) - 1]
            np.testing.assert_array_equal(touched, list(expected))


def test_names_are_families_or_say_what_they_depend_on():
    outside = [e for e in HIDDEN.values() if e.family is None]
    assert len(outside) >= 5
    assert all(e.depends_on(w) for e in outside for w in e.places(6))
    assert {e.family for e in HIDDEN.values() if e.family} <= set(FAMILIES)


def test_a_tooth_is_local():
    session = open_session(ROBOT, "many", "warm_up", "white", 3)
    visits = session.visits
    active = activate(session, [("damaged_tooth", "joint3", 1.0)])[0][2]
    moved = np.abs(points_seen(session, visits, [active]) - points_seen(session, visits, [])).max((1, 2)) > 1e-7
    truth = {p.name: p.value for p in active.parameters}
    inside = np.abs(visits.q[:, 2] - truth["centre"]) < np.deg2rad(7.5)
    assert moved.any()
    assert not moved[~inside].any()
    assert truth["height"] == pytest.approx(8e-4)


def test_errors_absorbed_by_a_refit_do_not_count_beyond_the_standard():
    small = {"program": "few", "noise": "white", "seed": 3, "beyond_standard": True}
    assert size_in_sigma(ROBOT, [("joint_compliance", "joint2", 1.0)], **small)["poses"] < 0.05
    assert size_in_sigma(ROBOT, [("payload", None, 1.0)], tables=("free_air",), **small)["free_air"] < 0.02
    stiff = draw_robot("uncoupled6", 3, compliance=False)
    assert size_in_sigma(stiff, [("joint_compliance", "joint2", 1.0)], **small)["poses"] > 0.05


def test_effects_are_drawn_by_seed_name_and_place_only():
    session = open_session(ROBOT, "few", "warm_up", "white", 3)
    alone = activate(session, [("gear_eccentricity", "joint2", 1.0)])[0][2]
    beside = activate(session, [("hysteresis", "joint1", 2.0), ("gear_eccentricity", "joint2", 1.0)])[1][2]
    assert alone.parameters == beside.parameters


@pytest.mark.parametrize(("where", "expected"), [("joint3", 2), ("link2", 1), ("joint4+joint5", 3)])
def test_places_have_indices(where, expected):
    session = open_session(ROBOT, "few", "warm_up", "white", 3)
    setting = Setting(ROBOT, where, 1.0, np.random.default_rng(0), np.zeros((0, 6)), session.instrument)
    assert setting.index() == expected


def test_wrong_names_are_told_with_what_exists():
    session = open_session(ROBOT, "few", "warm_up", "white", 3)
    with pytest.raises(ValueError, match="expected one of backlash"):
        activate(session, [("backlsh", None, 1.0)])
    with pytest.raises(ValueError, match="link_bending at 'joint9': expected one of link2, link3"):
        activate(session, [("link_bending", "joint9", 1.0)])
    with pytest.raises(ValueError, match="changes nothing in poses"):
        magnitude_for(
            draw_robot("uncoupled6", 3, compliance=False, backlash=False), "payload", None, 1.0, table="poses", **SMALL
        )


def test_no_magnitude_is_returned_for_a_size_that_it_does_not_have():
    """One target on a line: geometry absorbs a tilt of a bearing to 3e-5 of the noise, unless it turns by radians."""
    robot = draw_robot("big6", 3709, mounting="ceiling")
    with pytest.raises(ValueError, match=r"no magnitude with 0\.8 sigma in poses was found"):
        magnitude_for(
            robot, "bearing_tilt", "joint1", 0.8, table="poses", beyond_standard=True,
            program="line24", noise="walk", seed=3709,
        )  # fmt: skip
