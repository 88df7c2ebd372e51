"""Units in which a person gives and reads angles and distances; inside, and in files, all is in radians and metres."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import typer

__all__ = ["Degrees", "GivenDegrees", "GivenMillimetres", "Millimetres", "Units"]

Degrees = Annotated[bool, typer.Option("--deg", help="Angles are given and printed in degrees, not radians.")]
Millimetres = Annotated[bool, typer.Option("--mm", help="Distances are given and printed in millimetres, not metres.")]
GivenDegrees = Annotated[bool, typer.Option("--deg", help="Angles are given in degrees, not radians.")]
GivenMillimetres = Annotated[bool, typer.Option("--mm", help="Distances are given in millimetres, not metres.")]
"""Of verbs that print every number in a unit that suits its size."""


@dataclass(frozen=True)
class Units:
    """Whether angles are in degrees, and distances in millimetres."""

    degrees: bool = False
    millimetres: bool = False

    def radians(self, angle: float) -> float:
        """An angle that was given, rad."""
        return math.radians(angle) if self.degrees else angle

    def metres(self, distance: float) -> float:
        """A distance that was given, m."""
        return distance / 1000.0 if self.millimetres else distance

    def lengths(self, numbers: Sequence[float] | None) -> tuple[float, ...] | None:
        """Distances that were given, m; None where the option was not."""
        return None if numbers is None else tuple(map(self.metres, numbers))

    def angles(self, numbers: Sequence[float] | None) -> tuple[float, ...] | None:
        """Angles that were given, rad; None where the option was not."""
        return None if numbers is None else tuple(map(self.radians, numbers))

    def cone(self, numbers: Sequence[float] | None) -> tuple[float, ...] | None:
        """An axis x, y, z and the angle about it, which alone has a unit: rad."""
        return None if numbers is None else (*numbers[:3], *map(self.radians, numbers[3:]))

    def part_of_sphere(self, numbers: Sequence[float] | None) -> tuple[float, ...] | None:
        """A centre and two radii, m, and a :meth:`cone` where there is one."""
        if numbers is None:
            return None
        return (*map(self.metres, numbers[:5]), *(self.cone(numbers[5:]) or ()))

    def angle(self, radians: float, decimals: int = 6) -> str:
        """An angle for people: of a joint as fine in degrees as ``decimals`` of a radian are."""
        number = self.bare_angle(radians, decimals)
        return f"{number} {self.angle_unit}"

    def bare_angle(self, radians: float, decimals: int = 6) -> str:
        """The same without its unit."""
        return f"{math.degrees(radians):.{decimals - 2}f}" if self.degrees else f"{radians:.{decimals}f}"

    def distance(self, metres: float) -> str:
        """A distance for people, to a tenth of a millimetre."""
        return f"{1000.0 * metres:.1f} mm" if self.millimetres else f"{metres:.4f} m"

    @property
    def angle_unit(self) -> str:
        """The sign of the unit of angles."""
        return "deg" if self.degrees else "rad"

    @property
    def distance_unit(self) -> str:
        """The sign of the unit of distances."""
        return "mm" if self.millimetres else "m"

    @property
    def options(self) -> Sequence[str]:
        """The options that ask for these units."""
        return [*(["--deg"] if self.degrees else []), *(["--mm"] if self.millimetres else [])]
