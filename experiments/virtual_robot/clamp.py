"""A clamped arm in equilibrium: springs, gaps and the block share the displacement by the motors."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from experiments.virtual_robot.bodies import Bodies
from experiments.virtual_robot.description import Array
from experiments.virtual_robot.drive import compliance_matrix, nonlinear_yield
from experiments.virtual_robot.plant import Drive, Plant
from experiments.virtual_robot.play import slipping


def press(C: Array, gap: Array, angle: Array, start: Array | None = None, tolerance: float = 1e-12) -> Array:
    """Return the torques with C·tau + ½·gap·sign(tau) = angle, none inside a gap: argmin ½τ'Cτ + ½gap'|τ| − angle'τ.

    Parameters
    ----------
    C
        Compliance, rad/Nm, (n, n), symmetric and positive definite.
    gap
        Clearances, rad, (n,).
    angle
        By how far the gears' outputs are ahead of the arm, rad, (N, n).
    start
        Torques to start from, Nm, (N, n).
    tolerance
        Largest change in the last pass, rad.
    """
    tau = np.zeros_like(angle) if start is None else start.copy()
    diagonal = np.diag(C)
    for _ in range(2000):
        change = 0.0
        for i in range(len(C)):  # each joint in turn, exactly; convex, so it ends
            left = angle[:, i] - tau @ C[i] + diagonal[i] * tau[:, i]
            new = np.sign(left) * np.maximum(np.abs(left) - gap[i] / 2, 0.0) / diagonal[i]
            change = max(change, float(np.max(np.abs(new - tau[:, i]), initial=0.0)) * float(diagonal[i]))
            tau[:, i] = new
        if change < tolerance:
            return tau
    raise RuntimeError(f"the clamped equilibrium did not settle: still moving by {change:.1e} rad")


def block_compliance(plant: Plant, jacobian: Array) -> tuple[Array, Array]:
    """Return the block's compliance as the joints see it, rad/Nm, (n, n), and the wrench per joint torque, (6, n)."""
    wrench = np.linalg.pinv(jacobian).T  # W = J⁻ᵀ (tau − load)
    seen = wrench.T @ np.diag(plant.fixture.compliance) @ wrench
    return np.asarray(seen, dtype=float), np.asarray(wrench, dtype=float)


def clamped_torques(
    plant: Plant,
    bodies: Bodies,
    output: Array,
    arm: Array,
    load: Array,
    slipped: npt.NDArray[np.bool_] | None = None,
    shift: Array | None = None,
) -> tuple[Array, Array]:
    """Return joint torques, Nm, (N, n), and the flange's displacement, m and rad, (N, 6), of one clamping.

    Parameters
    ----------
    plant, bodies
        The robot.
    output
        Angles of the gears' outputs in the order of time, rad, (N, n).
    arm
        Angles at which the arm was clamped, rad, (n,).
    load
        Torques that held it there, Nm, (n,).
    slipped
        Whether the block has slipped by then, (N,); by default it has not.
    shift
        By how much it has, m and rad, (N, 6), where that is not the plant's own slip.
    """
    drive = plant.drive
    jacobian = bodies.jacobian(arm)
    block, wrench = block_compliance(plant, jacobian)
    if shift is None:
        shift = np.zeros((len(output), 6)) if slipped is None else np.outer(slipped, plant.fixture.shift)
    C = compliance_matrix(drive) + block
    ahead = (
        output - arm - shift @ np.linalg.pinv(jacobian).T + block @ load
    )  # a block that yields gives way to tau − load, not to tau
    tau = press(C, drive.gap, ahead)
    if drive.hardening.any() or drive.soft.any() or drive.slip.any():
        tau = _with_nonlinear(drive, C, ahead, tau)
    return tau, (tau - load) @ wrench.T * plant.fixture.compliance + shift


def _with_nonlinear(drive: Drive, C: Array, ahead: Array, tau: Array) -> Array:
    """Solve for springs that harden or slip: the extra deflection is moved to the right side until nothing changes."""
    for _ in range(200):
        extra = nonlinear_yield(drive, tau) - slipping(drive.slip, drive.slip_torque, tau)
        new = press(C, drive.gap, ahead - extra, tau, 1e-10)
        if float(np.max(np.abs(new - tau) @ np.diag(np.diag(C)))) < 1e-9:
            return new
        tau = new
    raise RuntimeError("the clamped equilibrium with nonlinear springs did not settle")
