"""Which of the eight postures: the nearest to a given one, a fixed side of axis 5, KUKA's Status and Turn, or all."""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import numpy as np
import numpy.typing as npt

from offline_ik.errors import TargetError
from offline_ik.inverse.ortho import SIGNS, OrthoArm, signs_of

__all__ = ["Choice", "candidate_turns", "parse_choice", "status_and_turn"]

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Choice:
    """What a posture must be.

    Attributes
    ----------
    kind
        ``nearest`` to the posture at hand, ``axis5+``, ``axis5-``, ``status`` or ``all``.
    status, turn
        KUKA's bits, where ``kind`` is ``status``; turn None: any.
    """

    kind: Literal["nearest", "axis5+", "axis5-", "status", "all"] = "nearest"
    status: int = 0
    turn: int | None = None

    def allows(self, ortho: OrthoArm | None, q: Array) -> bool:
        """Whether a posture ``(n,)`` of the chain is one of those asked for."""
        match self.kind:
            case "axis5+":
                return bool(q[4] >= 0)
            case "axis5-":
                return bool(q[4] < 0)
            case "status":
                status, turn = status_and_turn(ortho, q)
                return status == self.status and self.turn in (None, turn)
            case _:
                return True


@lru_cache  # the same few all the time
def parse_choice(text: str) -> Choice:
    """Read ``nearest``, ``all``, ``axis5+``, ``axis5-``, ``S2`` or ``S2T35`` (bits as decimal numbers).

    Raises
    ------
    TargetError
        It is none of these.
    """
    match text:
        case "nearest" | "all" | "axis5+" | "axis5-":
            return Choice(text)
        case _:
            found = re.fullmatch(r"[Ss](\d+)(?:[Tt](\d+))?", text)
            if found and int(found[1]) < 8 and int(found[2] or 0) < 64:
                return Choice("status", int(found[1]), None if found[2] is None else int(found[2]))
            raise TargetError(
                f"branch: expected nearest, all, axis5+, axis5-, or Status and Turn as S2 or S2T35 (0 to 7, 0 to 63), "
                f"found {text!r}"
            )


def status_and_turn(ortho: OrthoArm | None, q: Array, branch: int | None = None) -> tuple[int, int]:
    """KUKA's Status and Turn of a posture of the chain; ``branch`` is its number, where that is known.

    Status bit 0: the wrist's centre lies behind axis 1; bit 1: A3 is at or beyond the angle at which the arm is
    stretched; bit 2: A5 is negative (or at least 180°). Turn bit i: joint i + 1 is negative. Source: KUKA System
    Software, operating and programming instructions for integrators, chapter on Status and Turn.
    """
    angles = q.tolist()
    turn = 0
    for i, angle in enumerate(angles):
        turn |= (angle < 0) << i
    a5 = angles[4] if len(angles) > 4 else 0.0
    status = 4 if -np.pi <= a5 < 0 or a5 >= np.pi else 0
    if ortho is not None:
        shoulder = signs_of(ortho, q)[0] if branch is None else SIGNS[branch, 0]
        status |= (1 if shoulder != ortho.front else 0) | (2 if angles[2] >= ortho.stretched else 0)
    return status, turn


def candidate_turns(q: Array, near: Array, lower: Array, upper: Array) -> Array | None:
    """The posture ``(n,)`` with every joint in the turn within its limits that is nearest to ``near``; None: none."""
    out = np.empty_like(q)
    for i, value in enumerate(q):
        low, high = lower[i], upper[i]
        if not np.isfinite(low) or not np.isfinite(high):
            out[i] = near[i] + (value - near[i] + np.pi) % (2 * np.pi) - np.pi
            continue
        first = int(np.ceil((low - value) / (2 * np.pi) - 1e-12))
        last = int(np.floor((high - value) / (2 * np.pi) + 1e-12))
        if first > last:
            return None
        wished = round((near[i] - value) / (2 * np.pi))
        out[i] = value + 2 * np.pi * min(max(wished, first), last)
    return out
