"""Options that all verbs of ``clampid plan`` share: the robot, its surroundings, and how torques are read."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from clampid.verbs.inputs import numbers_of
from clampid.verbs.units import GivenDegrees, GivenMillimetres, Units

if TYPE_CHECKING:
    from clampid.planning.logs import TorqueNoise
    from clampid.planning.scene import Scene
    from experiments.plans.limits import Limits
    from experiments.plans.model import Cell

__all__ = ["Acceleration", "Effects", "PlanFile", "Surroundings", "TorqueReadings", "names_of"]

PlanFile = Annotated[
    Path, typer.Option("--output", "-o", metavar="PLAN.toml", help="Plan file to write.", show_default=False)
]
Effects = Annotated[
    str | None, typer.Option(metavar="A,B,…", help="Effects to plan for; otherwise the stage's standard set.")
]

Acceleration = Annotated[
    str | None,
    typer.Option(
        metavar="RAD/S2[,…]", help="Accelerations; otherwise top speed is reached in half a second.", show_default=False
    ),
]


@dataclass(frozen=True)
class Surroundings:
    """The robot, how much of its joints' ranges may be used, and what it must not touch."""

    robot: Annotated[str, typer.Option(help="A bundled robot, or the path of a description.")] = "kuka_kr20_r1810"
    like: Annotated[
        Path | None,
        typer.Option(
            metavar="CAMPAIGN", help="Take tool, targets, instrument, gravity from there.", show_default=False
        ),
    ] = None
    range_share: Annotated[
        float, typer.Option(metavar="SHARE", help="Share of each joint's range that may be used.")
    ] = 0.95
    floor: Annotated[
        str | None,
        typer.Option(metavar="M|none", help="Height of the floor over the base; 0 if upright.", show_default=False),
    ] = None
    obstacles: Annotated[
        Path | None, typer.Option(metavar="FILE.toml", help="Boxes, spheres, cylinders to stay clear of.")
    ] = None
    cell_file: Annotated[
        Path | None,
        typer.Option(
            "--cell", metavar="CELL.toml", help="Stay clear of what `ik` and `serve` stay clear of: their cell file.",
            show_default=False,
        ),
    ] = None  # fmt: skip
    arm_radius: Annotated[
        float | None,
        typer.Option(
            metavar="M",
            help="Radius of all links; otherwise the cell file's, or from the reach.",
            show_default=False,
        ),
    ] = None
    deg: GivenDegrees = False
    mm: GivenMillimetres = False

    @property
    def units(self) -> Units:
        """What angles and distances are given in."""
        return Units(self.deg, self.mm)

    def cell(self, acceleration: str | None = None) -> tuple[Cell, Limits, tuple[str, ...]]:
        """Cell and limits, and what had to be assumed; ``acceleration`` as the option of that name."""
        from experiments.plans.cell import cell_of
        from experiments.plans.errors import PlanError
        from experiments.plans.limits import limits_of

        cell, assumed = cell_of(self.robot, self.like)
        given = self.units.angles(numbers_of("--acceleration", acceleration))
        if given is not None and len(given) not in (1, cell.robot.n):
            raise PlanError(f"--acceleration: expected one number or {cell.robot.n}, found {len(given)}")
        limits, more = limits_of(cell.robot, share=self.range_share, acceleration=given)
        return cell, limits, (*assumed, *more)

    def scene(self, cell: Cell) -> Scene:
        """What the arm must not touch."""
        from clampid.planning.obstacle_files import read_obstacles
        from clampid.planning.scene import Scene, usual_floor

        given = None if self.floor in (None, "none") else self.units.lengths(numbers_of("--floor", self.floor))
        floor = None if given is None else given[0]
        around = () if self.obstacles is None else read_obstacles(self.obstacles)
        radius = None if self.arm_radius is None else self.units.metres(self.arm_radius)
        if self.cell_file is not None:
            return Scene.of_cell_file(cell, self.cell_file, around, floor, radius)
        return Scene.around(cell, around, usual_floor(cell) if self.floor is None else floor, radius)


@dataclass(frozen=True)
class TorqueReadings:
    """What the motors are rated for, and how well their torques are read."""

    torque_noise: Annotated[
        float | None,
        typer.Option(
            metavar="SHARE", help="Noise of the motor torques, share of the rated ones; 0.01.", show_default=False
        ),
    ] = None
    rated_torque: Annotated[
        str | None, typer.Option(metavar="NM,…", help="At the joints, where the description has none.")
    ] = None

    @property
    def rated(self) -> tuple[float, ...] | None:
        """Rated joint torques, Nm, or None: the description's."""
        return numbers_of("--rated-torque", self.rated_torque)

    def noise(self, cell: Cell) -> tuple[TorqueNoise, tuple[str, ...]]:
        """Noise of the torques, and what had to be assumed."""
        from clampid.planning.logs import torque_noise_of

        return torque_noise_of(cell, self.torque_noise, self.rated)


def names_of(text: str | None) -> tuple[str, ...] | None:
    """Names separated by commas; None where the option was not given."""
    return None if text is None else tuple(name.strip() for name in text.split(",") if name.strip())
