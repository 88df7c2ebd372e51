"""The detector on an eighth of a sphere, against the hidden truth of the virtual robot that the model is identified on.

    python benchmarks/detector_sphere.py [--robots 12] [--poses 200] [--no-effects]

The stated radius of 95 % is counted over the poses of one robot, whose errors all come from one fit: a handful of
directions in the parameters make nearly all of them. So even where the covariance is exactly right the share covered
differs from robot to robot; between which bounds is drawn from the covariance itself and printed beside it.

Each robot hides its geometry, springs, gaps and warm-up; a model is identified from its own campaign and asked for
joint angles; where the true arm then holds its detector is compared with where it was asked to be. Then once more with
each effect left out of the model, which is what that effect is worth.
"""

from __future__ import annotations

import argparse
import os
from dataclasses import dataclass, replace

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np

from clampid.identification.identify import identify
from clampid.models.model import Model
from clampid.stages.pose_rows import align
from experiments.campaign import Campaign
from experiments.simulate import measured_campaign
from experiments.virtual_robot import Hidden, Measured, measure
from experiments.virtual_robot.bodies import Bodies
from experiments.virtual_robot.drive import arm_at_rest
from experiments.virtual_robot.pose_tables import tracked_points
from kinematics.description import load_robot
from offline_ik.arm.identified import IdentifiedArm
from offline_ik.cell.cell import Cell, default_cell
from offline_ik.inverse.detector import Detector
from offline_ik.inverse.opening import open_detector
from offline_ik.inverse.uncertainty import Uncertainty

ROBOT = "kuka_kr20_r1810"
EFFECTS = ("geometry", "joint_compliance", "backlash", "gravity", "wrist_coupling_friction", "thermal_expansion")
R = 0.8  # m
HEIGHT = 0.12  # m, of the detector and of the tracked targets before the flange


@dataclass(frozen=True)
class Errors:
    """Of all poses: radial and tangential true errors and the stated 95 % radius, m, the rotation's error, rad, and
    stated standard deviations, m."""

    radial: np.ndarray
    tangential: np.ndarray
    radius95: np.ndarray
    angle: np.ndarray
    tangential_std: np.ndarray
    std: np.ndarray

    @property
    def size(self) -> np.ndarray:
        return np.hypot(self.radial, self.tangential)

    @property
    def covered(self) -> float:
        return float(np.mean(self.size <= self.radius95))


def measured_robot(seed: int, poses: int = 250) -> tuple[Measured, Campaign]:
    """A robot that warms up, and all that can be measured of it."""
    robot = load_robot(ROBOT)
    measured = measure(robot, [Hidden("thermal_expansion")], seed=seed, poses=poses)
    return measured, measured_campaign(measured, robot)


def identified(campaign: Campaign) -> Model:
    return identify([campaign], {"poses": EFFECTS})


def cell_of(campaign: Campaign, base: np.ndarray, link: np.ndarray, motor: np.ndarray) -> Cell:
    """The octant of the default cell, in the instrument's frame: there the truth is known."""
    usual = default_cell(campaign.robot)
    turn = base[:3, :3]
    convention = replace(
        usual.convention,
        beam=tuple((turn @ usual.convention.beam).tolist()),
        up=tuple((turn @ usual.convention.up).tolist()),
        sample=tuple((turn @ usual.convention.sample + base[:3, 3]).tolist()),
        frame="instrument",
    )
    mount = np.eye(4)
    mount[2, 3] = HEIGHT
    return replace(
        usual, convention=convention, mount=mount, gravity=tuple(campaign.gravity.tolist()), targets=campaign.targets,
        tool_mass=campaign.tool.mass, tool_com=tuple(campaign.tool.com.tolist()), link_temperature=link,
        motor_temperature=motor,
    )  # fmt: skip


def detector_of(model: Model, campaign: Campaign) -> Detector:
    """The model in its cell, at the temperatures of the campaign's last row."""
    last = campaign.tables["poses"].iloc[-1]
    n = campaign.robot.n
    link, motor = (np.array([last[f"temp_{k}{i + 1}_C"] for i in range(n)]) for k in ("link", "motor"))
    base = np.eye(4)
    first = open_detector(model, cell_of(campaign, base, link, motor))
    return Detector(first.arm, cell_of(campaign, first.arm.base, link, motor))


def octant(count: int, seed: int) -> np.ndarray:
    """(gamma, delta) ``(count, 2)``, even on an eighth of a sphere."""
    rng = np.random.default_rng(seed)
    return np.column_stack([rng.uniform(0, np.pi / 2, count), np.arcsin(rng.uniform(0, 1, count))])


def true_poses(measured: Measured, q: np.ndarray, direction: np.ndarray, link: np.ndarray) -> np.ndarray:
    """Where the true arm holds the detector ``(N, 4, 4)``, instrument frame, without its repeatability."""
    plant = measured.truth.plant
    bodies = Bodies(plant.geometry, plant.masses)
    arm, _ = arm_at_rest(plant, bodies, q, direction)
    points = tracked_points(plant, bodies, arm, np.tile(link, (len(q), 1)))
    nominal = np.array(list(measured.header["targets_m"].values()))
    mount = np.eye(4)
    mount[2, 3] = HEIGHT
    return np.array([align(nominal, seen) @ mount for seen in points])


