"""The cell: convention, mount of the detector, what the flange carries, temperatures, obstacles. One TOML file.

Everything that a model does not know and a detector position depends on is here, and nothing of it is assumed silently:
what a cell file does not say is taken from :func:`default_cell` and listed in ``assumed``.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal, cast

import numpy as np
import numpy.typing as npt

from kinematics.gravity import STANDARD_GRAVITY
from kinematics.reading import read_text, toml_of
from kinematics.robot import RobotDescription
from offline_ik.cell_defaults import assumed_of
from offline_ik.cell_values import known, number, numbers, positive, sizes, spread, switch, temperatures, text, whole
from offline_ik.coordinates import CONVENTIONS, Convention
from offline_ik.errors import CellError

__all__ = ["FORMAT", "LONGEST", "Cell", "Obstacle", "default_cell", "read_cell"]

Array = npt.NDArray[np.float64]
Shape = Literal["box", "cylinder", "sphere", "capsule", "mesh"]

FORMAT = "clampid-cell/1"
PIXEL = 55e-6  # m, of the reference robot's detector
# What the cell file's numbers may be at most: wide of anything real, short of other units.
HAND = 3.0  # m: what a flange carries, how far it sticks out, a link's radius
CELL, HALL = 10.0, 100.0  # m: around a robot; around an instrument, and obstacles
WIDEST = 1.0  # m, of a clearance
LARGEST_PIXEL = 0.01  # m
LARGEST_MARGIN = 0.5  # rad
HEAVIEST = 2000.0  # kg
LONGEST = 1e8  # s, three years
WEAKEST, STRONGEST = 9.0, 10.6  # m/s², of gravity
SHAPES: Mapping[Shape, int] = {"box": 3, "cylinder": 2, "sphere": 1, "capsule": 2, "mesh": 0}
_KEYS = {
    "": ("format", "robot", "session", "gravity_m_s2", "convention", "detector", "tool", "temperature", "robot_shape",
         "safety", "obstacle"),
    "convention": ("name", "order", "gamma_sign", "delta_sign", "beam", "up", "sample_m", "frame"),
    "detector": ("position_m", "x", "z", "size_m", "pixel_m", "targets_m"),
    "tool": ("mass_kg", "com_m"),
    "temperature": ("link_C", "motor_C", "running_s"),
    "robot_shape": ("radius_m", "base_radius_m"),
    "safety": ("clearance_m", "limit_margin_rad", "speed"),
    "obstacle": ("name", "shape", "size_m", "position_m", "x", "z", "file", "holds_sample"),
}  # fmt: skip


@dataclass(frozen=True)
class Obstacle:
    """A thing in the robot's way.

    Attributes
    ----------
    size
        m. Box: x, y, z edges; cylinder and capsule: radius, length along z; sphere: radius; mesh: none.
    pose
        ``(4, 4)``: its middle in the robot's base frame.
    file
        Of a mesh (STL, OBJ, DAE; m).
    holds_sample
        The sample may lie inside (a cryostat's shroud, a stage drawn as one box).
    """

    name: str
    shape: Shape
    size: tuple[float, ...]
    pose: Array
    file: Path | None = None
    holds_sample: bool = False


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
    tool_mass: float | None = None
    tool_com: tuple[float, float, float] = (0.0, 0.0, 0.0)
    link_temperature: Array | None = None
    motor_temperature: Array | None = None
    running: float | None = None
    radius: Array | None = None
    base_radius: float | None = None
    clearance: float = 0.02
    limit_margin: float = 0.0
    speed: float = 0.3
    obstacles: tuple[Obstacle, ...] = ()
    assumed: tuple[str, ...] = ()

    def to_json(self) -> dict[str, Any]:
        """What a result must say about the cell beside its convention."""
        return {
            "robot": self.robot,
            "session": self.session + 1,
            "mount": np.asarray(self.mount).tolist(),
            "targets_m": {name: np.asarray(p).tolist() for name, p in self.targets.items()},
            "pixel_m": self.pixel,
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
    try:
        table = toml_of(read_text(path))
    except FileNotFoundError:
        raise CellError(f"{path}: expected a cell file, found none") from None
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise CellError(f"{path}: expected a cell as TOML, found: {error}") from error
    try:
        return _cell(table, robot, path.parent)
    except CellError as error:
        raise CellError(f"{path}: {error}") from None


def _cell(table: Mapping[str, Any], robot: RobotDescription, folder: Path) -> Cell:
    known("", table, _KEYS[""])
    if table.get("format") != FORMAT:
        raise CellError(f"format: expected {FORMAT!r}, found {table.get('format')!r}")
    if table.get("robot") != robot.name:
        raise CellError(f"robot: the model is of {robot.name!r}, the cell of {table.get('robot')!r}")
    parts = {k: known(k, table.get(k, {}), keys) for k, keys in _KEYS.items() if k not in ("", "obstacle")}
    detector, tool, heat, safety = (parts[k] for k in ("detector", "tool", "temperature", "safety"))
    shape, cell, n = parts["robot_shape"], default_cell(robot), robot.n
    size = sizes("detector.size_m", detector["size_m"], 3, HAND) if "size_m" in detector else None
    return replace(
        cell,
        convention=_convention(parts["convention"], cell.convention),
        mount=_pose("detector", detector, HAND),
        gravity=_gravity(table["gravity_m_s2"]) if "gravity_m_s2" in table else cell.gravity,
        session=whole("session", table.get("session", 1)) - 1,
        targets=_targets(detector.get("targets_m", {})),
        size=None if size is None else (float(size[0]), float(size[1]), float(size[2])),
        pixel=positive("detector.pixel_m", detector.get("pixel_m", PIXEL), LARGEST_PIXEL, "metres"),
        tool_mass=number("tool.mass_kg", tool["mass_kg"], HEAVIEST, "kilograms") if "mass_kg" in tool else None,
        tool_com=_tool_com(tool.get("com_m", [0.0, 0.0, 0.0])),
        link_temperature=temperatures("temperature.link_C", heat["link_C"], n) if "link_C" in heat else None,
        motor_temperature=temperatures("temperature.motor_C", heat["motor_C"], n) if "motor_C" in heat else None,
        running=number("temperature.running_s", heat["running_s"], LONGEST, "seconds") if "running_s" in heat else None,
        radius=sizes("robot_shape.radius_m", shape["radius_m"], n, HAND) if "radius_m" in shape else None,
        base_radius=_base_radius(shape),
        clearance=number("safety.clearance_m", safety.get("clearance_m", cell.clearance), WIDEST, "metres"),
        limit_margin=_limit_margin(safety.get("limit_margin_rad", 0.0), robot),
        speed=positive("safety.speed", safety.get("speed", cell.speed), 1.0, "a share of the greatest speeds"),
        obstacles=_obstacles(table.get("obstacle", []), folder),
        assumed=assumed_of(table, robot),
    )


def _tool_com(value: Any) -> tuple[float, float, float]:
    x, y, z = numbers("tool.com_m", value, 3, HAND, "metres").tolist()
    return x, y, z


def _gravity(value: Any) -> tuple[float, float, float]:
    x, y, z = numbers("gravity_m_s2", value, 3).tolist()
    length = math.hypot(x, y, z)
    if not WEAKEST < length < STRONGEST:
        raise CellError(f"gravity_m_s2: expected a vector of about 9.81 m/s2, found {value!r}, that is {length:g}")
    return x, y, z


def _targets(value: Any) -> Mapping[str, Array]:
    if not isinstance(value, Mapping):
        raise CellError(f"detector.targets_m: expected a table NAME = [x, y, z], found {value!r}")
    points = {k: numbers(f"detector.targets_m.{k}", v, 3, HAND, "metres") for k, v in value.items()}
    return spread("detector.targets_m", points)


def _base_radius(shape: Mapping[str, Any]) -> float | None:
    if "base_radius_m" not in shape:
        return None
    return positive("robot_shape.base_radius_m", shape["base_radius_m"], HAND, "metres")


def _limit_margin(value: Any, robot: RobotDescription) -> float:
    margin = number("safety.limit_margin_rad", value, LARGEST_MARGIN, "radians")
    for joint in robot.joints:
        if not joint.upper - joint.lower > 2 * margin:
            raise CellError(f"safety.limit_margin_rad: {margin:g} rad on both sides leave {joint.name} no range")
    return margin


def _obstacles(value: Any, folder: Path) -> tuple[Obstacle, ...]:
    if not isinstance(value, list):
        raise CellError(f"obstacle: expected tables [[obstacle]], found {value!r}")
    out = tuple(_obstacle(k + 1, part, folder) for k, part in enumerate(value))
    names = [o.name for o in out]
    for name in names:
        if names.count(name) > 1:
            raise CellError(f"obstacle {name}: expected a name of its own, found {names.count(name)} of it")
    return out


def _convention(part: Mapping[str, Any], default: Convention) -> Convention:
    name = text("convention.name", part.get("name", default.name))
    if name not in CONVENTIONS:
        raise CellError(f"convention: no convention is called {name!r}; known: {', '.join(CONVENTIONS)}")
    named = CONVENTIONS[name]
    frame = part.get("frame", named.frame)
    if "sample_m" in part:
        numbers("convention.sample_m", part["sample_m"], 3, CELL if frame == "base" else HALL, "metres")
    return replace(
        named,
        order=part.get("order", named.order),
        gamma_sign=part.get("gamma_sign", named.gamma_sign),
        delta_sign=part.get("delta_sign", named.delta_sign),
        beam=part.get("beam", default.beam),
        up=part.get("up", named.up),
        sample=part.get("sample_m", default.sample),
        frame=frame,
    )


def _obstacle(count: int, part: Any, folder: Path) -> Obstacle:
    known("obstacle", part, _KEYS["obstacle"])
    name, shape = text("obstacle.name", part.get("name", f"obstacle {count}")), part.get("shape")
    if not isinstance(shape, str) or shape not in SHAPES:
        raise CellError(f"obstacle {name}: expected a shape of {', '.join(SHAPES)}, found {shape!r}")
    file = None
    if shape == "mesh":
        if not isinstance(part.get("file"), str):
            raise CellError(f"obstacle {name}: expected the file of its mesh, found {part.get('file')!r}")
        file = folder / part["file"]
        if not file.is_file():
            raise CellError(f"obstacle {name}: expected a mesh at {file}, found none")
    kind = cast(Shape, shape)
    size = sizes(f"obstacle {name}: size_m", part.get("size_m", []), SHAPES[kind], HALL)
    holds = switch(f"obstacle {name}: holds_sample", part.get("holds_sample", False))
    return Obstacle(name, kind, tuple(size.tolist()), _pose(f"obstacle {name}", part, HALL), file, holds)


def _pose(where: str, part: Mapping[str, Any], most: float) -> Array:
    """From ``position_m``, at most ``most`` off, ``x`` and ``z``; y follows."""
    z = numbers(f"{where}.z", part.get("z", [0.0, 0.0, 1.0]), 3)
    x = numbers(f"{where}.x", part.get("x", [1.0, 0.0, 0.0]), 3)
    lengths = np.linalg.norm(x), np.linalg.norm(z)
    if min(lengths) < 1e-9 or abs(float(x @ z)) > 1e-6 * float(lengths[0] * lengths[1]):
        raise CellError(f"{where}: expected x and z perpendicular directions, found {x.tolist()} and {z.tolist()}")
    x, z = x / lengths[0], z / lengths[1]
    out = np.eye(4)
    out[:3, :3] = np.column_stack([x, np.cross(z, x), z])
    out[:3, 3] = numbers(f"{where}.position_m", part.get("position_m", [0.0, 0.0, 0.0]), 3, most, "metres")
    return out
