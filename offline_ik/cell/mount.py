"""Where the detector sits on the flange, corrected by the tracked targets that are fixed to it.

Points alone do not tell how the flange is turned: the identification moves the targets instead, and only the frame that
they make is known. Three targets on the detector's body therefore carry its mount along: the rigid motion that takes
their nominal positions nearest to the identified ones.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from clampid.role_slots import has_role, slot_of
from clampid.stages.pose_rows import align
from kinematics.screws import log_so3
from offline_ik.arm.identified import IdentifiedArm
from offline_ik.cell.cell import Cell
from offline_ik.errors import CellError

__all__ = ["identified_mount", "mount_jacobian"]

Array = npt.NDArray[np.float64]

DIFFERENCE_STEP = 1e-6  # m


def identified_mount(cell: Cell, arm: IdentifiedArm, theta: Array | None = None) -> Array:
    """Pose ``(4, 4)`` of the detector in the flange's frame; the cell's own, where it names no targets.

    Raises
    ------
    CellError
        Fewer than three targets, or one that the model does not know.
    """
    if not cell.targets:
        return np.asarray(cell.mount, dtype=float)
    if len(cell.targets) < 3:
        raise CellError(f"detector.targets_m: expected at least three targets, found {len(cell.targets)}")
    values = dict(zip(arm.slots, (arm.theta if theta is None else theta).tolist(), strict=True))
    nominal = np.array(list(cell.targets.values()))
    shift = np.zeros_like(nominal)
    for i, name in enumerate(cell.targets):
        label = name if len(arm.layout.sessions) == 1 else f"session{arm.session + 1}:{name}"
        if label not in arm.layout.targets:
            known = ", ".join(arm.layout.targets) or "none"
            raise CellError(f"detector.targets_m: the model knows no target {name!r}; it knows: {known}")
        shift[i] = [values.get(slot_of("target_point", label, a), 0.0) for a in "xyz"]
    return np.asarray(align(nominal, nominal + shift) @ cell.mount)


def mount_jacobian(cell: Cell, arm: IdentifiedArm) -> Array:
    """``(6, P)``: d (position, rotation vector) of the mount, flange frame, by the targets' parameters."""
    out = np.zeros((6, len(arm.slots)))
    if not cell.targets:
        return out
    here = identified_mount(cell, arm)
    for k, slot in enumerate(arm.slots):
        if has_role(slot, "target_point"):
            theta = arm.theta.copy()
            theta[k] += DIFFERENCE_STEP
            moved = identified_mount(cell, arm, theta)
            out[:3, k] = (moved[:3, 3] - here[:3, 3]) / DIFFERENCE_STEP
            out[3:, k] = log_so3(moved[:3, :3] @ here[:3, :3].T) / DIFFERENCE_STEP
    return out
