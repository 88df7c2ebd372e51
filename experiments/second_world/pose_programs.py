"""
Programmes of measured poses: where the robot goes, from which side, how long it takes, and which targets are seen.

A programme is drawn on the nominal arm; what the controller commands is what it reports.
"""

from dataclasses import dataclass

import numpy as np

from experiments.second_world.arms import Arm
from experiments.second_world.arrays import Array, stream
from experiments.second_world.chain import Bend, forward
from experiments.second_world.individual import Robot
from experiments.second_world.inverse import reach
from experiments.second_world.states import Visits

__all__ = ["POSE_PROGRAMS", "PoseProgram", "run_poses"]


@dataclass(frozen=True)
class PoseProgram:
    """A programme of poses."""

    poses: int
    region: str  # "wide", "near" (about the home posture), "plane", "line"
    seconds: float  # median time of a visit
    targets: int  # how many of the robot's targets are measured at each visit
    both_sides: bool = False  # every pose is visited from both sides of every joint
    returns: int = 0  # how many of the poses are visited once more at the end
    out_and_back: bool = False
    cycles: int = 1  # how often the whole programme is run in the same order


POSE_PROGRAMS: dict[str, PoseProgram] = {
    "quick": PoseProgram(90, "wide", 7.0, 3, returns=10),
    "slow": PoseProgram(150, "wide", 45.0, 3, returns=20),
    "few": PoseProgram(40, "wide", 12.0, 3),
    "many": PoseProgram(320, "wide", 14.0, 3, returns=40),
    "two_sided": PoseProgram(90, "wide", 15.0, 3, both_sides=True),
    "cycles": PoseProgram(45, "wide", 10.0, 3, cycles=3),
    "near": PoseProgram(120, "near", 12.0, 4, returns=15),
    "plane": PoseProgram(110, "plane", 15.0, 3, both_sides=True),
    "line24": PoseProgram(24, "line", 75.0, 1, out_and_back=True),
}


def _wide(arm: Arm, count: int, rng: np.random.Generator, share: float, about: Array | None = None) -> Array:
    """Draw postures (count, n) with the flange above the floor and not inside the arm's own column."""
    low, high = np.clip(arm.limits(), -2.6, 2.6)
    middle = (low + high) / 2 if about is None else about
    half = share * (high - low) / 2
    length = sum(float(np.linalg.norm(j.xyz_m)) for j in arm.joints[2:])
    kept: list[Array] = []
    while len(kept) < count:
        q = np.clip(middle + half * rng.uniform(-1, 1, (400, arm.n)), low, high)
        f = forward(arm, q, Bend.none(*q.shape))
        out = np.hypot(f.flange_m[:, 0], f.flange_m[:, 1])
        kept += list(q[(f.flange_m[:, 2] > 0.12 * length) & (out > 0.3 * length)])
    return np.array(kept[:count])


def _straight(robot: Robot, program: PoseProgram, rng: np.random.Generator, place: np.random.Generator) -> Array:
    """Postures (poses, n) with the first target on a line or a plane through its place at the home posture."""
    arm, target = robot.nominal, robot.nominal_targets_m[0]
    f = forward(arm, arm.home_rad[None], Bend.none(1, arm.n))
    centre = (f.flange_m + f.flange @ target)[0]
    length = sum(float(np.linalg.norm(j.xyz_m)) for j in arm.joints[2:])
    yaw = place.uniform(-0.6, 0.6) + np.pi / 2
    along = np.array([np.cos(yaw), np.sin(yaw), 0.15 * place.standard_normal()])
    for size in 0.9 * length * 0.8 ** np.arange(12):
        if program.region == "line":
            places = centre + np.linspace(-0.5, 0.5, program.poses)[:, None] * size * along
        else:
            up = np.array([0.3 * np.sin(yaw), -0.3 * np.cos(yaw), 1.0])
            u = size * rng.uniform(-0.5, 0.5, (program.poses, 2))
            places = centre + u[:, :1] * along + u[:, 1:] * up
        q = reach(arm, target, places, arm.home_rad)
        f = forward(arm, q, Bend.none(*q.shape))
        if np.abs(f.flange_m + f.flange @ target - places).max() < 1e-3:
            return q
    raise ValueError(f"robot {arm.name}: no {program.region} about its home posture is within reach")


def _postures(robot: Robot, program: PoseProgram, rng: np.random.Generator, place: np.random.Generator) -> Array:
    if program.region == "wide":
        return _wide(robot.nominal, program.poses, rng, 0.85)
    if program.region == "near":
        return _wide(robot.nominal, program.poses, rng, 0.28, robot.nominal.home_rad)
    return _straight(robot, program, rng, place)


def _order(program: PoseProgram, rng: np.random.Generator) -> tuple[Array, Array]:
    """Order of the visits: pose numbers (N,) and counts of visits (N,)."""
    first = np.arange(program.poses)
    if program.out_and_back:
        return np.concatenate([first, first[::-1]]), np.repeat([0, 1], program.poses)
    if program.both_sides:
        return np.repeat(first, 2), np.tile([0, 1], program.poses)
    if program.cycles > 1:
        return np.tile(first, program.cycles), np.repeat(np.arange(program.cycles), program.poses)
    again = np.sort(rng.choice(program.poses, program.returns, replace=False))
    return np.concatenate([first, again]), np.repeat([0, 1], [program.poses, program.returns])


def run_poses(robot: Robot, program: PoseProgram, seed: int, label: str, start_s: float, first_pose: int) -> Visits:
    """
    Run a programme of poses.

    Parameters
    ----------
    robot, program
        Who does what.
    seed, label
        Where the random choices come from.
    start_s
        Time of the table's clock at which it begins; the robot has worked since time 0.
    first_pose
        Number of the first pose.

    Returns
    -------
    Visits
        In the order of time.
    """
    rng = stream(seed, f"poses {label}")
    postures = _postures(robot, program, rng, stream(seed, "line or plane"))  # the same for every table
    pose, visit = _order(program, rng)
    q = postures[pose]
    if program.both_sides:
        side = rng.choice([-1.0, 1.0], (program.poses, robot.n))[pose] * np.where(visit == 0, 1.0, -1.0)[:, None]
        travel = side * rng.uniform(0.04, 0.25, q.shape)
    else:
        before = np.vstack([q[:1] - 0.2 * rng.choice([-1.0, 1.0], (1, robot.n)), q[:-1]])
        travel = q - before
        for k in range(1, len(q)):  # a joint that stood still keeps its last motion
            travel[k] = np.where(np.abs(travel[k]) < 1e-9, travel[k - 1], travel[k])
    time = start_s + np.cumsum(program.seconds * np.exp(0.15 * rng.standard_normal(len(q))))
    climate = robot.climate
    return Visits(
        pose=(pose + first_pose).astype(float),
        visit=visit.astype(float),
        time_s=time,
        q=q,
        dirs=np.sign(travel),
        travel_rad=travel,
        speed=rng.choice([0.2, 0.5, 1.0], len(q)),
        link_temps_C=climate.links(time, time),
        ambient_C=climate.ambient(time),
    )
