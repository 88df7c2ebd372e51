"""The one error of measurement plans: it names file and place, what was expected and what was found."""

from __future__ import annotations

__all__ = ["PlanError", "PlanStopped"]


class PlanError(ValueError):
    """A plan is wrong, or a call that makes or runs one."""


class PlanStopped(RuntimeError):  # noqa: N818 - being stopped is no error
    """A run that ended before its plan did; what was measured until then is kept, and the run can be resumed."""