def commanded(detector: Detector, angles: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[Uncertainty]]:
    """Targets, joint angles, directions of approach, one move after another; what cannot be reached is left out."""
    near, out = detector.rest + 0.1, []
    for gamma, delta in angles.tolist():
        answer = detector.locate(gamma, delta, R, near=near, direction="moved")
        if answer.reachable:
            first = answer.solutions[0]
            near = first.q
            out.append((answer.target, first.q, first.direction, first.uncertainty))
    targets, q, direction, stated = zip(*out, strict=True)
    return np.array(targets), np.array(q), np.array(direction), list(stated)


def errors(measured: Measured, detector: Detector, angles: np.ndarray) -> Errors:
    """Of the detector's commands on the true robot."""
    targets, q, direction, stated = commanded(detector, angles)
    assert detector.cell.link_temperature is not None
    there = true_poses(measured, q, np.where(direction == 0, 1.0, direction), detector.cell.link_temperature)
    off = there[:, :3, 3] - targets[:, :3, 3]
    radial = np.einsum("ni,ni->n", off, targets[:, :3, 2])
    turned = np.einsum("nji,njk->nik", targets[:, :3, :3], there[:, :3, :3])
    angle = np.arccos(np.clip((np.trace(turned, axis1=1, axis2=2) - 1) / 2, -1, 1))
    return Errors(
        np.abs(radial),
        np.linalg.norm(off - radial[:, None] * targets[:, :3, 2], axis=1),
        np.array([u.radius95_m for u in stated]),
        angle,
        np.array([u.tangential_m for u in stated]),
        np.array([u.std_m for u in stated]),
    )


@dataclass(frozen=True)
class Expected:
    """What the covariance says of one robot's poses: shares covered (5 %, median, 95 %), and degrees of freedom."""

    covered: np.ndarray
    freedom: float


def expected(detector: Detector, angles: np.ndarray, draws: int = 500) -> Expected:
    """The shares of poses that the stated radii cover on robots whose parameters are drawn from the covariance."""
    _, q, direction, stated = commanded(detector, angles)
    C = detector.propagation.covariance
    size = np.sqrt(np.diag(C)) + 1e-300
    values, vectors = np.linalg.eigh(C / np.outer(size, size))
    root = size[:, None] * vectors * np.sqrt(np.maximum(values, 0.0))
    J = np.array([
        detector.propagation.jacobian(at, replace(detector.still, direction=way))[0][:3] @ root
        for at, way in zip(q, direction, strict=True)
    ])  # fmt: skip
    power = np.linalg.svd(J.reshape(-1, J.shape[2]), compute_uv=False) ** 2
    drawn = np.random.default_rng(0).normal(size=(draws, J.shape[2])) @ J.reshape(-1, J.shape[2]).T
    radius = np.array([u.radius95_m for u in stated])
    inside = np.linalg.norm(drawn.reshape(draws, -1, 3), axis=2) <= radius
    return Expected(np.quantile(inside.mean(axis=1), [0.05, 0.5, 0.95]), float(power.sum() ** 2 / (power**2).sum()))


def nominal(arm: IdentifiedArm) -> IdentifiedArm:
    """The arm with nothing but its place in the room, and that of the targets on its flange, identified."""
    kept = [s.parameter.startswith(("base_", "target_")) for s in arm.slots]
    return arm.with_theta(np.where(kept, arm.theta, 0.0))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--robots", type=int, default=12)
    parser.add_argument("--poses", type=int, default=200)
    parser.add_argument("--first", type=int, default=0, help="seed of the first robot")
    parser.add_argument("--no-effects", action="store_true", help="do not leave out effect by effect")
    given = parser.parse_args()
    full: list[Errors] = []
    for seed in range(given.first, given.first + given.robots):
        measured, campaign = measured_robot(seed)
        detector = detector_of(identified(campaign), campaign)
        angles = octant(given.poses, seed)
        found = errors(measured, detector, angles)
        full.append(found)
        print(
            f"robot {seed}: {len(found.radial)} of {given.poses} reachable, tangential "
            f"{1e6 * found.tangential.mean():.0f} (stated {1e6 * found.tangential_std.mean():.0f}), radial "
            f"{1e6 * found.radial.mean():.0f} µm mean, {1e6 * found.angle.mean():.0f} µrad; 95 % covers "
            f"{100 * found.covered:.1f} %",
            flush=True,
        )
        share = expected(detector, angles)
        low, middle, high = (100 * share.covered).tolist()
        print(
            f"  of robots with this covariance it covers {low:.0f} to {high:.0f} %, median {middle:.0f} % "
            f"({share.freedom:.0f} degrees of freedom); true over stated rms "
            f"{np.sqrt(np.mean(found.size**2) / np.mean(found.std**2)):.2f}",
            flush=True,
        )
        if given.no_effects:
            continue
        variants = {f"without {e}": detector.arm.without(e) for e in EFFECTS if e != "geometry"}
        for name, arm in {**variants, "nominal": nominal(detector.arm)}.items():
            other = errors(measured, Detector(arm, detector.cell), angles)
            print(
                f"  {name}: tangential {1e6 * other.tangential.mean():.0f}, radial {1e6 * other.radial.mean():.0f} µm"
            )
    print(
        f"all: tangential {1e6 * np.mean([f.tangential.mean() for f in full]):.0f} µm, covers "
        f"{100 * np.mean([f.covered for f in full]):.1f} %"
    )


if __name__ == "__main__":
    main()
