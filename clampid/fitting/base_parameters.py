"""The base (minimal) parameters of gravity and inertia: combinations of parameters that the data determine.

Torques depend on fewer numbers than there are masses, first moments and inertias: a mass on the axis of joint k+1 has
the same effect as more mass at the far end of link k. Columns of the Jacobian are taken in a fixed order (from the base
outwards; first moments, then inertias, then masses). A column that depends linearly on those before it is dropped, and
its parameter is added to theirs with these coefficients, which are lengths of the arm. A column of zeros has no effect
on the data. The columns are those of the data's own postures: links on both sides of a joint that never moved count as
one body. How accurately the data determine each combination is a separate question, which depends on the noise.

Source: Gautier 1991, Numerical calculation of the base inertial parameters of robots, J. Robotic Systems 8(4), eqs.
14-23 (QR of the observation matrix, X_B = X_1 + R_1^-1 R_2 X_2), with the order of columns fixed instead of pivoted, so
that the names stay the same from one campaign to the next; Khalil and Dombre 2002, section 9.4.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy import linalg

from clampid.fitting.base_names import BaseParameter, base_name
from clampid.fitting.log_sample import sampled_rows
from clampid.fitting.solve import Estimate
from clampid.role_slots import axis_of, has_role, role_of, slot_of
from clampid.roles import INERTIAL, INERTIAS, WEIGHTS, Role
from clampid.slots import Slot, find_parameter
from clampid.stages.fit_problem import FitProblem
from clampid.stages.loads import gravity_regressors
from clampid.stages.rows import Array, Rows
from kinematics.dynamics import inertial_parameters
from kinematics.masses import links_of
from kinematics.robot import RobotDescription

__all__ = ["base_parameters", "described_parameters", "grouped", "regroup", "to_joint_points"]

EXACT = 1e-7  # relative length of a column's part that is new: below this it is a combination of others
NEGLIGIBLE_COLUMN = 1e-11  # length over that of the largest column: below this a column counts as zero
NEGLIGIBLE_COEFFICIENT = 1e-6  # in reasonable sizes: smaller coefficients are rounding errors
OPEN_SHARE = 0.7  # standard error over that of the prior: above this the data do not determine a combination
TENSOR = ("xx", "yy", "zz", "xy", "xz", "yz")
OF_BODY: tuple[Role, ...] = (*WEIGHTS, "inertia_tensor")


def base_parameters(estimate: Estimate) -> tuple[BaseParameter, ...]:
    """The base parameters of a torque fit, from the rank of its Jacobian in the rows that it has fitted.

    Source: the module's docstring. The standard errors are those of the whole fit, prior included.

    Parameters
    ----------
    estimate
        A fit of the stage ``free_air``.

    Returns
    -------
    tuple
        From the base outwards; empty where the fit has no inertial parameters, or is of another stage.
    """
    problem, count = estimate.problem, len(estimate.slots)
    if not problem.kind.moving or not problem.numbers_of(*INERTIAL):
        return ()
    columns, offsets = _columns(estimate)
    return grouped(
        problem,
        estimate.theta[:count],
        estimate.covariance[:count, :count],
        estimate.prior_precision[:count, :count],
        columns,
        offsets,
    )


def grouped(
    problem: FitProblem, theta: Array, covariance: Array, precision: Array, columns: Array, offsets: Array
) -> tuple[BaseParameter, ...]:
    """The base parameters of a torque fit, from columns of its Jacobian.

    Parameters
    ----------
    problem
        The fitted problem; its slots, effects and robot are used.
    theta, covariance, precision
        Fitted values ``(P,)``, their covariance ``(P, P)`` and the prior's precision ``(P, P)``, SI.
    columns, offsets
        Jacobian in a sample of rows, over their noise, by the slots ``(M, P)`` and by the runs' offsets ``(M, K)``.

    Returns
    -------
    tuple
        From the base outwards.
    """
    slots, effects = problem.slots, problem.effects
    robot, count = problem.rows.robot, len(slots)
    size = problem.sizes()[:count]
    turned = to_joint_points(slots, robot)
    order = sorted(range(count), key=lambda k: _column_order(slots[k]))
    kept, coefficients = regroup(columns @ np.linalg.inv(turned) * size, order, offsets)
    described = described_parameters(slots, robot)
    theta = turned @ theta + described
    before = turned @ np.linalg.inv(precision) @ turned.T
    covariance = turned @ covariance @ turned.T
    out = []
    for k, shares in zip(kept, coefficients, strict=True):
        if not has_role(slots[k], *INERTIAL):
            continue
        weights = np.where(np.abs(shares) > NEGLIGIBLE_COEFFICIENT, shares * size[k] / size, 0.0)
        terms = _ordered([(slots[j], float(weights[j])) for j in order if weights[j] != 0.0], slots[k])
        std, prior = (float(np.sqrt(max(float(weights @ C @ weights), 0.0))) for C in (covariance, before))
        unit = find_parameter(slots[k], effects).unit
        value, nominal = float(weights @ theta), float(weights @ described) if robot.has_masses else 0.0
        known = bool(std < min(size[k], OPEN_SHARE * prior))
        out.append(BaseParameter(base_name(terms, effects), unit, terms, value, std, nominal, known))
    return tuple(out)


def regroup(columns: Array, order: Sequence[int], nuisance: Array | None = None) -> tuple[list[int], Array]:
    """Take columns in order; keep the linearly independent ones, and express the others by them.

    Source: Gautier 1991, eqs. 14-23; here by Gram-Schmidt with reorthogonalisation in a given order.

    Parameters
    ----------
    columns
        ``(M, P)``, scaled alike.
    order
        In which the columns are taken.
    nuisance
        ``(M, K)``: columns that are projected out first.

    Returns
    -------
    list, Array
        Numbers of the columns kept, and coefficients ``(kept, P)`` with ``columns ≈ columns[:, kept] @ coefficients``.
    """
    basis = np.zeros((len(columns), 0))
    if nuisance is not None and nuisance.size:
        # gesvd: the quicker routine fails now and then where the sizes span twenty decades.
        U, s, _ = linalg.svd(nuisance, full_matrices=False, lapack_driver="gesvd")
        basis = U[:, s > EXACT * s.max(initial=0.0)]
    hidden = basis.shape[1]
    floor = NEGLIGIBLE_COLUMN * float(np.linalg.norm(columns, axis=0).max(initial=0.0))
    kept: list[int] = []
    inside = np.zeros((columns.shape[1], columns.shape[1]))  # rows: basis vectors of the columns kept
    for k in order:
        column = columns[:, k]
        share = basis.T @ column
        rest = column - basis @ share
        again = basis.T @ rest
        rest, share = rest - basis @ again, share + again
        inside[: len(kept), k] = share[hidden:]
        length = float(np.linalg.norm(rest))
        if length > max(EXACT * float(np.linalg.norm(column)), floor):
            inside[len(kept), k] = length
            basis = np.c_[basis, rest / length]
            kept.append(k)
    triangle = inside[: len(kept)]
    if not kept:
        return kept, triangle
    return kept, np.asarray(np.linalg.solve(triangle[:, kept], triangle))


def to_joint_points(slots: Sequence[Slot], robot: RobotDescription) -> Array:
    """The matrix ``(P, P)`` that moves the origin of the links' first moments from the base to a point on their joint.

    In the model, m c is about the base's origin, so that it does not depend on a choice of link frames. The new moments
    are m (c − p) = m c − m p, with p a point on the link's joint axis.
    """
    index = {slot: k for k, slot in enumerate(slots)}
    out = np.eye(len(slots))
    for k, slot in enumerate(slots):
        if has_role(slot, "first_moment", per="link"):
            mass = index.get(slot_of("mass", slot.place))
            if mass is not None:
                point = robot.joints[slot.number].point
                out[k, mass] = -float(point["xyz".index(axis_of(slot))])
    return out


def described_parameters(slots: Sequence[Slot], robot: RobotDescription) -> Array:
    """Described values ``(P,)`` to which the fitted slots are added, about the links' joint points, SI.

    If the description has no masses, those of :func:`kinematics.masses.usual_links` are used. Links without described
    inertia are point masses, as in the model's own torques (:func:`clampid.stages.loads.inertial_bodies`).
    Source: Lynch & Park, theorem 8.2 (Steiner).
    """
    out = np.zeros(len(slots))
    names = (*[("mass", "")], *[("first_moment", a) for a in "xyz"], *[("inertia_tensor", a) for a in TENSOR])
    bodies = []
    for body, joint in zip(links_of(robot), robot.joints, strict=True):
        phi = inertial_parameters(body.mass, body.com, body.inertia, joint.point)
        phi[1:4] -= body.mass * joint.point
        bodies.append(dict(zip(names, phi.tolist(), strict=True)))
    for k, slot in enumerate(slots):
        if has_role(slot, *OF_BODY, per="link"):
            out[k] = bodies[slot.number][role_of(slot), axis_of(slot)]
    return out


def _columns(estimate: Estimate) -> tuple[Array, Array]:
    """Jacobian of a sample of rows over their noise, by the slots ``(M, P)`` and by the runs' offsets ``(M, K)``."""
    rows: Rows = estimate.problem.rows
    chosen = sampled_rows(rows)
    part = rows.take(chosen)
    if not estimate.problem.numbers_of(*INERTIAS):
        # Rows are steady then. Their small accelerations would make parameters look separable that gravity cannot
        # separate.
        part = replace(part, signals={**part.signals, **_at_rest(part)})
    trial = estimate.problem.with_rows(part)
    count = len(estimate.slots)
    theta = np.r_[estimate.theta[:count], np.zeros(trial.offsets)]
    _, jacobian = trial.residual(theta)
    white = (jacobian / estimate.noise.sigma[chosen][:, :, None])[part.used]
    return white[:, :count], white[:, count:]


