"""The parts of a detector that do not depend on temperatures: solver, searches and kernels, each made once."""

from __future__ import annotations

from functools import cached_property

import numpy as np
import numpy.typing as npt

from kinematics.robot import RobotDescription
from offline_ik.arm.identified import IdentifiedArm
from offline_ik.arm.kernel import Kernel
from offline_ik.cell.cell import Cell
from offline_ik.cell.checks import check_arm
from offline_ik.cell.frames import Framing
from offline_ik.cell.mount import identified_mount
from offline_ik.inverse.kernels import looking_kernel
from offline_ik.inverse.nearest import Nearest
from offline_ik.inverse.postures import PostureSearch
from offline_ik.inverse.solver import Solver
from offline_ik.inverse.uncertainty import Propagation

__all__ = ["DetectorParts"]

Array = npt.NDArray[np.float64]


class DetectorParts:
    """The parts of a detector that follow from the arm and from all of a cell but its temperatures and running time.

    Parameters
    ----------
    arm, cell
        Of the same robot.

    Attributes
    ----------
    lower, upper
        ``(n,)``, rad: the joints' limits less the cell's margin.
    fastest
        ``(n,)``, rad/s.
    rest
        ``(n,)``, rad: the posture nearest to all joints at zero.
    twin
        The same parts with kernels of their own, for another thread; None until they are wanted.

    Raises
    ------
    DetectorError
        The arm has a joint that is not revolute, or fewer than six.
    """

    def __init__(self, arm: IdentifiedArm, cell: Cell) -> None:
        self.arm, self.cell = arm, cell
        self.robot: RobotDescription = arm.robot
        check_arm(self.robot)
        self.solver = Solver(arm, identified_mount(cell, arm))
        self.lower = self.robot.lower + cell.limit_margin
        self.upper = self.robot.upper - cell.limit_margin
        self.search = PostureSearch(self.solver, self.lower, self.upper)
        self.fastest = np.array([j.max_speed or np.pi for j in self.robot.joints])
        self.rest = np.clip(np.zeros(arm.n), self.lower, self.upper)
        self.twin: DetectorParts | None = None

    @cached_property
    def propagation(self) -> Propagation:
        """From the model's covariance to the detector's."""
        return Propagation(self.solver, self.cell)

    @cached_property
    def nearest(self) -> Nearest | None:
        """Finds the posture next to the one at hand in closed form; None of an arm without one."""
        ortho = self.solver.ortho
        return None if ortho is None else Nearest(ortho, self.search, self.propagation, self.cell)

    @cached_property
    def framing(self) -> Framing:
        """Makes the frames that a controller writes."""
        return Framing(self.robot, self.solver.mount)

    @cached_property
    def looking(self) -> Kernel:
        """See :func:`offline_ik.inverse.kernels.looking_kernel`."""
        return looking_kernel(self.arm, self.solver.mount, self.cell.convention)

    @cached_property
    def to_motor(self) -> Array:
        """``(n, n)``: motor angles from joint angles."""
        return np.linalg.inv(np.asarray(self.robot.transmission))
