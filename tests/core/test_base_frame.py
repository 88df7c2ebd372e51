"""The base from circles: exact where nothing gives way, biased where springs do, right again with the correction."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from circle_arms import ROBOT, circle_campaign, known_drives, stiff

from clampid.base_frames.base_frame import base_from_circles
from clampid.identification.identify import identify
from clampid.models.model import ModelError, StageModel
from clampid.slots import Slot
from experiments.campaign import Campaign, CampaignError, Instrument, Tool
from kinematics.description import load_robot
from kinematics.poe import forward
from kinematics.robot import RobotDescription
from kinematics.screws import exp_se3, exp_so3, inverse, log_se3

TARGETS = {"T1": np.array([0.1, 0.0, 0.12]), "T2": np.array([-0.05, 0.09, 0.12])}
WHERE = exp_se3(np.array([0.3, -0.2, 1.9, 2.0, -1.0, 0.4]))


def campaign_of(
    robot: RobotDescription, q: np.ndarray, points: dict[str, np.ndarray], nominal: RobotDescription | None = None
) -> Campaign:
    frames = []
    for name, p in points.items():
        frame = pd.DataFrame({f"q{i + 1}_rad": q[:, i] for i in range(robot.n)})
        frame[[f"dir{i + 1}" for i in range(robot.n)]] = 1
        frame[["x_m", "y_m", "z_m"]] = p
        frame["pose"], frame["visit"], frame["time_s"] = np.arange(1, len(q) + 1), 1, 10.0 * np.arange(len(q))
        frames.append(frame.assign(target=name))
    return Campaign(
        "circles", None, nominal or robot, np.array([0, 0, -9.81]), Tool(0.0, np.zeros(3)), TARGETS,
        Instrument("none", 1e-5, None), {"poses": pd.concat(frames, ignore_index=True)}, "0" * 64,
    )  # fmt: skip


def turned(robot: RobotDescription, azimuth: float = 0.0) -> np.ndarray:
    """Joint 1 turned from one posture, joint 2 from another."""
    q = np.tile([0.2, -1.0, 1.2, 0.1, 0.3, 0.2][: robot.n], (20, 1))
    q[:10, 0], q[10:, 1] = np.linspace(-2, 2, 10), np.linspace(-2, 0.4, 10)
    q[10:, 0] = azimuth
    return q


def measured(robot: RobotDescription, q: np.ndarray) -> dict[str, np.ndarray]:
    pose = WHERE @ forward(robot.screws, robot.flange, q)
    return {name: pose[:, :3, :3] @ t + pose[:, :3, 3] for name, t in TARGETS.items()}


@pytest.mark.parametrize("name", [ROBOT, "abb_irb4600_40_255", "staubli_tx40", "ur10"])
def test_a_rigid_robot_gives_its_base_exactly(name: str) -> None:
    robot = load_robot(name)
    q = turned(robot, azimuth=0.7)
    found = base_from_circles(campaign_of(robot, q, measured(robot, q)), rigid=True)
    np.testing.assert_allclose(found.base, WHERE, atol=1e-9)
    np.testing.assert_allclose(found.between, 0.0, atol=1e-9)
    assert found.rms < 1e-10
    listed = [(c.joint, c.target, len(c.rows)) for c in found.circles]
    assert listed == [(j, t, 10) for j in (0, 1) for t in ("T1", "T2")]


def test_angle_and_distance_of_the_two_axes_are_this_robots_own() -> None:
    robot = load_robot(ROBOT)
    tilt, apart = 2e-3, -7e-4
    normal = np.array([1.0, 0.0, 0.0])  # from axis 1 to axis 2, which it meets at the point given
    second = replace(
        robot.joints[1],
        axis=exp_so3(tilt * np.cross(robot.joints[0].axis, robot.joints[1].axis)) @ robot.joints[1].axis,
        point=robot.joints[1].point + apart * normal,
    )
    real = replace(robot, joints=(robot.joints[0], second, *robot.joints[2:]), dh=None)
    q = turned(real, azimuth=-0.4)
    found = base_from_circles(campaign_of(real, q, measured(real, q), nominal=robot), rigid=True)
    np.testing.assert_allclose(found.base, WHERE, atol=1e-9)
    # The common normal may point either way; the description says which.
    sign = np.sign(np.cross(robot.joints[0].axis, robot.joints[1].axis) @ normal)
    np.testing.assert_allclose(found.between, [tilt, sign * apart], atol=1e-9)


def test_errors_of_the_angle_that_turns_move_points_along_their_circle_only() -> None:
    robot = load_robot(ROBOT)
    q = turned(robot)
    true = q.copy()
    true[10:, 1] += 2e-3 * np.sin(3 * q[10:, 1])
    true[:10, 0] += 1e-3 * np.cos(5 * q[:10, 0])
    found = base_from_circles(campaign_of(robot, q, measured(robot, true)), rigid=True)
    np.testing.assert_allclose(found.base, WHERE, atol=1e-9)


def test_a_point_on_no_circle_is_left_out_and_listed() -> None:
    robot = load_robot(ROBOT)
    q = turned(robot)
    points = measured(robot, q)
    rng = np.random.default_rng(0)
    points = {name: p + 1e-5 * rng.standard_normal(p.shape) for name, p in points.items()}
    points["T2"][13] += [0.0, 3e-3, 2e-3]
    found = base_from_circles(campaign_of(robot, q, points), rigid=True)
    assert found.outliers == (34,)
    assert np.linalg.norm(log_se3(inverse(WHERE) @ found.base)[3:]) < 5e-5


@pytest.mark.slow
def test_deflection_lowers_the_base_and_the_correction_puts_it_back() -> None:
    """Half a millimetre and more without, within its interval with: the virtual robot's physics against the model's."""
    pulls, inside, low = [], [], []
    for seed in range(5):
        campaign, plant = circle_campaign(seed)
        unbent, _ = circle_campaign(seed, stiff, noise=1)
        truth = base_from_circles(unbent, rigid=True)
        found = base_from_circles(campaign, known_drives(plant, seed))
        plain = base_from_circles(campaign, rigid=True)
        assert abs(found.bias[5]) > 4 * found.std[5]
        np.testing.assert_allclose(plain.base, found.base @ exp_se3(found.bias), atol=1e-9)
        low.append(log_se3(inverse(truth.base) @ plain.base)[5])
        off = log_se3(inverse(truth.base) @ found.base)
        both = np.sqrt(found.std[:6] ** 2 + truth.std[:6] ** 2)
        pulls.append(off / both)
        inside.append(np.abs(off) <= found.interval()[:6] / found.std[:6] * both)
    assert max(low) < -4e-4
    # 30 numbers, about four of them a robot's own: their mean square is 1 within 2 standard errors of chi-square / 20.
    assert np.mean(np.square(pulls)) == pytest.approx(1.0, abs=0.65)
    assert np.mean(inside) > 0.8


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_springs_identified_from_torques_put_the_base_right(seed: int, simulated: Callable[..., Campaign]) -> None:
    model = identify(simulated(seed=seed, tables=("free_air", "wrist", "clamped")))
    campaign, _ = circle_campaign(seed)
    unbent, _ = circle_campaign(seed, stiff, noise=1)
    truth, found = base_from_circles(unbent, rigid=True), base_from_circles(campaign, model)
    off = log_se3(inverse(truth.base) @ found.base)
    both = np.sqrt(found.std[:6] ** 2 + truth.std[:6] ** 2)
    assert np.abs(off / both).max() < 3.5
    assert np.linalg.norm(off[3:]) < 0.15 * np.linalg.norm(found.bias[3:])


def test_springs_that_are_not_known_well_are_counted() -> None:
    campaign, plant = circle_campaign(1)
    sure, unsure = (base_from_circles(campaign, known_drives(plant, 1, relative)) for relative in (0.001, 0.1))
    # Springs a tenth off put the base off by up to a tenth of what they bend, less because they are off independently.
    by_springs = np.sqrt(unsure.std[5] ** 2 - sure.std[5] ** 2)
    assert 0.03 < by_springs / abs(unsure.bias[5]) < 0.11
    # Axis 1 is upright: the weight turns nothing about it, and what springs are says nothing of where it is.
    np.testing.assert_allclose(unsure.std[3:5], sure.std[3:5], rtol=0.1)


def test_a_stage_of_poses_serves_as_well_and_its_geometry_is_left_out() -> None:
    campaign, plant = circle_campaign(2)
    model = known_drives(plant, 2)
    parts = list(model.stages.values())
    moved = Slot("geometry", "z", "link2")
    merged = StageModel(
        "poses",
        tuple(t for part in parts for t in part.terms),
        (*(s for part in parts for s in part.slots), moved),
        np.concatenate([*(part.theta for part in parts), [1e-3]]),
        np.diag(np.concatenate([*(np.diag(part.covariance) for part in parts), [1e-6]])),
        (True,) * (sum(len(part.slots) for part in parts) + 1),
    )
    apart = base_from_circles(campaign, model)
    found = base_from_circles(campaign, replace(model, stages={"poses": merged}))
    np.testing.assert_allclose(found.base, apart.base, atol=1e-12)
    np.testing.assert_allclose(found.std, apart.std, rtol=1e-6)
    assert "poses" in found.springs


def test_the_description_serves_where_there_is_no_model() -> None:
    campaign, _ = circle_campaign(1)
    found, plain = base_from_circles(campaign), base_from_circles(campaign, rigid=True)
    assert "description" in found.springs
    assert found.rms < plain.rms
    assert found.bias[5] < -4e-4
    assert plain.deflection == 0.0


def test_what_cannot_be_is_refused() -> None:
    campaign, plant = circle_campaign(1)
    table = campaign.tables["poses"]
    first = replace(campaign, tables={"poses": table[table["pose"] <= 28]})
    with pytest.raises(CampaignError, match=r"5 poses or more .* found none of joint 2"):
        base_from_circles(first)
    with pytest.raises(CampaignError, match="expected a table poses"):
        base_from_circles(replace(campaign, tables={}))
    model = known_drives(plant, 1)
    with pytest.raises(ModelError, match="robot ur10"):
        base_from_circles(campaign, replace(model, robot="ur10"))
    with pytest.raises(ModelError, match="expected a model with joint_compliance"):
        base_from_circles(campaign, replace(model, stages={"free_air": model.stages["free_air"]}))
    arm = load_robot("kuka_kr16_2")
    q = turned(arm)
    with pytest.raises(ModelError, match=r"no springs or no masses.*--rigid"):
        base_from_circles(campaign_of(arm, q, measured(arm, q)))


def test_points_on_no_circles_are_refused_soon() -> None:
    robot = load_robot("ur10")
    q, rng = turned(robot), np.random.default_rng(0)
    points = measured(robot, q)
    flat = {name: np.c_[p[:, :2], np.full(len(p), 3.0)] for name, p in points.items()}
    with pytest.raises(CampaignError, match="on which no base settles"):
        base_from_circles(campaign_of(robot, q, flat), rigid=True)
    anywhere = {name: p + rng.uniform(-0.4, 0.4, p.shape) for name, p in points.items()}
    with pytest.raises(CampaignError, match=r"found points \d+ mm \(rms\) off any"):
        base_from_circles(campaign_of(robot, q, anywhere), rigid=True)
