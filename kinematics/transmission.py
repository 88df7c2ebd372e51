"""
The gears between motors and joints: θ_joint = Tᵀ·θ_motor and τ_motor = T·τ_joint.

The two go together because power is conserved. The thesis prints the first one the other way round; why this is the
consistent reading is in appendix_data/DERIVATION.md.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from kinematics.typing_ import Array, frozen_array

__all__ = ["Transmission"]


@dataclass(frozen=True, eq=False)
class Transmission:
    """
    An ideal transmission, motors on one side, joints on the other.

    Attributes
    ----------
    T
        Matrix (n, n) [joint rad (or m) per motor rad]; T[i, j] is what motor i turns joint j. Not necessarily diagonal:
        in a wrist whose shafts run through each other, motor 4 turns joints 5 and 6 as well.

    Raises
    ------
    ValueError
        If T is not square, not finite, or cannot be inverted.

    Notes ----- All methods take arrays (..., n) and act on the last axis. Source: Calibration and Implementation of
    Robot for Detection of X-rays (thesis), appendix, in its consistent form (appendix_data/DERIVATION.md).
    """

    T: Array

    def __post_init__(self) -> None:
        T = frozen_array(self.T)
        if T.ndim != 2 or T.shape[0] != T.shape[1]:
            raise ValueError(f"transmission: expected a square matrix, found shape {T.shape}")
        if not np.all(np.isfinite(T)) or np.linalg.matrix_rank(T / np.abs(T).max(initial=1e-300)) < len(T):
            raise ValueError("transmission: expected an invertible matrix of finite numbers, found one that is not")
        object.__setattr__(self, "T", T)

    @cached_property
    def inverse(self) -> Array:
        """The inverse of T (n, n), motor rad per joint rad."""
        return frozen_array(np.linalg.inv(self.T))

    def joint_from_motor(self, motor: npt.ArrayLike) -> Array:
        """Give joint angles (..., n) [rad] from motor-shaft angles (..., n) [rad]: θ_joint = Tᵀ·θ_motor."""
        return np.asarray(np.asarray(motor, dtype=np.float64) @ self.T)

    def motor_from_joint(self, joint: npt.ArrayLike) -> Array:
        """Give motor-shaft angles (..., n) [rad] from joint angles (..., n) [rad]: θ_motor = T⁻ᵀ·θ_joint."""
        return np.asarray(np.asarray(joint, dtype=np.float64) @ self.inverse)

    def motor_torque(self, joint_torque: npt.ArrayLike) -> Array:
        """Give motor-shaft torques (..., n) [Nm] from joint torques (..., n) [Nm]: τ_motor = T·τ_joint."""
        return np.asarray(np.asarray(joint_torque, dtype=np.float64) @ self.T.T)

    def joint_torque(self, motor_torque: npt.ArrayLike) -> Array:
        """Give joint torques (..., n) [Nm] from motor-shaft torques (..., n) [Nm]: τ_joint = T⁻¹·τ_motor."""
        return np.asarray(np.asarray(motor_torque, dtype=np.float64) @ self.inverse.T)

    def joint_compliance(self, motor_spring: npt.ArrayLike) -> Array:
        """
        Give the compliance at the joints of springs at the motors, Tᵀ·diag(1/k)·T: not diagonal in a coupled wrist.

        Parameters
        ----------
        motor_spring
            Spring constants (n,) at the motor shafts [Nm/rad].

        Returns
        -------
        Array
            Symmetric matrix (n, n) [rad/Nm]: joint deflection per joint torque.

        Raises
        ------
        ValueError
            If a spring constant is not positive, or there are not n of them.
        """
        k = np.asarray(motor_spring, dtype=np.float64)
        if k.shape != (len(self.T),) or not np.all(k > 0):
            raise ValueError(f"motor springs: expected {len(self.T)} positive constants, found {k.tolist()}")
        return np.asarray(self.T.T @ (self.T / k[:, None]))
