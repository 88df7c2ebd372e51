"""Wrong calls, and which errors mean that the input or the call is wrong (exit code 2) and not the program (1)."""

from __future__ import annotations

import errno
import sys

from clampid.wrong_call import CallError

__all__ = ["CallError", "is_wrong_input"]


_WRONG_INPUT = (
    ("experiments.errors", "CampaignError"),
    ("experiments.targets", "OutputError"),
    ("experiments.plans.errors", "PlanError"),
    ("experiments.simulate", "SimulationError"),
    ("kinematics.robot", "DescriptionError"),
    ("kinematics.dh_conversion", "DHError"),
    ("kinematics.kuka", "MachineDataError"),
    ("clampid.effect", "EffectError"),
    ("clampid.models.model", "ModelError"),
    ("clampid.fitting.solve", "FitError"),
)
_WRONG_PLACE = (FileNotFoundError, FileExistsError, PermissionError, IsADirectoryError, NotADirectoryError)
_WRONG_NAME = (errno.ENAMETOOLONG, errno.ELOOP, errno.EILSEQ)


def is_wrong_input(error: BaseException) -> bool:
    """Whether an error is the caller's. Looks only at modules already imported: one that raised has been."""
    known = (getattr(sys.modules.get(module), name, None) for module, name in _WRONG_INPUT)
    if isinstance(error, OSError) and error.errno in _WRONG_NAME:
        return True
    return isinstance(error, (CallError, *_WRONG_PLACE, *(kind for kind in known if isinstance(kind, type))))
