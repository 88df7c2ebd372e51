"""How large an effect must be to be visible in measured points: the residual of a fit of the standard model.

The standard model has free geometry, joint compliance, backlash, arm-side friction and centres of mass. Its columns are
differences of the virtual robot's own measurement, so they know nothing of the identification code.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cached_property

import numpy as np

from experiments.virtual_robot.bodies import Bodies
from experiments.virtual_robot.description import Array
from experiments.virtual_robot.drive import arm_at_rest
from experiments.virtual_robot.heat import session
from experiments.virtual_robot.plant import Plant
from experiments.virtual_robot.pose_tables import tracked_points
from experiments.virtual_robot.rotations import rotation_matrix
from experiments.virtual_robot.sampling import Site

VISIBLE = 1.5  # times the instrument's noise (one axis), rms of what a standard model leaves
LARGEST_HIDDEN = 8.0  # times the noise, rms before the fit: a limit for what the standard model nearly absorbs


class Sight:
    """The change of the points by a change of the plant, always in the same hundred poses of a warming robot."""

    def __init__(self, site: Site, plant: Plant) -> None:
        rng = np.random.default_rng(1)
        self.plant = plant
        self._q = site.configurations(100, 0.85, 2 * np.pi, rng)
        self._direction = rng.choice([-1.0, 1.0], self._q.shape)
        warm = session(plant.heat, np.array([8000.0]), np.ones((1, plant.n)))
        self._time = np.linspace(0.0, 8000.0, len(self._q))
        self._link = warm.at(self._time).link

    def points(self, plant: Plant) -> Array:
        """Return all coordinates of all tracked points of a plant, m, flat."""
        bodies = Bodies(plant.geometry, plant.masses)
        arm, _ = arm_at_rest(plant, bodies, self._q, self._direction)
        return tracked_points(plant, bodies, arm, self._link, self._time).ravel()

    @cached_property
    def _here(self) -> Array:
        return self.points(self.plant)

    @cached_property
    def _columns(self) -> dict[str, Array]:
        """Columns of the standard model by what they belong to, each of unit length."""
        found: dict[str, list[Array]] = {}
        for family, plant in _small_changes(self.plant):
            column = self.points(plant) - self._here
            length = float(np.linalg.norm(column))
            if length > 1e-9:
                found.setdefault(family, []).append(column / length)
        return {family: np.array(columns).T for family, columns in found.items()}

    def left(self, changed: Plant, *spare: str) -> float:
        """Return the rms, m, one axis, that the standard model without the families ``spare`` leaves of a change."""
        change = self.points(changed) - self._here
        A = np.hstack([columns for family, columns in self._columns.items() if family not in spare])
        u, s, _ = np.linalg.svd(A, full_matrices=False)
        Q = u[:, s > 1e-4 * s[0]]
        return float(np.sqrt(np.mean((change - Q @ (Q.T @ change)) ** 2)))

    def rms(self, changed: Plant, before: Plant) -> float:
        """Return the rms, m, one axis, of the whole change between two plants."""
        return float(np.sqrt(np.mean((self.points(changed) - self.points(before)) ** 2)))

    def factor(self, change: Callable[[Plant], Plant], *spare: str) -> float:
        """Return the factor on a small change that makes it clearly visible; 0 where nothing of it can be seen."""
        changed = change(self.plant)
        whole = self.rms(changed, self.plant)
        if whole < 1e-9:
            return 0.0
        sigma = self.plant.instrument.sigma
        return sigma * min(VISIBLE / max(self.left(changed, *spare), 1e-12), LARGEST_HIDDEN / whole)


def _small_changes(plant: Plant) -> Iterator[tuple[str, Plant]]:
    g, step = plant.geometry, 1e-4
    for i in range(plant.n):
        yield "geometry", replace(plant, geometry=replace(g, zero=_bump(g.zero, i, step)))
        drive, masses, friction = plant.drive, plant.masses, plant.friction
        soft = _bump(drive.extra_compliance, i, 1e-7)
        yield "joint_compliance", replace(plant, drive=replace(drive, extra_compliance=soft))
        yield "backlash", replace(plant, drive=replace(drive, gap=_bump(drive.gap, i, step)))
        yield "wrist_coupling_friction", replace(plant, friction=replace(friction, arm=_bump(friction.arm, i, 0.1)))
        for k in range(3):
            yield "geometry", replace(plant, geometry=replace(g, axes=_turned(g.axes, i, k, step)))
            yield "geometry", replace(plant, geometry=replace(g, points=_bump(g.points, (i, k), step)))
            yield "gravity", replace(plant, masses=replace(masses, com=_bump(masses.com, (i, k), 1e-2)))
    for name, point in g.targets.items():
        for k in range(3):
            yield "geometry", replace(plant, geometry=replace(g, targets={**g.targets, name: _bump(point, k, step)}))
    for k in range(3):
        origin = _bump(plant.instrument.origin, k, step)
        yield "geometry", replace(plant, instrument=replace(plant.instrument, origin=origin))
        turn = rotation_matrix(step * np.eye(3)[k : k + 1])[0] @ plant.instrument.rotation
        yield "geometry", replace(plant, instrument=replace(plant.instrument, rotation=turn))


def _bump(values: Array, index: int | tuple[int, int], step: float) -> Array:
    out = values.copy()
    out[index] += step
    return out


def _turned(axes: Array, joint: int, k: int, step: float) -> Array:
    out = axes.copy()
    out[joint] = rotation_matrix(step * np.eye(3)[k : k + 1])[0] @ axes[joint]
    return out
