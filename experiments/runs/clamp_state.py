"""The state of a clamping campaign, from its journal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

__all__ = ["ClampState", "clamp_state"]


@dataclass
class ClampState:
    """Which sweeps are done, and whether the flange is clamped.

    Attributes
    ----------
    done
        Numbers of sweeps that are finished, or were ended by a limit.
    clamping
        Which place the flange is clamped in; 0: it is free.
    boot
        Of the controller, when it was clamped.
    holding_torque
        Torques of the free arm where it was clamped ``(n,)``, Nm, if they were measured.
    reference
        Where the torque is least ``(n,)``, rad, once that has been found in this clamping.
    current, step
        The sweep that was begun and not finished, and its last recorded step.
    """

    done: set[int] = field(default_factory=set)
    clamping: int = 0
    boot: int | None = None
    holding_torque: list[float] | None = None
    reference: list[float] | None = None
    current: int | None = None
    step: int = 0


def clamp_state(entries: Sequence[Mapping[str, Any]]) -> ClampState:
    """Work out the state from a journal."""
    state = ClampState()
    for entry in entries:
        match entry["what"]:
            case "held":
                state.holding_torque = entry["torque"]
            case "least_torque":
                state.reference = entry["posture"]
            case "clamped":
                state.clamping, state.boot = entry["clamping"], entry["boot"]
            case "released":
                state.clamping, state.holding_torque, state.reference = 0, None, None
            case "row":
                state.current, state.step = entry["key"][1], entry["key"][2]
            case "swept" | "cut":
                state.done.add(entry["sweep"])
                state.current, state.step = None, 0
            case "void":
                state.done -= set(entry["sweeps"])
                if state.current in entry["sweeps"]:
                    state.current, state.step = None, 0
    return state
