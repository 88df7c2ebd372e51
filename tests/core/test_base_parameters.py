"""Base parameters: no torque is lost, nothing is told that pinocchio cannot tell apart, and names are lengths."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from clampid.catalogue import with_user_effects
from clampid.fitting.base_names import base_name
from clampid.fitting.base_parameters import base_parameters, described_parameters, regroup, to_joint_points
from clampid.identification.fitted_stage import fit_stage
from clampid.identification.identify import effects_in, stage_rows
from clampid.models.model import Model, load_model, save_model
from clampid.slots import Slot, Term
from clampid.stages.layout import layout_of
from clampid.stages.loads import gravity_regressors
from experiments.campaign import read_campaign, write_campaign
from experiments.virtual_robot import measure
from kinematics.description import load_robot
from kinematics.gravity import gravity_torque

GRAVITY = ("gravity", "coulomb_friction", "viscous_friction", "wrist_coupling_friction")
DYNAMICS = (*GRAVITY, "link_inertia", "inertia")
LINK = ("m", "mx", "my", "mz")


def fitted(campaign, names):
    effects, layout = with_user_effects(None), layout_of([campaign])
    terms = [Term(name) for name in names]
    rows = stage_rows([campaign], layout, "free_air", active=effects_in(terms, effects))
    return fit_stage(rows, effects, terms, {})


@pytest.fixture
def rng():
    return np.random.default_rng(20240607)


@pytest.fixture(scope="module")
def still(tiny):
    return fitted(tiny, GRAVITY)


@pytest.fixture(scope="module")
def moving(tiny):
    return fitted(tiny, DYNAMICS)


def matrix(base, slots):
    """Rows: base parameters; columns: slots about their joint points."""
    out = np.zeros((len(base), len(slots)))
    for row, parameter in enumerate(base):
        for slot, coefficient in parameter.terms:
            out[row, slots.index(slot)] = coefficient
    return out


def pin_model(robot, bodies):
    """A pinocchio arm of bodies (mass, first moment and inertia about the joint point, base axes at the zero pose)."""
    model, parent, before = pin.Model(), 0, np.zeros(3)
    for i, (joint, body) in enumerate(zip(robot.joints, bodies, strict=True)):
        placement = pin.SE3(np.eye(3), np.asarray(joint.point) - before)
        parent = model.addJoint(parent, pin.JointModelRevoluteUnaligned(np.asarray(joint.axis)), placement, f"j{i}")
        before = np.asarray(joint.point)
        m, mx, my, mz, xx, yy, zz, xy, xz, yz = body
        dynamic = np.array([m, mx, my, mz, xx, xy, yy, xz, yz, zz])  # pinocchio's order
        model.appendBodyToJoint(parent, pin.Inertia.FromDynamicParameters(dynamic), pin.SE3.Identity())
    return model


def bodies_of(theta, slots, n):
    out = np.zeros((n, 10))
    names = (*LINK, "Ixx", "Iyy", "Izz", "Ixy", "Ixz", "Iyz")
    for value, slot in zip(theta, slots, strict=True):
        if slot.effect in ("gravity", "link_inertia"):
            out[int(slot.place.removeprefix("link")) - 1, names.index(slot.parameter)] = value
    return out


def test_coefficients_of_gravity_are_lengths_of_the_arm(still):
    base = still.model.base
    names = [p.name for p in base]
    assert len(base) == 10
    assert "m·c_x of link 2 + 0.78 m · m of links 3, 4, 5 and 6" in names
    assert "m·c_x of links 3 and 4 + 0.86 m · m of links 5 and 6" in names
    assert "m·c_z of link 3 + 0.15 m · m of links 4, 5 and 6" in names
    for parameter, length in ((base[0], 0.78), (base[2], 0.86)):
        masses = [c for s, c in parameter.terms if s.parameter == "m"]
        assert masses == pytest.approx([length] * len(masses), abs=1e-9)


@pytest.mark.parametrize("which", ["still", "moving"])
def test_pinocchio_does_not_determine_what_the_base_parameters_do_not(which, request, rng):
    """Bodies that share all base parameters have the same torques, whatever else of them is different."""
    model = request.getfixturevalue(which).model
    robot = load_robot("kuka_kr20_r1810")
    slots = tuple(s for s in model.slots if s.effect in ("gravity", "link_inertia"))
    K = matrix(model.base, model.slots)[:, [model.slots.index(s) for s in slots]]
    if which == "moving":  # of the combinations with a rotor's inertia, the rotor is held
        assert any(s.effect == "inertia" for p in model.base for s, _ in p.terms)
    one = rng.uniform(-5.0, 5.0, len(slots)) + 10.0
    _, sizes, directions = np.linalg.svd(K)
    null = directions[np.sum(sizes > 1e-9) :]
    assert len(null) >= 10
    other = one + null.T @ rng.uniform(-5.0, 5.0, len(null))
    seen = one + K.T @ rng.uniform(-1.0, 1.0, len(K))
    q, qd, qdd = rng.uniform(-2.0, 2.0, (3, 30, robot.n))
    if which == "still":
        qd, qdd = 0 * qd, 0 * qdd
    torques = []
    for theta in (one, other, seen):
        arm = pin_model(robot, bodies_of(theta, slots, robot.n))
        arm.gravity.linear = np.array([0.0, 0.0, -9.81])
        data = arm.createData()
        torques.append(np.array([pin.rnea(arm, data, *row) for row in zip(q, qd, qdd, strict=True)]))
    scale = np.abs(torques[0]).max()
    assert np.abs(one - other).max() > 1.0
    np.testing.assert_allclose(torques[1], torques[0], atol=1e-9 * scale)
    assert np.abs(torques[2] - torques[0]).max() > 1e-3 * scale


def test_columns_are_combinations_of_those_kept(rng):
    columns = rng.standard_normal((50, 4))
    mixing = rng.standard_normal((4, 3))
    columns = np.c_[columns, columns @ mixing, np.zeros(50)]
    kept, coefficients = regroup(columns, range(8))
    assert kept == [0, 1, 2, 3]
    np.testing.assert_allclose(columns[:, kept] @ coefficients, columns, atol=1e-12)
    np.testing.assert_allclose(coefficients[:, 4:7], mixing, atol=1e-10)
    hidden, _ = regroup(columns, range(8), columns[:, :2])
    assert hidden == [2, 3]


def test_a_joint_that_never_moved_welds_its_links(still):
    """Locked at q3 = 90 degrees, link 3's moment along x points down from where link 2's z was."""
    rows = still.estimate.problem.rows
    q = rows.signals["q"].copy()
    q[:, 2] = np.pi / 2
    used = rows.used.copy()
    used[:, 2] = False  # a motor at rest says nothing
    locked = still.estimate.problem.with_rows(replace(rows, signals={**rows.signals, "q": q}, used=used))
    base = base_parameters(replace(still.estimate, problem=locked))
    first = next(p for p in base if p.terms[0][0] == Slot("gravity", "mz", "link2"))
    assert dict(first.terms)[Slot("gravity", "mx", "link3")] == pytest.approx(-1.0, abs=1e-9)
    assert not any(p.terms[0][0].place == "link3" and p.terms[0][0].parameter != "my" for p in base)


def test_parameters_that_the_data_hardly_determine_are_said_so(moving):
    known = {p.terms[0][0].label: p.known for p in moving.model.base}
    assert known["gravity.mx@link2"]
    assert not known["link_inertia.Izz@link1"]  # a slow program: the first joint hardly accelerates
    assert all(p.std < 2.0 for p in moving.model.base if p.known and p.unit == "kg m^2" and "rotor" not in p.name)


def test_described_parameters_give_the_described_torque(still, rng):
    robot, slots = load_robot("kuka_kr20_r1810"), still.model.slots
    theta = np.linalg.solve(to_joint_points(slots, robot), described_parameters(slots, robot))
    masses = [theta[slots.index(Slot("gravity", name, f"link{i + 1}"))] for i in range(robot.n) for name in LINK]
    q = rng.uniform(-2.0, 2.0, (20, robot.n))
    held = gravity_regressors(robot, np.array([1.0, 2.0, -9.81]), q)["regressor"] @ masses
    np.testing.assert_allclose(held, gravity_torque(robot, q, (1.0, 2.0, -9.81)), atol=1e-9)


@pytest.mark.parametrize(
    ("terms", "name"),
    [
        ([(Slot("gravity", "mx", "link3"), 1.0), (Slot("gravity", "m", "link4"), 0.425)],
         "m·c_x of link 3 + 0.425 m · m of link 4"),
        ([(Slot("link_inertia", "Iyy", "link2"), 1.0), (Slot("link_inertia", "Izz", "link2"), -1.0),
          (Slot("inertia", "I", "joint2"), 1.0)], "I_yy of link 2 − I_zz of link 2 + rotor inertia of joint 2"),
        ([(Slot("gravity", "mz", "link6"), 1.0), (Slot("payload", "mz", "tool"), 1.0)],
         "m·c_z of link 6 + m·c_z of the tool beyond what was declared"),
        ([(Slot("gravity", "mx", "link2"), 1.0), (Slot("gravity_compensator", "b", "joint2"), -0.1019)],
         "m·c_x of link 2 − 0.1019 kg m/(Nm) · gravity_compensator.b of joint 2"),
    ],
)  # fmt: skip
def test_names(terms, name):
    assert base_name(terms, with_user_effects(None)) == name


def test_a_balancer_and_a_tool_share_the_names_of_what_they_cannot_be_separated_from(tiny):
    base = fitted(tiny, (*GRAVITY, "payload", "gravity_compensator")).model.base
    names = [p.name for p in base]
    assert any("gravity_compensator" in name and name.startswith("m·c_x of link 2") for name in names)
    assert any("the tool beyond what was declared" in name and name.startswith("m·c_x of link") for name in names)


def test_they_survive_the_model_file(still, tmp_path):
    model = Model("kuka_kr20_r1810", still.estimate.problem.rows.layout, {"free_air": still.model}, ())
    save_model(model, tmp_path / "m.json")
    assert load_model(tmp_path / "m.json").stages["free_air"].base == still.model.base


@pytest.mark.slow
def test_recovered_within_their_standard_errors(tmp_path):
    """Over eight robots, truth and estimate differ by as much as the standard errors say."""
    robot = load_robot("kuka_kr20_r1810")
    points = np.array([joint.point for joint in robot.joints])
    scores, described = [], []
    for seed in range(8):
        measured = measure(robot, seed=seed, poses=1, tables=("free_air", "wrist"))
        write_campaign(tmp_path / str(seed), measured.header, measured.tables)
        model = fitted(read_campaign(tmp_path / str(seed)), GRAVITY).model
        masses = measured.truth.plant.masses
        moments = masses.link[:, None] * (masses.com - points)
        truth = {Slot("gravity", "m", f"link{i + 1}"): masses.link[i] for i in range(robot.n)}
        truth |= {Slot("gravity", LINK[1 + k], f"link{i + 1}"): moments[i, k] for i in range(robot.n) for k in range(3)}
        for p in model.base:
            true = sum(c * truth[s] for s, c in p.terms)
            scores.append((p.value - true) / p.std)
            described.append((p.described - true) / p.std)
    assert 0.7 < np.sqrt(np.mean(np.square(scores))) < 1.4
    assert np.sqrt(np.mean(np.square(described))) > 2.0
