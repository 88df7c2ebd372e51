"""A free roll: the best there is, as a fine grid knows it, on the identified arm, within limits and branches."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from ik_arms import drawn_model

from kinematics.description import load_robot
from offline_ik.cell.cell import default_cell
from offline_ik.cell.coordinates import detector_pose
from offline_ik.errors import TargetError
from offline_ik.inverse import free_roll
from offline_ik.inverse.detector import Detector
from offline_ik.inverse.free_roll import FIRST_ROLLS
from offline_ik.inverse.opening import open_detector

FINE = 10 * FIRST_ROLLS  # rolls all round


def moved(q: np.ndarray, near: np.ndarray) -> float:
    """The effort, written out."""
    return float(max(abs(q - near)) + 0.1 * np.sqrt(sum((q - near) ** 2)))


def best_of_grid(detector: Detector, place: tuple[float, float, float], near: np.ndarray, branch: str) -> float:
    """The least effort at the rolls of the grid, rad; infinite where none leads to a posture."""
    best = np.inf
    for roll in np.arange(FINE) * (2 * np.pi / FINE) - np.pi:
        answer = detector.locate(*place, roll, near=near, branch=branch, nearest=False)
        if answer.reachable:
            best = min(best, moved(answer.solutions[0].q, near))
    return best


def drawn(detector: Detector, count: int, seed: int) -> list[tuple[tuple[float, float, float], np.ndarray]]:
    """Places, many near the border of the reach, and postures at hand."""
    rng = np.random.default_rng(seed)
    low, high = np.maximum(detector.lower, -np.pi), np.minimum(detector.upper, np.pi)
    return [
        ((float(g), float(d), float(r)), rng.uniform(low, high))
        for g, d, r in rng.uniform([-0.3, -0.2, 0.3], [1.5, 1.3, 1.2], (count, 3))
    ]


PLAY = 1e-4  # rad: the drawn arm's gaps and wind-up, by which the effort jumps where a joint changes its flank


@pytest.fixture(scope="module")
def smooth(cell_file: Path) -> Detector:
    """An arm without play."""
    return open_detector(drawn_model(effects=("geometry", "joint_compliance", "gravity")), cell_file)


@pytest.mark.slow
@pytest.mark.parametrize(("arm", "jumps"), [("smooth", 0.0), ("detector", PLAY)])
def test_no_roll_of_a_ten_times_finer_grid_is_better(arm: str, jumps: float, request: pytest.FixtureRequest) -> None:
    detector: Detector = request.getfixturevalue(arm)
    reached = 0
    for place, near in drawn(detector, 6, 0):
        free = detector.locate(*place, None, near=near, nearest=False)
        best = best_of_grid(detector, place, near, "nearest")
        assert free.reachable or not np.isfinite(best)
        if free.reachable:
            reached += 1
            first = free.solutions[0]
            assert moved(first.q, near) <= best + jumps + 1e-6
            wanted = detector_pose(detector.cell.convention, *place, first.roll)
            assert np.allclose(detector.pose(first.q[None])[0], wanted, atol=3e-9)
    assert reached >= 4


def test_nor_where_a_branch_is_asked_for(detector: Detector) -> None:
    for place, near in drawn(detector, 1, 1):
        some = detector.locate(*place, 0.3, near=near, branch="all", nearest=False).solutions
        for branch in ("axis5-", *(f"S{s.status}T{s.turn}" for s in some[-1:])):
            free = detector.locate(*place, None, near=near, branch=branch, nearest=False)
            # a tenth of the grid, since each of its rolls solves all branches
            rolls = np.arange(FIRST_ROLLS) * (2 * np.pi / FIRST_ROLLS) - np.pi
            every = [detector.locate(*place, roll, near=near, branch=branch, nearest=False) for roll in rolls]
            moves = [moved(a.solutions[0].q, near) for a in every if a.reachable]
            assert free.reachable or not moves
            if free.reachable:
                assert moved(free.solutions[0].q, near) <= min(moves, default=np.inf) + PLAY


def test_a_window_between_limits_narrower_than_the_grid_is_found(detector: Detector) -> None:
    """Limits around one posture leave a hundredth of a radian of roll: between two rolls of the grid."""
    place, roll = (0.5, 0.3, 0.8), 0.731
    q = detector.locate(*place, roll).solutions[0].q
    slack = np.array([0.02, 0.02, 0.02, 0.02, 0.02, 0.005])  # axis 6 turns with the roll
    narrow = Detector(detector.arm, detector.cell)
    narrow.lower, narrow.upper = q - slack, q + slack
    narrow.search = replace(narrow.search, lower=narrow.lower, upper=narrow.upper)
    grid = np.arange(FIRST_ROLLS) * (2 * np.pi / FIRST_ROLLS) - np.pi
    assert np.abs(grid - roll).min() > 0.01
    found = narrow.locate(*place, None, near=q, nearest=False)
    assert found.reachable
    assert found.solutions[0].roll == pytest.approx(roll, abs=0.006)


def test_the_best_is_that_of_the_identified_arm(detector: Detector, monkeypatch: pytest.MonkeyPatch) -> None:
    """The nominal arm's best roll is off by its millimetres."""
    near = np.array([0.1, -1.2, 1.2, 0.1, 0.4, 0.0])
    best = detector.locate(0.5, 0.3, 0.8, None, near=near).solutions[0]
    monkeypatch.setattr(free_roll._Along, "on_identified", lambda self, roll, branch: (0.0, roll))
    nominal = detector.locate(0.5, 0.3, 0.8, None, near=near).solutions[0]
    assert moved(nominal.q, near) > moved(best.q, near) + 1e-9
    assert nominal.roll == pytest.approx(best.roll, abs=max(free_roll.ROLLS_AROUND))


def test_a_roll_that_turns_one_joint_alone_does_not_turn_it_for_nothing(detector: Detector) -> None:
    """The detector is square on axis 6: whatever the roll, another joint may move furthest."""
    near = np.array([1.2, -1.2, 1.2, 0.1, 0.4, 0.3])
    first = detector.locate(0.5, 0.3, 0.8, None, near=near).solutions[0]
    assert first.distance == pytest.approx(np.abs(first.q - near)[:5].max())
    assert abs(first.q[5] - near[5]) < 0.02


def test_a_free_roll_out_of_reach_has_reasons(detector: Detector) -> None:
    answer = detector.locate(0.3, 0.2, 3.0, None)
    assert not answer.reachable
    assert answer.reasons
    assert answer.nearest is not None
    with pytest.raises(TargetError):
        detector.locate(30.0, 0.2, 0.8, None)


@pytest.mark.slow
def test_an_arm_without_closed_form_takes_the_best_from_the_posture_at_hand() -> None:
    robot = load_robot("ur10")
    detector = open_detector(drawn_model("ur10", ("geometry", "joint_compliance")), default_cell(robot))
    near = detector.locate(0.6, 0.4, 0.5, 1.0).solutions[0].q
    free = detector.locate(0.6, 0.4, 0.5, None, near=near + 0.05).solutions[0]
    assert free.position_error < 1e-8
    for roll in np.linspace(-np.pi, np.pi, 9)[:-1]:
        fixed = detector.locate(0.6, 0.4, 0.5, float(roll), near=near + 0.05, nearest=False)
        here = [moved(s.q, near + 0.05) for s in fixed.solutions]
        assert moved(free.q, near + 0.05) <= min(here, default=np.inf) + 1e-6
