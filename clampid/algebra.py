"""The few symbolic operations that effects are written in, over casadi.

Effects import these and nothing else symbolic, so that an effect's file reads like its formula.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import casadi as ca

__all__ = ["along", "columns", "cos", "dot", "exp", "fabs", "interleave", "rows", "sin", "tanh"]

sin, cos, exp, fabs, tanh = ca.sin, ca.cos, ca.exp, ca.fabs, ca.tanh


def rows(*parts: Any) -> Any:
    """Stack scalars or columns on top of each other."""
    return ca.vertcat(*parts)


def columns(*parts: Any) -> Any:
    """Stand columns ``(n,)`` side by side: ``(n, k)``."""
    return ca.horzcat(*parts)


def dot(a: Any, b: Any) -> Any:
    """Inner product of two columns."""
    return ca.dot(a, b)


def interleave(*parts: Any) -> Any:
    """``(a1, b1, a2, b2, …)`` from columns a, b of equal length."""
    return ca.vec(ca.horzcat(*parts).T)


def along(lengths: Any, vectors: Any) -> Any:
    """Link twists ``(n, 6)`` that move each link's far end by ``lengths`` times its own vector ``(n, 3)``, unturned."""
    scaled = ca.horzcat(*(lengths * vectors[:, k] for k in range(3)))
    return ca.horzcat(ca.SX(scaled.shape[0], 3), scaled)


def turning(angles: Sequence[Any], shifts: Sequence[Any] | None = None) -> Any:
    """Link twists ``(n, 6)`` from three columns of angles and, where given, three of shifts."""
    n = angles[0].shape[0]
    moved = list(shifts) if shifts is not None else [ca.SX(n, 1)] * 3
    return ca.horzcat(*angles, *moved)
