"""The few symbolic operations that effects are written in, over casadi.

Effects import these and nothing else symbolic, so that an effect's file reads like its formula.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import product
from math import pi
from typing import Any

import casadi as ca
import numpy as np
from scipy.interpolate import CubicSpline

__all__ = [
    "across_rows",
    "along",
    "at_link",
    "at_place",
    "before",
    "columns",
    "combined",
    "cos",
    "cross",
    "cross_rows",
    "dot",
    "exp",
    "fabs",
    "floor",
    "fmax",
    "fourier",
    "harmonics",
    "interleave",
    "log",
    "norm",
    "norms",
    "pi",
    "powers",
    "products",
    "rows",
    "shifted_down",
    "shifted_up",
    "sin",
    "sliding",
    "spline",
    "tanh",
    "turned_by",
    "turning",
    "winding",
    "within",
]

Terms = Mapping[str, Any]
"""Terms of a shape by name, none of them constant: what a free factor each makes any smooth function of."""

sin, cos, exp, log, fabs, floor, fmax, tanh = ca.sin, ca.cos, ca.exp, ca.log, ca.fabs, ca.floor, ca.fmax, ca.tanh


def rows(*parts: Any) -> Any:
    """Stack scalars or columns on top of each other."""
    return ca.vertcat(*parts)


def columns(*parts: Any) -> Any:
    """Stand columns ``(n,)`` side by side: ``(n, k)``."""
    return ca.horzcat(*parts)


def dot(a: Any, b: Any) -> Any:
    """Inner product of two columns."""
    return ca.dot(a, b)


def norm(a: Any) -> Any:
    """Length of a column; of one that is zero, zero, with no derivative."""
    return ca.sqrt(ca.fmax(ca.sumsqr(a), 1e-300))


def cross(a: Any, b: Any) -> Any:
    """Cross product of two columns of three."""
    return ca.cross(a, b)


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


def before(twists: Any, link_vectors: Any) -> Any:
    """Link twists ``(n, 6)`` that turn each link at its near joint instead, as motions of its far end.

    A turn w at the joint moves the far end by w x d.
    """
    w = twists[:, :3]
    return ca.horzcat(w, twists[:, 3:] + cross_rows(w, link_vectors))


def cross_rows(a: Any, b: Any) -> Any:
    """Cross products of the rows of ``(n, 3)`` with those of ``(n, 3)``."""
    return ca.horzcat(
        a[:, 1] * b[:, 2] - a[:, 2] * b[:, 1],
        a[:, 2] * b[:, 0] - a[:, 0] * b[:, 2],
        a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0],
    )


def across_rows(vectors: Any, axes: Any) -> Any:
    """The rows of ``(n, 3)`` less their parts along the rows of ``axes`` ``(n, 3)``; whole where an axis is zero."""
    length = ca.sum2(axes**2)
    share = ca.sum2(vectors * axes) / ca.if_else(length > 0, length, 1)
    return vectors - ca.horzcat(*(share * axes[:, k] for k in range(3)))


def norms(vectors: Any) -> Any:
    """Lengths ``(n,)`` of the rows of ``(n, 3)``."""
    return ca.sqrt(ca.sum2(vectors**2))


def turned_by(angle: Any) -> Any:
    """An angle less whole turns: within half a turn to either side, rad."""
    return ca.atan2(ca.sin(angle), ca.cos(angle))


def within(value: Any, lower: Any, upper: Any) -> Any:
    """1 where ``lower < value < upper``, else 0."""
    return ca.if_else(ca.logic_and(value > lower, value < upper), 1.0, 0.0)


def shifted_up(column: Any) -> Any:
    """``(0, c_1, …, c_(n-1))``: each entry is the one before it."""
    return ca.vertcat(0, column[:-1])


def shifted_down(column: Any) -> Any:
    """``(c_2, …, c_n, 0)``: each entry is the one after it."""
    return ca.vertcat(column[1:], 0)


def at_place(number: int, value: Any, x: Any) -> Any:
    """``(n,)``: a scalar at joint or motor ``number``, from 1, and nothing at the others."""
    column = ca.SX(x.transmission.shape[0], 1)
    column[number - 1] = value
    return column


def at_link(number: int, motion: Sequence[Any], x: Any) -> Any:
    """Link twists ``(n, 6)``: a motion of the far end of link ``number``, from 1, and no other; 0 is the last one."""
    twists = ca.SX(x.transmission.shape[0], 6)
    twists[number - 1, :] = ca.horzcat(*motion)
    return twists


def harmonics(angle: Any, orders: int) -> list[tuple[Any, Any]]:
    """(sin k u, cos k u) for k = 1 ... orders, each turned on from the one before: a sine takes ten times as long.

    The rounding grows with the order, to some 1e-15 times k.
    """
    s, c = sin(angle), cos(angle)
    out = [(s, c)]
    for _ in range(orders - 1):
        a, b = out[-1]
        out.append((a * c + b * s, b * c - a * s))
    return out


def fourier(name: str, angle: Any, orders: int) -> dict[str, Any]:
    """``sin_q4``, ``cos_q4``, ``sin_2q4``, … up to ``orders`` a turn."""
    found: dict[str, Any] = {}
    for k in range(1, orders + 1):
        label = name if k == 1 else f"{k}{name}"
        found |= {f"sin_{label}": sin(k * angle), f"cos_{label}": cos(k * angle)}
    return found


def winding(name: str, angle: Any, orders: int) -> dict[str, Any]:
    """``q4``, ``sin_q4``, ``cos_q4``, …: of a joint that turns more than once, at which a cable is not what it was."""
    return {name: angle, **fourier(name, angle, orders)}


def spline(value: Any, nodes: Iterable[float]) -> list[Any]:
    """Weight of each node in a natural cubic spline at ``value``, which must lie between the first and last node.

    Weights add up to one. They bend smoothly, so that a search for ``value`` takes few steps. As truncated powers:
    a + b (x - x_0) + sum c_j (x - x_j)^3 over the nodes below x.
    """
    x = np.array(list(nodes))
    through = CubicSpline(x, np.eye(len(x)), bc_type="natural")
    bends = np.diff(through.c[0], axis=0, prepend=0.0)  # (nodes - 1, nodes)
    steps = [fmax(0.0, value - node) ** 3 for node in x[:-1]]
    lines = zip(through(x[0]), through(x[0], 1), bends.T, strict=True)
    return [a + b * (value - x[0]) + sum(c * step for c, step in zip(own, steps, strict=True)) for a, b, own in lines]


def powers(name: str, value: Any, orders: int) -> dict[str, Any]:
    """``time``, ``time_2``, … up to the power ``orders``; ``value`` is to be of order one."""
    return {name if k == 1 else f"{name}_{k}": value**k for k in range(1, orders + 1)}


def sliding(name: str, motion: Any, speed: Any) -> dict[str, Any]:
    """What friction is made of: the sign of the motion, also at standstill, the speed, and its square with its sign."""
    return {f"sign_{name}": motion, name: speed, f"{name}_2": speed * fabs(speed)}


def products(*shapes: Terms) -> dict[str, Any]:
    """All terms, and all products of terms of different variables: any smooth function of them together."""
    found: dict[str, Any] = {}
    for chosen in product(*([*terms.items(), ("", 1.0)] for terms in shapes)):
        name = "_".join(label for label, _ in chosen if label)
        if name:
            value = 1.0
            for _, term in chosen:
                value = value * term
            found[name] = value
    return found


def combined(p: Any, terms: Terms, prefix: str = "") -> Any:
    """The sum of terms, each times the parameter of its name (with a prefix, such as ``rx_``)."""
    return sum(getattr(p, prefix + name) * term for name, term in terms.items())
