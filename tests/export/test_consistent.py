"""Bodies that can exist: pinocchio takes them, they are the only nearest ones, and they cost what is said."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from clampid.exports.dynamics_export import dynamics, torque_errors
from clampid.identification.identify import identify
from clampid.models.consistent import consistent_arm, reference_bodies
from clampid.models.model import ModelError
from clampid.slots import Slot
from clampid.standard_sets import STANDARD
from experiments.campaign import read_campaign
from experiments.simulate import simulate
from kinematics.description import load_robot
from kinematics.pseudo_inertia import about_centre, is_consistent, parameters_of, pseudo_inertia

ROBOT = "kuka_kr20_r1810"
FULL = ("gravity", "coulomb_friction", "viscous_friction", "wrist_coupling_friction", "link_inertia", "inertia")


@pytest.fixture(scope="module")
def campaign(tmp_path_factory):
    folder = tmp_path_factory.mktemp("campaigns") / "arm"
    return read_campaign(simulate(folder, ROBOT, seed=3, tables=("free_air", "wrist")))


@pytest.fixture(scope="module")
def gravity(campaign):
    return identify(campaign, {"free_air": STANDARD["free_air"]})


@pytest.fixture(scope="module")
def full(campaign):
    return identify(campaign, {"free_air": FULL})


def pin_body(phi):
    m, x, y, z, xx, yy, zz, xy, xz, yz = phi
    return pin.Inertia.FromDynamicParameters(np.array([m, x, y, z, xx, xy, yy, xz, yz, zz]))


def test_pseudo_inertia_is_that_of_points():
    rng = np.random.default_rng(1)
    points, masses = rng.standard_normal((7, 3)), rng.uniform(0.1, 2.0, 7)
    ones = np.c_[points, np.ones(7)]
    inertia = sum(m * ((r @ r) * np.eye(3) - np.outer(r, r)) for m, r in zip(masses, points, strict=True))
    first = masses @ points
    phi = np.r_[masses.sum(), first, np.diag(inertia), inertia[0, 1], inertia[0, 2], inertia[1, 2]]
    np.testing.assert_allclose(pseudo_inertia(phi), (ones.T * masses) @ ones, atol=1e-12)
    np.testing.assert_allclose(parameters_of(pseudo_inertia(phi)), phi, atol=1e-12)
    mass, centre, about = about_centre(phi)
    body = pin_body(phi)
    assert mass == pytest.approx(body.mass)
    np.testing.assert_allclose(centre, body.lever, atol=1e-12)
    np.testing.assert_allclose(about, body.inertia, atol=1e-12)
    assert is_consistent(phi)


@pytest.mark.parametrize(
    "phi",
    [
        [-1.0, 0, 0, 0, 1, 1, 1, 0, 0, 0],
        [1.0, 0, 0, 0, 1, 1, 2.1, 0, 0, 0],  # the triangle inequality
        [1.0, 1.0, 0, 0, 1, 1, 0.9, 0, 0, 0],  # positive definite, but not about its centre
    ],
)
def test_what_no_body_can_have(phi):
    assert not is_consistent(phi)


@pytest.mark.parametrize("which", ["gravity", "full"])
def test_bodies_can_exist_and_are_the_base_parameters_said(which, request):
    model = request.getfixturevalue(which)
    robot, stage = load_robot(ROBOT), model.stages["free_air"]
    arm = consistent_arm(model, robot)
    assert is_consistent(arm.parameters).all()
    values = {}
    for i, (phi, link) in enumerate(zip(arm.parameters, arm.links, strict=True)):
        body = pin_body(phi)
        assert body.mass > 0
        principal = np.linalg.eigvalsh(body.inertia)
        assert principal[0] > 0
        assert principal[0] + principal[1] > principal[2]
        assert link.mass == pytest.approx(body.mass)
        np.testing.assert_allclose(link.com - robot.joints[i].point, body.lever, atol=1e-12)
        np.testing.assert_allclose(link.inertia, body.inertia, atol=1e-9)
        names = ("m", "mx", "my", "mz", "Ixx", "Iyy", "Izz", "Ixy", "Ixz", "Iyz")
        for name, value in zip(names, phi, strict=True):
            values["link_inertia" if name[0] == "I" else "gravity", name, f"link{i + 1}"] = value
    if arm.rotors is not None:
        assert arm.rotors.min() > 0
        values |= {("inertia", "I", f"joint{i + 1}"): r for i, r in enumerate(arm.rotors)}
    for parameter, told in zip(stage.base, arm.base, strict=True):
        expected = sum(c * values[s.effect, s.parameter, s.place] for s, c in parameter.terms)
        assert told == pytest.approx(expected, abs=1e-9)
        assert abs(told - parameter.value) < 4 * parameter.std


def test_nothing_near_is_better(full):
    """The minimum, checked from outside: chi-square and divergences computed anew, in random directions."""
    rng = np.random.default_rng(2)
    robot, stage = load_robot(ROBOT), full.stages["free_air"]
    arm = consistent_arm(full, robot)
    reference = [pseudo_inertia(p) for p in reference_bodies(robot)]
    fitted = dict(zip(stage.slots, stage.theta, strict=True))
    order = [p.terms for p in stage.base]
    jacobian = np.array([[dict(t).get(s, 0.0) for s in stage.slots] for t in order])
    move = np.eye(len(stage.slots))  # first moments from the base's origin to the joint's point
    for k, slot in enumerate(stage.slots):
        if slot.effect == "gravity" and slot.parameter != "m":
            axis = "xyz".index(slot.parameter[1])
            point = robot.joints[int(slot.place[4:]) - 1].point[axis]
            move[k, stage.slots.index(Slot("gravity", "m", slot.place))] = -point
    C = jacobian @ move @ stage.covariance @ move.T @ jacobian.T
    rotors = np.maximum(np.abs([fitted[Slot("inertia", "I", f"joint{i + 1}")] for i in range(6)]), 0.02)
    names = ("m", "mx", "my", "mz", "Ixx", "Iyy", "Izz", "Ixy", "Ixz", "Iyz")

    def cost(parameters, spinning):
        values = {
            Slot("link_inertia" if name[0] == "I" else "gravity", name, f"link{i + 1}"): parameters[i, k]
            for i in range(6)
            for k, name in enumerate(names)
        } | {Slot("inertia", "I", f"joint{i + 1}"): spinning[i] for i in range(6)}
        off = np.array([sum(c * values[s] for s, c in t) for t in order]) - [p.value for p in stage.base]
        divergence = 0.0
        for P, P0 in zip(map(pseudo_inertia, parameters), reference, strict=True):
            ratio = np.linalg.solve(P0, P)
            divergence += np.trace(ratio) - np.log(np.linalg.det(ratio)) - 4.0
        ratio = spinning / rotors
        return off @ np.linalg.solve(C, off) + 2 * arm.weight * (divergence + (ratio - np.log(ratio) - 1.0).sum())

    best = cost(arm.parameters, arm.rotors)
    for _ in range(200):
        links = arm.parameters * (1 + 1e-3 * rng.standard_normal(arm.parameters.shape))
        assert cost(links, arm.rotors * (1 + 1e-2 * rng.standard_normal(6))) > best
    off = arm.base - [p.value for p in stage.base]
    assert arm.chi_square == pytest.approx(off @ np.linalg.solve(C, off), rel=1e-6)


def test_the_torque_hardly_gets_worse_and_is_that_of_the_bodies(gravity, campaign):
    robot = load_robot(ROBOT)
    arm = consistent_arm(gravity, robot)
    before, after = torque_errors(gravity, arm, campaign, robot)
    assert (after >= before * (1 - 1e-3)).all()
    assert (after < before * 1.02).all()
    heavier = replace(arm, parameters=arm.parameters * 1.2)
    assert torque_errors(gravity, heavier, campaign, robot)[1][1] > 1.2 * before[1]


def test_an_impossible_fit_gives_bodies_all_the_same(full):
    """A mass moment and inertias that no body can have are told by a large chi-square, not by an impossible body."""
    stage = full.stages["free_air"]
    base = tuple(
        replace(p, value=-50.0 * p.std) if p.terms[0][0] == Slot("link_inertia", "Iyy", "link3") else p
        for p in stage.base
    )
    arm = consistent_arm(full.with_stage(replace(stage, base=base)), load_robot(ROBOT))
    assert is_consistent(arm.parameters).all()
    assert arm.chi_square > 100.0


def test_an_arm_without_described_masses(full):
    bare = replace(load_robot(ROBOT), links=())
    assert is_consistent(reference_bodies(bare)).all()


def test_what_is_written(full, gravity, campaign):
    told = dynamics(full, consistent=True, campaign=campaign)
    json.dumps(told, allow_nan=False)
    assert told["inertia_identified"]
    assert len(told["links"]) == len(told["rotor_inertia_kg_m2"]) == 6
    assert len(told["fit"]["rms_Nm"]) == 6
    assert "links" not in dynamics(gravity)
    assert dynamics(gravity, consistent=True)["rotor_inertia_kg_m2"] is None


def test_a_model_without_torques_is_refused(make_model):
    with pytest.raises(ModelError, match="gravity identified"):
        dynamics(make_model("ur10"))
