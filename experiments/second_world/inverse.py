"""Joint angles that bring a point of the tool to wanted places, by damped least squares for all places at once."""

import numpy as np

from experiments.second_world.arms import Arm
from experiments.second_world.arrays import Array
from experiments.second_world.chain import Bend, forward

__all__ = ["reach"]


def reach(arm: Arm, target_m: Array, places_m: Array, start_rad: Array, turn_weight_m: float = 0.3) -> Array:
    """
    Solve for postures that keep the flange's orientation of the start.

    Parameters
    ----------
    arm
        The nominal arm.
    target_m
        The point (3,) in the flange frame.
    places_m
        Wanted places (N, 3) in the base frame.
    start_rad
        Posture (n,) to start from; the solution stays on its branch.
    turn_weight_m
        Metres of position error that one radian of orientation error counts for.

    Returns
    -------
    Array
        Angles (N, n), rad. Places out of reach end as near as the limits of the joints let them.
    """
    N, n = len(places_m), arm.n
    start = forward(arm, start_rad[None], Bend.none(1, n))
    first = (start.flange_m + start.flange @ target_m)[0]
    low, high = arm.limits()
    q = np.tile(start_rad, (N, 1))
    for k in range(60):
        wanted = first + (places_m - first) * min(1.0, (k + 1) / 20)
        f = forward(arm, q, Bend.none(N, n))
        point = f.flange_m + f.flange @ target_m
        turn = start.flange @ np.swapaxes(f.flange, 1, 2)
        off = np.stack([turn[:, 2, 1] - turn[:, 1, 2], turn[:, 0, 2] - turn[:, 2, 0], turn[:, 1, 0] - turn[:, 0, 1]], 1)
        error = np.concatenate([wanted - point, turn_weight_m * off / 2], axis=1)
        lever = np.cross(f.axes, point[:, None] - f.origin_m)
        J = np.swapaxes(np.concatenate([lever, turn_weight_m * f.axes], axis=2), 1, 2)  # (N, 6, n)
        A = np.swapaxes(J, 1, 2) @ J + 1e-6 * np.eye(n)
        step = np.linalg.solve(A, np.swapaxes(J, 1, 2) @ error[..., None])[..., 0]
        q = np.clip(q + np.clip(step, -0.3, 0.3), low, high)
        if k > 20 and np.abs(step).max() < 1e-9:
            break
    return np.asarray(q)
