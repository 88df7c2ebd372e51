"""The instrument that sees the targets: where it stands, and how its noise lies in its axes."""

from dataclasses import dataclass

import numpy as np

from experiments.second_world.arrays import Array, exp_so3, stream
from experiments.second_world.individual import Robot
from experiments.second_world.noise import Noise

__all__ = ["Instrument", "place_instrument"]


@dataclass(frozen=True)
class Instrument:
    """Pose of the robot's base in the instrument's frame, and the instrument's noise."""

    name: str
    rotation: Array  # (3, 3) base to instrument
    position_m: Array  # (3,) of the base in the instrument's frame
    std_m: Array  # (3,) per axis of the instrument's frame
    stated_std_m: float
    sight: Array  # (3,) unit vector in the instrument's frame towards the middle of the work
    middle_m: Array  # (3,) that middle, in the instrument's frame

    def see(self, points_m: Array) -> Array:
        """Points (..., 3) in the base frame, seen in the instrument's frame."""
        return np.asarray(points_m @ self.rotation.T + self.position_m)


def place_instrument(robot: Robot, noise: Noise, seed: int) -> Instrument:
    """
    Put an instrument some metres from a robot.

    A stereo camera looks along its z axis at the work. Any other instrument stands upright, turned at random.

    Parameters
    ----------
    robot, noise, seed
        What it looks at, how it errs, and where the random choices come from.

    Returns
    -------
    Instrument
        With the noise in its own axes.
    """
    rng = stream(seed, "instrument")
    length = sum(float(np.linalg.norm(j.xyz_m)) for j in robot.nominal.joints[1:])
    middle = np.array([0.5 * length, 0.0, 0.6 * length])
    bearing = rng.uniform(-1.2, 1.2)
    place = middle + (1.2 + length) * np.array([np.cos(bearing), np.sin(bearing), rng.uniform(0.0, 0.4)])
    if noise.looks_along_z:
        z = (middle - place) / np.linalg.norm(middle - place)
        x = np.cross(z, [0.0, 0.0, 1.0])
        x /= np.linalg.norm(x)
        R = np.stack([x, np.cross(z, x), z])
    else:
        tilt = np.array([*(2e-3 * rng.standard_normal(2)), rng.uniform(-np.pi, np.pi)])
        R = exp_so3(tilt)
    std = noise.position_std_m * np.array(noise.axes) * float(np.exp(0.1 * rng.standard_normal()))
    centre = R @ (middle - place)
    return Instrument(
        name=noise.instrument,
        rotation=R,
        position_m=-R @ place,
        std_m=std,
        stated_std_m=noise.position_std_m,
        sight=centre / np.linalg.norm(centre),
        middle_m=centre,
    )
