"""How many geometric parameters a robot has follows from it and from what is measured, not from names."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from test_chain_poses import campaign_of

from clampid.catalogue import catalogue
from clampid.fitting.gauge import independent_geometry
from clampid.fitting.nulls import named_directions
from clampid.identification.identify import stage_rows
from clampid.slots import Slot
from clampid.stages.fit_problem import fit_problem
from clampid.stages.layout import layout_of
from clampid.stages.rows import Rows
from kinematics.description import load_robot
from kinematics.poe import forward


def flange_rows(name: str, rotated: bool, targets: dict[str, tuple[float, float, float]] | None = None) -> Rows:
    """Poses of a nominal robot: the flange with its rotation, or targets on it."""
    robot = load_robot(name)
    rng = np.random.default_rng(0)
    q = rng.uniform(np.maximum(robot.lower, -2.0), np.minimum(robot.upper, 2.0), (30, robot.n))
    pose = forward(robot.screws, robot.flange, q @ np.asarray(robot.linkage).T)
    frames = []
    for target, at in (targets or {"flange": (0.0, 0.0, 0.0)}).items():
        frame = pd.DataFrame(q, columns=[f"q{i + 1}_rad" for i in range(robot.n)])
        for i in range(robot.n):
            frame[f"dir{i + 1}"] = 1
        frame["pose"], frame["visit"], frame["target"] = np.arange(len(q)), 1, target
        frame["time_s"] = 1.0 * np.arange(len(q))
        points = pose[:, :3, :3] @ np.asarray(at) + pose[:, :3, 3]
        frame[["x_m", "y_m", "z_m"]] = points
        if rotated:
            frame[["qw", "qx", "qy", "qz"]] = [quaternion(R) for R in pose[:, :3, :3]]
        frames.append(frame)
    campaign = campaign_of(robot, {"poses": pd.concat(frames, ignore_index=True)}, targets)
    return stage_rows([campaign], layout_of([campaign]), "poses")


def quaternion(R: np.ndarray) -> np.ndarray:
    """Unit quaternion, scalar first: the eigenvector of Bar-Itzhack's matrix."""
    K = np.zeros((4, 4))
    K[0, 0] = np.trace(R)
    K[1:, 1:] = R + R.T - np.trace(R) * np.eye(3)
    K[0, 1:] = K[1:, 0] = (R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1])
    return np.linalg.eigh(K)[1][:, -1]


THREE = {"T1": (0.1, 0.0, 0.12), "T2": (-0.05, 0.0866, 0.12), "T3": (-0.05, -0.0866, 0.12)}


@pytest.mark.parametrize(
    ("robot", "rotated", "targets", "count"),
    [
        ("kuka_kr20_r1810", False, THREE, 4 * 6 + 9),  # the base is among the 24; the tool is the targets
        ("kuka_kr20_r1810", False, {"T1": THREE["T1"]}, 4 * 6 + 3),
        ("ur10", True, None, 4 * 6 + 6),
        ("ur10", False, THREE, 4 * 6 + 9),
        ("kuka_kr20_r1810", True, None, 4 * 6 + 6),
    ],
)
def test_count(robot: str, rotated: bool, targets: dict[str, tuple[float, float, float]] | None, count: int):
    assert len(independent_geometry(flange_rows(robot, rotated, targets), catalogue())) == count


def test_a_point_on_the_last_axis_has_less():
    on_axis = flange_rows("kuka_kr20_r1810", False, {"T1": (0.0, 0.0, 0.1)})
    beside = flange_rows("kuka_kr20_r1810", False, {"T1": (0.1, 0.0, 0.1)})
    assert len(independent_geometry(on_axis, catalogue())) <= len(independent_geometry(beside, catalogue()))


@pytest.mark.parametrize("robot", ["kuka_kr20_r1810", "ur10"])
def test_what_is_left_out_adds_nothing(robot: str):
    rows = flange_rows(robot, False, THREE)
    kept = independent_geometry(rows, catalogue())
    every = [
        Slot("geometry", f"{part}{a}", place)
        for part, places in (("", [f"link{i + 1}" for i in range(6)]), ("r", [f"link{i + 1}" for i in range(6)]))
        for a in "xyz"
        for place in places
    ]
    rest = [s for s in every if s not in kept]

    def columns(slots: list[Slot] | tuple[Slot, ...]) -> np.ndarray:
        trial = fit_problem(rows, catalogue(), slots)
        jacobian = trial.residual(np.zeros(len(slots)))[1] * trial.sizes()
        return jacobian.reshape(-1, len(slots))

    basis = np.linalg.qr(columns(kept))[0]
    more = columns(rest)
    assert np.linalg.norm(more - basis @ (basis.T @ more)) < 1e-6 * np.linalg.norm(more)
    assert np.linalg.svd(columns(kept) / np.linalg.norm(columns(kept), axis=0), compute_uv=False)[-1] > 1e-5


def test_two_open_directions_of_two_parameters_are_said_once() -> None:
    slots = [Slot("backlash", "gap", f"joint{j}") for j in (1, 2, 3)]
    turn = np.array([[0.8, 0.6, 0.0], [-0.6, 0.8, 0.0], [0.0, 0.0, 1.0]])
    information = turn.T @ np.diag([0.1, 0.2, 50.0]) @ turn
    said = named_directions(information, np.ones(3), slots, np.eye(3), np.zeros(3, dtype=bool))
    assert said == ("backlash.gap@joint1 and backlash.gap@joint2: the data narrow the plausible range of none of them",)
    one = turn.T @ np.diag([0.1, 20.0, 50.0]) @ turn
    said = named_directions(one, np.ones(3), slots, np.eye(3), np.zeros(3, dtype=bool))
    assert said == ("backlash.gap@joint1 and backlash.gap@joint2: only a combination of them is known",)
