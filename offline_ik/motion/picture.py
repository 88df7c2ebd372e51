"""A picture of a simulated move: the cell from the side and from above, as SVG.

Bodies are drawn as the outline of their corners as seen from the side (x to the right, z up) and from above (x to the
right, y up), in the robot's base frame. Cylinders and capsules are outlined by the circles at their ends.
"""

from __future__ import annotations

from html import escape
from typing import TYPE_CHECKING, Any

import coal  # type: ignore[import-untyped]
import numpy as np
import numpy.typing as npt

from kinematics.collision.bodies import Shape, shapes_of
from kinematics.poe import joint_transforms

if TYPE_CHECKING:
    from offline_ik.motion.simulation import Simulation

__all__ = ["picture_of"]

Array = npt.NDArray[np.float64]

WIDTH, HEIGHT, MARGIN = 460.0, 420.0, 34.0  # of one view
POINTS = 25  # of the detector's way
CIRCLE = np.linspace(0.0, 2 * np.pi, 24, endpoint=False)
FLOOR = 1.0  # m, half of the edge of what is drawn of a half-space
MAX_CORNERS = 400  # corners of a mesh that are drawn
VIEWS = (("from the side", "x", "z", (0, 2)), ("from above", "x", "y", (0, 1)))
COLOURS = {"obstacle": "#8a8f98", "base": "#c9b899", "link": "#e08a3c", "detector": "#2f6fb0"}
ASIDE = 3.0  # of the reach, beyond which bodies do not widen the picture


def picture_of(simulation: Simulation) -> str:
    """The picture, as the text of an SVG file: where the robot stands, where it goes, and the detector's way."""
    detector = simulation.detector
    shapes, corners = shapes_of(detector.robot, detector.cell.world), simulation.postures
    robot = detector.robot
    reach = float(robot.reach)
    sample = detector.to_base(_at(np.asarray(detector.cell.convention.sample)))[:3, 3]
    q, _ = simulation.along(POINTS)
    way = np.array([detector.to_base(pose)[:3, 3] for pose in detector.pose(q)]) if len(q) else np.zeros((0, 3))
    shown = [*([] if not len(corners) else [corners[0]]), *([] if len(corners) < 2 else [corners[-1]])]
    bodies: list[tuple[Shape, Array, float]] = [(s, _outline(s, np.eye(4)), 1.0) for s in shapes if s.link == 0]
    for k, posture in enumerate(shown):
        G = joint_transforms(robot.screws, np.asarray(robot.linkage) @ posture)
        last = k == len(shown) - 1
        bodies += [(s, _outline(s, G[s.link]), 1.0 if last else 0.3) for s in shapes if s.link]
    seen = np.vstack([sample[None], way, *(np.clip(points, -ASIDE * reach, ASIDE * reach) for _, points, _ in bodies)])
    parts = [_view(k, view, bodies, way, sample, seen) for k, view in enumerate(VIEWS)]
    size = f'viewBox="0 0 {2 * WIDTH:g} {HEIGHT + 40:g}"'
    style = 'font-family="sans-serif" font-size="13"'
    text = escape(_caption(simulation))
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" {size} {style}><title>{text}</title>'
        f'<rect width="100%" height="100%" fill="white"/>{"".join(parts)}'
        f'<text x="{MARGIN:g}" y="{HEIGHT + 26:g}">{text}</text></svg>\n'
    )


def _caption(simulation: Simulation) -> str:
    way = simulation.way
    if way is None:
        return f"not reachable: {'; '.join(simulation.reasons)}"
    if not simulation.safe:
        return f"refused: {'; '.join(simulation.reasons)}"
    path = way.path
    near = f"; {' and '.join(path.between)} come within {1e3 * path.clearance:.0f} mm" if any(path.between) else ""
    return f"safe{near}; {path.duration:.1f} s; pale: where it begins"


