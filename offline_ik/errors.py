"""The errors of this layer: a request that makes no sense, or one that cannot be fulfilled."""

from __future__ import annotations

from clampid.wrong_call import CallError

__all__ = ["CellError", "DetectorError", "TargetError"]


class DetectorError(CallError):
    """Base of all: the message says what was expected and what was found; the command's exit code is 2."""


class CellError(DetectorError):
    """A description of the cell (convention, mount, obstacles) that contradicts itself, the model or the robot."""


class TargetError(DetectorError):
    """A detector position that cannot be meant: not a number, degrees for radians, millimetres for metres."""
