"""What can be wrong with a call or with what a client sends."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

__all__ = ["ControllerError", "DocumentError"]


class ControllerError(ValueError):
    """The virtual controller cannot be started as asked; the message says what was expected."""


class DocumentError(ValueError):
    """A client sent what EthernetKRL does not take; the connection is closed.

    Attributes
    ----------
    whole
        The documents that were whole before it, values by path.
    """

    whole: Sequence[Mapping[str, int | float | bool | str]] = ()