def _view(
    number: int, view: tuple[str, str, str, tuple[int, int]], bodies: list[tuple[Shape, Array, float]],
    way: Array, sample: Array, seen: Array,
) -> str:  # fmt: skip
    name, across, up, axes = view
    low, high = seen[:, axes].min(axis=0), seen[:, axes].max(axis=0)
    scale = float(min((WIDTH - 2 * MARGIN) / (high[0] - low[0]), (HEIGHT - 2 * MARGIN) / (high[1] - low[1])))

    def on_paper(points: Array) -> Array:
        flat = (np.atleast_2d(points)[:, axes] - low) * scale
        return np.column_stack([number * WIDTH + MARGIN + flat[:, 0], HEIGHT - MARGIN - flat[:, 1]])

    out = [f'<text x="{number * WIDTH + MARGIN:g}" y="18">{name}: {across} to the right, {up} up (m)</text>']
    for shape, points, strength in bodies:
        hull = _hull(on_paper(points))
        drawn = " ".join(f"{x:.1f},{y:.1f}" for x, y in hull.tolist())
        colour = COLOURS[shape.kind]
        out.append(
            f'<polygon points="{drawn}" fill="{colour}" fill-opacity="{0.35 * strength:.2f}" stroke="{colour}" '
            f'stroke-opacity="{strength:g}"><title>{escape(shape.name)}</title></polygon>'
        )
    if len(way):
        line = " ".join(f"{x:.1f},{y:.1f}" for x, y in on_paper(way).tolist())
        out.append(f'<polyline points="{line}" fill="none" stroke="#b02f2f" stroke-width="2"/>')
    ((x, y),) = on_paper(sample).tolist()
    out.append(f'<circle cx="{x:.1f}" cy="{y:.1f}" r="4" fill="#b02f2f"><title>sample</title></circle>')
    ruler = 10 ** np.floor(np.log10((high[0] - low[0]) / 2))
    left, below = number * WIDTH + MARGIN, HEIGHT - 8
    out.append(
        f'<path d="M{left:.1f} {below:g} h{ruler * scale:.1f}" stroke="black"/>'
        f'<text x="{left + ruler * scale + 6:.1f}" y="{below + 4:g}">{ruler:g} m</text>'
    )
    return "".join(out)


def _outline(shape: Shape, motion: Array) -> Array:
    """Points ``(k, 3)`` whose hull is the body, where its link has moved to, base frame."""
    own = _corners(shape.geometry if shape.hull is None else shape.hull)
    T = motion @ shape.pose
    return np.asarray(own @ T[:3, :3].T + T[:3, 3])


def _corners(geometry: Any) -> Array:
    circle = np.column_stack([np.cos(CIRCLE), np.sin(CIRCLE), 0 * CIRCLE])
    match geometry:
        case coal.Box():
            signs = np.array([[a, b, c] for a in (-1, 1) for b in (-1, 1) for c in (-1, 1)])
            return np.asarray(signs * geometry.halfSide)
        case coal.Cylinder():
            return np.vstack([geometry.radius * circle + [0, 0, z * geometry.halfLength] for z in (-1, 1)])
        case coal.Sphere():
            return _ball(geometry.radius)
        case coal.Capsule():
            return np.vstack([_ball(geometry.radius) + np.array([0, 0, z * geometry.halfLength]) for z in (-1, 1)])
        case coal.Halfspace():  # the part of its surface around its own origin
            return np.array([[x, y, 0.0] for x in (-FLOOR, FLOOR) for y in (-FLOOR, FLOOR)])
    points = np.array([np.asarray(p) for p in geometry.points()]).reshape(-1, 3)
    return points[:: max(len(points) // MAX_CORNERS, 1)]


def _ball(radius: float) -> Array:
    c, s, none = np.cos(CIRCLE), np.sin(CIRCLE), 0 * CIRCLE
    rings = [np.column_stack(ring) for ring in ((c, s, none), (c, none, s), (none, c, s), (c, 0.7 * s, 0.7 * s))]
    return radius * np.vstack(rings)


def _hull(points: Array) -> Array:
    """The convex hull ``(k, 2)`` of points; Andrew (1979), Another efficient algorithm for convex hulls."""
    ordered = sorted(map(tuple, points.round(3).tolist()))

    def half(given: list[tuple[float, ...]]) -> list[tuple[float, ...]]:
        out: list[tuple[float, ...]] = []
        for p in given:
            while len(out) > 1 and _turn(out[-2], out[-1], p) <= 0:
                out.pop()
            out.append(p)
        return out[:-1]

    return np.array(half(ordered) + half(ordered[::-1]) or ordered[:1])


def _turn(a: tuple[float, ...], b: tuple[float, ...], c: tuple[float, ...]) -> float:
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


def _at(point: Array) -> Array:
    out = np.eye(4)
    out[:3, 3] = point
    return out
