"""The robot as it is, at one temperature of all links and under no load: a product of exponentials.

The calibrated chain (see :mod:`clampid.stages.poses`) is::

    x = X_0 M_0 prod_i exp([xi_i] q_i) M_i F

with F the flange's nominal home pose. Moving every M_i through the exponentials behind it gives screws
xi'_i = Ad(M_1 … M_{i-1}) xi_i and a home pose M_1 … M_n F: a chain as any other. Where a linkage couples joints,
q are the joint values of the chain and not the controller's.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from clampid.models.described import robot_of
from clampid.models.model import Model, ModelError
from clampid.role_slots import any_of_role, numbers_of_role, slot_of
from clampid.roles import FRAMES, Role
from clampid.stages.pose_kernel import link_points
from clampid.stages.poses import link_vectors
from clampid.stages.rows import Array
from clampid.stages.stage_kind import known_of, only_of
from experiments.temperatures import COLDEST_C, HOTTEST_C, REFERENCE_TEMPERATURE
from kinematics.poe import forward
from kinematics.robot import RobotDescription
from kinematics.screws import adjoint, cayley, transform

__all__ = ["CalibratedChain", "calibrated_chain", "sensitivity"]

DIFFERENCE_STEP = 1e-7  # m or rad: far below every calibrated number, far above rounding
_AXES = ("rx", "ry", "rz", "x", "y", "z")


@dataclass(frozen=True)
class CalibratedChain:
    """The robot as it is: a product of exponentials.

    Errors of ratio and pitch are no part of it, because no form for others could hold them: exports say what they are
    worth.

    Attributes
    ----------
    base
        ``(4, 4)``: the base in the instrument's frame.
    screws
        ``(n, 6)``: (omega, v) in the base frame at the zero pose.
    home
        ``(4, 4)``: the flange at the zero pose, in the base frame.
    """

    robot: RobotDescription
    base: Array
    screws: Array
    home: Array

    def flange(self, q: Array) -> Array:
        """Poses ``(..., 4, 4)`` of the flange in the instrument's frame at joint values ``(..., n)``."""
        return np.asarray(self.base @ forward(self.screws, self.home, q))


def calibrated_chain(
    model: Model,
    *,
    session: int = 0,
    robot: RobotDescription | None = None,
    theta: Array | None = None,
    temperature: float = REFERENCE_TEMPERATURE,
) -> CalibratedChain:
    """The static geometry of a model at one temperature of all links.

    Parameters
    ----------
    session
        Whose base and flange, from 0.
    robot
        The nominal robot, if the model's name for it is not that of a bundled one.
    theta
        Other values for the slots of the stage ``poses``.
    temperature
        °C; another than 20 needs expansion to have been identified.

    Raises
    ------
    ModelError
        The model has no geometry from a table of poses, no such session, or no expansion for another temperature; or
        the temperature is none of a robot.
    """
    stage = known_of(model.stages, "points")
    if stage is None or not any_of_role(stage.slots, *FRAMES):
        raise ModelError("expected a model with geometry identified from a table of poses, found none to export")
    if not 0 <= session < len(model.sessions):
        raise ModelError(f"session {session + 1}: the model has sessions 1 to {len(model.sessions)}")
    reference = model.sessions[session].base_reference
    if reference is None:
        raise ModelError(f"session {session + 1} has no table of poses; its base is not known")
    if not COLDEST_C <= temperature <= HOTTEST_C:
        raise ModelError(
            f"temperature {temperature:g} degC: expected one of a robot, {COLDEST_C:g} to {HOTTEST_C:g} degC; is it in "
            "kelvin?"
        )
    if temperature != REFERENCE_TEMPERATURE and not any_of_role(stage.slots, "expansion"):
        raise ModelError(
            f"temperature {temperature:g} degC: expected a model with thermal_expansion in poses, found none; its "
            f"geometry is that of the temperatures of its poses, exported as {REFERENCE_TEMPERATURE:g} degC"
        )
    nominal = robot_of(model, robot)
    values = dict(zip(stage.slots, stage.theta if theta is None else theta, strict=True))
    here = model.layout.sessions[session]

    def twist(role: Role, place: str) -> Array:
        return np.array([values.get(slot_of(role, place, axis), 0.0) for axis in _AXES])

    vectors = link_vectors(nominal)
    base = np.asarray(reference) @ _motion(twist("base_frame", here), np.zeros(3))
    moved, screws = np.eye(4), np.empty((nominal.n, 6))
    for i, pivot in enumerate(link_points(nominal)):
        screws[i] = adjoint(moved) @ nominal.screws[i]
        far_end = twist("link_frame", f"link{i + 1}")
        alpha = values.get(slot_of("expansion", f"link{i + 1}"), 0.0)
        far_end[3:] += alpha * (temperature - REFERENCE_TEMPERATURE) * vectors[i]
        if i + 1 == nominal.n:
            far_end = far_end + twist("flange_frame", here)
        moved = moved @ _motion(far_end, pivot)
    return CalibratedChain(nominal, base, screws, moved @ nominal.flange)


def _motion(twist: Array, pivot: Array) -> Array:
    """The small motion x -> pivot + v + C(w)(x - pivot), C Cayley's rotation, as in :mod:`clampid.stages.poses`."""
    C = cayley(twist[:3])
    return transform(C, pivot + twist[3:] - C @ pivot)


def sensitivity(
    model: Model,
    numbers: Callable[[CalibratedChain], Array],
    *,
    session: int = 0,
    robot: RobotDescription | None = None,
    temperature: float = REFERENCE_TEMPERATURE,
    difference: Callable[[Array, Array], Array] = np.subtract,
) -> tuple[Array, Array]:
    """How numbers of the calibrated chain follow the parameters of the geometry, by central differences.

    Parameters
    ----------
    numbers
        Gives the numbers ``(M,)`` of a chain, SI.
    session, robot, temperature
        See `calibrated_chain`.
    difference
        Of two results of ``numbers``, where that is more than a subtraction.

    Returns
    -------
    tuple of Array
        Derivatives ``(M, P)`` by the P parameters of ``geometry`` (at another temperature than 20 °C also of the
        expansion), and these parameters' covariance ``(P, P)``.
    """
    stage = only_of(model.stages, "points")
    warm: tuple[Role, ...] = ("expansion",) if temperature != REFERENCE_TEMPERATURE else ()
    free = numbers_of_role(stage.slots, *FRAMES, *warm)
    columns = []
    for k in free:
        step = DIFFERENCE_STEP * np.eye(len(stage.slots))[k]
        sides = [
            numbers(calibrated_chain(model, session=session, robot=robot, theta=theta, temperature=temperature))
            for theta in (stage.theta + step, stage.theta - step)
        ]
        columns.append(difference(sides[0], sides[1]) / (2 * DIFFERENCE_STEP))
    return np.array(columns).T, stage.covariance[np.ix_(free, free)]
