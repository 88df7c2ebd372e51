"""The quantities of a command outside the range on which a model was identified: :mod:`clampid.models.ranges`.

Angles and the torques of the weight are a matter of each posture: one small kernel has them and says whether any is
beyond. Temperatures and the tool's mass are the same for all postures.
"""

from __future__ import annotations

import casadi as ca
import numpy as np
import numpy.typing as npt

from clampid.models.ranges import QUANTITIES, Beyond, Ranges, doubt, empirical, place_of, reads_temperature
from experiments.temperatures import REFERENCE_TEMPERATURE
from offline_ik.arm.identified import IdentifiedArm
from offline_ik.arm.kernel import Kernel
from offline_ik.arm.loads_sx import Loads

__all__ = ["Outside", "outside_of"]

Array = npt.NDArray[np.float64]


class Outside:
    """What of a posture is outside the ranges on which the arm's model was identified.

    Parameters
    ----------
    arm
        Its ranges are known.
    """

    def __init__(self, arm: IdentifiedArm, ranges: Ranges) -> None:
        self.ranges, self.theta = ranges, arm.theta
        self.empirical = empirical(arm.slots, arm.effects)
        where = zip(self.empirical.kind.tolist(), self.empirical.place.tolist(), strict=True)
        self.doubtful = {(QUANTITIES[kind], place_of(kind, index)) for kind, index in where}
        self.reads_temperature = reads_temperature(arm.slots, arm.effects)
        self.mass = ranges.beyond_mass(float(arm.tool[0]))
        self.kernel = _kernel(arm, ranges)

    def posture(self, q: Array) -> tuple[Beyond, ...]:
        """Angles and torques beyond at ``q`` ``(n,)``, rad; nothing where all are inside, within 1 µs."""
        kernel = self.kernel
        kernel.row[:] = q
        kernel.trigger()
        if not kernel.out[0][0]:
            return ()
        n = len(q)
        values = np.full((3, n), np.nan)
        values[:2] = kernel.out[1].reshape(2, n)
        return self.ranges.beyond(values)

    def surroundings(self, link_temperature: Array | None) -> tuple[Beyond, ...]:
        """The tool and, ``(n,)``, °C, temperatures beyond.

        Where nobody says how warm the links are, they count as of 20 °C if the model reads that.
        """
        n = self.ranges.lower.shape[1]
        values = np.full((3, n), np.nan)
        if link_temperature is not None:
            values[2] = link_temperature
        elif self.reads_temperature:
            values[2] = REFERENCE_TEMPERATURE
        return (*self.ranges.beyond(values), *self.mass)

    def widens(self, beyond: tuple[Beyond, ...]) -> bool:
        """Whether an empirical effect of the model is extrapolated."""
        return any((one.quantity, one.at) in self.doubtful for one in beyond)

    def widening(self, J: Array, q: Array, link_temperature: Array) -> Array:
        """Covariance ``(6, 6)`` that extrapolation of empirical effects adds; zero inside the range.

        Parameters
        ----------
        J
            ``(6, E)``: derivative of the pose by the amplitudes of :attr:`empirical`, in the covariance's axes.
        q
            ``(n,)``, rad.
        link_temperature
            ``(n,)``, less 20 °C, K.
        """
        self.kernel.one(q)
        values = np.vstack([self.kernel.out[1].reshape(2, -1), link_temperature + REFERENCE_TEMPERATURE])
        moved = J * doubt(self.empirical, self.theta, self.ranges.distance(values))
        return np.asarray(moved @ moved.T)


def outside_of(arm: IdentifiedArm) -> Outside | None:
    """Of an arm; None where its model does not say what it was identified on."""
    return None if arm.ranges is None else Outside(arm, arm.ranges)


def _kernel(arm: IdentifiedArm, ranges: Ranges) -> Kernel:
    """Rows q ``(n,)`` to (whether anything is beyond) and values ``(2 n,)``: angles turned to their ranges, torques.

    The torques are those of :attr:`clampid.stages.rows.Rows.signals`: of the described links with the declared tool.
    """
    q = ca.SX.sym("q", arm.n)
    whole = ca.floor((q - ca.DM(ranges.middle[0])) / (2 * np.pi) + 0.5)
    turned = q - 2 * np.pi * ca.DM(ranges.turns.astype(float)) * whole
    values = ca.vertcat(turned, Loads(arm.robot, arm.gravity, arm.tool, q).signal("gravity_torque"))
    middle, reach = (ca.DM(np.concatenate(part[:2])) for part in (ranges.middle, ranges.reach))
    far = ca.mmax(ca.fabs(values - middle) - reach) > 0
    return Kernel(ca.Function("beyond", [q], ca.cse([ca.densify(far), ca.densify(values)])))
