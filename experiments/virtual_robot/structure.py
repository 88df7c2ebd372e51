"""The true place of a tracked point: the chain of true joints with all bending, expansion and tilts."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from experiments.virtual_robot.bodies import Bodies
from experiments.virtual_robot.description import Array
from experiments.virtual_robot.plant import Plant
from experiments.virtual_robot.rotations import rotation_matrix

REFERENCE_TEMPERATURE = 20.0  # °C, at which links have the length of the true geometry
CREEP_BEGINS, SETTLING_TIME = 600.0, 3600.0  # s


@dataclass(frozen=True)
class Deformation:
    """Small motions at the n joints and, last, at the flange; in the frame of the link before each.

    ``rotation`` (N, n+1, 3) in rad about the joint's point, ``shift`` (N, n+1, 3) in m; ``base`` (N, 3) in rad about
    the base origin, in the base frame, and ``foot`` (N, 3) in m the shift of that origin.
    """

    rotation: Array
    shift: Array
    base: Array
    foot: Array


def deformation(
    plant: Plant, bodies: Bodies, q: Array, link_temperature: Array, time: Array | None = None
) -> Deformation:
    """Return how the structure deforms at true joint angles q, rad, (N, n), and link temperatures, °C, (N, n).

    ``time`` (N,) is what has passed since the robot was set up, s; without it nothing has.
    """
    N, n = q.shape
    rotation, shift, base = np.zeros((N, n + 1, 3)), np.zeros((N, n + 1, 3)), np.zeros((N, 3))
    vectors, s = plant.geometry.link_vectors, plant.structure
    growth = s.expansion * (link_temperature - REFERENCE_TEMPERATURE)  # (N, n)
    shift[:, 1:] += growth[..., None] * vectors
    if plant.masses.known and (s.bearing.any() or s.bending.any() or s.base):
        load = bodies.wrenches(q)
        across = (
            load.moment - np.einsum("nij,ij->ni", load.moment, plant.geometry.axes)[..., None] * plant.geometry.axes
        )
        rotation[:, :n] += s.bearing[:, None] * across
        for i in np.flatnonzero(s.bending[: n - 1]):
            turn, sag = _cantilever(s.bending[i], vectors[i], load.force[:, i + 1], load.moment[:, i + 1])
            rotation[:, i + 1] += turn
            shift[:, i + 1] += sag
        foot = load.moment[:, 0] + np.cross(plant.geometry.points[0], load.force[:, 0])
        base = s.base * foot * np.array([1.0, 1.0, 0.0])
    # Grout and anchors creep with the logarithm of time.
    crept = np.zeros(N) if time is None else np.log1p(time / CREEP_BEGINS) / np.log1p(SETTLING_TIME / CREEP_BEGINS)
    settled = crept[:, None] * s.settling
    return Deformation(rotation, shift, base + settled[:, :3], settled[:, 3:])


def _cantilever(flexibility: float, vector: Array, force: Array, moment: Array) -> tuple[Array, Array]:
    """Return rotation and shift of a beam's end; ``flexibility`` is 1/EI in 1/(Nm²), the load acts at the end."""
    L = float(np.linalg.norm(vector))
    if L == 0.0:
        return np.zeros_like(force), np.zeros_like(force)
    u = vector / L
    bend = moment - (moment @ u)[:, None] * u
    across = force - (force @ u)[:, None] * u
    turn = flexibility * (L**2 / 2 * np.cross(u, across) + L * bend)
    sag = flexibility * (L**3 / 3 * across + L**2 / 2 * np.cross(bend, u))
    return turn, sag


def flange_poses(bodies: Bodies, q: Array, deformed: Deformation) -> Array:
    """Return the flange in the base frame, (N, 4, 4), at true joint angles q, rad, (N, n)."""
    steps = bodies.steps(q)
    flange = np.broadcast_to(bodies.flange, (len(q), 1, 4, 4))
    chain = np.concatenate([steps, flange], axis=1)
    turn = rotation_matrix(deformed.rotation)
    # Turning about the joint's own point leaves its translation as it is.
    bent = chain.copy()
    bent[..., :3, :3] = turn @ chain[..., :3, :3]
    bent[..., :3, 3] += deformed.shift
    pose = np.tile(np.eye(4), (len(q), 1, 1))
    pose[:, :3, :3], pose[:, :3, 3] = rotation_matrix(deformed.base), deformed.foot
    for k in range(bent.shape[1]):
        pose = pose @ bent[:, k]
    return np.asarray(pose, dtype=float)
