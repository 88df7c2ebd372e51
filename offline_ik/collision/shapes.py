"""The bodies of a cell: the arm's links as capsules, the detector as a box, obstacles; which pairs may not touch.

Neighbouring links meet at the joint between them: what they may do to each other is what joint limits are for. The
detector is no link. It is held against every link but the one that carries it, and where the capsule of the forearm,
whose round end is a guess, would reach into it at any posture of the wrist, that end is cut back for this pair.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import product
from typing import TYPE_CHECKING, Any

import coal  # type: ignore[import-untyped]
import numpy as np
import numpy.typing as npt

from kinematics.poe import joint_transforms
from kinematics.robot import RobotDescription
from offline_ik.cell.cell import Cell, Obstacle
from offline_ik.collision.mesh import SHEET, Mesh, MeshError, read_mesh
from offline_ik.errors import CellError

if TYPE_CHECKING:
    from offline_ik.inverse.detector import Detector

__all__ = ["Shape", "carries", "checked_pairs", "distance_of", "radii_of", "shapes_of", "sheets_of"]

Array = npt.NDArray[np.float64]

RADII = (0.11, 0.10, 0.065, 0.07, 0.05, 0.04, 0.035)
"""Of the reach: base and links 1 to 6, a little more than what arms of this kind have."""
BASE_HEIGHT = 0.6  # of the shoulder's
CUT = 0.25  # of a link's radius: the steps in which its end is cut back
QUARTERS = (0.0, 0.5 * np.pi, -0.5 * np.pi, np.pi)  # rad: a straight wrist is one of these


@dataclass(frozen=True, eq=False)
class Shape:
    """A body.

    Attributes
    ----------
    kind
        ``obstacle``, ``base``, ``link`` or ``detector``.
    link
        Which link carries it; 0: the world or the base.
    geometry
        Of `coal`, m.
    pose
        ``(4, 4)``: where it is at the zero posture, base frame.
    extent
        How far its points are from its link's joint, m.
    radius
        What it needs around its link, m.
    hull
        Of a mesh, which has no inside: its convex hull, of `coal`.
    """

    name: str
    kind: str
    link: int
    geometry: Any
    pose: Array
    extent: float
    radius: float = 0.0
    hull: Any = None

    def at(self, motion: Array) -> Any:
        """Its place for `coal`, its link moved ``(4, 4)`` from the zero posture."""
        T = motion @ self.pose
        return coal.Transform3s(T[:3, :3].copy(), T[:3, 3].copy())


def distance_of(a: Any, a_at: Any, b: Any, b_at: Any) -> float:
    """Between two geometries at their places, m; negative: overlapping."""
    return float(coal.distance(a, a_at, b, b_at, coal.DistanceRequest(), coal.DistanceResult()))


def radii_of(robot: RobotDescription, cell: Cell) -> tuple[float, Array]:
    """Of the base and of the links ``(n,)``, m: the cell's, or guessed from the arm's reach."""
    guessed = np.interp(np.linspace(0, 1, robot.n + 1), np.linspace(0, 1, len(RADII)), RADII) * robot.reach
    base = float(guessed[0]) if cell.base_radius is None else cell.base_radius
    return base, guessed[1:] if cell.radius is None else cell.radius


def shapes_of(detector: Detector) -> list[Shape]:
    """Obstacles, base, links and detector of a cell.

    Raises
    ------
    CellError
        The file of a mesh is none.
    """
    robot, cell = detector.robot, detector.cell
    points = np.array([*(j.point for j in robot.joints), robot.flange[:3, 3]])
    n, (base, radii) = robot.n, radii_of(robot, cell)
    height = max(BASE_HEIGHT * abs(float(points[1][2])), 1e-3)
    out = [_obstacle(o) for o in cell.obstacles]
    out.append(Shape("base", "base", 0, coal.Cylinder(base, height), _placed(np.array([0, 0, height / 2])), 0.0, base))
    for k in range(n):
        # Where link 1 begins, the base is around it; below the foot there is none of it.
        start = _raised(points[k], points[k + 1], float(radii[k])) if k == 0 else points[k]
        if np.linalg.norm(points[k + 1] - points[k]) < 1e-6:
            continue
        out.append(_capsule(k + 1, points[k], start, points[k + 1], float(radii[k])))
    if cell.size is not None:
        x, y, z = cell.size
        pose = np.asarray(robot.flange) @ detector.solver.mount @ _placed(np.array([0, 0, -0.5 * z]))
        extent = float(np.linalg.norm(pose[:3, 3] - points[n - 1]) + 0.5 * np.linalg.norm(cell.size))
        out.append(Shape("detector", "detector", n, coal.Box(x, y, z), pose, extent))
    return out


def checked_pairs(detector: Detector, shapes: list[Shape], lengths: Array) -> Iterator[tuple[Shape, Shape]]:
    """Pairs that may not touch, the one nearer to the base first.

    Parameters
    ----------
    lengths
        ``(n,)`` of the links, m.
    """
    clearance = detector.cell.clearance
    base = next(s for s in shapes if s.kind == "base")
    for i, a in enumerate(shapes):
        for b in shapes[i + 1 :]:
            if a.link == b.link or (a.kind == "obstacle" and b.link == 1 and carries(a, base, clearance)):
                continue
            close = float(lengths[a.link : b.link - 1].sum()) < a.radius + b.radius + clearance
            if a.kind == "obstacle" or not close:
                yield a, b
            elif a.kind == "link" and b.kind == "detector":
                cut = _cut(detector, a, b, float(lengths[a.link - 1]))
                if cut is not None:
                    yield cut, b


def carries(obstacle: Shape, base: Shape, clearance: float) -> bool:
    """Whether the robot stands on an obstacle: it reaches the foot of the base."""
    foot = coal.Cylinder(base.radius, 2e-3)
    still = np.eye(4)
    return distance_of(obstacle.geometry, obstacle.at(still), foot, replace(base, pose=still).at(still)) <= clearance


def _cut(detector: Detector, link: Shape, held: Shape, length: float) -> Shape | None:
    """A link's capsule with its outer end cut back until the detector keeps clear of it at some posture of the wrist.

    None: it never does, so that the two are one body for all that the cell says.
    """
    n, robot = detector.robot.n, detector.robot
    turned = np.array(list(product(QUARTERS, repeat=n - link.link)))
    q = np.hstack([np.zeros((len(turned), link.link)), turned])
    places = [held.at(G[held.link]) for G in joint_transforms(robot.screws, q)]
    shift = np.eye(4)
    for back in np.arange(0.0, length, CUT * link.radius):
        shift[2, 3] = -0.5 * back
        shape = replace(link, geometry=coal.Capsule(link.radius, length - back), pose=link.pose @ shift)
        here = shape.at(np.eye(4))
        if max(distance_of(shape.geometry, here, held.geometry, at) for at in places) > detector.cell.clearance:
            return shape
    return None


def _capsule(number: int, joint: Array, start: Array, end: Array, radius: float) -> Shape:
    vector = end - start
    length = float(np.linalg.norm(vector))
    pose = _placed(0.5 * (start + end), vector / length)
    extent = float(np.linalg.norm(end - joint)) + radius
    return Shape(f"link {number}", "link", number, coal.Capsule(radius, length), pose, extent, radius)


def _raised(start: Array, end: Array, radius: float) -> Array:
    """The place between two points at which a ball of the radius just stands on the foot's plane z = 0."""
    rise = float(end[2] - start[2])
    share = (radius - float(start[2])) / rise if rise > 0 else 0.0
    return np.asarray(start + min(max(share, 0.0), 0.99) * (end - start))


