"""The cell: convention, mount of the detector, what the flange carries, temperatures, obstacles. One TOML file.

Everything that a model does not know and a detector position depends on is here, and nothing of it is assumed silently:
what a cell file does not say is taken from :func:`default_cell` and listed in ``assumed``.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, cast

import numpy as np
import numpy.typing as npt

from kinematics.collision.bodies import CLEARANCE, WorldDescription, carried_box
from kinematics.collision.obstacles import Obstacle, pose_of
from kinematics.collision.reading import LARGEST_TOOL, open_cell, world_in
from kinematics.gravity import STANDARD_GRAVITY
from kinematics.robot import RobotDescription
from kinematics.section import Section
from offline_ik.cell.cell_defaults import assumed_of
from offline_ik.cell.cell_values import COLDEST, HOTTEST, spread
from offline_ik.cell.coordinates import CONVENTIONS, Convention
from offline_ik.errors import CellError

__all__ = ["LONGEST_TIME", "Cell", "default_cell", "read_cell"]

Array = npt.NDArray[np.float64]

PIXEL = 55e-6  # m, of the reference robot's detector
# What the cell file's numbers may be at most: wide of anything real, short of other units.
CELL, HALL = 10.0, 100.0  # m: around a robot; around an instrument
LARGEST_PIXEL = 0.01  # m
MOST_PIXELS = 100_000  # along an edge
LARGEST_MARGIN = 0.5  # rad
HEAVIEST = 2000.0  # kg
LONGEST_TIME = 1e8  # s, three years
WEAKEST, STRONGEST = 9.0, 10.6  # m/s², of gravity


@dataclass(frozen=True)
class Cell:
    """Where a robot holds which detector about which sample, among which obstacles.

    Attributes
    ----------
    mount
        ``(4, 4)``: the detector in the flange's frame; z is its normal, origin its middle.
    targets
        Names and nominal positions ``(3,)``, flange frame, of tracked points that are fixed to the detector. With three
        or more the mount follows their identified positions.
    size
        Edges of the detector's box (x, y across, z behind its plane), m; none if None.
    pixels
        Rows and columns of the detector's pixels; None: nobody says.
    tool_mass, tool_com
        What the flange carries, kg and ``(3,)`` m, flange frame; None: as the model's session declared it, at the
        flange.
    link_temperature, motor_temperature
        ``(n,)`` °C, or None: 20.
    running
        For how long the robot has been running, s; None: nobody says, and it counts as 0, the first row of a campaign.
    clearance
        Least distance between shapes, m.
    limit_margin
        Kept from joint limits, rad.
    speed
        Share of the joints' greatest speeds.
    assumed
        What nobody said.
    """

    robot: str
    convention: Convention
    mount: Array
    gravity: tuple[float, float, float] = STANDARD_GRAVITY
    session: int = 0
    targets: Mapping[str, Array] = field(default_factory=dict)
    size: tuple[float, float, float] | None = None
    pixel: float = PIXEL
    pixels: tuple[int, int] | None = None
    tool_mass: float | None = None
    tool_com: tuple[float, float, float] = (0.0, 0.0, 0.0)
    link_temperature: Array | None = None
    motor_temperature: Array | None = None
    running: float | None = None
    radius: Array | None = None
    base_radius: float | None = None
    clearance: float = CLEARANCE
    limit_margin: float = 0.0
    speed: float = 0.3
    obstacles: tuple[Obstacle, ...] = ()
    assumed: tuple[str, ...] = ()

    @property
    def world(self) -> WorldDescription:
        """What stands around the robot, how thick its links are, and the detector's body."""
        carried = None if self.size is None else carried_box(self.size, self.mount)
        return WorldDescription(self.obstacles, self.base_radius, self.radius, self.clearance, carried)

    def to_json(self) -> dict[str, Any]:
        """What a result must say about the cell beside its convention."""
        return {
            "robot": self.robot,
            "session": self.session + 1,
            "mount": np.asarray(self.mount).tolist(),
            "targets_m": {name: np.asarray(p).tolist() for name, p in self.targets.items()},
            "pixel_m": self.pixel,
            "pixels": self.pixels,
            "gravity_m_s2": list(self.gravity),
            "tool_mass_kg": self.tool_mass,
            "tool_com_m": list(self.tool_com),
            "running_s": self.running or 0.0,
            "obstacles": [o.name for o in self.obstacles],
            "clearance_m": self.clearance,
            "assumed": list(self.assumed),
        }


def default_cell(robot: RobotDescription) -> Cell:
    """A cell for a robot of which nothing is said: a placeholder, marked as such.

    The robot stands behind the detector, which looks back at a sample in front of it: the octant gamma, delta from 0 to
    90° lies in its reach, for r from a third to half of that.
    """
    reach = robot.reach
    shoulder = np.asarray(robot.joints[1].point)
    sample = tuple(np.round(np.array([DEFAULT_X, DEFAULT_Y, DEFAULT_Z]) * reach + [0, 0, shoulder[2]], 3).tolist())
    beam = (math.cos(DEFAULT_AZIMUTH), math.sin(DEFAULT_AZIMUTH), 0.0)
    convention = replace(CONVENTIONS["thesis"], beam=beam, sample=cast(tuple[float, float, float], sample))
    return Cell(robot.name, convention, np.eye(4), assumed=assumed_of({}, robot))


