"""The nearest position that can be reached: held against a search from many postures by another formulation."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from ik_arms import drawn_model
from scipy.optimize import minimize

from offline_ik.cell.cell import read_cell
from offline_ik.cell.coordinates import detector_angles
from offline_ik.cell.reach import nearest_reachable
from offline_ik.inverse.detector import Detector
from offline_ik.inverse.opening import open_detector

AS_FAR = 1e-4  # m by which a search from everywhere may find a nearer place


def by_brute_force(detector: Detector, goal: np.ndarray, roll: float | None, starts: int) -> float:
    """The least distance to ``goal`` ``(3,)`` that a general optimiser finds from random postures, m."""
    convention, rng = detector.cell.convention, np.random.default_rng(7)

    def looks(q: np.ndarray) -> np.ndarray:
        at = detector_angles(convention, detector.pose(q[None])[0])
        off = 0.0 if roll is None else (at.roll - roll + np.pi) % (2 * np.pi) - np.pi
        return np.array([*at.tilt, off] if roll is not None else at.tilt)

    def distance(q: np.ndarray) -> float:
        return float(np.linalg.norm(detector.pose(q[None])[0, :3, 3] - goal))

    least, low, high = np.inf, np.maximum(detector.lower, -np.pi), np.minimum(detector.upper, np.pi)
    for start in rng.uniform(low, high, (starts, detector.arm.n)):
        end = minimize(
            distance, start, method="SLSQP", bounds=list(zip(detector.lower, detector.upper, strict=True)),
            constraints=[{"type": "eq", "fun": looks}], options={"maxiter": 150, "ftol": 1e-9},
        )  # fmt: skip
        pose = detector.pose(end.x[None])[0]
        faces = pose[:3, 2] @ (np.asarray(convention.sample) - pose[:3, 3]) > 0
        if faces and np.abs(looks(end.x)).max() < 1e-6:
            least = min(least, float(end.fun))
    return least


def check(detector: Detector, place: tuple[float, float, float], roll: float | None, starts: int = 6) -> None:
    asked = detector.locate(*place, roll, nearest=False)
    assert not asked.reachable
    goal = asked.target[:3, 3]
    found = nearest_reachable(detector, asked.target, roll)
    assert found is not None
    assert found["distance_m"] < by_brute_force(detector, goal, roll, starts) + AS_FAR
    there = detector.locate(found["gamma_rad"], found["delta_rad"], found["r_m"], found["roll_rad"], nearest=False)
    assert there.reachable
    assert np.linalg.norm(there.target[:3, 3] - goal) == pytest.approx(found["distance_m"], abs=1e-12)
    assert roll is None or found["roll_rad"] == roll


PLACES = ((0.3, 0.2, 2.7), (0.3, 0.2, 9.9), (2.5, -0.4, 6.0), (-1.2, 0.9, 1.6), (3.0, 0.1, 0.3), (0.98, -0.27, 4.5))


@pytest.mark.parametrize("place", PLACES)
def test_no_search_finds_a_nearer_place(detector: Detector, place: tuple[float, float, float]) -> None:
    check(detector, place, 0.0)


def test_with_the_roll_free_any_roll_will_do(detector: Detector) -> None:
    place = (0.3, 0.2, 4.0)
    check(detector, place, None)
    free, fixed = detector.locate(*place, None).nearest, detector.locate(*place).nearest
    assert free is not None
    assert fixed is not None
    assert free["distance_m"] <= fixed["distance_m"] + 1e-6
    assert fixed["roll_rad"] == 0.0


@pytest.mark.slow
def test_where_a_limit_and_not_the_reach_is_in_the_way(detector: Detector) -> None:
    q = detector.locate(0.3, 0.2, 0.8).solutions[0].q
    joints = tuple(
        replace(j, lower=max(j.lower, v - 0.4), upper=min(j.upper, v + 0.4))
        for j, v in zip(detector.robot.joints, q, strict=True)
    )
    tight = Detector(replace(detector.arm, robot=replace(detector.robot, joints=joints)), detector.cell)
    check(tight, (0.3, 1.0, 0.8), 0.0)


@pytest.mark.slow
@pytest.mark.parametrize("order", ["gamma_outer", "delta_outer"])
def test_in_the_instruments_frame_and_in_either_order(detector: Detector, order: str) -> None:
    convention = detector.cell.convention
    beam, up = (tuple(detector.arm.base[:3, :3] @ v) for v in (convention.beam, convention.up))
    sample = detector.arm.base @ np.append(convention.sample, 1.0)
    turned = replace(convention, order=order, frame="instrument", beam=beam, up=up).with_sample(sample[:3])
    there = Detector(detector.arm, replace(detector.cell, convention=turned))
    rng = np.random.default_rng(3)
    for q in rng.uniform(-1.0, 1.0, (5, 6)):
        row = np.concatenate([q, [0.3], there.still.vector])
        place, moves, _, slopes = (o.copy() for o in there.looking.one(row))
        assert place == pytest.approx(there.pose(q[None])[0, :3, 3], abs=1e-12)
        for k in range(6):
            step = 1e-6 * np.eye(len(row))[k]
            up_, down = ([o.copy() for o in there.looking.one(row + s * step)] for s in (1.0, -1.0))
            assert moves.reshape(3, 6)[:, k] == pytest.approx((up_[0] - down[0]) / 2e-6, abs=1e-7)
            assert slopes.reshape(3, 6)[:, k] == pytest.approx((up_[2] - down[2]) / 2e-6, abs=1e-7)
    pose = there.locate(0.3, 0.2, 0.8, 0.4, nearest=False)
    if pose.reachable:
        row = np.concatenate([pose.solutions[0].q, [0.4], there.still.vector])
        assert np.abs(there.looking.one(row)[2]).max() < 1e-8
    check(there, (0.3, 0.2, 5.0), 0.4, starts=6)


@pytest.mark.slow
def test_an_arm_without_a_closed_form(tmp_path: Path, cell_file: Path) -> None:
    text = cell_file.read_text(encoding="utf-8").replace("kuka_kr20_r1810", "ur10")
    text = text.replace("[1.4, 0.0, 0.0]", "[0.9, 0.0, 0.3]").replace("[1.4, 0.0, -0.35]", "[0.9, 0.0, -0.6]")
    (tmp_path / "cell.toml").write_text(text, encoding="utf-8")
    model = drawn_model("ur10", ("geometry", "joint_compliance"))
    check(open_detector(model, read_cell(tmp_path / "cell.toml", open_detector(model).robot)), (0.3, 0.2, 4.0), 0.0, 8)


@pytest.fixture(scope="module")
def linked() -> Detector:
    """An arm whose elbow is held by a linkage with joint 2."""
    return open_detector(drawn_model("abb_irb2400_12_155"))


@pytest.mark.slow
def test_an_arm_with_a_linkage(linked: Detector) -> None:
    check(linked, (0.3, 0.2, 0.4), 0.0, 16)


def test_derivatives_by_the_joints_of_a_linkage(linked: Detector) -> None:
    still = linked.still.vector
    for q in np.random.default_rng(2).uniform(-0.8, 0.8, (4, 6)):
        target = linked.pose(q[None] + 0.01)[0]
        wanted = [*target[:3, :3].ravel(), *target[:3, 3]]
        rows = {
            "looking": (linked.looking, np.concatenate([q, [0.3], still]), 0),
            "whole": (linked.solver.whole, np.concatenate([wanted, q, still]), 12),
        }
        _, moves, _, slopes = (o.copy() for o in linked.looking.one(rows["looking"][1]))
        jacobian = linked.solver.whole.one(rows["whole"][1])[1].copy().reshape(6, 6)
        for k in range(6):
            sides = {}
            for name, (kernel, row, first) in rows.items():
                step = 1e-6 * np.eye(len(row))[first + k]
                sides[name] = [[o.copy() for o in kernel.one(row + s * step)] for s in (1.0, -1.0)]
            up, down = sides["looking"]
            assert moves.reshape(3, 6)[:, k] == pytest.approx((up[0] - down[0]) / 2e-6, abs=1e-7)
            assert slopes.reshape(3, 6)[:, k] == pytest.approx((up[2] - down[2]) / 2e-6, abs=1e-7)
            up, down = sides["whole"]  # what is left to the pose falls as the arm comes nearer
            assert jacobian[:3, k] == pytest.approx((down[0] - up[0])[:3] / 2e-6, abs=1e-7)
