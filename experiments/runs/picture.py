"""A picture of a plan: where the flange goes, from above and from the side, as SVG."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from itertools import pairwise

import numpy as np

from experiments.plans.model import Plan
from experiments.plans.motion import Array
from experiments.runs.dry import Motion, hours_or_minutes
from kinematics.description import RobotDescription
from kinematics.poe import forward

__all__ = ["picture"]

SIZE, EDGE, HEAD = 420.0, 40.0, 50.0  # of a panel, its margin and the title, px
POINTS_BETWEEN = 12  # points on each motion: straight in the joints is curved in space
SCALE_BAR = 0.5  # m


def picture(plan: Plan, steps: Sequence[Motion]) -> str:
    """SVG text: the ways of the flange, with a dot wherever something is measured."""
    robot = plan.cell.robot
    different = {(a.to.tobytes(), b.to.tobytes()): (a.to, b.to) for a, b in pairwise(steps)}  # cycles repeat them
    ways = [_way(robot, a, b) for a, b in different.values()]
    stops = np.array([_flange(robot, q) for q in {s.to.tobytes(): s.to for s in steps if s.measured}.values()])
    every = np.vstack([*ways, stops, np.zeros((1, 3))]) if ways else np.vstack([stops, np.zeros((1, 3))])
    time = hours_or_minutes(steps[-1].start + steps[-1].duration)
    measured = sum(bool(step.measured) for step in steps)
    title = f"{plan.kind} of {robot.name}: {len(steps)} motions, {time}, {measured} of them measured"
    panels = "".join(
        _panel(ways, stops, every, axes, words, k)
        for k, (axes, words) in enumerate((((0, 1), "from above"), ((0, 2), "from the side")))
    )
    width, height = 2 * SIZE, SIZE + HEAD
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width:g} {height:g}" font-family="sans-serif" '
        f'font-size="12"><rect width="100%" height="100%" fill="white"/>'
        f'<text x="{EDGE:g}" y="28" font-size="15">{escape(title)}</text>{panels}</svg>\n'
    )


def _flange(robot: RobotDescription, q: Array) -> Array:
    return np.asarray(forward(robot.screws, robot.flange, np.asarray(robot.linkage) @ q)[:3, 3])


def _way(robot: RobotDescription, one: Array, other: Array) -> Array:
    """Places of the flange ``(m, 3)``, m, on a straight way in the joints."""
    if np.max(np.abs(other - one)) < 0.02:
        return np.array([_flange(robot, one), _flange(robot, other)])
    return np.array([_flange(robot, one + s * (other - one)) for s in np.linspace(0.0, 1.0, POINTS_BETWEEN)])


def _panel(ways: Sequence[Array], stops: Array, every: Array, axes: tuple[int, int], words: str, place: int) -> str:
    low = every.min(axis=0)
    span = float(np.max(np.ptp(every, axis=0))) or 1.0
    scale = (SIZE - 2 * EDGE) / span

    def at(points: Array) -> Array:
        flat = (points[..., list(axes)] - low[list(axes)]) * scale
        return np.stack([place * SIZE + EDGE + flat[..., 0], HEAD + SIZE - EDGE - flat[..., 1]], axis=-1)

    lines = "".join(
        f'<polyline points="{" ".join(f"{x:.1f},{y:.1f}" for x, y in at(way))}" fill="none" stroke="#888" '
        'stroke-width="0.8"/>'
        for way in ways
    )
    dots = "".join(f'<circle cx="{x:.1f}" cy="{y:.1f}" r="2.5" fill="#0a58a6"/>' for x, y in at(stops))
    x, y = at(np.zeros(3))
    base = f'<rect x="{x - 5:.1f}" y="{y - 5:.1f}" width="10" height="10" fill="#333"/>'
    bar = SCALE_BAR * scale
    left, bottom = place * SIZE + EDGE, HEAD + SIZE - 12
    ruler = (
        f'<path d="M{left:.1f} {bottom:.1f}h{bar:.1f}" stroke="#333" stroke-width="2"/>'
        f'<text x="{left + bar + 6:.1f}" y="{bottom + 4:.1f}">{SCALE_BAR:g} m, {escape(words)}</text>'
    )
    return lines + base + dots + ruler