def _obstacle(obstacle: Obstacle) -> Shape:
    match obstacle.shape:
        case "box":
            geometry = coal.Box(*obstacle.size)
        case "cylinder":
            geometry = coal.Cylinder(*obstacle.size)
        case "capsule":
            geometry = coal.Capsule(*obstacle.size)
        case "sphere":
            geometry = coal.Sphere(*obstacle.size)
        case "mesh":
            mesh = _mesh(obstacle)
            return Shape(obstacle.name, "obstacle", 0, mesh.surface(), np.asarray(obstacle.pose), 0.0, hull=mesh.hull())
    return Shape(obstacle.name, "obstacle", 0, geometry, np.asarray(obstacle.pose), 0.0)


def _mesh(obstacle: Obstacle) -> Mesh:
    if obstacle.file is None:
        raise CellError(f"obstacle {obstacle.name}: expected the file of its mesh, found none")
    try:
        return read_mesh(obstacle.file)
    except MeshError as error:
        raise CellError(f"obstacle {obstacle.name}: {obstacle.file} is no mesh: {error}") from None


def sheets_of(cell: Cell) -> list[str]:
    """What to say of meshes that are flat."""
    flat = [o.name for o in cell.obstacles if o.shape == "mesh" and _mesh(o).thickened]
    return [f"obstacle {name}: the mesh is flat; it counts as a sheet {1e3 * SHEET:g} mm thick" for name in flat]


def _placed(middle: Array, z: Array | None = None) -> Array:
    """A pose at ``middle`` with its z axis along ``z``."""
    out = np.eye(4)
    out[:3, 3] = middle
    if z is not None:
        x = np.cross([0.0, 1.0, 0.0] if abs(z[1]) < 0.9 else [1.0, 0.0, 0.0], z)
        x /= np.linalg.norm(x)
        out[:3, :3] = np.column_stack([x, np.cross(z, x), z])
    return out
