"""How a run ends before its plan does."""

from __future__ import annotations

__all__ = ["RunStopped"]


class RunStopped(RuntimeError):  # noqa: N818 - being stopped is no error
    """The run stopped safely before the end; what was recorded is kept, and the run can be resumed."""
