"""The detector's spherical coordinates: (gamma, delta, r) to a pose and back, by an explicit convention.

The laboratory frame has z along the beam, y up and x = y × z. The detector stands at ``sample + r u``, its normal
(its z axis) points back at the sample, z = -u, and at gamma = delta = 0 its x axis points down. Two circles carry it::

    gamma_outer   R = Ry(-s_g gamma) Rx(-s_d delta) R_0      u = (-sin(s_g gamma) cos(s_d delta), sin(s_d delta), …)
    delta_outer   R = Rx(-s_d delta) Ry(-s_g gamma) R_0      u = (-sin(s_g gamma), sin(s_d delta) cos(s_g gamma), …)

Public sources of one beamline differ in just this order, by 55 mm at a metre at (30°, 20°), so that a convention is
never assumed: it is a value, and is written with every result. In the convention ``thesis`` (beam horizontal in the
robot's base, gamma positive about +z) R is the matrix that the thesis commands, with A = azimuth of the beam + gamma +
pi, B = pi/2 + delta, C = 0.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Any, Literal

import casadi as ca
import numpy as np
import numpy.typing as npt

from offline_ik.errors import CellError, TargetError

__all__ = [
    "CONVENTIONS",
    "Convention",
    "DetectorAngles",
    "check_target",
    "detector_angles",
    "detector_pose",
    "pose_sx",
]

Array = npt.NDArray[np.float64]
Order = Literal["gamma_outer", "delta_outer"]
Frame = Literal["base", "instrument"]

R_MAX = 10.0  # m: no arm here reaches as far; a larger r is in millimetres
REAL = (float, int, np.floating, np.integer)
AT_ZERO = np.array([[0.0, -1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
"""The detector at gamma = delta = 0 in the laboratory's axes: x down, y against up × beam, z against the beam."""
_SQUARE = 1e-6  # rad, how far beam and up may be from perpendicular
_POLE = 1e-12  # of the inner circle's radius, below which the outer angle is undefined


@dataclass(frozen=True)
class Convention:
    """How two angles and a distance become a place.

    Attributes
    ----------
    name
        Of the convention it derives from.
    order
        Which circle carries the other.
    gamma_sign, delta_sign
        +1 as in :mod:`offline_ik.cell.coordinates`, or -1.
    beam, up
        Unit vectors ``(3,)`` in ``frame``, perpendicular to each other.
    sample
        The scattering point ``(3,)`` in ``frame``, m.
    frame
        ``base``: the robot's calibrated base; ``instrument``: that of the instrument the model was measured with.
    """

    name: str = "thesis"
    order: Order = "gamma_outer"
    gamma_sign: int = -1
    delta_sign: int = 1
    beam: tuple[float, float, float] = (1.0, 0.0, 0.0)
    up: tuple[float, float, float] = (0.0, 0.0, 1.0)
    sample: tuple[float, float, float] = (0.0, 0.0, 0.0)
    frame: Frame = "base"
    lab: Array = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        if self.order not in ("gamma_outer", "delta_outer"):
            raise CellError(f"convention: expected the order gamma_outer or delta_outer, found {self.order!r}")
        if self.frame not in ("base", "instrument"):
            raise CellError(f"convention: expected the frame base or instrument, found {self.frame!r}")
        for name in ("gamma_sign", "delta_sign"):
            if getattr(self, name) not in (-1, 1):
                raise CellError(f"convention: expected {name} +1 or -1, found {getattr(self, name)!r}")
        vectors = {name: _vector(name, getattr(self, name)) for name in ("beam", "up", "sample")}
        for name in ("beam", "up"):
            length = float(np.linalg.norm(vectors[name]))
            if not 0.5 < length < 2.0:
                raise CellError(f"convention: expected {name} a unit vector, found one of length {length:g}")
            vectors[name] = vectors[name] / length
        if abs(float(vectors["beam"] @ vectors["up"])) > _SQUARE:
            raise CellError("convention: expected up perpendicular to the beam: give the upward normal of the beam")
        for name, vector in vectors.items():
            object.__setattr__(self, name, tuple(vector.tolist()))
        z, y = vectors["beam"], vectors["up"]
        object.__setattr__(self, "lab", np.column_stack([np.cross(y, z), y, z]))

    def with_sample(self, sample: npt.ArrayLike) -> Convention:
        """The same convention about another scattering point ``(3,)``, m."""
        x, y, z = _vector("sample", sample).tolist()
        return replace(self, sample=(x, y, z))

    def to_json(self) -> dict[str, Any]:
        """Everything that a result must say about its coordinates."""
        return {
            "name": self.name,
            "order": self.order,
            "gamma_sign": self.gamma_sign,
            "delta_sign": self.delta_sign,
            "beam": list(self.beam),
            "up": list(self.up),
            "sample_m": list(self.sample),
            "frame": self.frame,
            "direction": "u = outer(inner(beam)); lab axes x = up × beam, y = up, z = beam; signs +1: gamma turns "
            "about -y, delta about -x",
            "detector": "at sample + r u, z axis at the sample; x axis down at gamma = delta = 0; roll turns about z",
        }


