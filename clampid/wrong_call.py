"""The error of a call whose arguments make no sense."""

from __future__ import annotations

__all__ = ["CallError"]


class CallError(ValueError):
    """A call that cannot be meant; the message says what was expected. Other packages may derive from it."""
