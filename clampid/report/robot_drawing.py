"""A robot at its zero pose as SVG: from the side and from above, with the axes of its joints."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

import numpy as np
import numpy.typing as npt

from kinematics.robot import RobotDescription

__all__ = ["robot_drawing"]

Array = npt.NDArray[np.float64]

SIDE = 420  # pixels across one view
LEAST_HEIGHT = 180  # pixels
DRAWING_MARGIN = 60
VIEWS = (("from the side", 0, 2, "x", "z"), ("from above", 0, 1, "x", "y"))
"""Title, the base frame's axis to the right and the one upwards, and their names."""
BLUE, ORANGE, INK, GREY = "#0072b2", "#d55e00", "#222222", "#888888"


def robot_drawing(robot: RobotDescription) -> str:
    """Draw a robot at its zero pose.

    Parameters
    ----------
    robot
        The description.

    Returns
    -------
    str
        SVG: base, joints and flange joined by lines, seen along −y and along −z of the base frame, m. Each joint has
        its number and its axis; an axis towards the reader is a dot in a circle, one away from the reader a cross.
    """
    joints = np.array([joint.point for joint in robot.joints])
    flange = np.asarray(robot.flange[:3, 3])
    points = np.vstack([np.zeros(3), joints, flange])
    middle = 0.5 * (points.max(axis=0) + points.min(axis=0))
    extent = float(np.ptp(points, axis=0).max()) or 1.0
    scale = (SIDE - 2 * DRAWING_MARGIN) / extent
    tall = max(LEAST_HEIGHT, scale * float(np.ptp(points[:, 1:], axis=0).max()) + 2 * DRAWING_MARGIN)
    body = [view for k in range(len(VIEWS)) for view in _view(robot, points, middle, scale, tall, k)]
    body += _ruler(_round_length(0.3 * extent), scale, tall)
    width, height = len(VIEWS) * SIDE, round(tall + 60)
    head = (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width}" height="{height}" viewBox="0 0 {width} {height}" '
        f'font-family="sans-serif" font-size="13" fill="{INK}"><rect width="100%" height="100%" fill="white"/>'
    )
    title = f'<text x="12" y="20" font-size="15">{escape(robot.title)}, zero pose</text>'
    return "\n".join([head, title, *body, "</svg>", ""])


def _view(robot: RobotDescription, points: Array, middle: Array, scale: float, tall: float, k: int) -> list[str]:
    name, right, up, right_name, up_name = VIEWS[k]
    depth = ({0, 1, 2} - {right, up}).pop()
    toward = -1.0 if depth == 1 else 1.0  # the reader stands at −y of the side view, at +z of the one from above

    def at(point: Array) -> tuple[float, float]:
        x = k * SIDE + SIDE / 2 + scale * (point[right] - middle[right])
        return float(x), float(30 + tall / 2 - scale * (point[up] - middle[up]))

    line = " ".join(f"{x:.1f},{y:.1f}" for x, y in map(at, points))
    out = [f'<polyline points="{line}" fill="none" stroke="{BLUE}" stroke-width="6" stroke-linejoin="round"/>']
    x, y = at(points[0])
    out.append(f'<rect x="{x - 12:.1f}" y="{y - 3:.1f}" width="24" height="8" fill="{INK}"/>')
    taken: list[tuple[float, float]] = []
    for number, joint in enumerate(robot.joints, 1):
        x, y = at(np.asarray(joint.point))
        out += _axis((x, y), float(joint.axis[right]), float(joint.axis[up]), toward * float(joint.axis[depth]))
        beside = _free((x + 12, y - 12), taken)
        taken.append(beside)
        out.append(f'<text x="{beside[0]:.1f}" y="{beside[1]:.1f}">{number}</text>')
    x, y = at(points[-1])
    below = _free((x + 10, y + 20), taken)
    out.append(f'<circle cx="{x:.1f}" cy="{y:.1f}" r="4" fill="{INK}"/>')
    out.append(f'<text x="{below[0]:.1f}" y="{below[1]:.1f}">flange</text>')
    left, foot = k * SIDE + 16, tall + 40
    out.append(_arrow((left, foot), (left + 34, foot), GREY) + _arrow((left, foot), (left, foot - 34), GREY))
    out.append(
        f'<text x="{left + 38}" y="{foot + 4:.1f}" fill="{GREY}">{right_name}</text>'
        f'<text x="{left - 4}" y="{foot - 40:.1f}" fill="{GREY}">{up_name}</text>'
        f'<text x="{left + 70}" y="{foot + 4:.1f}" fill="{GREY}">{name}</text>'
    )
    return out


def _free(wanted: tuple[float, float], taken: Sequence[tuple[float, float]]) -> tuple[float, float]:
    """A place for a label: to the right of those that stand there."""
    x, y = wanted
    while any(abs(x - a) < 12 and abs(y - b) < 13 for a, b in taken):
        x += 13
    return x, y


def _axis(at: tuple[float, float], right: float, up: float, toward: float) -> list[str]:
    """A joint's axis: an arrow in the plane of the view, or a dot or cross in a circle."""
    x, y = at
    out = [f'<circle cx="{x:.1f}" cy="{y:.1f}" r="7" fill="white" stroke="{ORANGE}" stroke-width="2"/>']
    if np.hypot(right, up) > 0.3:
        out.insert(0, _arrow(at, (x + 34 * right, y - 34 * up), ORANGE))
    elif toward > 0:
        out.append(f'<circle cx="{x:.1f}" cy="{y:.1f}" r="2.5" fill="{ORANGE}"/>')
    else:
        cross = f"M{x - 4:.1f},{y - 4:.1f} l8,8 m0,-8 l-8,8"
        out.append(f'<path d="{cross}" stroke="{ORANGE}" stroke-width="2"/>')
    return out


def _arrow(start: tuple[float, float], end: tuple[float, float], color: str) -> str:
    direction = np.subtract(end, start)
    length = float(np.hypot(*direction)) or 1.0
    u = direction / length
    side = np.array([-u[1], u[0]])
    tip = np.asarray(end)
    head = [tip, tip - 8 * u + 3.5 * side, tip - 8 * u - 3.5 * side]
    corners = " ".join(f"{x:.1f},{y:.1f}" for x, y in head)
    return (
        f'<line x1="{start[0]:.1f}" y1="{start[1]:.1f}" x2="{end[0]:.1f}" y2="{end[1]:.1f}" stroke="{color}" '
        f'stroke-width="2"/><polygon points="{corners}" fill="{color}"/>'
    )


def _round_length(wanted: float) -> float:
    """The largest of 1, 2, 5 times a power of ten that is at most what is wanted."""
    power = 10.0 ** np.floor(np.log10(wanted))
    return float(max(step * power for step in (1.0, 2.0, 5.0) if step * power <= wanted * (1 + 1e-9)))


def _ruler(length: float, scale: float, tall: float) -> list[str]:
    x, y = len(VIEWS) * SIDE - 20 - length * scale, tall + 44
    return [
        f'<line x1="{x:.1f}" y1="{y}" x2="{x + length * scale:.1f}" y2="{y}" stroke="{INK}" stroke-width="3"/>',
        f'<text x="{x:.1f}" y="{y - 8}">{length:g} m</text>',
    ]