DEFAULT_X, DEFAULT_Y, DEFAULT_Z = 0.8, 0.0, -0.3  # of the reach, from the foot of axis 1 at the shoulder's height
DEFAULT_AZIMUTH = 0.75 * math.pi  # so that the middle of the octant looks at the robot


def read_cell(path: str | Path, robot: RobotDescription) -> Cell:
    """Read a cell file.

    Parameters
    ----------
    robot
        The model's robot, which the cell must be of.

    Raises
    ------
    CellError
        The file is not there, no TOML, has unknown keys or values that cannot be meant, or is of another robot.
    """
    path = Path(path)
    return _cell(open_cell(path, robot, "model", CellError), robot, path.parent)


def _cell(at: Section, robot: RobotDescription, folder: Path) -> Cell:
    detector, tool, heat, safety, shape, convention = (
        at.section(k, optional=True) for k in ("detector", "tool", "temperature", "safety", "robot_shape", "convention")
    )
    cell, n = default_cell(robot), robot.n
    world = world_in(at, detector, shape, safety, n, folder)
    out = replace(
        cell,
        convention=_convention(convention, cell.convention),
        mount=pose_of(detector, LARGEST_TOOL),
        gravity=_gravity(at, cell.gravity),
        session=at.integer("session", default=1) - 1,
        targets=_targets(detector),
        size=_three(detector.vector("size_m", default=None)),
        pixel=detector.number("pixel_m", 0.0, LARGEST_PIXEL, "m", PIXEL, above=True),
        pixels=_pixels(detector),
        tool_mass=tool.number("mass_kg", 0.0, HEAVIEST, "kg", None),
        tool_com=_three(tool.vector("com_m", 3, -LARGEST_TOOL, LARGEST_TOOL, "m", np.zeros(3))),
        link_temperature=heat.vector("link_C", n, COLDEST, HOTTEST, "°C", None),
        motor_temperature=heat.vector("motor_C", n, COLDEST, HOTTEST, "°C", None),
        running=heat.number("running_s", 0.0, LONGEST_TIME, "s", None),
        radius=world.link_radii,
        base_radius=world.base_radius,
        clearance=world.clearance,
        limit_margin=_limit_margin(safety, robot),
        speed=safety.number("speed", 0.0, 1.0, "", cell.speed, above=True),
        obstacles=world.obstacles,
        assumed=assumed_of(at.content, robot),
    )
    for section in (detector, tool, heat, safety, shape, convention, at):
        section.done()
    return out


def _pixels(detector: Section) -> tuple[int, int] | None:
    found = detector.vector("pixels", 2, 1, MOST_PIXELS, "", None)
    if found is None:
        return None
    rows, columns = found.tolist()
    if rows != round(rows) or columns != round(columns):
        raise detector.fault("pixels", "two whole numbers, rows and columns", repr(found.tolist()))
    return int(rows), int(columns)


def _three(found: Array | None) -> Any:
    return None if found is None else tuple(found.tolist())


def _gravity(at: Section, default: tuple[float, float, float]) -> Any:
    found = at.vector("gravity_m_s2", default=np.array(default))
    length = float(np.linalg.norm(found))
    if not WEAKEST < length < STRONGEST:
        raise at.fault("gravity_m_s2", "a vector of about 9.81 m/s2", f"{found.tolist()}, that is {length:g}")
    return _three(found)


def _targets(detector: Section) -> Mapping[str, Array]:
    at = detector.section("targets_m", optional=True)
    return spread(at, {name: at.vector(name, 3, -LARGEST_TOOL, LARGEST_TOOL, "m") for name in at.keys()})  # noqa: SIM118 - no dict


def _limit_margin(safety: Section, robot: RobotDescription) -> float:
    margin = float(safety.number("limit_margin_rad", 0.0, LARGEST_MARGIN, "rad", 0.0))
    for joint in robot.joints:
        if not joint.upper - joint.lower > 2 * margin:
            found = f"{margin:g} rad on both sides, which leave {joint.name} no range"
            raise safety.fault("limit_margin_rad", "less than half of each joint's range", found)
    return margin


def _convention(at: Section, default: Convention) -> Convention:
    named = CONVENTIONS[at.text("name", tuple(CONVENTIONS), default.name)]
    frame = at.text("frame", ("base", "instrument"), named.frame)
    most = CELL if frame == "base" else HALL
    return replace(
        named,
        order=at.text("order", ("gamma_outer", "delta_outer"), named.order),
        gamma_sign=at.integer("gamma_sign", -1, 1, named.gamma_sign),
        delta_sign=at.integer("delta_sign", -1, 1, named.delta_sign),
        beam=_three(at.vector("beam", default=np.array(default.beam))),
        up=_three(at.vector("up", default=np.array(named.up))),
        sample=_three(at.vector("sample_m", 3, -most, most, "m", np.array(default.sample))),
        frame=frame,
    )
