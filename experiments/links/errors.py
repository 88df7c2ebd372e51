"""The errors of links, whatever the vendor; each message is one line for a person."""

from __future__ import annotations

__all__ = [
    "CannotError",
    "InterruptedProgramError",
    "LinkError",
    "LinkLostError",
    "NotExecutedError",
    "RefusedError",
    "UnknownFateError",
]


class LinkError(ValueError):
    """Base of all errors of links; the message is one line for a person."""


class LinkLostError(LinkError):
    """There is no connection, or nothing has been heard over it for too long."""


class CannotError(LinkError):
    """A call that the link does not have; its capabilities say so."""


class RefusedError(LinkError):
    """The link or the controller refused: nothing of the program moves, or will."""


class InterruptedProgramError(LinkError):
    """The program began and ended before its last point."""


class NotExecutedError(LinkError):
    """The controller says that the program was never begun, and it never will be."""


class UnknownFateError(LinkError):
    """Whether the program moved the robot is not known: a person has to look, and to confirm."""
