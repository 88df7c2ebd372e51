"""Where the robot is sent: random configurations inside its limits, above the floor, and postures for clamping."""

from __future__ import annotations

import numpy as np

from experiments.virtual_robot.bodies import Bodies
from experiments.virtual_robot.description import Array, RobotDescription
from experiments.virtual_robot.draw import nominal_geometry, nominal_masses, rated_torques

FLOOR = 0.1  # m, lowest height of a tracked point above the base


class Site:
    """The nominal robot, as the author of the programs knows it."""

    def __init__(self, robot: RobotDescription) -> None:
        self.robot = robot
        self.geometry = nominal_geometry(robot)
        self.bodies = Bodies(self.geometry, nominal_masses(robot))
        self.weighed = nominal_masses(robot).known
        self.rated = rated_torques(robot)
        bounds = np.array([(j.lower, j.upper) for j in robot.joints], dtype=float)
        bounds = np.where(np.isfinite(bounds), bounds, np.array([-np.pi, np.pi]))
        self.middle: Array = bounds.mean(axis=1)
        self.half: Array = np.ptp(bounds, axis=1) / 2
        self.speed: Array = np.array([float(j.max_speed or 3.0) for j in robot.joints])

    def lowest_point(self, q: Array) -> Array:
        """Return the height of the lowest target above the base plane, m, (N,), at joint angles q, rad, (N, n)."""
        pose = np.tile(np.eye(4), (len(q), 1, 1))
        for step in np.moveaxis(self.bodies.steps(q), 1, 0):
            pose = pose @ step
        flange = pose @ self.bodies.flange
        heights = [flange[:, 2, 3] + flange[:, 2, :3] @ p for p in self.geometry.targets.values()]
        return np.asarray(np.min(heights, axis=0), dtype=float)

    def configurations(self, count: int, share: float, reach: float, rng: np.random.Generator) -> Array:
        """Return random configurations, rad, (count, n), above the floor.

        ``share`` is how much of the joint ranges is used, ``reach`` the most that a joint moves from its middle, rad.
        """
        width = np.minimum(share * self.half, reach)
        found: list[Array] = []
        for _ in range(200):
            q = self.middle + width * rng.uniform(-1, 1, (count, len(width)))
            found += list(q[self.lowest_point(q) > FLOOR])
            if len(found) >= count:
                return np.array(found[:count])
        raise ValueError(
            f"{self.robot.name}: hardly any configuration has its tool above the floor (base z > {FLOOR} m)"
        )

    def postures(self, count: int, rng: np.random.Generator) -> Array:
        """Return postures, rad, (count, n), far from singular, with little weight on the drives, unlike each other."""
        q = self.configurations(400, 0.6, 2.0, rng)
        weight = np.max(np.abs(self.bodies.gravity(q)) / self.rated, axis=1)
        scale = np.array([1.0, 1.0, 1.0, 0.4, 0.4, 0.4])[:, None]
        condition = np.array([np.linalg.cond(self.bodies.jacobian(row) * scale) for row in q])
        # Below a sixth of the rated torque, sweeps to not quite half of it cross zero, and with it the gap.
        good = q[np.argsort(condition * (1 + (weight / 0.15) ** 6))[:30]]
        chosen = [good[0]]
        while len(chosen) < count:
            apart = np.min([np.linalg.norm((good - c) / self.half, axis=1) for c in chosen], axis=0)
            chosen.append(good[int(np.argmax(apart))])
        return np.array(chosen)
