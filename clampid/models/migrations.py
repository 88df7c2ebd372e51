"""Model files of earlier versions, brought to the newest."""

from __future__ import annotations

from typing import Any

from kinematics.section import Migration

__all__ = ["MIGRATIONS"]


def _from_1(content: dict[str, Any]) -> dict[str, Any]:
    """Version 1 left out what its writer did not know yet; in version 2 every key is there."""
    layout, stages = _filled(content.get("layout"), {"anchors": []}), content.get("stages")
    new: dict[str, Any] = {"base_parameters": [], "observability": {}}
    new |= dict.fromkeys(("bootstrap", "told", "lean_rad", "by_springs", "ranges"))
    if isinstance(stages, dict):
        stages = {name: _filled(stage, new) for name, stage in stages.items()}
    sessions = content.get("sessions")
    if isinstance(sessions, list):
        sessions = [_filled(one, {"anchors_m": {}, "tool_com_m": None, "gravity_m_s2": None}) for one in sessions]
    whole = _filled(content, {"robot_file": None, "user_effects": None, "joint": False, "seed": 0, "holdout": 0.0})
    return {**whole, "layout": layout, "stages": stages, "sessions": sessions}


def _filled(part: Any, defaults: dict[str, Any]) -> Any:
    return {**defaults, **part} if isinstance(part, dict) else part


MIGRATIONS: dict[int, Migration] = {1: _from_1}
