"""What can be hidden: visible where it should be, absent elsewhere, told truthfully."""

import ast
import re
from pathlib import Path

import numpy as np
import pytest

import experiments.virtual_robot as package
from experiments.virtual_robot import HIDEABLE, OUTSIDE, Hidden, measure
from experiments.virtual_robot.kinds import KINDS

MUST = {
    "backlash", "joint_compliance", "gear_eccentricity", "thermal_expansion", "payload", "stribeck_friction",
    "fixture_compliance", "base_tilt", "torque_offset", "instrument_scale", "bearing_tilt", "link_bending",
    "coupling_ratio_error", "nonlinear_stiffness", "hysteresis", "asymmetric_friction", "load_dependent_friction",
    "temperature_dependent_friction", "torque_ripple", "dress_pack", "gravity_compensator", "cross_coupled_stiffness",
    "time_lag", "presliding_friction", "torque_gain",
}  # fmt: skip


def _change(hidden, clean):
    """Rms change of every table in units of its noise; of torques, the motor that changes most."""
    sizes = {}
    for name, truth in hidden.truth.noise_free.items():
        change = truth - clean.truth.noise_free[name]
        if name in ("poses", "verification"):
            sizes[name] = np.sqrt(np.mean(change**2)) / clean.truth.plant.instrument.sigma
        else:
            rms = np.sqrt(np.mean(change**2, axis=0))
            sizes[name] = np.max(rms / clean.truth.plant.instrument.torque_sigma)
    return sizes


def test_everything_asked_for_can_be_hidden():
    assert set(HIDEABLE) >= MUST
    assert len(OUTSIDE) >= 5
    assert set(OUTSIDE) < set(HIDEABLE)


# Small in rms, but systematic over thousands of rows; and what acts at one place may spare one of its tables.
FAINT = {
    "motor_eccentricity": 0.1,
    "nonlinear_stiffness": 0.2,
    "soft_near_zero": 0.2,
    "load_dependent_friction": 0.2,
    "torque_gain": 0.1,
    "temperature_dependent_friction": 0.05,
    "torque_ripple": 0.1,
    "gravity_compensator": 0.0,
    "asymmetric_friction": 0.0,
    "damaged_tooth": 0.0,
}


@pytest.mark.parametrize("effect", HIDEABLE)
def test_an_effect_changes_the_tables_that_it_should(robot, clean, effect):
    hidden = measure(robot, [Hidden(effect)], seed=3, poses=60)
    for name, size in _change(hidden, clean).items():
        if name in KINDS[effect].tables:
            assert size >= FAINT.get(effect, 0.5), name
        else:
            assert size < 0.05, name
    assert max(_change(hidden, clean).values()) > 0.7
    told = hidden.hidden[0]
    assert told["effect"] == effect
    assert re.fullmatch(r"joint[1-6]|joints|link[1-6]|tool|base|fixture|instrument|clock|point", told["where"])
    for name, value in told["parameters"].items():
        assert re.search(r"_(m|rad|kg|kg_m|Nm|1|K|1_K|s|N_m|rad_s|rad_Nm|m_N|rad_rad|rad_Nm3|1_Nm2|Nm_rad)$", name)
        assert isinstance(value, float)


@pytest.mark.parametrize(
    "effect", ["backlash", "gear_eccentricity", "payload", "outside_third_harmonic", "torque_offset"]
)
def test_magnitude_is_a_factor(robot, effect):
    one, three = (
        measure(robot, [Hidden(effect, None, m)], seed=3, poses=2, tables=["poses"]).hidden[0]["parameters"]
        for m in (1, 3)
    )
    first = next(iter(one))
    assert three[first] == pytest.approx(3 * one[first])


@pytest.mark.slow
def test_magnitude_zero_hides_nothing(robot, clean):
    for effect in HIDEABLE:
        hidden = measure(robot, [Hidden(effect, None, 0.0)], seed=3, poses=60, tables=["poses", "clamped"])
        assert max(_change(hidden, clean).values()) < 1e-9, effect


@pytest.mark.parametrize("joint", range(1, 7))
def test_backlash_and_compliance_sit_where_they_are_put(robot, clean, joint):
    place = f"joint{joint}"
    hidden = measure(robot, [Hidden("backlash", place), Hidden("joint_compliance", place)], seed=3, poses=60)
    drive, before = hidden.truth.plant.drive, clean.truth.plant.drive
    gap, soft = (h["parameters"] for h in hidden.hidden)
    np.testing.assert_allclose(drive.gap - before.gap, gap["gap_rad"] * np.eye(6)[joint - 1], atol=1e-18)
    np.testing.assert_allclose(drive.extra_compliance, soft["compliance_rad_Nm"] * np.eye(6)[joint - 1])
    assert _change(hidden, clean)["clamped"] > 0.5


def test_a_payload_is_the_same_in_torques_and_in_points(robot, clean):
    hidden = measure(robot, [Hidden("payload")], seed=3, poses=60)
    masses, told = hidden.truth.plant.masses, hidden.hidden[0]["parameters"]
    assert masses.tool - 12.0 == pytest.approx(told["mass_kg"])
    moment = masses.tool * masses.tool_com - 12.0 * np.array([0, 0, 0.08])
    np.testing.assert_allclose(moment, [told[f"moment_{a}_kg_m"] for a in "xyz"])
    assert hidden.header == clean.header


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("gear_eccentricity@joint3:2.0", Hidden("gear_eccentricity", "joint3", 2.0)),
        ("payload", Hidden("payload")),
        ("payload:0.5", Hidden("payload", None, 0.5)),
        ("thermal_expansion@link2", Hidden("thermal_expansion", "link2")),
    ],
)
def test_parse(text, expected):
    assert Hidden.parse(text) == expected


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("backlsh", "did you mean 'backlash'.*known are backlash, "),
        ("backlash@link2", "expected joint1, joint2"),
        ("backlash@", "after '@'"),
        ("backlash:big", "a number after ':', found 'big'"),
        ("payload@joint3", "expected tool"),
        ("backlash:nan", "finite"),
    ],
)
def test_parse_says_what_is_wrong(text, message):
    with pytest.raises(ValueError, match=message):
        Hidden.parse(text)


def test_a_joint_that_does_not_exist_is_refused(robot):
    with pytest.raises(ValueError, match="joint1 to joint6"):
        measure(robot, [Hidden("backlash", "joint9")], poses=1)


def test_no_inverse_crime():
    for path in Path(package.__file__).parent.glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            for name in names:
                assert not name.startswith(("kinematics", "clampid", "offline_ik")), path
                assert not name.startswith("experiments.") or name.startswith("experiments.virtual_robot."), path