@dataclass(frozen=True)
class DetectorAngles:
    """Where a pose of the detector is on the sphere.

    Attributes
    ----------
    gamma, delta, roll
        rad; the outer angle is 0 where the inner circle's pole leaves it undefined.
    r
        Distance from the sample, m.
    tilt
        ``(2,)``: how far the normal misses the sample, about the detector's x and y, rad.
    """

    gamma: float
    delta: float
    r: float
    roll: float
    tilt: tuple[float, float]


def detector_pose(
    convention: Convention, gamma: float | Array, delta: float | Array, r: float | Array, roll: float | Array = 0.0
) -> Array:
    """Pose of the detector in the convention's frame.

    Parameters
    ----------
    gamma, delta, roll
        Angles, rad; any shapes that broadcast.
    r
        Distance from the sample, m.

    Returns
    -------
    Array
        ``(..., 4, 4)``.
    """
    g, d, r, roll = np.broadcast_arrays(*(np.asarray(v, dtype=float) for v in (gamma, delta, r, roll)))
    out = np.zeros((*g.shape, 4, 4))
    out[..., 3, 3] = 1.0
    R = _carried(convention, g, d)
    out[..., :3, 3] = np.asarray(convention.sample) - r[..., None] * R[..., :, 2]
    out[..., :3, :3] = R @ _about_z(roll)
    return out