def _at_rest(rows: Rows) -> dict[str, Array]:
    """The regressors of gravity alone in the rows' postures."""
    out: dict[str, Array] = {}
    for s in np.unique(rows.session):
        own = rows.session == s
        found = gravity_regressors(rows.robot, rows.log.gravity_vector[s], rows.signals["q"][own])
        for name, values in found.items():
            out.setdefault(name, np.zeros_like(rows.signals[name]))[own] = values
    return out


def _column_order(slot: Slot) -> tuple[int, int, int, str]:
    """Sort key of columns: links from the base outwards (first moments, inertias, mass); tool; rotors; all others."""
    role = role_of(slot)
    if has_role(slot, *OF_BODY, per="link"):
        return 0, slot.number, ("first_moment", "inertia_tensor", "mass").index(role), slot.parameter
    if role in WEIGHTS:
        return 1, 0, int(role == "mass"), slot.parameter
    return (2, slot.number, 0, "") if role == "rotor_inertia" else (3, 0, 0, "")


def _ordered(terms: Sequence[tuple[Slot, float]], first: Slot) -> tuple[tuple[Slot, float], ...]:
    """Terms in the order of the name: the first parameter, then by kind; equal ones together, for a short name."""

    def key(term: tuple[Slot, float]) -> tuple[object, ...]:
        slot, weight = term
        return (
            slot != first,
            _kind(slot),
            has_role(slot, "mass"),
            slot.parameter,
            -float(f"{abs(weight):.4g}"),
            weight < 0,
            slot.place,
        )

    return tuple(sorted(terms, key=key))


def _kind(slot: Slot) -> int:
    """Rank of a parameter's kind: weight of links, their inertia, weight of the tool, inertia of rotors, all others."""
    if has_role(slot, *WEIGHTS):
        return 0 if has_role(slot, *WEIGHTS, per="link") else 2
    return {"inertia_tensor": 1, "rotor_inertia": 3}.get(role_of(slot), 4)
