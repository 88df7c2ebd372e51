"""Bodies that can exist behind identified base parameters: positive masses, inertias that a body can have.

Torques determine base parameters only, and with noise. Of all arms of real bodies (every link's pseudo-inertia matrix
positive definite, every rotor's inertia positive) the one is found that

    minimises  (K x − β)ᵀ C⁻¹ (K x − β) + 2 w Σ_links [tr(P₀⁻¹ P) − log det(P₀⁻¹ P) − 4]

with β and C the base parameters and their covariance, and P₀ the described link. The second part, the divergence of two
bodies' mass distributions, decides what torques do not determine, and keeps bodies possible: it is infinite at the
edge. Both parts are convex in x, so that the minimum is the only one. The weight w is the largest at which the
description moves the base parameters by no more than half a standard error (root mean square) beyond what consistency
itself costs.

Source: Lee, Wensing and Park 2020, Geometric robot dynamic identification: a convex programming approach, IEEE Trans.
Robotics 36(2) (entropic divergence, convexity); Traversaro et al. 2016 (pseudo-inertia); the log-Cholesky parameters of
Rucker and Wensing 2022 reach the same set without constraints, but not convexly.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from clampid.fitting.base_names import BaseParameter
from clampid.fitting.base_parameters import described_parameters, to_joint_points
from clampid.models.model import Model, ModelError, StageModel
from clampid.role_slots import any_of_role, has_role, slot_of
from clampid.roles import WEIGHTS as WEIGHT_ROLES
from clampid.stages.rows import Array
from clampid.stages.stage_kind import known_of
from kinematics.dynamics import inertial_parameters
from kinematics.pseudo_inertia import BASIS, about_centre, pseudo_inertia
from kinematics.robot import Link, RobotDescription

__all__ = ["ConsistentArm", "consistent_arm", "off_by", "reference_bodies"]

NAMES = ("m", "mx", "my", "mz", "Ixx", "Iyy", "Izz", "Ixy", "Ixz", "Iyz")
WEIGHTS = 10.0 ** np.arange(2.0, -2.1, -0.25)  # 25 holds masses to 10 %, 1 to a factor of two
ALLOWED = 0.25  # of chi-square a base parameter: half a standard error of each is what the description's pull may cost
GYRATION_SHARE = 0.3  # of a link's length: the radius of gyration of a link of unknown inertia
LEAST_RADIUS = 0.05  # m
UNKNOWN_MASS, LUMPED_MASS = 5.0, 0.5  # kg: of a link of an arm without described masses; of one lumped into another
LEAST_ROTOR = 0.02  # kg m²
MAX_STEPS = 200
DONE, ROUNDING = 1e-9, 1e-3  # of Newton's decrement, in units of chi-square
SHORTEST_STEP = 1e-9


@dataclass(frozen=True)
class ConsistentArm:
    """An arm of bodies that can exist.

    Attributes
    ----------
    parameters
        ``(n, 10)``: mass, first moment and inertia of each link about the point on its own joint, base axes at the
        zero pose; SI, order of :data:`kinematics.pseudo_inertia.BASIS`.
    rotors
        ``(n,)``, kg m² at the joint: inertia of the rotors; None where the model has none to tell from the links'.
    links
        The same as masses with centres in the base frame at the zero pose, and inertias about them.
    base
        ``(B,)``: the base parameters that this arm has, in the order of the stage's.
    chi_square
        How far they are from the identified ones, in the metric of the fit's covariance.
    weight
        Of the description.
    """

    parameters: Array
    rotors: Array | None
    links: tuple[Link, ...]
    base: Array
    chi_square: float
    weight: float

    def slot_values(self, stage: StageModel, robot: RobotDescription) -> Array:
        """The stage's parameters ``(P,)``, with this arm's in place of those of masses and inertias."""
        theta = to_joint_points(stage.slots, robot) @ stage.theta
        described = described_parameters(stage.slots, robot)
        for k, slot in enumerate(stage.slots):
            if has_role(slot, *WEIGHT_ROLES, "inertia_tensor", per="link"):
                theta[k] = self.parameters[slot.number, NAMES.index(slot.parameter)] - described[k]
            elif has_role(slot, "rotor_inertia") and self.rotors is not None:
                theta[k] = self.rotors[slot.number]
        return np.asarray(np.linalg.solve(to_joint_points(stage.slots, robot), theta))


def consistent_arm(model: Model, robot: RobotDescription) -> ConsistentArm:
    """The arm of real bodies nearest to a model's base parameters; source: the module's docstring.

    Parameters of other effects that share a base parameter (a balancer, a tool other than declared) keep their fitted
    values, and so do rotors where the model has no inertia of links to distinguish them from.

    Raises
    ------
    ModelError
        The model has no base parameters, or none that any bodies come near to.
    """
    stage = known_of(model.stages, "moving")
    if stage is None or not stage.base:
        raise ModelError("expected a model with gravity identified from free-air or wrist logs, found none to export")
    bodies = any_of_role(stage.slots, "inertia_tensor")
    K, constant, rotors = _matrices(stage, robot.n, bodies)
    target = np.array([p.value for p in stage.base]) - constant
    metric = _metric(stage, robot)
    reference = reference_bodies(robot)
    first = np.where(rotors, np.maximum(np.abs(_fitted_rotors(stage, robot.n)), LEAST_ROTOR), 1.0)
    inverse = np.asarray(np.linalg.inv(pseudo_inertia(reference)), dtype=np.float64)
    problem = _Problem(K, target, metric, inverse, first, rotors)
    x = np.r_[reference.ravel(), first]
    found: list[tuple[float, float, Array]] = []
    for weight in WEIGHTS:  # from the inside outwards: each start lies near its solution
        x, converged = problem.solve(x, float(weight))
        if not converged:
            break
        found.append((float(weight), problem.chi_square(x), x))
    if not found:
        raise ModelError("no consistent arm was found: the base parameters are not finite, or far beyond any robot's")
    least = min(chi for _, chi, _ in found)
    weight, chi, x = next(f for f in found if f[1] <= least + ALLOWED * len(target))
    parameters = x[: 10 * robot.n].reshape(-1, 10)
    links = []
    for phi, joint in zip(parameters, robot.joints, strict=True):
        mass, centre, inertia = about_centre(phi)
        links.append(Link(mass, centre + joint.point, inertia))
    turning = x[10 * robot.n :] if bodies and rotors.any() else None
    return ConsistentArm(parameters, turning, tuple(links), K @ x + constant, chi, weight)


def reference_bodies(robot: RobotDescription) -> Array:
    """What the links are taken for before any torque is seen ``(n, 10)``, about their joint points; SI.

    As described; where no inertia is, with a radius of gyration of a share of the link's length, the same about all
    axes; where no mass is, with a mass half-way along the link.
    """
    out = np.zeros((robot.n, 10))
    ends = [*(np.asarray(joint.point) for joint in robot.joints[1:]), np.asarray(robot.flange)[:3, 3]]
    for i, (joint, end) in enumerate(zip(robot.joints, ends, strict=True)):
        body = robot.links[i] if robot.has_masses else None
        if body is None or not body.mass > 0.0:
            mass, centre, inertia = LUMPED_MASS if robot.has_masses else UNKNOWN_MASS, 0.5 * (joint.point + end), None
        else:
            mass, centre, inertia = body.mass, np.asarray(body.com), body.inertia
        if inertia is None or np.linalg.eigvalsh(0.5 * np.trace(inertia) * np.eye(3) - inertia)[0] <= 0.0:
            radius = max(GYRATION_SHARE * float(np.linalg.norm(end - joint.point)), LEAST_RADIUS)
            inertia = mass * radius**2 * np.eye(3)
        own = inertial_parameters(mass, centre, inertia, joint.point)
        own[1:4] -= mass * joint.point
        out[i] = own
    return out


@dataclass(frozen=True)
class _Problem:
    """The convex problem: base parameters, their metric, and what the links and rotors are pulled to."""

    K: Array  # (B, 10 n + n)
    target: Array  # (B,)
    metric: Array  # (B, B)
    inverse: Array  # (n, 4, 4), of the described links' pseudo-inertias
    rotors: Array  # (n,) kg m²
    turning: np.ndarray[tuple[int], np.dtype[np.bool_]]  # (n,): which rotors are free

    def chi_square(self, x: Array) -> float:
        off = self.K @ x - self.target
        return float(off @ self.metric @ off)

    def cost(self, x: Array, weight: float) -> float:
        """Half of the module's function; infinite for what no body can have."""
        n = len(self.rotors)
        P, r = pseudo_inertia(x[: 10 * n].reshape(n, 10)), x[10 * n :]
        if np.linalg.eigvalsh(P).min() <= 0.0 or r.min() <= 0.0:
            return float("inf")
        ratio = self.inverse @ P
        pull = np.trace(ratio, axis1=1, axis2=2) - np.linalg.slogdet(ratio)[1] - 4.0
        spin = r / self.rotors - np.log(r / self.rotors) - 1.0
        return 0.5 * self.chi_square(x) + weight * float(pull.sum() + spin.sum())

    def solve(self, x: Array, weight: float) -> tuple[Array, bool]:
        """Newton's method from a point inside, and whether it arrived.

        Steps are shortened until the cost falls and bodies stay possible (Boyd & Vandenberghe 2004, section 9.5).
        """
        for _ in range(MAX_STEPS):
            gradient, hessian = self._derivatives(x, weight)
            scale = 1.0 / np.sqrt(np.diag(hessian))
            step = -scale * np.linalg.solve(hessian * np.outer(scale, scale), scale * gradient)
            decrement = -float(gradient @ step)
            if decrement < DONE:
                return x, True
            now, length = self.cost(x, weight), 1.0
            while length > SHORTEST_STEP and not self.cost(x + length * step, weight) <= now - 0.1 * length * decrement:
                length *= 0.5
            if length <= SHORTEST_STEP:
                return x, decrement < ROUNDING  # the cost cannot be lowered any more
            x = x + length * step
        return x, False

    def _derivatives(self, x: Array, weight: float) -> tuple[Array, Array]:
        n = len(self.rotors)
        off = self.metric @ (self.K @ x - self.target)
        gradient, hessian = self.K.T @ off, self.K.T @ self.metric @ self.K
        for i, phi in enumerate(x[: 10 * n].reshape(n, 10)):
            P = np.linalg.inv(pseudo_inertia(phi))
            own = slice(10 * i, 10 * i + 10)
            gradient[own] += weight * np.einsum("kab,ba->k", BASIS, self.inverse[i] - P)
            moved = P @ BASIS
            hessian[own, own] += weight * np.einsum("kab,lba->kl", moved, moved)
        r = x[10 * n :]
        gradient[10 * n :] += weight * (1.0 / self.rotors - 1.0 / r)
        hessian[10 * n :, 10 * n :] += weight * np.diag(1.0 / r**2)
        return gradient, hessian