def pose_sx(convention: Convention, gamma: Any, delta: Any, r: Any, roll: Any) -> tuple[Any, Any]:
    """As :func:`detector_pose`, as casadi expressions: rotation ``(3, 3)`` and position ``(3,)``."""
    g, d = -convention.gamma_sign * gamma, -convention.delta_sign * delta
    cg, sg, cd, sd, c, s = ca.cos(g), ca.sin(g), ca.cos(d), ca.sin(d), ca.cos(roll), ca.sin(roll)
    Ry = ca.blockcat([[cg, 0, sg], [0, 1, 0], [-sg, 0, cg]])
    Rx = ca.blockcat([[1, 0, 0], [0, cd, -sd], [0, sd, cd]])
    turned = Ry @ Rx if convention.order == "gamma_outer" else Rx @ Ry
    R = ca.DM(convention.lab) @ turned @ ca.DM(AT_ZERO) @ ca.blockcat([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    return R, ca.DM(convention.sample) - r * R[:, 2]


def detector_angles(convention: Convention, pose: Array) -> DetectorAngles:
    """The inverse of :func:`detector_pose`, for any pose ``(4, 4)`` that is not at the sample.

    Raises
    ------
    TargetError
        The pose is at the sample itself.
    """
    v = np.asarray(convention.lab).T @ (np.asarray(pose)[:3, 3] - np.asarray(convention.sample))
    r = float(np.linalg.norm(v))
    if not r > 0:
        raise TargetError("the detector is at the sample: no angles lead there")
    x, y, z = (v / r).tolist()
    if convention.order == "gamma_outer":
        delta, rest = math.atan2(y, math.hypot(x, z)), math.hypot(x, z)
        gamma = math.atan2(-x, z) if rest > _POLE else 0.0
    else:
        gamma, rest = math.atan2(-x, math.hypot(y, z)), math.hypot(y, z)
        delta = math.atan2(y, z) if rest > _POLE else 0.0
    gamma, delta = convention.gamma_sign * gamma, convention.delta_sign * delta
    M = _carried(convention, np.asarray(gamma), np.asarray(delta)).T @ np.asarray(pose)[:3, :3]
    roll = math.atan2(M[1, 0] - M[0, 1], M[0, 0] + M[1, 1])
    normal = M[:, 2]  # the detector's normal in the frame of the ideal one
    return DetectorAngles(gamma, delta, r, roll, (float(-normal[1]), float(normal[0])))


def check_target(gamma: float, delta: float, r: float, roll: float = 0.0) -> None:
    """Refuse coordinates that cannot be meant.

    Raises
    ------
    TargetError
        Not finite, an angle beyond ±pi, r not positive or beyond 10 m; asks whether degrees or millimetres were meant.
    """
    for name, value in (("gamma", gamma), ("delta", delta), ("r", r), ("roll", roll)):
        if isinstance(value, bool) or not isinstance(value, REAL) or not math.isfinite(value):
            raise TargetError(f"{name}: expected a finite number, found {value!r}")
    for name, value in (("gamma", gamma), ("delta", delta), ("roll", roll)):
        if abs(value) > math.pi:
            hint = ""
            if abs(value) <= 360.0:
                hint = f"; did you mean {value:g} degrees, that is {math.radians(value):.6g}?"
            raise TargetError(f"{name}: expected radians from -pi to pi, found {value:g}{hint}")
    if not r > 0:
        raise TargetError(f"r: expected a positive distance in metres, found {r:g}")
    if r > R_MAX:
        hint = f"; did you mean {r:g} mm, that is {r / 1000:g} m?" if r / 1000 <= R_MAX else ""
        raise TargetError(f"r: expected a distance in metres of at most {R_MAX:g}, found {r:g}{hint}")


def _vector(name: str, value: npt.ArrayLike) -> Array:
    try:
        vector = np.asarray(value, dtype=float)
    except (TypeError, ValueError):
        raise CellError(f"convention: expected {name} as three numbers, found {value!r}") from None
    if vector.shape != (3,) or not np.isfinite(vector).all():
        raise CellError(f"convention: expected {name} as three finite numbers, found {value!r}")
    return vector


def _carried(convention: Convention, gamma: Array, delta: Array) -> Array:
    """Orientations ``(..., 3, 3)`` at roll 0, in the convention's frame."""
    g, d = -convention.gamma_sign * gamma, -convention.delta_sign * delta
    cg, sg, cd, sd, one, nil = np.cos(g), np.sin(g), np.cos(d), np.sin(d), np.ones_like(g), np.zeros_like(g)
    Ry = _stack([[cg, nil, sg], [nil, one, nil], [-sg, nil, cg]])
    Rx = _stack([[one, nil, nil], [nil, cd, -sd], [nil, sd, cd]])
    turned = Ry @ Rx if convention.order == "gamma_outer" else Rx @ Ry
    return np.asarray(convention.lab @ turned @ AT_ZERO)


def _about_z(angle: Array) -> Array:
    c, s, one, nil = np.cos(angle), np.sin(angle), np.ones_like(angle), np.zeros_like(angle)
    return _stack([[c, -s, nil], [s, c, nil], [nil, nil, one]])


def _stack(rows: list[list[Array]]) -> Array:
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


CONVENTIONS: Mapping[str, Convention] = MappingProxyType(
    {
        "thesis": Convention("thesis", "gamma_outer", gamma_sign=-1),
        "nanomax": Convention("nanomax", "gamma_outer", gamma_sign=1),
        "nanomax_reversed": Convention("nanomax_reversed", "delta_outer", gamma_sign=1),
    }
)
"""Named conventions. ``nanomax`` is that of bcdi and cdiutils, ``nanomax_reversed`` that of another public script set
of the same beamline. Beam, up and sample are placeholders: they belong to a cell."""
