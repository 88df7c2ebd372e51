"""Errors of a call, or of the documents of a client."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

__all__ = ["ControllerError", "DocumentError"]


class ControllerError(ValueError):
    """The virtual controller cannot be started as asked; the message says what was expected."""


class DocumentError(ValueError):
    """A client sent a document that EthernetKRL does not accept; the connection is closed.

    Attributes
    ----------
    whole
        The documents that were whole before it, values by path.
    """

    whole: Sequence[Mapping[str, int | float | bool | str]] = ()
