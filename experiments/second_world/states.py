"""The variables of an effect: the state of the robot at each visit of a pose, and at each sample of a log."""

from collections.abc import Callable
from dataclasses import dataclass

from experiments.second_world.arrays import Array
from experiments.second_world.chain import Bend, Frames, Loads
from experiments.second_world.individual import Robot

__all__ = ["BendLaw", "LogState", "PoseState", "ReadingLaw", "TorqueLaw", "Visits"]


@dataclass(frozen=True)
class Visits:
    """The visits of a pose programme, in order; N of them."""

    pose: Array  # (N,) numbers of the poses
    visit: Array  # (N,) count of returns to that pose
    time_s: Array  # (N,)
    q: Array  # (N, n) rad, commanded
    dirs: Array  # (N, n) +1 or −1: sign of each joint's last motion
    travel_rad: Array  # (N, n) signed length of that last motion
    speed: Array  # (N,) of the approach, as a share of full speed
    link_temps_C: Array  # (N, n) as sensors on the links' surfaces read
    ambient_C: Array  # (N,)


@dataclass(frozen=True)
class PoseState:
    """A robot at rest at each visit, with the loads in its deflected posture."""

    robot: Robot
    visits: Visits
    frames: Frames
    loads: Loads


@dataclass(frozen=True)
class LogState:
    """A robot in motion at each of S samples."""

    robot: Robot
    time_s: Array  # (S,)
    work_s: Array  # (S,) how long it has worked since it was cold
    q: Array  # (S, n) rad
    qd: Array  # (S, n) rad/s
    qdd: Array  # (S, n) rad/s²
    direction: Array  # (S, n) smooth sign of motion
    load_Nm: Array  # (S, n) torque that the gears transmit
    motor_temps_C: Array  # (S, n)
    ambient_C: Array  # (S,)


BendLaw = Callable[[PoseState], Bend]
ReadingLaw = Callable[[Array, Array], Array]  # points (M, 3) in the instrument's frame, times (M,) -> error (M, 3), m
TorqueLaw = Callable[[LogState], Array]  # added torque (S, n), Nm
