"""The pose experiment: the arm stands still, and a point of it, or the whole flange, is measured.

Product of exponentials with a small motion of each link's far end between the joints (universal model, eqs. 5-11)::

    x = X_0 M_0 prod_i exp([xi_i] (q_i + dq_i)) M_i  (flange target)

X_0 is a constant guess of where the instrument sees the base; M_0 and M_i come from the chain.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise
from typing import Any

import numpy as np

from clampid.chain.chain import Chain, Deviations
from clampid.stages.pose_kernel import kernel, link_points
from clampid.stages.rows import Array, Rows
from kinematics.screws import log_so3

__all__ = [
    "PARAMETERS_OF_A_LARGE_CHAIN",
    "by_parameter",
    "by_station",
    "constants_of",
    "evaluate",
    "flanks",
    "frozen_flanks",
    "link_vectors",
    "moved",
    "predict",
    "pressing",
    "residual",
]

_NOTHING = np.zeros(0)
# Of one entry of a chain, from which on they are worth a product of their own.
PARAMETERS_OF_A_LARGE_CHAIN = 24


def link_vectors(robot: Any) -> Array:
    """From each joint's point to its link's far end ``(n, 3)``, base axes at the zero pose, m."""
    return np.asarray(link_points(robot) - np.array([joint.point for joint in robot.joints]))


def constants_of(robot: Any) -> dict[str, Array]:
    """Constants of the nominal robot that effects may read.

    ``transmission`` and ``linkage`` ``(n, n)``; ``link_vectors`` ``(n, 3)``, m; ``turning_axes`` ``(n, 3)``: unit
    vectors, base axes at the zero pose, zero for joints that slide.
    """
    return {
        "transmission": np.asarray(robot.transmission),
        "linkage": np.asarray(robot.linkage),
        "link_vectors": link_vectors(robot),
        "turning_axes": robot.screws[:, :3],
    }


def predict(rows: Rows, deviations: Deviations) -> tuple[Array, Array, Array]:
    """Positions and orientations, and their derivative by the deviation at each station.

    Returns
    -------
    position
        ``(N, 3)``, instrument frame, m.
    rotation
        ``(N, 3, 3)``, flange to instrument frame.
    sensitivity
        ``(N, 6, S)``: d (position, rotation vector) / d station entries, instrument frame.
    """
    reference = rows.pose.base_reference
    position, rotation, sensitivity = kernel(rows.robot)(
        _NOTHING,
        rows.signals["q"],
        reference[:, :3, :3].reshape(-1, 9),
        reference[:, :3, 3],
        rows.pose.target,
        deviations.values,
    )
    return position, rotation.reshape(-1, 3, 3), sensitivity.reshape(len(rows), 6, -1)


def pressing(rows: Rows, chain: Chain, theta: Array) -> Array | None:
    """Torques that press on the flanks at these parameters ``(N, n)``, Nm, or None if no effect asks."""
    return chain.pressing(theta, {**rows.signals, "flank": np.zeros((len(rows), rows.robot.n))})


def flanks(rows: Rows, chain: Chain, theta: Array) -> Array | None:
    """Sides on which the torques press at these parameters ``(N, n)``, or None if no effect asks."""
    found = pressing(rows, chain, theta)
    return None if found is None else np.sign(found)


def frozen_flanks(rows: Rows, chain: Chain, theta: Array) -> Mapping[str, Array]:
    """The rows' signals with flanks and loads where these parameters put them.

    The arm sags a little, which changes the lever of its weight: by a few thousandths of the load. One step of the
    fixed-point iteration reduces this error to a few millionths.
    """
    if not chain.reads_flanks and chain.yield_function is None:
        return rows.signals
    level = {**rows.signals, "sag_torque": np.zeros((len(rows), rows.robot.n))}
    if chain.reads_flanks:
        found = chain.pressing(theta, {**level, "flank": level["sag_torque"]})
        level["flank"] = level["sag_torque"] if found is None else np.sign(found)
    off = chain.yields(theta, level)
    if off is None:
        return level
    return {**level, "yielded": off, "sag_torque": np.einsum("nij,nj->ni", rows.signals["weight_stiffness"], off)}


def evaluate(rows: Rows, chain: Chain, theta: Array) -> Deviations:
    """Deviations at the flanks and loads that are frozen, or else at those that these parameters give."""
    follows = chain.reads_flanks and "flank" not in rows.signals
    follows |= chain.yield_function is not None and "yielded" not in rows.signals
    return chain.evaluate(theta, frozen_flanks(rows, chain, theta) if follows else rows.signals)


def residual(rows: Rows, chain: Chain, theta: Array, first: int = 0) -> tuple[Array, Array]:
    """Measured less predicted ``(N, m)``, and the prediction's derivative ``(N, m, P)``; zero where nothing was read.

    The derivative is that by the parameters from the ``first`` on. m = 3, with rotations 6, with distances 7.
    """
    deviations = evaluate(rows, chain, theta)
    error, sensitivity = by_station(rows, deviations)
    return error, by_parameter(sensitivity, deviations, chain, first)


def moved(rows: Rows, chain: Chain, theta: Array, steps: Array) -> Array:
    """Change of the prediction ``(N, m, k)`` by steps ``(P, k)``, to first order."""
    deviations = evaluate(rows, chain, theta)
    sensitivity = by_station(rows, deviations)[1]
    out = np.zeros((*sensitivity.shape[:2], steps.shape[1]))
    for a, run in chain.runs:
        out += sensitivity[:, :, a, None] * (deviations.partials[:, run] @ steps[deviations.parameter[run]])[:, None]
    return out


def by_station(rows: Rows, deviations: Deviations) -> tuple[Array, Array]:
    """Measured less predicted ``(N, m)``, and the prediction's derivative by each station's deviation ``(N, m, S)``.

    Of a distance from the anchor a to the point p: the distance less the length of p - a, and u' dp with u the unit
    vector from a to p.
    """
    position, rotation, sensitivity = predict(rows, deviations)
    width = rows.measured.shape[1]
    error = np.zeros((len(rows), width))
    error[:, :3] = rows.measured[:, :3] - position
    if width == 3:
        return error, sensitivity[:, :3]
    read = rows.pose.oriented
    error[read, 3:6] = log_so3(rows.pose.rotation[read] @ np.swapaxes(rotation[read], 1, 2))
    if width == 6 and read.all():
        return error, sensitivity
    seen = np.zeros((len(rows), width, sensitivity.shape[2]))
    seen[:, :6] = sensitivity
    seen[~read, 3:6] = 0.0
    if width > 6:
        far = rows.ranged
        way = position[far] - rows.pose.anchor[far]
        distance = np.linalg.norm(way, axis=1)
        along = way / np.maximum(distance, 1e-12)[:, None]
        error[far, :3], seen[far, :3] = 0.0, 0.0
        error[far, 6] = rows.measured[far, 6] - distance
        seen[far, 6] = np.einsum("ni,nis->ns", along, sensitivity[far, :3])
    return error, seen


def by_parameter(sensitivity: Array, deviations: Deviations, chain: Chain, first: int = 0) -> Array:
    """Chain rule: d measurement / d parameters ``(N, m, P)``, the sum over the stations that a parameter moves.

    Of the parameters from the ``first`` on, ``(N, m, P - first)``.
    """
    jacobian = np.zeros((*sensitivity.shape[:2], len(chain.slots) - first))
    station, parameter = deviations.station, deviations.parameter
    own, several = (k[parameter[k] >= first] for k in (chain.moves_one, chain.moves_several))
    few = np.ones(len(own), dtype=bool)
    # Of a curve's parameters, which stand beside each other, products are written where they belong.
    apart = (np.diff(own) != 1) | (np.diff(parameter[own]) != 1) | (np.diff(station[own]) != 0)
    for i, j in pairwise([0, *(np.flatnonzero(apart) + 1).tolist(), len(own)]):
        if j - i >= PARAMETERS_OF_A_LARGE_CHAIN:
            lever, by = sensitivity[:, :, station[own[i]], None], deviations.partials[:, None, own[i] : own[j - 1] + 1]
            np.multiply(lever, by, out=jacobian[:, :, parameter[own[i]] - first : parameter[own[j - 1]] - first + 1])
            few[i:j] = False
    at, of = station[own[few]], parameter[own[few]] - first
    jacobian[:, :, of] = sensitivity[:, :, at] * deviations.partials[:, None, own[few]]
    if several.size:
        stations, row = np.unique(station[several], return_inverse=True)
        parameters, column = np.unique(parameter[several], return_inverse=True)
        # Loads move all joints and are moved by all masses, so that the block is nearly full.
        block = np.zeros((len(sensitivity), len(stations), len(parameters)))
        block[:, row, column] = deviations.partials[:, several]
        jacobian[:, :, parameters - first] = sensitivity[:, :, stations] @ block
    return jacobian