def _matrices(
    stage: StageModel, n: int, bodies: bool
) -> tuple[Array, Array, np.ndarray[tuple[int], np.dtype[np.bool_]]]:
    """K ``(B, 11 n)``, the part of the base parameters that keeps its value ``(B,)``, and which rotors are free."""
    values = stage.values()
    K, constant, rotors = np.zeros((len(stage.base), 11 * n)), np.zeros(len(stage.base)), np.zeros(n, dtype=bool)
    for row, parameter in enumerate(stage.base):
        for slot, coefficient in parameter.terms:
            if has_role(slot, *WEIGHT_ROLES, "inertia_tensor", per="link"):
                K[row, 10 * slot.number + NAMES.index(slot.parameter)] = coefficient
            elif has_role(slot, "rotor_inertia") and bodies:
                K[row, 10 * n + slot.number] = coefficient
                rotors[slot.number] = True
            else:
                constant[row] += coefficient * values[slot]
    return K, constant, rotors


def _metric(stage: StageModel, robot: RobotDescription) -> Array:
    """The inverse of the base parameters' covariance ``(B, B)``."""
    turned = to_joint_points(stage.slots, robot)
    K = np.zeros((len(stage.base), len(stage.slots)))
    for row, parameter in enumerate(stage.base):
        for slot, coefficient in parameter.terms:
            K[row, stage.slots.index(slot)] = coefficient
    covariance = K @ turned @ stage.covariance @ turned.T @ K.T
    scale = 1.0 / np.sqrt(np.diag(covariance))
    return np.asarray(np.linalg.pinv(covariance * np.outer(scale, scale), hermitian=True) * np.outer(scale, scale))


def _fitted_rotors(stage: StageModel, n: int) -> Array:
    values = stage.values()
    return np.array([values.get(slot_of("rotor_inertia", f"joint{i + 1}"), 0.0) for i in range(n)])


def off_by(base: Sequence[BaseParameter], arm: ConsistentArm) -> Array:
    """How far each base parameter of the arm is from the identified one, in its standard errors ``(B,)``."""
    return np.array([(found - p.value) / p.std for p, found in zip(base, arm.base, strict=True)])
